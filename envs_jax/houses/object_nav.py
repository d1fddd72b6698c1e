"""ObjectNav: find an instance of a category, and say so."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from envs_jax.houses import journey as journeys
from envs_jax.houses import lattice as lattices
from envs_jax.houses import visibility
from envs_jax.houses.collision import obstacles
from envs_jax.houses.draws import first_true
from envs_jax.houses.environment import House, check_house
from envs_jax.houses.expert import look, walk
from envs_jax.houses.geodesic import GoalField
from envs_jax.houses.journey import Journey
from envs_jax.houses.lattice import Lattice
from envs_jax.houses.scene import Scene
from envs_jax.houses.state import HouseState
from envs_jax.houses.visibility import ROBOTHOR_SIGHT, Sight
from jaxact.compaction import while_loop_for_few
from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import POMDP, ExpertAction, Outcome, Task

RULES = ("visible", "view_point")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ObjectNavState:
    """Progress of an `ObjectNav`.

    Attributes:
      category: int32 scalar, index into `categories.NAMES` of what to find.
      start: float32 [3], the plan and the yaw at which the agent set out.
      journey: how far the nearest view point is.
      lattice: how shortest walks go, if the agent stays on a lattice.
    """

    category: jax.Array
    start: jax.Array
    journey: Journey
    lattice: Lattice | None = None


@dataclass(frozen=True)
class ObjectNav(Task):
    """End where an instance is visible, or at a view point; "end" ends the episode anywhere.

    Distances are to the nearest place from which an instance is visible to who turns to it, see
    `visibility.view_points`. The shaping reward of a step is no more than the metres moved in it,
    either way: distances may jump as things move.

    Sources: AllenAct's `ObjectNavTask` for RoboTHOR and `ObjectNaviThorGridTask`, and habitat-lab's
    ObjectNav (`distance_to: VIEW_POINTS`).

    Attributes:
      house: the dynamics: its body, its actions, of which one is "end", and what the expert does.
      sight: when an instance is visible.
      rule: what success is: "visible", by AI2-THOR's rule; "view_point", strictly within `radius`
        of one (Habitat).
      radius: metres.
      view_points: G, at most how many places are goals.
      places: how many steps on a lattice the greatest house is long; 0 if walks on lattices are not
        to be searched, see `lattice`.
      step_penalty: the reward, a negative one, of each step.
      refusal_penalty: added for an action that was stopped or changed nothing.
      shaping: reward for each metre that a goal comes nearer.
      success_reward: for ending with success.
      failure_reward: for ending without.
    """

    house: House
    sight: Sight = ROBOTHOR_SIGHT
    rule: str = "visible"
    radius: float = 0.1
    view_points: int = 64
    places: int = 0
    step_penalty: float = -0.01
    refusal_penalty: float = 0.0
    shaping: float = 1.0
    success_reward: float = 10.0
    failure_reward: float = 0.0

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise unknown("rule of success", self.rule, RULES)

    def goals(self, scene: Scene, category: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Finds places from which an instance of a category is visible.

        Args:
          scene: to search.
          category: int32 scalar, index into `categories.NAMES`.

        Returns:
          Plans float32 [G, 2] and bool [G], which of them are used.
        """
        boxes, body = scene.boxes, self.house.body
        wanted = (scene.category == category) & scene.present
        rows = visibility.nearest(boxes, wanted, jnp.zeros(2, jnp.float32), self.sight.instances)
        blocked = obstacles(boxes, body)
        places, good = jax.vmap(
            lambda row: visibility.view_points(self.sight, body, boxes, blocked, row)
        )(rows)
        good &= wanted[rows][:, None]
        # The instances take turns, so that each has its share of the goals.
        places, good = places.swapaxes(0, 1).reshape(-1, 2), good.T.reshape(-1)
        chosen, present = first_true(good, min(self.view_points, good.shape[0]))
        return places[chosen], present

    def survey(self, scene: Scene, category: jax.Array) -> Lattice | None:
        """Finds the shortest walks to where an instance of a category is visible.

        Args:
          scene: as it stands.
          category: int32 scalar, index into `categories.NAMES`.

        Returns:
          The walks from multiples of a step; None where the agent does not stay on them.
        """
        if self.places == 0 or self.rule != "visible" or not lattices.fits(self.house):
            return None
        wanted = (scene.category == category) & scene.present
        return lattices.survey(self.house, self.sight, scene, wanted, self.places)

    def start(
        self,
        field: GoalField,
        state: HouseState,
        category: jax.Array,
        lattice: Lattice | None = None,
    ) -> ObjectNavState:
        """Returns the first state of an episode.

        Args:
          field: how far `goals(scene, category)` are, from `geodesic.goal_field`.
          state: where the agent begins, from `house.start(scene, position, yaw, pitch)`.
          category: int32 scalar, index into `categories.NAMES`.
          lattice: from `survey(scene, category)`.
        """
        journey = journeys.begin(field, state, self.house.body)
        start = jnp.concatenate([state.position, state.yaw[None]])
        return ObjectNavState(jnp.asarray(category, jnp.int32), start, journey, lattice)

    def step(
        self,
        task_state: ObjectNavState,
        before: HouseState,
        action: jax.Array,
        after: HouseState,
    ) -> tuple[ObjectNavState, Outcome]:
        """Judges one step; see `Task.step`."""
        old = task_state.journey
        new = journeys.advance(old, self.house.body, before, after)
        task_state = replace(task_state, journey=new)
        ended = jnp.asarray(action, jnp.int32) == self.house.actions.index("end")
        success = ended & self._found(task_state, after)
        limit = journeys.moved(before, after)
        zero = jnp.float32(0)
        end_reward = jnp.where(
            success, self._number("success_reward"), self._number("failure_reward")
        )
        refused = journeys.refused(before, after) & ~ended
        approach = jnp.clip(journeys.approach(old, new), -limit, limit)
        return task_state, Outcome(
            reward={
                "step": self._number("step_penalty"),
                "refusal": jnp.where(refused, self._number("refusal_penalty"), zero),
                "shaping": self._number("shaping") * approach,
                "success": jnp.where(ended, end_reward, zero),
            },
            success={"goal": success},
            terminated=ended,
            metrics=journeys.report(new, success),
        )

    def expert(self, key: jax.Array, task_state: ObjectNavState, state: HouseState) -> ExpertAction:
        """Returns the next action of a short search of somebody who knows where things are."""
        del key
        if self.rule == "view_point":
            radius = self._number("radius") - 1e-3
            action = walk(self.house, task_state.journey, state, radius)
        else:
            turned, seen = look(self.house, self.sight, self._wanted(task_state, state), state)
            action = jnp.where(seen, turned, self._go_looking(task_state, state, ~seen))
        end = self.house.actions.index("end")
        action = jnp.where(self._found(task_state, state), end, action)
        return ExpertAction(action.astype(jnp.int32), jnp.bool_(True))

    def _go_looking(
        self, task_state: ObjectNavState, state: HouseState, asked: jax.Array
    ) -> jax.Array:
        """Returns the int32 next action on the way to where the target can be seen, if `asked`."""
        known = task_state.journey, state, jnp.float32(0)
        if task_state.lattice is None:
            return walk(self.house, *known)
        action, is_known = lattices.walk(self.house, task_state.lattice, state)

        def search(_: jax.Array, known: Any) -> tuple[jax.Array, jax.Array]:
            return walk(self.house, *known), jnp.bool_(False)

        # Hardly anybody stands where no walk on the lattice is known.
        carry = action, asked & ~is_known
        action, _ = while_loop_for_few(lambda carry, _: carry[1], search, carry, known)
        return action

    def _wanted(self, task_state: ObjectNavState, state: HouseState) -> jax.Array:
        return (state.scene.category == task_state.category) & state.scene.present

    def _found(self, task_state: ObjectNavState, state: HouseState) -> jax.Array:
        """Returns a bool scalar: whether to end here is success."""
        if self.rule == "view_point":
            near = task_state.journey.distance < self._number("radius")
            return near & jnp.isfinite(task_state.journey.start_distance)
        wanted = self._wanted(task_state, state)
        return visibility.is_visible(
            self.sight,
            self.house.body,
            state.scene.boxes,
            wanted,
            state.position,
            state.yaw,
            state.pitch,
        )

    def check(self, pomdp: POMDP) -> None:
        """Refuses an environment with other dynamics than `house`."""
        check_house("task.house", self.house, pomdp)

    def _number(self, name: str) -> jax.Array:
        return jnp.asarray(getattr(self, name), jnp.float32)


def check_sight(task: ObjectNav, pomdp: POMDP) -> None:
    """Refuses a task beside a sampler's own that sees otherwise: goals are where things are seen.

    Args:
      task: the sampler's.
      pomdp: that the sampler is to be a part of.

    Raises:
      JaxactError: they differ.
    """
    judge = pomdp.task
    if isinstance(judge, ObjectNav) and judge.sight != task.sight:
        raise JaxactError(
            f"sampler.task.sight is {task.sight!r}, but task.sight is {judge.sight!r}: "
            "goals are where things are visible, so both are set alike"
        )
