"""FurnLift: two agents find a television, stand around it and lift it at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.furniture.coordination import (
    LIFT_ACTIONS,
    MOVE_AHEAD,
    PICKUP,
    ROTATE_LEFT,
    ROTATE_RIGHT,
    Coordination,
    lift_matrices,
)
from envs_jax.furniture.footprints import (
    CELL,
    DIRECTIONS,
    TELEVISION,
    at,
    choose_place,
    covered,
    is_set,
    places,
)
from envs_jax.furniture.rooms import DrawnRooms, WrittenRooms
from envs_jax.furniture.soundness import check_lifting
from envs_jax.furniture.views import EgocentricView
from jaxact.pomdp import POMDP, Environment, Episode, Outcome, PyTree, Task, TaskSampler
from jaxact.spaces import Agents, Discrete

# Cells within which a television is seen: 1.25 m.
SIGHT = 5
# Cells (Manhattan) that agents must be apart to lift it.
APART = 8


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FurnLiftState:
    """Who and what is where, and how the last step went.

    Attributes:
      floor: bool [S, S], where agents can stand; not under the television.
      agents: int32 [2, 2], their cells.
      yaw: int32 [2].
      object: int32 [2], the television's middle.
      object_yaw: int32 scalar.
      lifted: bool, whether it has been.
      liftable: bool, whether it could have been in the last step.
      succeeded: bool [2], whose action did what it is for.
    """

    floor: jax.Array
    agents: jax.Array
    yaw: jax.Array
    object: jax.Array
    object_yaw: jax.Array
    lifted: jax.Array
    liftable: jax.Array
    succeeded: jax.Array


@dataclass(frozen=True)
class FurnLift(Environment):
    """Two agents and a television in a room, on a map of 0.25 m a cell.

    The television is lifted if both pick it up at once while both see it and are at least 8 cells
    (Manhattan) apart. An agent sees it if its middle is at most 1.25 m away and not more than 45
    degrees aside of where the agent looks; nothing hides it. All else happens one after the other,
    the first agent's action first; picking up alone fails.

    Attributes:
      agents_block: whether agents are in each other's way.
    """

    agents_block: bool = False

    @property
    def agents(self) -> int:
        """Two."""
        return 2

    @property
    def action_names(self) -> tuple[str, ...]:
        """The five actions."""
        return LIFT_ACTIONS

    @property
    def action_space(self) -> Agents:
        """An action for each agent."""
        return Agents(Discrete(len(LIFT_ACTIONS)), self.agents)

    @property
    def matrices(self) -> np.ndarray:
        """What each pair of actions is, uint8 [4, 4, 5, 5], the same at all of the agents' yaws."""
        return lift_matrices()

    @property
    def colors(self) -> tuple[tuple[int, int, int], ...]:
        """Of the map's planes."""
        return ((235, 230, 215), (150, 60, 170))

    def map(self, state: FurnLiftState) -> jax.Array:
        """Returns bool [2, S, S]: the floor, and the cells that the television covers."""
        size = state.floor.shape[0]
        television = covered(TELEVISION, state.object, state.object_yaw, size)
        return jnp.stack([state.floor, television])

    def sees(self, state: FurnLiftState) -> jax.Array:
        """Returns which agents see the television, bool [2]."""
        gap = state.object - state.agents
        ahead = jnp.sum(gap * jnp.asarray(DIRECTIONS)[state.yaw], axis=-1)
        aside = jnp.sum(gap * jnp.asarray(DIRECTIONS)[(state.yaw + 1) % 4], axis=-1)
        return (jnp.sum(gap * gap, axis=-1) <= SIGHT**2) & (ahead >= jnp.abs(aside))

    def step(self, key: jax.Array, state: FurnLiftState, action: jax.Array) -> FurnLiftState:
        """Returns what follows; see the class."""
        del key
        action = jnp.asarray(action, jnp.int32)
        apart = jnp.sum(jnp.abs(state.agents[0] - state.agents[1])) >= APART
        liftable = jnp.all(self.sees(state)) & apart
        lifted = liftable & jnp.all(action == PICKUP)
        agents, yaw, succeeded = state.agents, state.yaw, []
        for i in range(2):
            right, left = action[i] == ROTATE_RIGHT, action[i] == ROTATE_LEFT
            turn = right.astype(jnp.int32) - left.astype(jnp.int32)
            to = agents[i] + jnp.asarray(DIRECTIONS)[yaw[i]]
            walks = is_set(state.floor, to) & (action[i] == MOVE_AHEAD)
            if self.agents_block:
                walks &= jnp.any(to != agents[1 - i])
            agents = agents.at[i].set(jnp.where(walks, to, agents[i]))
            yaw = yaw.at[i].set((yaw[i] + turn) % 4)
            succeeded.append(walks | lifted | ((action[i] != MOVE_AHEAD) & (action[i] != PICKUP)))
        return replace(
            state,
            agents=agents,
            yaw=yaw,
            lifted=lifted,
            liftable=liftable,
            succeeded=jnp.stack(succeeded),
        )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LiftState:
    """How an episode of `Lift` went so far.

    Attributes:
      initial: float32, the agents' mean Manhattan distance from the television at the start, cells.
      steps: int32, taken.
      failed_pickups: int32, actions to pick up that lifted nothing.
      missed_pickups: int32, steps in which it could have been lifted, and was not.
    """

    initial: jax.Array
    steps: jax.Array
    failed_pickups: jax.Array
    missed_pickups: jax.Array


