"""ADVISOR's PoisonedDoors: an expert who knows what the agent cannot find out.

Four doors. Behind one of the last three, a different one in every episode, there is a reward of 2,
behind the others −2; nothing tells which. The first is locked by a combination that is always the
same, and worth 1. The expert takes the good door. To imitate it is to choose at random, which costs
2/3 of a point on average; the best that the agent can do is to learn the combination.

Source: Weihs et al. 2021, "Bridging the Imitation Gap by Adaptive Insubordination"
(https://arxiv.org/abs/2007.12173), and `poisoneddoors_plugin` of its repository,
https://github.com/allenai/advisor.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.registry import register
from jaxact.pomdp import (
    POMDP,
    Environment,
    Episode,
    ExpertAction,
    Outcome,
    PyTree,
    Sensor,
    Task,
    TaskSampler,
)
from jaxact.spaces import Box, Discrete

SYMBOLS = 3
# The one that ADVISOR's experiments draw for ten symbols.
COMBINATION = (2, 0, 1, 1, 2, 0, 0, 1, 1, 1)
NO_DOOR = -1

# What the agent is about.
CHOOSING, FIRST_SYMBOL, NEXT_SYMBOL, DONE = range(4)
_STAGES = 4

# Colours of pictures, and a door's width in pixels.
_LOCK, _GOOD, _POISONED = (180, 180, 180), (0, 255, 0), (150, 90, 40)
_DOOR = 40


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DoorsState:
    """The doors, as they stand.

    Attributes:
      stage: int32 scalar; 0 choosing a door, 1 about to enter the first symbol, 2 about to enter
        another one, 3 done.
      door: int32 scalar, the door that was chosen, −1 if none.
      entered: int32 scalar, symbols of the combination entered so far without a mistake.
    """

    stage: jax.Array
    door: jax.Array
    entered: jax.Array


@dataclass(frozen=True)
class PoisonedDoors(Environment):
    """Doors to choose from, and the lock of the first.

    The actions are the three symbols of the lock, then the doors. Symbols do nothing before door 0
    has been chosen; once it has, anything but the right symbol is a mistake, and all is over.
    Nothing is random.

    Attributes:
      doors: how many there are.
      combination: of the lock, symbols 0 … 2.
    """

    doors: int = 4
    combination: tuple[int, ...] = COMBINATION

    @property
    def action_names(self) -> tuple[str, ...]:
        """Symbols, then doors."""
        symbols = tuple(f"symbol {symbol}" for symbol in range(SYMBOLS))
        return symbols + tuple(f"door {door}" for door in range(self.doors))

    @property
    def action_space(self) -> Discrete:
        """Symbols and doors."""
        return Discrete(SYMBOLS + self.doors)

    def step(self, key: jax.Array, state: DoorsState, action: jax.Array) -> DoorsState:
        """Returns the state after one action; `key` is not used."""
        del key
        action = jnp.asarray(action, jnp.int32)
        chooses = (state.stage == CHOOSING) & (action >= SYMBOLS)
        enters = (state.stage == FIRST_SYMBOL) | (state.stage == NEXT_SYMBOL)
        correct = enters & (action == next_symbol(self.combination, state))
        entered = state.entered + correct.astype(jnp.int32)
        opened = entered == len(self.combination)
        after_choice = jnp.where(action == SYMBOLS, FIRST_SYMBOL, DONE)
        after_symbol = jnp.where(correct & ~opened, NEXT_SYMBOL, DONE)
        stage = jnp.where(chooses, after_choice, jnp.where(enters, after_symbol, state.stage))
        return DoorsState(
            stage=stage.astype(jnp.int32),
            door=jnp.where(chooses, action - SYMBOLS, state.door),
            entered=entered,
        )


def next_symbol(combination: tuple[int, ...], state: DoorsState) -> jax.Array:
    """Returns the right symbol to enter, an int32 scalar; meaningless when all have been."""
    place = jnp.minimum(state.entered, len(combination) - 1)
    return jnp.asarray(combination, jnp.int32)[place]


@dataclass(frozen=True)
class ChooseDoor(Task):
    """Choose the good door, or open the lock. The task's state is the good door, int32, from 1.

    Symbols entered rightly, all of the combination, earn 1, a mistake nothing; the good door earns
    2, any other −2. Either success ends the episode, as does every failure.

    Attributes:
      combination: of the lock.
      lock_reward: of opening the lock.
      door_reward: of the good door; the others cost as much.
    """

    combination: tuple[int, ...] = COMBINATION
    lock_reward: float = 1.0
    door_reward: float = 2.0

    def step(
        self, task_state: jax.Array, before: DoorsState, action: jax.Array, after: DoorsState
    ) -> tuple[jax.Array, Outcome]:
        """Judges one step; see `Task.step`."""
        del action
        ends = (after.stage == DONE) & (before.stage != DONE)
        opened = after.entered == len(self.combination)
        good = after.door == task_state
        lock = jnp.asarray(self.lock_reward, jnp.float32)
        door = jnp.asarray(self.door_reward, jnp.float32)
        zero = jnp.float32(0)
        chosen = ends & (after.door > 0)
        outcome = Outcome(
            reward={
                "lock": jnp.where(ends & opened, lock, zero),
                "door": jnp.where(chosen, jnp.where(good, door, -door), zero),
            },
            success={"door": opened | good},
            terminated=after.stage == DONE,
            metrics={
                "chose_no_door": (after.door == NO_DOOR).astype(jnp.float32),
                "chose_lock": (after.door == 0).astype(jnp.float32),
                "chose_good_door": good.astype(jnp.float32),
                "opened_lock": opened.astype(jnp.float32),
                "symbols_entered": after.entered.astype(jnp.float32),
            },
        )
        return task_state, outcome

    def expert(self, key: jax.Array, task_state: jax.Array, state: DoorsState) -> ExpertAction:
        """Returns the good door; if the agent is at the lock, the next symbol."""
        del key
        symbol = next_symbol(self.combination, state)
        action = jnp.where(state.stage == CHOOSING, SYMBOLS + task_state, symbol)
        return ExpertAction(action, state.stage != DONE)


@dataclass(frozen=True)
class AnyDoor(TaskSampler):
    """Episodes with the good door anywhere but at the lock."""

    doors: int = 4
    max_steps: int = 100

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        good = jax.random.randint(key, (), 1, self.doors, jnp.int32)
        start = DoorsState(jnp.int32(CHOOSING), jnp.int32(NO_DOOR), jnp.int32(0))
        return Episode(start, good, jnp.int32(self.max_steps))


@dataclass(frozen=True)
class StageSensor(Sensor):
    """What the agent is about, float32[4], one-hot; see `DoorsState.stage`."""

    @property
    def space(self) -> Box:
        """A one-hot vector."""
        return Box(0, 1, (_STAGES,), "float32")

    def observe(self, state: DoorsState, task_state: PyTree) -> jax.Array:
        """Returns the vector."""
        del task_state
        return jax.nn.one_hot(state.stage, _STAGES, dtype=jnp.float32)

    def picture(self, state: DoorsState, task_state: jax.Array) -> jax.Array:
        """Returns the doors in a row, the chosen one bright: grey the one with the lock, with a bar
        below as long as what was entered of the combination, green the good one, brown the rest."""
        x = jnp.arange(PoisonedDoors().doors * _DOOR, dtype=jnp.int32)
        door, across = x // _DOOR, x % _DOOR
        color = jnp.where((door == task_state)[:, None], jnp.array(_GOOD), jnp.array(_POISONED))
        color = jnp.where((door == 0)[:, None], jnp.array(_LOCK), color)
        color = jnp.where((door == state.door)[:, None], color, color // 2)
        color = jnp.where((across < _DOOR - 4)[:, None], color, 0)
        entered = x < state.entered * (_DOOR - 4) // len(COMBINATION)
        bar = jnp.where(entered[:, None], jnp.array(_LOCK), 0)
        rows = [jnp.broadcast_to(color, (2 * _DOOR, *color.shape)), jnp.zeros((4, *color.shape))]
        rows.append(jnp.broadcast_to(bar, (8, *bar.shape)))
        return jnp.concatenate([row.astype(jnp.uint8) for row in rows])


def poisoned_doors() -> POMDP:
    """Builds ADVISOR's PoisonedDoors: four doors, ten symbols, at most 100 steps."""
    return POMDP(PoisonedDoors(), ChooseDoor(), AnyDoor(), {"stage": StageSensor()})


register("Advisor-PoisonedDoors-v0", poisoned_doors)
