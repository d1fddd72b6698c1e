"""FurnMove: two agents carry a television to a dresser, and must agree on every step of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.furniture.coordination import (
    CARRY,
    INDIVIDUAL,
    MOVE_ACTIONS,
    MOVE_AHEAD,
    PASS,
    PUSH,
    ROTATE_LEFT,
    ROTATE_RIGHT,
    TOGETHER,
    TURN_OBJECT,
    UNCOORDINATED,
    Coordination,
    move_matrices,
)
from envs_jax.furniture.footprints import (
    CELL,
    DIRECTIONS,
    DRESSER,
    NEAR,
    TELEVISION,
    at,
    choose_place,
    covered,
    is_near,
    is_set,
    places,
)
from envs_jax.furniture.rooms import DrawnRooms, WrittenRooms
from envs_jax.furniture.soundness import check_carrying
from envs_jax.furniture.views import EgocentricView
from jaxact.pomdp import POMDP, Environment, Episode, Outcome, PyTree, Task, TaskSampler
from jaxact.spaces import Agents, Discrete


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FurnMoveState:
    """Who and what is where, and how the last step went.

    Attributes:
      floor: bool [S, S], where agents can stand; not under the dresser.
      places: bool [4, S, S], where the television can have its middle, by its yaw.
      agents: int32 [2, 2], their cells.
      yaw: int32 [2].
      object: int32 [2], the television's middle.
      object_yaw: int32 scalar.
      goal: int32 [2], the dresser's middle.
      goal_yaw: int32 scalar.
      visited: bool [S, S], where the television's middle has been.
      kind: int32 scalar, what the last pair of actions was, see `coordination`.
      succeeded: bool [2], whose action did what it is for.
    """

    floor: jax.Array
    places: jax.Array
    agents: jax.Array
    yaw: jax.Array
    object: jax.Array
    object_yaw: jax.Array
    goal: jax.Array
    goal_yaw: jax.Array
    visited: jax.Array
    kind: jax.Array
    succeeded: jax.Array


@dataclass(frozen=True)
class FurnMove(Environment):
    """Two agents that hold a television, on a map of 0.25 m a cell.

    Actions of both together happen if they are coordinated: both carry the television along, both
    push it while they stand, or both turn it, and in one direction of the map. It stays where it
    can be, agents on the floor, not in one cell, within reach of it (0.76 m) and not under it; what
    would lead elsewhere fails and changes nothing. An agent's own actions happen one after the
    other, the first agent's first.

    Attributes:
      one_passes: whether one of the two must pass for an agent's own action to happen. If so, two
        actions that are not coordinated fail both, but for the passing itself.
    """

    one_passes: bool = True

    @property
    def agents(self) -> int:
        """Two."""
        return 2

    @property
    def action_names(self) -> tuple[str, ...]:
        """The 13 actions."""
        return MOVE_ACTIONS

    @property
    def action_space(self) -> Agents:
        """An action for each agent."""
        return Agents(Discrete(len(MOVE_ACTIONS)), self.agents)

    @property
    def matrices(self) -> np.ndarray:
        """What each pair of actions is, uint8 [4, 4, 13, 13] by the agents' yaws."""
        return move_matrices(self.one_passes)

    @property
    def colors(self) -> tuple[tuple[int, int, int], ...]:
        """Of the map's planes."""
        return ((150, 150, 165), (235, 230, 215), (215, 205, 235), (150, 60, 170), (230, 160, 40))

    def map(self, state: FurnMoveState) -> jax.Array:
        """Returns bool [5, S, S]: where the television's middle can be at some yaw, the floor,
        where it has been, and the cells that television and dresser cover.
        """
        size = state.floor.shape[0]
        return jnp.stack(
            [
                jnp.any(state.places, axis=0),
                state.floor,
                state.visited,
                covered(TELEVISION, state.object, state.object_yaw, size),
                covered(DRESSER, state.goal, state.goal_yaw, size),
            ]
        )

    def step(self, key: jax.Array, state: FurnMoveState, action: jax.Array) -> FurnMoveState:
        """Returns what follows; see the class."""
        del key
        action = jnp.asarray(action, jnp.int32)
        kind = jnp.asarray(self.matrices)[state.yaw[0], state.yaw[1], action[0], action[1]]
        passes = jnp.any(action == PASS) if self.one_passes else jnp.bool_(True)
        apart = self._alone(state, action, passes & (kind != TOGETHER))
        together, works = self._together(state, action[0])
        works &= kind == TOGETHER
        after = jax.tree.map(lambda a, b: jnp.where(works, a, b), together, apart)
        return replace(
            after,
            visited=after.visited | at(after.object, after.visited.shape[0]),
            kind=kind.astype(jnp.int32),
            succeeded=after.succeeded | works,
        )

    def _alone(self, state: FurnMoveState, action: jax.Array, happen: jax.Array) -> FurnMoveState:
        """Agents' own actions, one after the other."""
        agents, yaw, succeeded = state.agents, state.yaw, []
        for i in range(2):
            right, left = action[i] == ROTATE_RIGHT, action[i] == ROTATE_LEFT
            turn = right.astype(jnp.int32) - left.astype(jnp.int32)
            to = agents[i] + jnp.asarray(DIRECTIONS)[yaw[i]]
            stands = is_set(state.floor, to) & is_near(to, state.object, state.object_yaw)
            free = stands & jnp.any(to != agents[1 - i])
            walks = happen & (action[i] == MOVE_AHEAD) & free
            agents = agents.at[i].set(jnp.where(walks, to, agents[i]))
            yaw = yaw.at[i].set(jnp.where(happen, (yaw[i] + turn) % 4, yaw[i]))
            succeeded.append(happen & (action[i] < CARRY) & (walks | (action[i] != MOVE_AHEAD)))
        return replace(state, agents=agents, yaw=yaw, succeeded=jnp.stack(succeeded))

    def _together(self, state: FurnMoveState, action: jax.Array) -> tuple[FurnMoveState, jax.Array]:
        """What the first agent's action does if both take it, and whether it can be."""
        carries = (action >= CARRY) & (action < TURN_OBJECT)
        relative = jnp.where(carries, action - CARRY, action - PUSH)
        turns = action == TURN_OBJECT
        direction = jnp.asarray(DIRECTIONS)[(state.yaw[0] + relative) % 4]
        direction = jnp.where(turns, 0, direction)
        object_yaw = jnp.where(turns, (state.object_yaw + 1) % 4, state.object_yaw)
        middle = state.object + direction
        agents = jnp.where(carries, state.agents + direction, state.agents)
        stand = jax.vmap(is_set, (None, 0))(state.floor, agents) | ~carries
        near = is_near(agents, middle, object_yaw)
        works = is_set(state.places[object_yaw], middle) & jnp.all(stand & near)
        return replace(state, agents=agents, object=middle, object_yaw=object_yaw), works


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CarryState:
    """How an episode of `Carry` went so far; int32 scalars, distances in cells.

    Attributes:
      initial: Manhattan distance from the television to the dresser at the start.
      closest: the shortest so far.
      steps: taken.
      uncoordinated: steps in which the two actions were.
      failed: actions, of both agents, that were not done.
    """

    initial: jax.Array
    closest: jax.Array
    steps: jax.Array
    uncoordinated: jax.Array
    failed: jax.Array