@dataclass(frozen=True)
class Lift(Task):
    """To lift the television; the step in which that is done costs nothing.

    Metrics: "md_spl", success weighted by the agents' mean Manhattan distance over steps;
    "distance", that mean at the end, in metres; "failed_pickups" and "missed_pickups", how many
    there were.

    Attributes:
      step_penalty: of each step.
      failure_penalty: for an agent whose action was not done.
      pickup_penalty: for an agent that picked up and lifted nothing, besides.
      lifted: for both.
    """

    step_penalty: float = -0.01
    failure_penalty: float = -0.02
    pickup_penalty: float = -0.1
    lifted: float = 1.0

    def step(
        self, task_state: LiftState, before: FurnLiftState, action: jax.Array, after: FurnLiftState
    ) -> tuple[LiftState, Outcome]:
        """Judges one step; see `Task.step`."""
        del before
        lifted = after.lifted
        misses = (jnp.asarray(action, jnp.int32) == PICKUP) & ~lifted
        done = LiftState(
            initial=task_state.initial,
            steps=task_state.steps + 1,
            failed_pickups=task_state.failed_pickups + jnp.sum(misses, dtype=jnp.int32),
            missed_pickups=task_state.missed_pickups + (after.liftable & ~lifted).astype(jnp.int32),
        )
        steps = done.steps.astype(jnp.float32)

        def pay(who: jax.Array, amount: float) -> jax.Array:
            return jnp.where(who, jnp.asarray(amount, jnp.float32), 0.0) + jnp.zeros(2, jnp.float32)

        return done, Outcome(
            reward={
                "step": pay(~lifted, self.step_penalty),
                "failed": pay(~after.succeeded, self.failure_penalty),
                "pickup": pay(misses, self.pickup_penalty),
                "lifted": pay(lifted, self.lifted),
            },
            success={"lifted": lifted},
            terminated=lifted,
            metrics={
                "md_spl": jnp.where(
                    lifted, (done.initial + 1e-4) / (jnp.maximum(done.initial, steps) + 1e-4), 0.0
                ),
                "distance": distance(after) * CELL,
                "failed_pickups": done.failed_pickups.astype(jnp.float32),
                "missed_pickups": done.missed_pickups.astype(jnp.float32),
            },
        )


def distance(state: FurnLiftState) -> jax.Array:
    """Returns the agents' mean Manhattan distance from the television's middle, float32, cells."""
    gaps = jnp.sum(jnp.abs(state.agents - state.object), axis=-1)
    return jnp.mean(gaps.astype(jnp.float32))


