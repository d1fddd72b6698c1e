"""`check_pomdp` passes sound worlds and says what is wrong with others."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
from jaxact.pomdp import ExpertAction
from jaxact.spaces import Box
from jaxact.testing import check_pomdp
from tests.corridor import CellAndGoal, Corridor, RandomStart, ReachEnd, corridor


def test_the_corridor_is_sound():
    check_pomdp(corridor())


@pytest.mark.parametrize(
    "name",
    ["MiniGrid-Empty-5x5-v0", pytest.param("BabyAI-GoToObj-v0", marks=pytest.mark.slow)],
)
def test_shipped_worlds_are_sound(name):
    check_pomdp(envs_jax.make(name), lanes=2, steps=4)


class WrongDtype(CellAndGoal):
    def observe(self, state, task_state):
        return super().observe(state, task_state).astype(jnp.int32)


class WrongShape(CellAndGoal):
    def observe(self, state, task_state):
        return super().observe(state, task_state)[1:]


class OutOfBounds(CellAndGoal):
    def observe(self, state, task_state):
        return super().observe(state, task_state) * 2.0


class LeavesItsSpace(CellAndGoal):
    space = Box(0, 1, (12,))

    def observe(self, state, task_state):
        reading = super().observe(state, task_state)
        return jnp.where((state == 0) | (state == 5), reading + 1.0, reading)


class Weak(Corridor):
    def step(self, key, state, action):
        return jnp.where(action == 1, 1, 2)


class Impure(Corridor):
    calls = []  # noqa: RUF012

    def step(self, key, state, action):
        self.calls.append(1)
        return jnp.int32(len(self.calls) % 5)


class NotANumber(ReachEnd):
    def step(self, task_state, before, action, after):
        task_state, outcome = super().step(task_state, before, action, after)
        return task_state, dataclasses.replace(outcome, reward={"step": jnp.float32(jnp.nan)})


class WholeReward(ReachEnd):
    def step(self, task_state, before, action, after):
        task_state, outcome = super().step(task_state, before, action, after)
        return task_state, dataclasses.replace(outcome, metrics={"distance": jnp.int32(1)})


class VectorFlag(ReachEnd):
    def step(self, task_state, before, action, after):
        task_state, outcome = super().step(task_state, before, action, after)
        return task_state, dataclasses.replace(outcome, terminated=jnp.zeros(1, bool))


class WildExpert(ReachEnd):
    def expert(self, key, task_state, state):
        return ExpertAction(jnp.int32(7), jnp.bool_(True))


class UnsureExpert(ReachEnd):
    def expert(self, key, task_state, state):
        return ExpertAction(jnp.int32(1), jnp.float32(1))


@dataclasses.dataclass(frozen=True)
class Branching(ReachEnd):
    bonus: float = 1.0

    def step(self, task_state, before, action, after):
        task_state, outcome = super().step(task_state, before, action, after)
        if self.bonus:
            reward = {**outcome.reward, "bonus": jnp.float32(self.bonus)}
            outcome = dataclasses.replace(outcome, reward=reward)
        return task_state, outcome


@dataclasses.dataclass(frozen=True)
class OnTheHost(ReachEnd):
    bonus: float = 1.0

    def step(self, task_state, before, action, after):
        task_state, outcome = super().step(task_state, before, action, after)
        reward = {**outcome.reward, "bonus": jnp.float32(np.sqrt(self.bonus))}
        return task_state, dataclasses.replace(outcome, reward=reward)


class Forgetful(RandomStart):
    def init(self, key):
        return jnp.float32(0)

    def update(self, sampler_state, finished):
        return jnp.zeros(2, jnp.float32)


@pytest.mark.parametrize(
    ("part", "broken", "message"),
    [
        ("sensors", {"vector": WrongDtype()}, r"sensor 'vector' returns int32\[12\], .*float32"),
        ("sensors", {"vector": WrongShape()}, r"sensor 'vector' returns float32\[11\]"),
        ("sensors", {"vector": OutOfBounds()}, "first reading of sensor 'vector' lies outside"),
        ("sensors", {"vector": LeavesItsSpace()}, "a reading leaves its space after"),
        ("environment", Weak(), r"weakly typed .*\.environment was"),
        ("environment", Impure(), "step is not a pure function"),
        ("task", NotANumber(), "a reward is not finite"),
        ("task", WholeReward(), r"metric distance must be a float32 scalar, it is int32"),
        ("task", VectorFlag(), "terminated must be a bool scalar"),
        ("task", WildExpert(), "the expert's action is not in the action space"),
        ("task", UnsureExpert(), "the expert's `valid` must be a bool scalar"),
        ("task", Branching(), "task.bonus decides in Python what is computed, but floats are data"),
        ("task", OnTheHost(), "task.bonus decides in Python what is computed"),
        ("sampler", Forgetful(), "the sampler's update changes the structure"),
    ],
    ids=lambda x: type(x).__name__ if not isinstance(x, str | dict) else None,
)
def test_broken_worlds_are_told_what_is_wrong(part, broken, message):
    with pytest.raises(AssertionError, match=message):
        check_pomdp(dataclasses.replace(corridor(), **{part: broken}))


def test_a_sound_world_is_left_as_it_was():
    pomdp = corridor()
    jax.jit(jax.vmap(pomdp.reset))(jax.random.split(jax.random.key(0), 2))
    check_pomdp(pomdp, seed=3, lanes=1, steps=1)
    assert pomdp == corridor()
