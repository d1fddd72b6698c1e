"""MiniGrid's Dynamic-Obstacles: balls that roam, and must not be run into."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import cast

import jax
import jax.numpy as jnp

from envs_jax.minigrid import expert as experts
from envs_jax.minigrid import tiles
from envs_jax.minigrid.environment import (
    FORWARD,
    LEFT,
    GridWorld,
    at_index,
    cell_index,
    front_index,
    with_index,
)
from envs_jax.minigrid.state import GridState
from envs_jax.minigrid.tasks import REWARD_SLOPE, GoalState, entered, success_reward
from jaxact.pomdp import Environment, ExpertAction, Outcome, Task
from jaxact.spaces import Discrete

NUM_ACTIONS = 3


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ObstacleState(GridState):
    """A grid world with obstacles.

    Attributes:
      obstacles: int32[n, 2], the cells of the balls that roam, in the order in which they move.
      blocked: bool scalar, whether something other than a goal square was in front of the agent
        when the last step began.
    """

    obstacles: jax.Array
    blocked: jax.Array

    @classmethod
    def of(cls, world: GridState, obstacles: jax.Array) -> ObstacleState:
        """Returns the first state of an episode that begins in `world`."""
        parts = {field.name: getattr(world, field.name) for field in fields(GridState)}
        return cls(**parts, obstacles=obstacles, blocked=jnp.bool_(False))


@dataclass(frozen=True)
class ObstacleWorld(Environment):
    """MiniGrid's dynamics with obstacles that move before the agent does.

    Actions are left, right and forward; all higher numbers are left. One after the other, each
    obstacle goes to a random empty cell of the eight around it, if there is one, but not to the
    agent's. Source: `DynamicObstaclesEnv.step` of minigrid 3.2.0.
    """

    width: int
    height: int

    @property
    def action_names(self) -> tuple[str, ...]:
        """Left, right, forward."""
        return ("left", "right", "forward")

    @property
    def action_space(self) -> Discrete:
        """Three actions."""
        return Discrete(NUM_ACTIONS)

    def step(self, key: jax.Array, state: ObstacleState, action: jax.Array) -> ObstacleState:
        """Returns the state after the obstacles' random moves and one action."""
        action = jnp.asarray(action, jnp.int32)
        action = jnp.where(action >= NUM_ACTIONS, LEFT, action)
        moved = self._moved(state, self.draw_moves(key, state))
        # What has fields of its own keeps them.
        return cast(ObstacleState, GridWorld(self.width, self.height).step(key, moved, action))

    def draw_moves(self, key: jax.Array, state: ObstacleState) -> jax.Array:
        """Returns int32[n, 2], where the obstacles go."""
        count = state.obstacles.shape[0]
        square = jnp.indices((3, 3), jnp.int32).reshape(2, 9).T - 1
        around = state.obstacles[:, None] + square
        found = at_index(state.tiles, jax.vmap(jax.vmap(self._index))(around))
        # Where another obstacle stands may be left by the time that it is this one's turn.
        roamed = jnp.any(jnp.all(around[:, :, None] == state.obstacles, axis=-1), axis=-1)
        here = jnp.all(around == state.position, axis=-1)
        open_ = ((found == tiles.EMPTY_TILE) | roamed) & ~here
        draws = jax.random.uniform(key, (count,), jnp.float32)

        def move(cells: jax.Array, item: tuple[jax.Array, ...]) -> tuple[jax.Array, None]:
            number, reached, may_go, draw = item
            taken = jnp.any(jnp.all(reached[:, None] == cells, axis=-1), axis=-1)
            ranks = jnp.cumsum(may_go & ~taken, dtype=jnp.int32)
            rank = (draw * ranks[-1].astype(jnp.float32)).astype(jnp.int32)
            chosen = jnp.argmax(ranks > rank)
            cell = jnp.where(ranks[-1] > 0, reached[chosen], cells[number])
            return cells.at[number].set(cell), None

        numbers = jnp.arange(count, dtype=jnp.int32)
        cells, _ = jax.lax.scan(move, state.obstacles, (numbers, around, open_, draws))
        return cells

    def _moved(self, state: ObstacleState, cells: jax.Array) -> ObstacleState:
        """Returns the state after the obstacles have gone to `cells`, int32[n, 2]."""
        index = jax.vmap(self._index)
        balls = at_index(state.tiles, index(state.obstacles))
        plane = with_index(state.tiles, index(state.obstacles), jnp.uint8(tiles.EMPTY_TILE))
        ahead = at_index(state.tiles, front_index(state, self.height))
        return replace(
            state,
            tiles=with_index(plane, index(cells), balls),
            obstacles=cells,
            blocked=(ahead != tiles.EMPTY_TILE) & (ahead & tiles.TYPE_MASK != tiles.GOAL),
        )

    def _index(self, cell: jax.Array) -> jax.Array:
        return cell_index(cell, self.height)


@dataclass(frozen=True)
class ObstacleTask(Task):
    """Reach the goal square and run into nothing on the way.

    A step forward that began with something ahead, walls included, costs 1 and ends the episode:
    even if the obstacle was gone by then. Otherwise this is `GoalTask`. Source:
    `DynamicObstaclesEnv.step` of minigrid 3.2.0.
    """

    width: int
    height: int
    slope: float = REWARD_SLOPE

    def step(
        self, task_state: GoalState, before: ObstacleState, action: jax.Array, after: ObstacleState
    ) -> tuple[GoalState, Outcome]:
        """Judges one step; see `Task.step`."""
        task_state = replace(task_state, steps=task_state.steps + 1)
        goal, lava = entered(before, action, after, self.height)
        collision = (action == FORWARD) & after.blocked
        reached = goal & ~collision
        reward = success_reward(self.slope, task_state.steps, task_state.max_steps)
        return task_state, Outcome(
            reward={
                "success": jnp.where(reached, reward, jnp.float32(0)),
                "collision": -collision.astype(jnp.float32),
            },
            success={"goal": reached},
            terminated=goal | lava | collision,
            metrics={},
        )

    def expert(self, key: jax.Array, task_state: GoalState, state: ObstacleState) -> ExpertAction:
        """Returns the first action of a shortest plan past the obstacles as they stand.

        A cell that is free now can be entered without harm. While there is no way, it turns about.
        """
        advice = experts.goal_expert(key, task_state, state, self.width, self.height)
        waits = jnp.int32(LEFT)
        return ExpertAction(jnp.where(advice.valid, advice.action, waits), jnp.bool_(True))
