from __future__ import annotations

from typing import Any

import gymnasium
import jax
import numpy as np
import pytest
from minigrid.core.actions import Actions
from minigrid.core.world_object import Ball, Box
from minigrid.envs import EmptyEnv
from minigrid_reference import python_env

from envs_jax.minigrid import interop
from jaxact.errors import JaxactError


def test_the_imported_pomdp_begins_that_very_episode_again():
    env = python_env("BabyAI-GoToLocal-v0")
    env.reset(seed=3)
    for _ in range(5):
        env.step(Actions.left)
    pomdp, state = interop.from_minigrid(env)
    assert (state.steps, state.horizon) == (5, 64)
    again, observation = jax.jit(pomdp.reset)(jax.random.key(0))
    np.testing.assert_array_equal(observation["image"], env.gen_obs()["image"])
    assert (again.steps, again.horizon) == (0, 59)
    for ours, begun in zip(
        jax.tree.leaves((state.environment, state.task)),
        jax.tree.leaves((again.environment, again.task)),
        strict=True,
    ):
        assert ours.dtype == begun.dtype
        np.testing.assert_array_equal(ours, begun)
    assert hash(pomdp) == hash(interop.from_minigrid(env)[0])


def test_stale_beliefs_last_until_the_next_drop():
    env = python_env("BabyAI-GoToObj-v0")
    env.reset(seed=0)
    (target,) = env.instrs.desc.obj_set
    env.grid.set(*target.cur_pos, None)
    env.put_obj(target, 3, 3)
    env.instrs.desc.obj_poss = [(3, 3)]
    env.agent_pos, env.agent_dir = (2, 3), 0
    pomdp, state = interop.from_minigrid(env)
    take = jax.jit(pomdp.step)
    results = []
    for action in (Actions.pickup, Actions.done, Actions.left, Actions.drop, Actions.right):
        _, reward, terminated, *_ = env.step(action)
        state, step = take(jax.random.key(0), state, int(action))
        assert bool(step.terminated) == terminated
        assert step.reward == pytest.approx(reward, abs=1e-6)
        results.append(terminated)
    # It is picked up; believed there still; turned away; dropped in front; turned away from there.
    assert results == [True, True, False, True, False]


class OwnRules(EmptyEnv):
    """A world whose ends nobody knows."""

    def step(self, action: int) -> Any:
        return super().step(action)


def reset(env: Any) -> Any:
    env.reset(seed=0)
    return env


def test_what_cannot_be_imported_is_named():
    fetch = gymnasium.make("MiniGrid-Fetch-5x5-N2-v0", disable_env_checker=True)
    fetch.reset(seed=0)
    with pytest.raises(JaxactError, match=r"unwrapped.*OrderEnforcing"):
        interop.from_minigrid(fetch)
    with pytest.raises(JaxactError, match="OwnRules ends by rules"):
        interop.from_minigrid(reset(OwnRules(size=5)))
    doors = reset(python_env("MiniGrid-RedBlueDoors-6x6-v0"))
    doors.grid.grid[doors.grid.grid.index(doors.red_door)] = None
    with pytest.raises(JaxactError, match="of RedBlueDoorEnv has lost the red door"):
        interop.from_minigrid(doors)
    env = python_env("BabyAI-OpenTwoDoors-v0")
    env.reset(seed=0)
    env.instrs.strict = True
    with pytest.raises(JaxactError, match="BabyAI-OpenTwoDoors-v0 has a strict BeforeInstr"):
        interop.from_minigrid(env)
    env = python_env("BabyAI-OneRoomS8-v0")
    env.reset(seed=0)
    env.carrying = env.instrs.desc.obj_set[0]
    env.step(Actions.left)
    env.carrying = None
    with pytest.raises(JaxactError, match="was exchanged by hand"):
        interop.from_minigrid(env)
    env = python_env("BabyAI-PutNextS5N2Carrying-v0")
    env.reset(seed=0)
    interop.from_minigrid(env)
    x, y = env.instrs.desc_fixed.obj_poss[0]
    env.carrying.cur_pos = (x - 1, y)
    with pytest.raises(JaxactError, match="has a position beside the object"):
        interop.from_minigrid(env)
    env = python_env("MiniGrid-Empty-5x5-v0")
    with pytest.raises(JaxactError, match="never reset"):
        interop.from_minigrid(env)
    env.reset(seed=0)
    env.carrying = Box("red", Ball("blue"))
    with pytest.raises(JaxactError, match="a box with a ball in it"):
        interop.from_minigrid(env)