@dataclass(frozen=True)
class Carry(Task):
    """To bring the television to less than 0.26 m (Manhattan, middles) from the dresser.

    Both earn `closer` when it comes nearer than it ever was, and in its place `reached` when that
    is the goal. CORDIAL-SYNC's code pays `closer` there too, which in its experiments is as much.

    Metrics: "md_spl", success weighted by Manhattan distance over steps; "distance" in metres;
    "invalid_actions", the share of steps with uncoordinated actions; "failed_actions", the share of
    actions that were not done.

    Attributes:
      step_penalty: of each step.
      failure_penalty: for an agent whose action was not done.
      closer: see above.
      reached: see above.
    """

    step_penalty: float = -0.01
    failure_penalty: float = -0.02
    closer: float = 1.0
    reached: float = 1.0

    def step(
        self,
        task_state: CarryState,
        before: FurnMoveState,
        action: jax.Array,
        after: FurnMoveState,
    ) -> tuple[CarryState, Outcome]:
        """Judges one step; see `Task.step`."""
        del before, action
        distance = manhattan(after)
        invalid = (after.kind == UNCOORDINATED).astype(jnp.int32)
        reached, nearer = distance <= 1, distance < task_state.closest
        done = CarryState(
            initial=task_state.initial,
            closest=jnp.minimum(distance, task_state.closest),
            steps=task_state.steps + 1,
            uncoordinated=task_state.uncoordinated + invalid,
            failed=task_state.failed + jnp.sum(~after.succeeded, dtype=jnp.int32),
        )
        steps, initial = done.steps.astype(jnp.float32), done.initial.astype(jnp.float32)

        def pay(who: jax.Array, amount: float) -> jax.Array:
            return jnp.where(who, jnp.asarray(amount, jnp.float32), 0.0) + jnp.zeros(2, jnp.float32)

        return done, Outcome(
            reward={
                "step": pay(jnp.bool_(True), self.step_penalty),
                "failed": pay(~after.succeeded, self.failure_penalty),
                "closer": pay(nearer & ~reached, self.closer),
                "reached": pay(reached, self.reached),
            },
            success={"reached": reached},
            terminated=reached,
            metrics={
                "md_spl": jnp.where(
                    reached, (initial + 1e-4) / (jnp.maximum(initial, steps) + 1e-4), 0.0
                ),
                "distance": distance.astype(jnp.float32) * CELL,
                "invalid_actions": done.uncoordinated.astype(jnp.float32) / steps,
                "failed_actions": done.failed.astype(jnp.float32) / (2 * steps),
            },
        )


