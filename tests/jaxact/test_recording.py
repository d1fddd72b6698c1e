"""Films: one frame a step, from the first state to the last action."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import JaxactError, Policy, evaluate_policy
from jaxact.evaluation import held_out_keys
from jaxact.recording import record_episode, side_by_side
from tests.corridor import CellAndGoal, Corridor, corridor
from tests.jaxact.test_evaluation import Drift


@dataclasses.dataclass(frozen=True)
class Shown(CellAndGoal):
    """Its picture has the brightness of the cell."""

    def picture(self, state, task_state):
        del task_state
        return jnp.full((20, 30, 3), 40 * state + 10, jnp.int32).astype(jnp.uint8)


POMDP = dataclasses.replace(corridor(), sensors={"vector": Shown()})


def policy(logit):
    return Policy(Drift(), jnp.float32(logit), POMDP.action_space)


def test_every_step_is_one_frame():
    right = policy(50.0)
    lengths = set()
    for seed in range(6):
        frames = record_episode(POMDP, right, seed=seed, greedy=True)
        assert frames.dtype == np.uint8
        assert frames.ndim == 4
        assert frames.shape[-1] == 3
        lengths.add(len(frames))
        # It goes right: 40 levels brighter at each step, till the wall.
        brightness = frames[:, 3, 3, 0].astype(int)
        assert set(np.diff(brightness)) <= {40, 0}
    assert lengths <= {1, 2, 3, 4, 10}
    assert len(lengths) > 1


@pytest.mark.parametrize("greedy", [False, True])
def test_the_film_is_of_the_first_held_out_episode(greedy):
    """A policy without a preference: where it begins and how long it takes is all chance."""
    lengths = set()
    for seed in range(4):
        frames = record_episode(POMDP, policy(0.0), seed=seed, greedy=greedy)
        reset_keys, _ = held_out_keys(seed, 3)
        state, _ = POMDP.reset(reset_keys[0])
        assert frames[0, 3, 3, 0] == 40 * int(state.environment) + 10
        played = evaluate_policy(POMDP, policy(0.0), 3, seed=seed, greedy=greedy)
        assert len(frames) == played.length[0]
        lengths.add(len(frames))
    assert len(lengths) > 1


def test_films_end_in_time():
    frames = record_episode(POMDP, policy(0.0), seed=0, max_steps=1)
    assert len(frames) == 1


def test_worlds_without_pictures_cannot_be_filmed():
    with pytest.raises(JaxactError, match="no sensor has a method picture"):
        record_episode(corridor(), policy(0.0))


def test_charts_show_the_way_so_far():
    @dataclasses.dataclass(frozen=True)
    class Charting(Corridor):
        """Its chart has a pixel for each step, as bright as the cell that was reached by it."""

        def waypoint(self, state):
            return jnp.stack([state, -state]).astype(jnp.float32)

        def chart(self, state, task_state, trail):
            del state, task_state
            shades = jnp.where(jnp.isnan(trail[:, 0]), 0, 40 * trail[:, 0] + 10)
            return jnp.broadcast_to(shades[None, :, None], (320, len(trail), 3)).astype(jnp.uint8)

    pomdp = dataclasses.replace(corridor(), environment=Charting())
    assert pomdp.has_pictures
    assert not corridor().has_pictures
    frames = record_episode(pomdp, policy(50.0), greedy=True, max_steps=8)[:, 0, :8, 0]
    assert len(frames) > 1
    last = frames[-1]
    for t, frame in enumerate(frames):
        np.testing.assert_array_equal(frame, np.where(np.arange(8) <= t, last, 0))
    # Who goes right is a cell further at every step, until there is none.
    moves = np.diff(last[: len(frames)].astype(int))
    assert moves[0] == 40
    assert set(moves) <= {0, 40}


def test_pictures_stand_side_by_side():
    one, other = np.full((4, 3, 3), 7, np.uint8), np.full((10, 5, 3), 9, np.uint8)
    joined = side_by_side([one, other])
    assert joined.shape == (10, 3 + 8 + 5, 3)
    assert (joined[3:7, :3] == 7).all()
    assert (joined[:3, :3] == 0).all()
    assert (joined[:, 3:11] == 0).all()
    assert (joined[:, 11:] == 9).all()
