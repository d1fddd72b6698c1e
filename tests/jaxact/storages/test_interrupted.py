"""A replay that a stage in between does not fill breaks off there, as by a truncation."""

import jax
import numpy as np
import pytest

from jaxact import Experiment, Stage, TrainingPipeline, make_train
from jaxact.losses import A2C, VTrace
from jaxact.models import ActorCritic, Concatenated, NoMemory, Vector
from jaxact.storages import Replay
from jaxact.train_state import make_key
from tests.corridor import corridor

CELLS, LANES, LENGTH = 6, 8, 8


@pytest.fixture(scope="module")
def held():
    """What the replay holds after two rollouts, one that it did not see, and one more."""
    pomdp = corridor(CELLS)
    model = ActorCritic(pomdp.action_space, Concatenated({"vector": Vector((8,))}), NoMemory())
    replay = Replay(losses={"vtrace": VTrace()}, capacity=32, lanes=LANES, length=LENGTH)
    storages, update = {"replay": replay}, LANES * LENGTH
    stages = (
        Stage({}, 2 * update, storages=storages),
        Stage({"a2c": A2C()}, update),
        Stage({}, update, storages=storages),
    )
    pipeline = TrainingPipeline(stages, lanes=LANES, rollout_length=LENGTH, epochs=1, minibatches=1)
    state, _ = jax.jit(make_train(Experiment("interrupted", pomdp, model, pipeline)))(make_key(0))
    return jax.tree.map(np.asarray, state.storages["replay"].steps)


def test_no_transition_is_held_that_never_was(held):
    vector = held.observation["vector"][:, : 3 * LENGTH]
    cell, goal = vector[..., :CELLS].argmax(-1), vector[..., CELLS:].argmax(-1)
    follows = ~(held.terminated | held.truncated)[:, : 3 * LENGTH - 1]
    led_to = np.clip(cell + 2 * held.action[:, : 3 * LENGTH] - 1, 0, CELLS - 1)[:, :-1]
    np.testing.assert_array_equal(led_to[follows], cell[:, 1:][follows])
    np.testing.assert_array_equal(goal[:, :-1][follows], goal[:, 1:][follows])
    np.testing.assert_array_equal(~follows, held.is_first[:, 1 : 3 * LENGTH])


def test_it_breaks_off_there_and_nowhere_else(held):
    ended = held.terminated | held.truncated
    assert ended[:, 2 * LENGTH - 1].all()
    assert held.is_first[:, 2 * LENGTH].all()
    assert not held.previous_action[:, 2 * LENGTH].any()
    assert not ended[:, LENGTH - 1].all()