def manhattan(state: FurnMoveState) -> jax.Array:
    """Returns the distance from the television's middle to the dresser's, int32, in cells."""
    return jnp.sum(jnp.abs(state.object - state.goal), dtype=jnp.int32)


@dataclass(frozen=True)
class FurnMoveSampler(TaskSampler):
    """A room, a television held by two, and a dresser, wherever there is room for them.

    Agents look towards the television. The dresser is nowhere where the episode would be over.

    Attributes:
      rooms: `DrawnRooms` or `WrittenRooms`.
      horizon: steps.

    Raises:
      JaxactError: a written room has no place for them, see `soundness.check_carrying`.
    """

    rooms: DrawnRooms | WrittenRooms
    horizon: int = 250

    def __post_init__(self) -> None:
        check_carrying(self.rooms)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        keys = jax.random.split(key, 6)
        room = self.rooms.sample(keys[0])
        size = room.floor.shape[0]
        fits = places(TELEVISION, room.air)
        stands = _room_to_hold(room.floor)
        object_yaw, middle = choose_place(keys[1], fits & stands & room.floor)
        index = jnp.stack(jnp.meshgrid(*[jnp.arange(size, dtype=jnp.int32)] * 2, indexing="ij"), -1)
        free = room.floor & is_near(index, middle, object_yaw)
        agents = []
        for one in jax.random.split(keys[2]):
            agents.append(choose_place(one, free[None])[1])
            free &= ~at(agents[-1], size)
        cells = jnp.stack(agents)
        taken = at(cells[0], size) | at(cells[1], size)
        far = jnp.sum(jnp.abs(index - middle), axis=-1) > 1
        goal_yaw, goal = choose_place(keys[3], places(DRESSER, room.floor & ~taken) & far)
        state = FurnMoveState(
            floor=room.floor & ~covered(DRESSER, goal, goal_yaw, size),
            places=fits,
            agents=cells,
            yaw=_towards(keys[4], cells, middle),
            object=middle,
            object_yaw=object_yaw,
            goal=goal,
            goal_yaw=goal_yaw,
            visited=at(middle, size),
            kind=jnp.int32(INDIVIDUAL),
            succeeded=jnp.ones(2, bool),
        )
        distance, none = manhattan(state), jnp.int32(0)
        task = CarryState(distance, distance, none, none, none)
        return Episode(state, task, jnp.int32(self.horizon))


def _room_to_hold(floor: jax.Array) -> jax.Array:
    """Returns where a television has at least two cells of floor around it, bool [4, S, S]."""
    size = floor.shape[0]
    kernels = jnp.asarray(NEAR[:, None], jnp.float32)
    counts = jax.lax.conv_general_dilated(
        floor[None, None].astype(jnp.float32), kernels, (1, 1), "SAME"
    )
    return counts[0].reshape(4, size, size) > 1.5


def _towards(key: jax.Array, cells: jax.Array, middle: jax.Array) -> jax.Array:
    """Returns yaws int32 [2] of agents that look towards a cell along one of the axes, drawn."""
    axis_key, side_key = jax.random.split(key)
    by_row = jax.random.bernoulli(axis_key, 0.5, (2,))
    gap = jnp.where(by_row, cells[:, 0] - middle[0], middle[1] - cells[:, 1])
    either = jax.random.bernoulli(side_key, 0.5, (2,))
    onwards = jnp.where(gap == 0, either, gap > 0)
    # Up or down by rows, right or left by columns.
    turned = jnp.where(onwards, jnp.int32(0), jnp.int32(2))
    return turned + jnp.where(by_row, jnp.int32(0), jnp.int32(1))


def furn_move(
    *,
    size: int = 24,
    maps: tuple[tuple[str, ...], ...] = (),
    one_passes: bool = True,
    view: int = 15,
    horizon: int = 250,
) -> POMDP:
    """Builds FurnMove; by default with the rules of CORDIAL-SYNC's grid worlds.

    Args:
      size: cells along each edge of the map.
      maps: of rooms, see `WrittenRooms`; without any they are drawn.
      one_passes: see `FurnMove`.
      view: cells along each edge of what agents see.
      horizon: steps.

    Returns:
      The POMDP; its observation has the "view", and the "coordination" for losses.

    Raises:
      JaxactError: there are no such maps or sizes, or nothing fits into a map.
    """
    world = FurnMove(one_passes)
    rooms = WrittenRooms(maps, size) if maps else DrawnRooms(size)
    sensors = {"view": EgocentricView(world, view), "coordination": Coordination(world)}
    return POMDP(world, Carry(), FurnMoveSampler(rooms, horizon), sensors)
