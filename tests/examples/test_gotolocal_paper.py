"""AllenAct's GoToLocal: the batches are its own, and every method updates the whole model."""

import dataclasses

import jax
import numpy as np
import pytest

from examples.babyai_gotolocal_paper import experiments
from jaxact import train
from jaxact.collect import collect
from jaxact.train_state import init_params, make_key


def test_the_numbers_are_allenacts():
    steps = {}
    for name, experiment in experiments.items():
        experiment.check()
        assert experiment.name == f"babyai_gotolocal_paper_{name}"
        pipeline = experiment.pipeline
        steps[name] = pipeline.steps_per_update(pipeline.stages[0])
    on_policy = 128 * 128
    assert steps == {
        "ppo": 1536 * 32,
        "a2c": 768 * 16,
        "bc": on_policy,
        "dagger": on_policy,
        "bc_forced": on_policy,
        "bc_offline": 16 * on_policy // 4,
    }
    # As many updates of demonstrations as there would have been rollouts.
    updates = {n: x.pipeline.updates(x.pipeline.stages[0]) for n, x in experiments.items()}
    assert updates["bc_offline"] == updates["bc"] == 458


def test_the_model_is_as_large_as_documented():
    shapes = jax.eval_shape(lambda: init_params(experiments["ppo"], make_key(0)))
    memory, view, words = 2048, 128, 256
    lstm = shapes["params"]["step"]["lstm"]
    assert lstm["input"]["kernel"].shape == (view, 4 * memory)
    assert shapes["params"]["step"]["query"]["kernel"].shape == (2 * memory, words)
    assert sum(x.size for x in jax.tree.leaves(shapes)) == 20_330_632


@pytest.mark.slow
@pytest.mark.parametrize("name", experiments)
def test_the_whole_model_is_updated(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    experiment = experiments[name]
    (stage,) = experiment.pipeline.stages
    storages = {
        name: dataclasses.replace(storage, lanes=4, length=4, updates=2)
        for name, storage in stage.storages.items()
    }
    for storage in storages.values():
        collect(experiment.pomdp, storage.path, 20, world=name, progress=False)
    stage = dataclasses.replace(stage, steps=1, storages=storages)
    pipeline = dataclasses.replace(
        experiment.pipeline, stages=(stage,), lanes=4, rollout_length=4, epochs=1
    )
    experiment = dataclasses.replace(experiment, pipeline=pipeline)
    result = train(experiment, evaluation_episodes=0, progress=False)
    metrics = result.metrics
    assert np.isfinite([x for n, x in metrics.items() if n.endswith("/total")]).all()
    assert (metrics["train/gradient_norm"] > 0).all()
