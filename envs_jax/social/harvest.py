"""Harvest: plants are worth a little to one while young, and more to all once they are ripe."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.social import grid
from envs_jax.social.maps import MapSensor
from jaxact.errors import JaxactError, check_at_least
from jaxact.pomdp import POMDP, Environment, Episode, Outcome, PyTree, Task, TaskSampler
from jaxact.spaces import Agents, Discrete


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HarvestState:
    """Who and what is where, and what has just been harvested.

    Attributes:
      agents: int32 [A, 2].
      plants: int32 [P, 2].
      ripe: bool [P].
      young_by: int32 [A], young plants that each agent harvested in the last step.
      ripe_by: int32 [A], ripe ones.
    """

    agents: jax.Array
    plants: jax.Array
    ripe: jax.Array
    young_by: jax.Array
    ripe_by: jax.Array


@dataclass(frozen=True)
class Harvest(Environment):
    """Agents and plants on a square grid; whoever stands on a plant harvests it.

    A step: all agents move at once; plants that somebody stands on are harvested; of the others
    young ones may ripen and ripe ones may die. What was harvested or died comes up young on a free
    cell. Of several agents on one plant the first has it.

    Attributes:
      size: of the grid.
      agents: how many there are.
      plants: how many there are.
      ripens: probability in each step that a young plant does.
      dies: that a ripe one does.
    """

    size: int = 5
    agents: int = 2
    plants: int = 4
    ripens: float = 0.1
    dies: float = 0.1

    def __post_init__(self) -> None:
        check_at_least(1, "Harvest", agents=self.agents, plants=self.plants)
        if self.size**2 < self.agents + self.plants:
            raise JaxactError(
                f"a grid of {self.size}×{self.size} has no room for {self.agents} agents and "
                f"{self.plants} plants"
            )

    @property
    def action_names(self) -> tuple[str, ...]:
        """The moves."""
        return grid.MOVES

    @property
    def action_space(self) -> Agents:
        """A move for each agent."""
        return Agents(Discrete(len(grid.MOVES)), self.agents)

    def things(self, state: HarvestState) -> list[jax.Array]:
        """Returns the cells of young plants and of ripe ones, int32 [P, 2]; −1 for those of the
        other kind.
        """
        ripe = state.ripe[:, None]
        return [jnp.where(ripe, -1, state.plants), jnp.where(ripe, state.plants, -1)]

    def step(self, key: jax.Array, state: HarvestState, action: jax.Array) -> HarvestState:
        """Returns what follows; see the class."""
        chances, places = grid.draws(key, 2 * self.plants).reshape(2, -1)
        agents = grid.move(state.agents, jnp.asarray(action, jnp.int32), self.size)
        stands = jnp.all(agents[:, None] == state.plants, axis=-1)
        takes = stands & (jnp.cumsum(stands, axis=0) == 1)
        taken = jnp.any(takes, axis=0)
        changes = chances < jnp.where(state.ripe, jnp.float32(self.dies), jnp.float32(self.ripens))
        dies = changes & state.ripe & ~taken
        ripe = (state.ripe | changes) & ~taken & ~dies
        plants, goes = state.plants, taken | dies
        for i in range(self.plants):
            full = grid.occupied(jnp.concatenate([agents, plants]), self.size)
            cell = grid.free_cell(places[i], full, self.size)
            plants = plants.at[i].set(jnp.where(goes[i], cell, plants[i]))
        return HarvestState(
            agents,
            plants,
            ripe,
            young_by=jnp.sum(takes & ~state.ripe, axis=1, dtype=jnp.int32),
            ripe_by=jnp.sum(takes & state.ripe, axis=1, dtype=jnp.int32),
        )


@dataclass(frozen=True)
class Reap(Task):
    """A young plant pays its harvester, a ripe one everybody.

    There is no end but the horizon; an episode counts as a success if a ripe plant was harvested.
    The task's state is how many were, int32.

    Attributes:
      young_reward: of a young plant, for who harvests it.
      ripe_reward: of a ripe one, for each agent.
    """

    young_reward: float = 1.0
    ripe_reward: float = 2.0

    def step(
        self, task_state: jax.Array, before: HarvestState, action: jax.Array, after: HarvestState
    ) -> tuple[jax.Array, Outcome]:
        """Judges one step; see `Task.step`."""
        del before, action
        ripe = jnp.sum(after.ripe_by, dtype=jnp.int32)
        so_far = task_state + ripe
        young = after.young_by.astype(jnp.float32) * jnp.asarray(self.young_reward, jnp.float32)
        for_all = ripe.astype(jnp.float32) * jnp.asarray(self.ripe_reward, jnp.float32)
        return so_far, Outcome(
            reward={"young": young, "ripe": jnp.broadcast_to(for_all, young.shape)},
            success={"ripe": so_far > 0},
            terminated=jnp.bool_(False),
            metrics={"ripe": so_far.astype(jnp.float32)},
        )


@dataclass(frozen=True)
class HarvestSampler(TaskSampler):
    """Agents in the corners, young plants anywhere else.

    Attributes:
      environment: whose grid it is.
      horizon: steps.
    """

    environment: Harvest
    horizon: int = 1000

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        world = self.environment
        agents = grid.corners(world.agents, world.size)
        drawn = grid.draws(key, world.plants)
        plants = grid.free_cells(drawn, grid.occupied(agents, world.size), world.size)
        none = jnp.zeros(world.agents, jnp.int32)
        state = HarvestState(agents, plants, jnp.zeros(world.plants, bool), none, none)
        return Episode(state, jnp.int32(0), jnp.int32(self.horizon))


def harvest(*, size: int = 5, agents: int = 2, plants: int = 4, horizon: int = 1000) -> POMDP:
    """Builds Harvest; its observation has the "map"."""
    world = Harvest(size, agents, plants)
    return POMDP(world, Reap(), HarvestSampler(world, horizon), {"map": MapSensor(world, 2)})
