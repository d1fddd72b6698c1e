"""Worlds in the dark: the agent sees nothing until it asks to."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import cast

import jax
import jax.numpy as jnp

from envs_jax.minigrid import planner
from envs_jax.minigrid.environment import TOGGLE, GridWorld
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.samplers.changed import ChangedEpisodes
from envs_jax.minigrid.sensors import GridSensor
from envs_jax.minigrid.state import GridState
from envs_jax.minigrid.tasks import GoalState, GoalTask, entered
from jaxact.pomdp import Environment, Episode, Outcome, PyTree, Sensor
from jaxact.spaces import Discrete, Space

NUM_ACTIONS = 4
# The action after left, right and forward.
ASK = 3


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SwitchState(GridState):
    """A grid world with a light in it.

    Attributes:
      is_lit: bool scalar, whether the agent can see.
    """

    is_lit: jax.Array


@dataclass(frozen=True)
class AskForHelpWorld(Environment):
    """MiniGrid's dynamics with a light, off when an episode begins.

    Actions are left, right, forward and toggle. Toggle is MiniGrid's, and puts on the light; any
    other action puts it out, unless `toggle_is_permanent`.

    Source: `AskForHelpSimpleCrossing.step` of AllenAct's MiniGrid plugin.
    """

    width: int
    height: int
    toggle_is_permanent: bool = False

    @property
    def action_names(self) -> tuple[str, ...]:
        """Left, right, forward, toggle."""
        return ("left", "right", "forward", "toggle")

    @property
    def action_space(self) -> Discrete:
        """Four actions."""
        return Discrete(NUM_ACTIONS)

    def step(self, key: jax.Array, state: SwitchState, action: jax.Array) -> SwitchState:
        """Returns the state after one action; `key` is not used."""
        asks = action == ASK
        is_lit = asks | state.is_lit if self.toggle_is_permanent else asks
        action = jnp.where(asks, TOGGLE, action)
        world = GridWorld(self.width, self.height).step(key, state, action)
        # What has fields of its own keeps them.
        return replace(cast(SwitchState, world), is_lit=is_lit)


@dataclass(frozen=True)
class LitSensor(Sensor):
    """An image that is all zeros while the light is off."""

    sensor: GridSensor

    @property
    def space(self) -> Space:
        """That of the image."""
        return self.sensor.space

    def observe(self, state: SwitchState, task_state: PyTree) -> jax.Array:
        """Returns the image, or zeros."""
        image = self.sensor.observe(state, task_state)
        return jnp.where(state.is_lit, image, jnp.zeros_like(image))

    def picture(self, state: SwitchState, task_state: PyTree) -> jax.Array:
        """Returns the sensor's picture; a dim one while the light is off."""
        frame = self.sensor.picture(state, task_state)
        return jnp.where(state.is_lit, frame, frame // 3)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AskForHelpState(GoalState):
    """Progress of an `AskForHelpTask`.

    Attributes:
      asked: int32 scalar, how often toggle was taken.
      explored: word[H], a bitboard (see `planner`) of the cells that the agent has been in.
      nearest: int32 scalar, the least distance of those from the goal's corner, along x and y.
    """

    asked: jax.Array
    explored: jax.Array
    nearest: jax.Array


@dataclass(frozen=True)
class AskForHelpTask(GoalTask):
    """`GoalTask` with rewards for new cells and for death, and with metrics of the search.

    Its expert is that of `GoalTask`: it needs no light, and so never asks for any. Metrics are the
    share of the actions that were toggle ("toggle_percent"), the number of cells the agent has been
    in, and how near it came to the goal's corner in steps along x and y ("final_distance").

    Source: `AskForHelpSimpleCrossing` and `AskForHelpSimpleCrossingTask` of AllenAct's
    MiniGrid plugin.

    Attributes:
      exploration_reward: for every step that leads into a new cell.
      death_penalty: the reward (as a rule a negative one) of stepping into lava before the last
        step.
    """

    exploration_reward: float = 0.0
    death_penalty: float = 0.0

    def step(
        self, task_state: GoalState, before: GridState, action: jax.Array, after: GridState
    ) -> tuple[AskForHelpState, Outcome]:
        """Judges one step; see `Task.step`."""
        judged, outcome = super().step(task_state, before, action, after)
        assert isinstance(judged, AskForHelpState)
        is_new = ~planner.contains(judged.explored, after.position)
        judged = replace(
            judged,
            asked=judged.asked + (action == ASK).astype(jnp.int32),
            explored=judged.explored | _board(after.position, self.width, self.height),
            nearest=jnp.minimum(judged.nearest, _distance(after.position, self.width, self.height)),
        )
        _, lava = entered(before, action, after, self.height)
        dies = lava & (judged.steps < judged.max_steps)
        steps = judged.steps.astype(jnp.float32)
        explored = jnp.sum(jax.lax.population_count(judged.explored).astype(jnp.float32))
        exploration = jnp.asarray(self.exploration_reward, jnp.float32)
        death = jnp.asarray(self.death_penalty, jnp.float32)
        reward = {
            **outcome.reward,
            "exploration": jnp.where(is_new, exploration, jnp.float32(0)),
            "death": jnp.where(dies, death, jnp.float32(0)),
        }
        metrics = {
            "toggle_percent": judged.asked.astype(jnp.float32) / steps,
            "explored_count": explored,
            "final_distance": judged.nearest.astype(jnp.float32),
        }
        return judged, replace(outcome, reward=reward, metrics=metrics)


@dataclass(frozen=True)
class AskForHelpSampler(ChangedEpisodes):
    """The episodes of a sampler, those of a `GoalTask`, in the dark.

    Attributes:
      width: cells of the grid along x.
      height: cells of the grid along y.
    """

    width: int
    height: int

    def change(self, episode: Episode) -> Episode:
        """Returns the episode with the light off and nothing explored."""
        world, task = episode.environment, episode.task
        place = world.position, self.width, self.height
        dark = SwitchState(
            **{field.name: getattr(world, field.name) for field in fields(GridState)},
            is_lit=jnp.bool_(False),
        )
        begun = AskForHelpState(
            **{field.name: getattr(task, field.name) for field in fields(GoalState)},
            asked=jnp.int32(0),
            explored=_board(*place),
            nearest=_distance(*place),
        )
        return replace(episode, environment=dark, task=begun)


def _board(position: jax.Array, width: int, height: int) -> planner.Board:
    """Returns word[H], the bitboard of one cell."""
    return planner.pack(placement.at(position, (width, height)))


def _distance(position: jax.Array, width: int, height: int) -> jax.Array:
    """Returns an int32 scalar, the steps along x and y from the corner where the goal is."""
    return width - 2 + height - 2 - jnp.sum(position, dtype=jnp.int32)