@dataclass(frozen=True)
class FurnLiftSampler(TaskSampler):
    """A room, a television where two can stand around it, and agents anywhere on the floor.

    Attributes:
      rooms: `DrawnRooms` or `WrittenRooms`.
      horizon: steps.

    Raises:
      JaxactError: a written room has no place for them, see `soundness.check_lifting`.
    """

    rooms: DrawnRooms | WrittenRooms
    horizon: int = 250

    def __post_init__(self) -> None:
        check_lifting(self.rooms, SIGHT, APART)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        room_key, object_key, cell_keys, yaw_key = jax.random.split(key, 4)
        room = self.rooms.sample(room_key)
        size = room.floor.shape[0]
        allowed = places(TELEVISION, room.air) & _two_sides(room.floor)
        object_yaw, middle = choose_place(object_key, allowed)
        floor = room.floor & ~covered(TELEVISION, middle, object_yaw, size)
        free, agents = floor, []
        for one in jax.random.split(cell_keys):
            agents.append(choose_place(one, free[None])[1])
            free &= ~at(agents[-1], size)
        state = FurnLiftState(
            floor=floor,
            agents=jnp.stack(agents),
            yaw=jax.random.randint(yaw_key, (2,), 0, 4, jnp.int32),
            object=middle,
            object_yaw=object_yaw,
            lifted=jnp.bool_(False),
            liftable=jnp.bool_(False),
            succeeded=jnp.ones(2, bool),
        )
        none = jnp.int32(0)
        task = LiftState(distance(state), none, none, none)
        return Episode(state, task, jnp.int32(self.horizon))


def _two_sides(floor: jax.Array) -> jax.Array:
    """Returns where a television is seen from two cells of floor that are far enough apart.

    Args:
      floor: bool [S, S].

    Returns:
      bool [4, S, S] by the television's yaw.
    """
    size = floor.shape[0]
    grid = np.stack(np.meshgrid(*[np.arange(-SIGHT, SIGHT + 1)] * 2, indexing="ij"), -1)
    offsets = grid.reshape(-1, 2)
    offsets = offsets[(offsets**2).sum(-1) <= SIGHT**2]
    padded = jnp.pad(floor, SIGHT)
    stands = jnp.stack(
        [padded[r : r + size, c : c + size] for r, c in (offsets + SIGHT).tolist()], axis=-1
    )
    outside = np.stack([(offsets[:, None] != cells).any(-1).all(-1) for cells in TELEVISION])
    stands = stands & jnp.asarray(outside)[:, None, None]

    def spread(along: np.ndarray) -> jax.Array:
        values = jnp.asarray(along, jnp.int32)
        least = jnp.min(jnp.where(stands, values, 99), axis=-1)
        return jnp.max(jnp.where(stands, values, -99), axis=-1) - least

    # The greatest Manhattan distance is the greater of the spreads along the two diagonals.
    farthest = jnp.maximum(spread(offsets.sum(-1)), spread(offsets[:, 0] - offsets[:, 1]))
    return farthest >= APART


def furn_lift(
    *,
    size: int = 24,
    maps: tuple[tuple[str, ...], ...] = (),
    agents_block: bool = False,
    view: int = 15,
    horizon: int = 250,
) -> POMDP:
    """Builds FurnLift; by default with the rules of CORDIAL-SYNC's code.

    Args:
      size: cells along each edge of the map.
      maps: of rooms, see `WrittenRooms`; without any they are drawn.
      agents_block: see `FurnLift`.
      view: cells along each edge of what agents see.
      horizon: steps.

    Returns:
      The POMDP; its observation has the "view", and the "coordination" for losses.

    Raises:
      JaxactError: there are no such maps or sizes, or nothing fits into a map.
    """
    world = FurnLift(agents_block)
    rooms = WrittenRooms(maps, size) if maps else DrawnRooms(size)
    sensors = {"view": EgocentricView(world, view), "coordination": Coordination(world)}
    return POMDP(world, Lift(), FurnLiftSampler(rooms, horizon), sensors)
