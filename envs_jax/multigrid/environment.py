"""A grid with several agents, each an object of the grid: who may do what, and in what order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp

from envs_jax.minigrid import tiles
from envs_jax.minigrid.environment import heading
from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import Environment
from jaxact.spaces import Agents, Discrete

STILL, LEFT, RIGHT, FORWARD, PICKUP, DROP, TOGGLE, DONE = range(8)
ACTION_NAMES = ("still", "left", "right", "forward", "pickup", "drop", "toggle", "done")

# What there is besides MiniGrid's types of tiles: a goal for what is carried, of a team's colour.
OBJECT_GOAL = 11
# In views, agent a is the tile AGENT of colour a, of which there are so many.
MAX_AGENTS = 16
# The index of what belongs to everybody.
ANYBODY = 0

PICKUPS = ("carries", "collects")
MOVES = ("in_turn", "at_once")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MultiGridState:
    """A grid of W × H cells, its walls included, and A agents.

    Attributes:
      tiles: uint8[W, H], indexed [x, y], packed as `envs_jax.minigrid.tiles` are; without agents,
        who stand on empty tiles.
      positions: int32[A, 2], the agents' (x, y), no two alike.
      directions: int32[A]; 0 right (+x), 1 down (+y), 2 left, 3 up.
      carrying: uint8[A], packed tiles in the agents' hands, 0 when they are empty.
      scored: uint8[A], what each agent scored with in the last step: the tile of the ball that it
        collected, or of the goal that it dropped one into; 0 for nothing.
    """

    tiles: jax.Array
    positions: jax.Array
    directions: jax.Array
    carrying: jax.Array
    scored: jax.Array


class _Deeds(NamedTuple):
    """What each agent does to the cell before it, bool[A] each, at most one of them."""

    enters: jax.Array
    lifts: jax.Array
    collects: jax.Array
    takes: jax.Array
    drops: jax.Array
    passes: jax.Array
    scores: jax.Array

    @property
    def any(self) -> jax.Array:
        return jnp.any(jnp.stack(self), axis=0)

    def only(self, who: jax.Array) -> _Deeds:
        return _Deeds(*(deed & who for deed in self))


@dataclass(frozen=True)
class MultiGrid(Environment):
    """The dynamics of gym-multigrid: agents on a grid, no two on one cell.

    Agents belong to teams by their index, which is a colour's number, as is that of a ball or of a
    goal; what has the index 0 is anybody's. An agent acts on the cell before it:

    - forward: enters it if it is empty (a goal is not).
    - pickup, where it "carries": with empty hands it lifts a ball, whosever, or takes what the
      agent there carries. Where it "collects": a ball that is its own or anybody's is gone, and
      scored; hands stay empty.
    - drop: what it carries goes onto an empty cell, or into the empty hands of the agent there, or
      into a goal, where it is gone, and scored; a goal takes its own team's balls and anybody's.
    - still, toggle and done: nothing, as there is nothing to toggle.

    With moves "in_turn" agents act one after the other, each on the grid as it then is, in an order
    that is drawn anew in each step. With "at_once", which is not the original's, all act on the
    grid as it was before the step: nobody enters or drops onto a cell that only becomes empty in
    it. What several want to do to one cell is done by the one that is the first in the order
    drawn; the others do nothing. Who can pick up or drop something is not taken from or passed to
    in that step.

    Source: `MultiGridEnv.step` of https://github.com/ArnaudFickinger/gym-multigrid (77b0ee0), and
    `_handle_pickup` and `_handle_drop` of its games. There, too, forward never enters a tile that
    can be walked over.

    Attributes:
      width: W, cells along x.
      height: H, cells along y.
      agents_index: the team of each agent, 0 … 5.
      pickup: "carries" or "collects".
      moves: "in_turn" or "at_once".
    """

    width: int
    height: int
    agents_index: tuple[int, ...]
    pickup: str = "carries"
    moves: str = "in_turn"

    def __post_init__(self) -> None:
        if min(self.width, self.height) < 3:
            raise JaxactError(f"a grid is of at least 3×3 cells, not {self.width}×{self.height}")
        if not 1 <= self.agents <= MAX_AGENTS:
            raise JaxactError(f"there must be 1 to {MAX_AGENTS} agents, not {self.agents}")
        check_indices("agents_index", self.agents_index)
        if self.pickup not in PICKUPS:
            raise unknown("pickup", self.pickup, PICKUPS)
        if self.moves not in MOVES:
            raise unknown("moves", self.moves, MOVES)

    @property
    def agents(self) -> int:
        """A, how many there are."""
        return len(self.agents_index)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Still, left, right, forward, pickup, drop, toggle, done."""
        return ACTION_NAMES

    @property
    def action_space(self) -> Agents:
        """Eight actions for each agent."""
        return Agents(Discrete(len(ACTION_NAMES)), self.agents)

    def order(self, key: jax.Array) -> jax.Array:
        """Returns the order in which agents act in the step with this key, int32[A]."""
        return jnp.argsort(jax.random.uniform(key, (self.agents,), jnp.float32))

    def step(self, key: jax.Array, state: MultiGridState, action: jax.Array) -> MultiGridState:
        """Returns what follows; see the class."""
        action = jnp.asarray(action, jnp.int32)
        order = self.order(key)
        state = replace(state, scored=jnp.zeros_like(state.scored))
        if self.moves == "at_once":
            return self._act(state, action, order)
        everybody = jnp.arange(self.agents, dtype=jnp.int32)

        def turn(k: jax.Array, now: MultiGridState) -> MultiGridState:
            return self._act(now, jnp.where(everybody == order[k], action, STILL), order)

        return jax.lax.fori_loop(0, self.agents, turn, state)

    def _act(self, state: MultiGridState, action: jax.Array, order: jax.Array) -> MultiGridState:
        """Lets all agents act at once."""
        fronts = state.positions + jax.vmap(heading)(state.directions)
        # Element [a, b]: whether agent b stands before agent a.
        faces = jnp.all(fronts[:, None] == state.positions, axis=-1)
        ahead = state.tiles[fronts[:, 0], fronts[:, 1]]
        theirs = jnp.max(jnp.where(faces, state.carrying, jnp.uint8(0)), axis=1)
        deeds = self._possible(state, action, ahead, theirs, jnp.any(faces, axis=1))
        hands = deeds.lifts | deeds.takes | deeds.drops | deeds.passes | deeds.scores
        left_alone = ~jnp.any(faces & hands, axis=1)
        deeds = deeds._replace(takes=deeds.takes & left_alone, passes=deeds.passes & left_alone)
        deeds = deeds.only(self._first(fronts, deeds.any, order))

        nothing, empty = jnp.uint8(0), jnp.uint8(tiles.EMPTY_TILE)
        changes = deeds.lifts | deeds.collects | deeds.drops
        # Those that change nothing write beyond the grid, which is to write nowhere.
        columns = jnp.where(changes, fronts[:, 0], self.width)
        left = jnp.where(deeds.drops, state.carrying, empty)
        passed = jnp.max(
            jnp.where(faces & deeds.passes[:, None], state.carrying[:, None], nothing), axis=0
        )
        robbed = jnp.any(faces & deeds.takes[:, None], axis=0)
        carrying = jnp.where(robbed, nothing, jnp.maximum(state.carrying, passed))
        carrying = jnp.where(deeds.drops | deeds.passes | deeds.scores, nothing, carrying)
        carrying = jnp.where(deeds.lifts, ahead, carrying)
        turn = (action == RIGHT).astype(jnp.int32) - (action == LEFT).astype(jnp.int32)
        return MultiGridState(
            tiles=state.tiles.at[columns, fronts[:, 1]].set(left, mode="drop"),
            positions=jnp.where(deeds.enters[:, None], fronts, state.positions),
            directions=(state.directions + turn) & 3,
            carrying=jnp.where(deeds.takes, theirs, carrying),
            scored=jnp.where(deeds.collects | deeds.scores, ahead, state.scored),
        )

    def _possible(
        self,
        state: MultiGridState,
        action: jax.Array,
        ahead: jax.Array,
        theirs: jax.Array,
        meets: jax.Array,
    ) -> _Deeds:
        """Returns what each agent could do if the others did nothing.

        Args:
          state: as it is.
          action: int32[A].
          ahead: uint8[A], the tile before each agent.
          theirs: uint8[A], what the agent before each one carries.
          meets: bool[A], whether there is one.
        """
        kind, color = ahead & tiles.TYPE_MASK, ahead >> tiles.COLOR_SHIFT
        free = (kind == tiles.EMPTY) & ~meets
        no = jnp.zeros_like(meets)
        enters = (action == FORWARD) & free
        grasps = (action == PICKUP) & (kind == tiles.BALL)
        if self.pickup == "collects":
            own = color == jnp.array(self.agents_index, jnp.uint8)
            return _Deeds(enters, no, grasps & (own | (color == ANYBODY)), no, no, no, no)
        has, holds = state.carrying != 0, state.carrying >> tiles.COLOR_SHIFT
        fits = (kind == OBJECT_GOAL) & ((holds == ANYBODY) | (holds == color))
        drop = (action == DROP) & has
        return _Deeds(
            enters,
            lifts=grasps & ~has,
            collects=no,
            takes=(action == PICKUP) & ~has & (theirs != 0),
            drops=drop & free,
            passes=drop & meets & (theirs == 0),
            scores=drop & fits,
        )

    def _first(self, fronts: jax.Array, wants: jax.Array, order: jax.Array) -> jax.Array:
        """Returns which agents are the first of those who want something of their cell, bool[A]."""
        rank = jnp.argsort(order)
        rivals = jnp.all(fronts[:, None] == fronts, axis=-1) & wants
        return ~jnp.any(rivals & (rank < rank[:, None]), axis=1)


def check_indices(name: str, indices: Sequence[int]) -> None:
    """Refuses indices that are no colours'.

    Raises:
      JaxactError: there is one.
    """
    for index in indices:
        if index not in range(tiles.NUM_COLORS):
            raise JaxactError(f"{name} must be from 0 to {tiles.NUM_COLORS - 1}; got {index!r}")
