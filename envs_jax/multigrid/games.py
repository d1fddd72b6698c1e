"""Soccer and Collect, gym-multigrid's two games."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import tiles
from envs_jax.multigrid.environment import (
    OBJECT_GOAL,
    MultiGrid,
    MultiGridState,
    check_indices,
)
from envs_jax.multigrid.points import Points
from envs_jax.multigrid.sensors import VIEW_SIZE, MultiGridSensor
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, Episode, PyTree, TaskSampler


@dataclass(frozen=True)
class MultiGridSampler(TaskSampler):
    """Goals where they are said to be; balls and agents on any other cells, looking anywhere.

    Attributes:
      environment: whose grid it is.
      task: whose state episodes begin with.
      num_balls: how many balls there are of each index in
      balls_index: likewise.
      goal_pst: cells (x, y) of goals, whose indices are in
      goal_index: likewise.
      horizon: steps.
    """

    environment: MultiGrid
    task: Points
    num_balls: tuple[int, ...]
    balls_index: tuple[int, ...]
    goal_pst: tuple[tuple[int, int], ...] = ()
    goal_index: tuple[int, ...] = ()
    horizon: int = 10_000

    def __post_init__(self) -> None:
        for counted, indices in (("num_balls", "balls_index"), ("goal_pst", "goal_index")):
            if len(getattr(self, counted)) != len(getattr(self, indices)):
                raise JaxactError(
                    f"{counted} and {indices} must be as long as each other; they are of "
                    f"{len(getattr(self, counted))} and {len(getattr(self, indices))}"
                )
            check_indices(indices, getattr(self, indices))
        width, height = self.environment.width, self.environment.height
        for (x, y), times in Counter(self.goal_pst).items():
            if times > 1 or not (0 < x < width - 1 and 0 < y < height - 1):
                raise JaxactError(
                    f"goal_pst must be different cells inside the walls of {width}×{height}; got "
                    f"{(x, y)}" + f" {times} times" * (times > 1)
                )
        room, needed = int(self._free.sum()), sum(self.num_balls) + self.environment.agents
        if needed > room or min(self.num_balls, default=0) < 0:
            raise JaxactError(
                f"a grid of {width}×{height} with {len(self.goal_pst)} goals has room for {room} "
                f"balls and agents, and there would be {needed}"
            )

    @property
    def _field(self) -> np.ndarray:
        """The tiles uint8[W, H] without balls."""
        field = np.full((self.environment.width, self.environment.height), tiles.WALL_TILE)
        field[1:-1, 1:-1] = tiles.EMPTY_TILE
        for (x, y), index in zip(self.goal_pst, self.goal_index, strict=True):
            field[x, y] = tiles.tile(OBJECT_GOAL, index)
        return field.astype(np.uint8)

    @property
    def _free(self) -> np.ndarray:
        return self._field == tiles.EMPTY_TILE

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        agents, height = self.environment.agents, self.environment.height
        balls = [
            tiles.tile(tiles.BALL, index)
            for count, index in zip(self.num_balls, self.balls_index, strict=True)
            for _ in range(count)
        ]
        cells_key, directions_key = jax.random.split(key)
        chances = jax.random.uniform(cells_key, self._field.shape, jnp.float32)
        chances = jnp.where(jnp.asarray(self._free), chances, -1.0).reshape(-1)
        cells = jax.lax.top_k(chances, agents + len(balls))[1]
        x, y = cells // height, cells % height
        state = MultiGridState(
            tiles=jnp.asarray(self._field)
            .at[x[agents:], y[agents:]]
            .set(jnp.array(balls, jnp.uint8)),
            positions=jnp.stack([x, y], axis=-1)[:agents],
            directions=jax.random.randint(directions_key, (agents,), 0, 4, jnp.int32),
            carrying=jnp.zeros(agents, jnp.uint8),
            scored=jnp.zeros(agents, jnp.uint8),
        )
        return Episode(state, self.task.start, jnp.int32(self.horizon))


def soccer(
    *,
    width: int = 15,
    height: int = 10,
    agents_index: tuple[int, ...] = (1, 1, 2, 2),
    num_balls: tuple[int, ...] = (1,),
    balls_index: tuple[int, ...] = (0,),
    goal_pst: tuple[tuple[int, int], ...] = ((1, 5), (13, 5)),
    goal_index: tuple[int, ...] = (1, 2),
    goal_reward: float = 1.0,
    zero_sum: bool = True,
    ends: bool = False,
    moves: str = "in_turn",
    observation: str = "image",
    view_size: int = VIEW_SIZE,
    horizon: int = 10_000,
) -> POMDP:
    """Builds Soccer: who drops a ball into a goal earns for the team whose goal it is.

    A ball that went into a goal is gone; with one ball an episode is decided by it, and goes on
    without, as in the original, unless it `ends`.

    Args:
      width, height, agents_index, moves: see `MultiGrid`. Two teams of two, by default.
      num_balls, balls_index, goal_pst, goal_index, horizon: see `MultiGridSampler`.
      goal_reward: of a ball in a goal.
      zero_sum: whether the other teams pay as much, see `Points`.
      ends: whether the episode ends with the last ball in a goal.
      observation, view_size: see `MultiGridSensor`. The original's Soccer has views of 3×3 cells
        by default (`view_size=3`), its engine and its Collect of 7×7.

    Returns:
      The POMDP; its observation has the "image".

    Raises:
      JaxactError: there is no such choice, or no room.
    """
    world = MultiGrid(width, height, tuple(agents_index), "carries", moves)
    rewards = (goal_reward,) * tiles.NUM_COLORS
    task = Points(world.agents_index, sum(num_balls), rewards, "color", zero_sum, ends)
    sampler = MultiGridSampler(
        world, task, tuple(num_balls), tuple(balls_index), goal_pst, tuple(goal_index), horizon
    )
    return POMDP(world, task, sampler, {"image": MultiGridSensor(world, observation, view_size)})


def collect(
    *,
    width: int = 10,
    height: int = 10,
    agents_index: tuple[int, ...] = (1, 2, 3),
    num_balls: tuple[int, ...] = (5,),
    balls_index: tuple[int, ...] = (0,),
    balls_reward: tuple[float, ...] = (1.0,),
    credit: str = "team",
    zero_sum: bool = True,
    ends: bool = False,
    moves: str = "in_turn",
    observation: str = "image",
    view_size: int = VIEW_SIZE,
    horizon: int = 10_000,
) -> POMDP:
    """Builds Collect: who picks up a ball earns for its team.

    The original's code credits a ball to the index that is the collecting agent's number in the
    list, counted from 0, so that in its own game the first agent's balls cost all, and the others'
    pay their predecessor; `credit="number"` has that. Its README credits it to the agents of the
    ball's colour (`credit="color"`), which in its own game are none.

    Args:
      width, height, agents_index, moves: see `MultiGrid`. Three agents, each on its own, by
        default, for all that the id says 4.
      num_balls, balls_index, horizon: see `MultiGridSampler`.
      balls_reward: of a ball of each index in `balls_index`.
      credit, zero_sum: see `Points`.
      ends: whether the episode ends when all balls have been collected.
      observation, view_size: see `MultiGridSensor`.

    Returns:
      The POMDP; its observation has the "image".

    Raises:
      JaxactError: there is no such choice, or no room.
    """
    if len(balls_reward) != len(balls_index) or len(set(balls_index)) != len(balls_index):
        raise JaxactError(
            "balls_reward must have one reward for each of balls_index, no two of which are alike; "
            f"got {tuple(balls_reward)} for {tuple(balls_index)}"
        )
    world = MultiGrid(width, height, tuple(agents_index), "collects", moves)
    worth = dict(zip(balls_index, balls_reward, strict=True))
    rewards = tuple(worth.get(index, 0.0) for index in range(tiles.NUM_COLORS))
    task = Points(world.agents_index, sum(num_balls), rewards, credit, zero_sum, ends)
    sampler = MultiGridSampler(world, task, tuple(num_balls), tuple(balls_index), horizon=horizon)
    return POMDP(world, task, sampler, {"image": MultiGridSensor(world, observation, view_size)})
