"""Markov Stag Hunt: a stag that takes several, and plants for one."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.social import grid
from envs_jax.social.maps import MapSensor
from jaxact.errors import JaxactError, check_at_least, unknown
from jaxact.pomdp import POMDP, Environment, Episode, Outcome, PyTree, Task, TaskSampler
from jaxact.spaces import Agents, Discrete

STAGS = ("follows", "wanders", "stands")
STARTS = ("corners", "anywhere")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class StagHuntState:
    """Who and what is where, and what has just been met.

    Attributes:
      agents: int32 [A, 2].
      stag: int32 [2], its upper left cell.
      plants: int32 [P, 2].
      at_stag: bool [A], who stood on the stag after the last step, before what was collected came
        up elsewhere.
      at_plant: bool [A], who stood on a plant and not on the stag.
    """

    agents: jax.Array
    stag: jax.Array
    plants: jax.Array
    at_stag: jax.Array
    at_plant: jax.Array


@dataclass(frozen=True)
class StagHunt(Environment):
    """Agents, a stag and plants on a square grid, any of which may share cells.

    A step: the stag moves, then all agents do at once. It goes to the agent that is the nearest
    before either has moved (straight distance from its middle; of several as near, the last), by
    one of the moves that bring it nearer along an axis, each as likely. Stag and plants that were
    collected come up again on free cells. A stag is caught when `hunters` agents or more stand on
    its cells after one step, be it on the same one; all of them have caught it. Plants are
    collected by whoever stands on them and not on the stag, but not in a step in which the stag is
    caught, nor with `flees` in one in which it was met by too few.

    Attributes:
      size: of the grid.
      agents: how many there are.
      plants: how many there are.
      stag_side: the stag is a square of so many cells along each edge.
      stag: "follows" the nearest agent, "wanders" or "stands".
      flees: whether a stag that was met by too few comes up elsewhere too.
      hunters: how many agents it takes at once, at most as many as there are.
    """

    size: int = 5
    agents: int = 2
    plants: int = 2
    stag_side: int = 1
    stag: str = "follows"
    flees: bool = False
    hunters: int = 2

    def __post_init__(self) -> None:
        if self.stag not in STAGS:
            raise unknown("stag", self.stag, STAGS)
        counts = {"agents": self.agents, "plants": self.plants, "hunters": self.hunters}
        check_at_least(1, "a stag hunt", **counts)
        if self.hunters > self.agents:
            raise JaxactError(
                f"a stag that takes {self.hunters} hunters is never caught by {self.agents} "
                f"agent(s): hunters must be 1 to {self.agents}"
            )
        needed = self.agents + self.plants + self.stag_side**2
        if self.stag_side < 1 or self.size**2 < needed or self.stag_side >= self.size:
            raise JaxactError(
                f"a grid of {self.size}×{self.size} has no room for {self.agents} agents, "
                f"{self.plants} plants and a stag of {self.stag_side}×{self.stag_side}"
            )

    @property
    def action_names(self) -> tuple[str, ...]:
        """The moves."""
        return grid.MOVES

    @property
    def action_space(self) -> Agents:
        """A move for each agent."""
        return Agents(Discrete(len(grid.MOVES)), self.agents)

    def things(self, state: StagHuntState) -> list[jax.Array]:
        """Returns the cells of the stag and of the plants, int32 [n, 2] each."""
        return [grid.footprint(state.stag, self.stag_side), state.plants]

    def step(self, key: jax.Array, state: StagHuntState, action: jax.Array) -> StagHuntState:
        """Returns what follows; see the class."""
        way, *places = grid.draws(key, 2 + self.plants)
        stag = self._stag_moves(way, state)
        agents = grid.move(state.agents, jnp.asarray(action, jnp.int32), self.size)
        away = agents - stag
        at_stag = jnp.all((away >= 0) & (away < self.stag_side), axis=-1)
        meets = jnp.all(agents[:, None] == state.plants, axis=-1) & ~at_stag[:, None]
        met = jnp.sum(at_stag, dtype=jnp.int32)
        caught = met >= self.hunters
        goes = caught | (met > 0) if self.flees else caught
        gathered = jnp.any(meets, axis=0) & ~goes
        placed = self._grow(places, agents, stag, state.plants, goes, gathered)
        return StagHuntState(agents, *placed, at_stag=at_stag, at_plant=jnp.any(meets, axis=1))

    def _stag_moves(self, draw: jax.Array, state: StagHuntState) -> jax.Array:
        if self.stag == "stands":
            return state.stag
        room = self.size - self.stag_side + 1
        allowed = grid.legal(state.stag, room)
        if self.stag == "follows":
            # In half cells, since the middle of an even stag is between cells.
            gap = 2 * state.agents - (2 * state.stag + self.stag_side - 1)
            distance = jnp.sum(gap * gap, axis=-1)
            nearest = self.agents - 1 - jnp.argmin(distance[::-1])
            x, y = gap[nearest]
            allowed &= jnp.stack([x < -1, y > 1, x > 1, y < -1])
        moved = grid.move(state.stag, grid.choose(draw, allowed), room)
        return jnp.where(jnp.any(allowed), moved, state.stag)

    def _grow(
        self,
        drawn: list[jax.Array],
        agents: jax.Array,
        stag: jax.Array,
        plants: jax.Array,
        stag_goes: jax.Array,
        gathered: jax.Array,
    ) -> tuple[jax.Array, jax.Array]:
        """Lets what was collected come up on free cells; returns stag and plants."""
        taken = grid.occupied(jnp.concatenate([agents, plants]), self.size)
        old = grid.occupied(grid.footprint(stag, self.stag_side), self.size)
        new = self.free_stag(drawn[0], taken | old)
        stag = jnp.where(stag_goes, new, stag)
        taken |= grid.occupied(grid.footprint(stag, self.stag_side), self.size)
        for i in range(self.plants):
            cell = grid.free_cell(drawn[1 + i], taken, self.size)
            plants = plants.at[i].set(jnp.where(gathered[i], cell, plants[i]))
            taken |= grid.occupied(plants[i : i + 1], self.size)
        return stag, plants

    def free_stag(self, draw: jax.Array, taken: jax.Array) -> jax.Array:
        """Returns a place where no cell of the stag is taken, by a draw; 0, 0 if there is none."""
        room = self.size - self.stag_side + 1
        free = ~taken.reshape(self.size, self.size)
        fits = jnp.ones((room, room), bool)
        for dy in range(self.stag_side):
            for dx in range(self.stag_side):
                fits &= free[dy : dy + room, dx : dx + room]
        return grid.free_cell(draw, ~fits.reshape(-1), room)


@dataclass(frozen=True)
class Hunt(Task):
    """Plants pay a little, a stag much to each hunter; who meets it with too few others pays.

    There is no end but the horizon, and an episode counts as a success if a stag was caught in it.
    The task's state is how many were, int32.

    Attributes:
      hunters: how many it takes, as in the environment.
      stag_reward: of a caught stag, for each who stands on it.
      plant_reward: of standing on a plant; in a step in which the stag is met, only for those who
        do not stand on it, and in one in which it is caught for nobody.
      maul_penalty: g, of meeting the stag with too few.
    """

    hunters: int = 2
    stag_reward: float = 5.0
    plant_reward: float = 1.0
    maul_penalty: float = 5.0

    def check(self, pomdp: POMDP) -> None:
        """Refuses an environment whose stag takes another number of hunters."""
        taken = getattr(pomdp.environment, "hunters", self.hunters)
        if taken != self.hunters:
            raise JaxactError(
                f"the task's stag takes {self.hunters} hunters, the environment's {taken}"
            )

    def step(
        self, task_state: jax.Array, before: StagHuntState, action: jax.Array, after: StagHuntState
    ) -> tuple[jax.Array, Outcome]:
        """Judges one step; see `Task.step`."""
        del before, action
        met = jnp.sum(after.at_stag, dtype=jnp.int32)
        caught = met >= self.hunters
        hunts = after.at_stag & caught
        mauled = after.at_stag & ~caught
        gathers = after.at_plant & ~caught
        caught_so_far = task_state + caught.astype(jnp.int32)

        def pay(who: jax.Array, amount: float) -> jax.Array:
            return jnp.where(who, jnp.asarray(amount, jnp.float32), 0.0)

        return caught_so_far, Outcome(
            reward={
                "stag": pay(hunts, self.stag_reward),
                "plant": pay(gathers, self.plant_reward),
                "maul": -pay(mauled, self.maul_penalty),
            },
            success={"caught": caught_so_far > 0},
            terminated=jnp.bool_(False),
            metrics={"stags": caught_so_far.astype(jnp.float32)},
        )


@dataclass(frozen=True)
class StagHuntSampler(TaskSampler):
    """Where a hunt begins.

    Attributes:
      environment: whose grid it is.
      starts: agents in the "corners" and the stag in the middle, or all "anywhere" that is free.
      horizon: steps.
    """

    environment: StagHunt
    starts: str = "corners"
    horizon: int = 1000

    def __post_init__(self) -> None:
        if self.starts not in STARTS:
            raise unknown("start", self.starts, STARTS)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        world = self.environment
        drawn = grid.draws(key, 1 + world.agents + world.plants)
        if self.starts == "corners":
            agents = grid.corners(world.agents, world.size)
            stag = jnp.full(2, (world.size - world.stag_side + 1) // 2, jnp.int32)
        else:
            nothing = jnp.zeros(world.size**2, bool)
            agents = grid.free_cells(drawn[1 : 1 + world.agents], nothing, world.size)
            stag = world.free_stag(drawn[0], grid.occupied(agents, world.size))
        taken = grid.occupied(
            jnp.concatenate([agents, grid.footprint(stag, world.stag_side)]), world.size
        )
        plants = grid.free_cells(drawn[1 + world.agents :], taken, world.size)
        nobody = jnp.zeros(world.agents, bool)
        state = StagHuntState(agents, stag, plants, nobody, nobody)
        return Episode(state, jnp.int32(0), jnp.int32(self.horizon))


def stag_hunt(
    maul_penalty: float = 5.0,
    *,
    size: int = 5,
    agents: int = 2,
    plants: int = 2,
    stag_side: int = 1,
    stag: str = "follows",
    flees: bool = False,
    hunters: int = 2,
    starts: str = "corners",
    horizon: int = 1000,
) -> POMDP:
    """Builds a stag hunt; by default with the rules of Gym-Stag-Hunt.

    Args:
      maul_penalty: g, what it costs each who meets the stag with fewer than `hunters`.
      size, agents, plants, stag_side, stag, flees, hunters: see `StagHunt`.
      starts: "corners" or "anywhere", see `StagHuntSampler`.
      horizon: steps.

    Returns:
      The POMDP; its observation has the "map".

    Raises:
      JaxactError: no such stag or start, more hunters than agents, or there is no room.
    """
    world = StagHunt(size, agents, plants, stag_side, stag, flees, hunters)
    task = Hunt(hunters, maul_penalty=maul_penalty)
    sampler = StagHuntSampler(world, starts, horizon)
    return POMDP(world, task, sampler, {"map": MapSensor(world, 2)})
