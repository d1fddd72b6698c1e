"""Every shipped experiment loads, can work, and trains for an update."""

import dataclasses
import re

import numpy as np
import pytest

from examples import (
    advisor,
    arm_point_nav,
    furnmove,
    hand_manipulation,
    physics_locomotion,
    stag_hunt,
)
from jaxact import train
from jaxact.collect import collect
from jaxact.loading import EXAMPLES, load_experiment, shipped_examples
from jaxact.overrides import numbers
from jaxact.storages import DemonstrationStorage, Replay

NAMES = shipped_examples()
QUICK = "babyai_gotolocal_ppo"


def shrunk(experiment):
    """The same with one update of a few steps in each stage, enough for any replay to begin."""
    pipeline = experiment.pipeline
    stages = tuple(
        dataclasses.replace(
            stage,
            steps=1,
            storages={
                name: dataclasses.replace(storage, start_after=0)
                if isinstance(storage, Replay)
                else storage
                for name, storage in stage.storages.items()
            },
            overrides={
                **stage.overrides,
                "rollout_length": max(
                    2,
                    *(loss.least_length for loss in stage.losses.values()),
                    *(getattr(x, "window", 0) for x in stage.storages.values()),
                ),
                "epochs": 1,
            },
        )
        for stage in pipeline.stages
    )
    pipeline = dataclasses.replace(pipeline, stages=stages, lanes=4, minibatches=2)
    return dataclasses.replace(experiment, pipeline=pipeline)


@pytest.mark.parametrize("name", NAMES)
def test_examples_can_work(name):
    experiment, _ = load_experiment(name)
    experiment.check()
    assert experiment.name.startswith(name)


def test_the_readme_lists_all_examples():
    text = (EXAMPLES.parent / "README.md").read_text(encoding="utf-8")
    section = text.split("\n## Examples\n")[1].split("\n## ")[0]
    listed = re.findall(r"^\| `(\S+)` \| .+ \|$", section, re.M)
    assert sorted(listed) == sorted(
        x.name for x in EXAMPLES.iterdir() if x.suffix in (".py", ".ipynb")
    )


def test_all_of_advisors_experiments_can_work():
    for name, experiment in advisor.experiments.items():
        experiment.check()
        assert experiment.name == f"advisor_{name}"
        paths = advisor.search_space(name)
        drawn = [x for key in paths for x in (key if isinstance(key, tuple) else (key,))]
        assert set(drawn) <= numbers(experiment).keys()


@pytest.mark.parametrize("example", [arm_point_nav, hand_manipulation, physics_locomotion])
def test_all_of_a_bodys_experiments_can_work(example):
    for experiment in example.experiments.values():
        experiment.check()
    names = {experiment.name for experiment in example.experiments.values()}
    assert len(names) == len(example.experiments)


def test_stag_hunt_beside_past_selves_can_work():
    stag_hunt.experiments["g1_past_selves"].check()


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["sync", "marginal", "central"])
def test_furnmoves_experiments_train(policy):
    experiment = shrunk(furnmove.experiments[policy])
    result = train(experiment, evaluate_every=0, evaluation_episodes=0, progress=False)
    assert 0 < result.metrics["losses/cordial/invalid_probability"][0] < 1
    assert (result.metrics["train/gradient_norm"] > 0).all()


@pytest.mark.parametrize(
    "name", [x if x == QUICK else pytest.param(x, marks=pytest.mark.slow) for x in NAMES]
)
def test_examples_train(name, tmp_path, monkeypatch):
    experiment = shrunk(load_experiment(name)[0])
    monkeypatch.chdir(tmp_path)
    for storage in experiment.pipeline.storages.values():
        if isinstance(storage, DemonstrationStorage):
            collect(experiment.pomdp, storage.path, 50, world=name, progress=False)
    result = train(experiment, evaluation_episodes=0, progress=False)
    assert result.metrics["stage"].tolist() == list(range(len(experiment.pipeline.stages)))
    totals = [x for name, x in result.metrics.items() if name.endswith("/total")]
    assert totals
    assert np.isfinite(totals).all()
    assert (result.metrics["train/gradient_norm"] > 0).all()
