"""Who earns what when a ball is collected or dropped into a goal."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import tiles
from envs_jax.multigrid.environment import ANYBODY, MultiGridState, check_indices
from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import Outcome, Task

CREDITS = ("color", "team", "number")
# By number.
COLOR_NAMES = ("red", "green", "blue", "purple", "yellow", "grey")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PointsState:
    """How an episode of `Points` went so far.

    Attributes:
      scored: int32 scalar, balls that were collected or dropped into a goal.
      credited: int32[6], how many of them to each index.
    """

    scored: jax.Array
    credited: jax.Array


@dataclass(frozen=True)
class Points(Task):
    """What is scored is credited to an index: it pays that team, and may cost the others as much.

    Agents of index 0 are of every team: they earn of all that is scored, and if it costs the others
    pay as well, which leaves them nothing. It is a success when all balls have been scored.

    What an agent scores with is credited to the index of

    - "color": the ball that was collected, or the goal that one was dropped into;
    - "team": the agent;
    - "number": none, but to the agent's number in the list of agents as if that were an index, as
      the original's Collect does.

    Metrics: "scored", how many balls were, and "scored_<color>" of each team, how many of them to
    its credit.

    Source: `_reward` of gym-multigrid's games (77b0ee0).

    Attributes:
      agents_index: the team of each agent.
      balls: how many there are at the start.
      rewards: of what is scored with, by the index of that ball or goal, six.
      credit: "color", "team" or "number".
      zero_sum: whether teams without the credit pay. (With more than two teams, or teams of
        unequal size, the sum is not zero.)
      ends: whether the episode ends when all balls have been scored. In the original it goes on.
    """

    agents_index: tuple[int, ...]
    balls: int
    rewards: tuple[float, ...] = (1.0,) * tiles.NUM_COLORS
    credit: str = "color"
    zero_sum: bool = True
    ends: bool = False

    def __post_init__(self) -> None:
        check_indices("agents_index", self.agents_index)
        if self.credit not in CREDITS:
            raise unknown("credit", self.credit, CREDITS)
        if len(self.rewards) != tiles.NUM_COLORS:
            raise JaxactError(
                f"rewards must be {tiles.NUM_COLORS}, one for each index; got {len(self.rewards)}"
            )

    @property
    def start(self) -> PointsState:
        """The state before anything was scored."""
        return PointsState(jnp.int32(0), jnp.zeros(tiles.NUM_COLORS, jnp.int32))

    def step(
        self,
        task_state: PointsState,
        before: MultiGridState,
        action: jax.Array,
        after: MultiGridState,
    ) -> tuple[PointsState, Outcome]:
        """Judges one step; see `Task.step`."""
        del before, action
        teams, agents = np.array(self.agents_index, np.int32), len(self.agents_index)
        color = (after.scored >> tiles.COLOR_SHIFT).astype(jnp.int32)
        credits = {"color": color, "team": teams, "number": np.arange(agents, dtype=np.int32)}
        index = jnp.asarray(credits[self.credit])
        scores = after.scored != 0
        worth = jnp.stack([jnp.asarray(reward, jnp.float32) for reward in self.rewards])
        amount = jnp.where(scores, worth[color], 0.0)
        # Element [a, b]: whether what agent a scores with is to the credit of agent b's team.
        same, every = index[:, None] == teams, teams == ANYBODY
        earned = jnp.sum(jnp.where(same | every, amount[:, None], 0.0), axis=0)
        paid = jnp.sum(jnp.where(~same | every, amount[:, None], 0.0), axis=0)
        credited = scores[:, None] & (index[:, None] == jnp.arange(tiles.NUM_COLORS))
        state = PointsState(
            task_state.scored + jnp.sum(scores, dtype=jnp.int32),
            task_state.credited + jnp.sum(credited, axis=0, dtype=jnp.int32),
        )
        all_scored = state.scored >= self.balls
        by_team = {
            f"scored_{COLOR_NAMES[team]}": state.credited[team].astype(jnp.float32)
            for team in sorted(set(self.agents_index))
        }
        return state, Outcome(
            reward={"scored": earned, "conceded": -paid if self.zero_sum else jnp.zeros_like(paid)},
            success={"all_scored": all_scored},
            terminated=all_scored & self.ends,
            metrics={"scored": state.scored.astype(jnp.float32), **by_team},
        )
