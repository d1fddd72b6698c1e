"""Escalation: the longer two keep together, the more it costs the one who is left."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.social import grid
from envs_jax.social.maps import MapSensor
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, Environment, Episode, Outcome, PyTree, Task, TaskSampler
from jaxact.spaces import Agents, Discrete


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EscalationState:
    """Who is where, and how it goes.

    Attributes:
      agents: int32 [2, 2].
      marker: int32 [2], the cell to be on together.
      at_marker: bool [2], who stood on it after the last step, before it moved on.
      streak: int32 scalar, steps in a row, up to the one before the last, in which both did.
    """

    agents: jax.Array
    marker: jax.Array
    at_marker: jax.Array
    streak: jax.Array


@dataclass(frozen=True)
class Escalation(Environment):
    """Two agents and a marked cell on a square grid.

    A step: both move at once; if both are then on the marker, it moves to a cell beside it, each as
    likely.

    Attributes:
      size: of the grid.
    """

    size: int = 5

    def __post_init__(self) -> None:
        if self.size < 2:
            raise JaxactError(f"size must be at least 2, got {self.size}")

    @property
    def agents(self) -> int:
        """Two."""
        return 2

    @property
    def action_names(self) -> tuple[str, ...]:
        """The moves."""
        return grid.MOVES

    @property
    def action_space(self) -> Agents:
        """A move for each agent."""
        return Agents(Discrete(len(grid.MOVES)), self.agents)

    def things(self, state: EscalationState) -> list[jax.Array]:
        """Returns the cell of the marker, int32 [1, 2]."""
        return [state.marker[None]]

    def step(self, key: jax.Array, state: EscalationState, action: jax.Array) -> EscalationState:
        """Returns what follows; see the class."""
        agents = grid.move(state.agents, jnp.asarray(action, jnp.int32), self.size)
        at_marker = jnp.all(agents == state.marker, axis=-1)
        beside = grid.choose(grid.draws(key, 1)[0], grid.legal(state.marker, self.size))
        moved = grid.move(state.marker, beside, self.size)
        together = jnp.all(state.at_marker)
        return EscalationState(
            agents,
            jnp.where(jnp.all(at_marker), moved, state.marker),
            at_marker,
            streak=jnp.where(together, state.streak + 1, 0),
        )


@dataclass(frozen=True)
class Streak(Task):
    """To be on the marker together pays; who breaks a streak of n by being there alone costs the
    other n times the penalty, and ends the episode, as does any other break.

    It is a success if both were together at least once. The task's state is how often, int32.

    Attributes:
      reward: of being together, for each.
      penalty: for each step of the streak, for the one who is not on the marker when it breaks.
    """

    reward: float = 1.0
    penalty: float = 0.5

    def step(
        self,
        task_state: jax.Array,
        before: EscalationState,
        action: jax.Array,
        after: EscalationState,
    ) -> tuple[jax.Array, Outcome]:
        """Judges one step; see `Task.step`."""
        del before, action
        together = jnp.all(after.at_marker)
        breaks = ~together & (after.streak > 0)
        left = breaks & jnp.any(after.at_marker) & ~after.at_marker
        so_far = task_state + together.astype(jnp.int32)
        cost = after.streak.astype(jnp.float32) * jnp.asarray(self.penalty, jnp.float32)
        pays = jnp.where(together, jnp.asarray(self.reward, jnp.float32), 0.0)
        return so_far, Outcome(
            reward={
                "together": jnp.broadcast_to(pays, left.shape),
                "left": -jnp.where(left, cost, 0.0),
            },
            success={"together": so_far > 0},
            terminated=breaks,
            metrics={"together": so_far.astype(jnp.float32)},
        )


@dataclass(frozen=True)
class EscalationSampler(TaskSampler):
    """Agents in two corners, the marker anywhere else.

    Attributes:
      environment: whose grid it is.
      horizon: steps.
    """

    environment: Escalation
    horizon: int = 1000

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        size = self.environment.size
        agents = grid.corners(2, size)
        marker = grid.free_cell(grid.draws(key, 1)[0], grid.occupied(agents, size), size)
        state = EscalationState(agents, marker, jnp.zeros(2, bool), jnp.int32(0))
        return Episode(state, jnp.int32(0), jnp.int32(self.horizon))


def escalation(*, size: int = 5, horizon: int = 1000) -> POMDP:
    """Builds Escalation; its observation has the "map"."""
    world = Escalation(size)
    sampler = EscalationSampler(world, horizon)
    return POMDP(world, Streak(), sampler, {"map": MapSensor(world, 1)})
