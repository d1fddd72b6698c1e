"""Training from recorded demonstrations, alone and beside rollouts."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxact import JaxactError, Stage, evaluate_policy, train
from jaxact.collect import collect
from jaxact.losses import A2C, Imitation
from jaxact.storages import DemonstrationStorage
from tests.corridor import corridor
from tests.tiny import OPTIONS, UPDATE, assert_same, experiment

EPISODES = 90


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    directory = tmp_path_factory.mktemp("demonstrations") / "corridor"
    collect(corridor(), directory, EPISODES, world="corridor", progress=False)
    return str(directory)


def storage(path, **fields):
    return DemonstrationStorage(
        losses={"imitation": Imitation()}, path=path, **{"lanes": 8, "length": 8} | fields
    )


def test_what_was_demonstrated_is_learnt_without_ever_acting(path):
    stage = Stage(losses={}, steps=60 * UPDATE, storages={"demonstrations": storage(path)})
    small = experiment(stages=(stage,), learning_rate=1e-2)
    result = train(small, evaluate_every=0, evaluation_episodes=0, progress=False)
    assert "episodes/count" not in result.metrics
    error = result.metrics["losses/demonstrations/imitation/cross_entropy"]
    assert error[-1] < 0.1 < 0.5 < error[0]
    assert evaluate_policy(corridor(), result.policy, 200).success.mean() > 0.95


def test_resumed_bit_for_bit_beside_rollouts(path, tmp_path):
    """The place in the demonstrations and the memory there are part of the state."""
    held = storage(path, updates=2)
    stages = (
        Stage({"a2c": A2C()}, steps=4 * UPDATE, storages={"demonstrations": held}),
        Stage({}, steps=4 * held.steps, storages={"demonstrations": replace(held, updates=1)}),
    )
    both = experiment(stages=stages)
    whole = train(both, **OPTIONS)
    first = train(both, **OPTIONS, output=tmp_path, total_steps=2 * UPDATE)
    rest = train(both, **OPTIONS, resume=first.run)
    assert_same(rest.state, whole.state)
    served = np.asarray(whole.state.storages["demonstrations"]["cursor"].offset)
    assert served.shape == (8,)
    assert np.isfinite(whole.metrics["losses/a2c/policy"][:4]).all()


def test_of_another_world_or_not_there(path):
    other = experiment(
        corridor(length=4),
        stages=(Stage({}, steps=1, storages={"demonstrations": storage(path)}),),
    )
    with pytest.raises(JaxactError, match="vector"):
        train(other, evaluation_episodes=0, progress=False)
    missing = Stage({}, steps=1, storages={"demonstrations": storage(f"{path}-not")})
    with pytest.raises(JaxactError, match="corridor-not"):
        train(experiment(stages=(missing,)), evaluation_episodes=0, progress=False)


def test_what_nobody_knows_of_demonstrations_is_nan(path):
    held = storage(path)
    pomdp, model = corridor(), experiment().model
    data = held.load(pomdp)
    state = held.init(pomdp, model, jax.random.split(jax.random.key(0), 8), data)
    _, batch = jax.jit(lambda state, data: held.batch(state, data, None))(state, data)
    for unknown in (batch.log_prob, batch.value, batch.advantage, batch.returns):
        assert unknown.shape == (8, 8)
        assert np.isnan(np.asarray(unknown)).all()
    assert np.asarray(batch.is_first)[0].all()
    assert np.asarray(batch.expert.valid).all()
