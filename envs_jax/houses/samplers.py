"""Where navigation begins and where it is to lead, in a bank of houses.

Starts and goals are drawn with bounded work: many at once, and one of the good ones is taken.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp

from envs_jax.houses import categories
from envs_jax.houses import lattice as lattices
from envs_jax.houses.bank import Bank, Scenes, build_bank, free_places
from envs_jax.houses.collision import obstacles
from envs_jax.houses.environment import House
from envs_jax.houses.geodesic import GoalField, distance, goal_field, is_reachable
from envs_jax.houses.lattice import Lattice
from envs_jax.houses.object_nav import ObjectNav
from envs_jax.houses.point_nav import PointNav
from envs_jax.houses.scene import Scene
from envs_jax.houses.state import HouseState
from jaxact.errors import JaxactError
from jaxact.pomdp import Episode, PyTree, TaskSampler

# From so many of the places that are free the way to the goal is measured.
_MEASURED = 8


@dataclass(frozen=True)
class Starts:
    """How episodes begin.

    Attributes:
      least: metres, the shortest way to the goal that is allowed.
      greatest: metres, the longest.
      ratio: least length of the way for each metre as the crow flies.
      grid: metres, starts are at multiples of it; 0 for anywhere.
      pitch: degrees down.
    """

    numbers_are_structure: ClassVar[bool] = True

    least: float = 1.0
    greatest: float = 30.0
    ratio: float = 1.0
    grid: float = 0.25
    pitch: float = 0.0


ROBOTHOR_STARTS = Starts(least=0.0, pitch=30.0)


@dataclass(frozen=True)
class PointNavSampler(TaskSampler):
    """Free starts and goals of `PointNav` in houses drawn from a bank.

    Attributes:
      task: whose house has the body.
      scenes: the houses; their held-out part is what is held out.
      starts: how episodes begin.
      horizon: steps.
      nodes: how many corners a roadmap has at most.
    """

    task: PointNav
    scenes: Scenes
    starts: Starts = Starts()
    horizon: int = 500
    nodes: int = 256

    @property
    def held_out(self) -> PointNavSampler:
        """The same in the houses to evaluate in."""
        return replace(self, scenes=self.scenes.held_out)

    def init(self, key: jax.Array) -> Bank:
        """Makes the bank of houses, the same for every key."""
        del key
        return build_bank(self.scenes, self.task.house.body, self.nodes)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        bank: Bank = sampler_state
        scene_key, goal_key, start_key = jax.random.split(key, 3)
        index, scene, roadmap = bank.draw(scene_key)
        radius = self.task.house.body.radius
        blocked = obstacles(scene.boxes, self.task.house.body)
        goals, free = free_places(goal_key, scene, blocked, radius, 0.0)
        middle = jax.tree.map(lambda leaf: leaf[index], bank.middles)
        joined = jax.vmap(lambda goal: is_reachable(middle, blocked, radius, goal))(goals)
        goal = goals[jnp.argmax(free & joined)]
        field = goal_field(roadmap, blocked, radius, goal[None])
        state = _begin(start_key, self.starts, self.task.house, scene, blocked, field)
        task_state = self.task.start(roadmap, state, goal)
        return Episode(state, task_state, jnp.int32(self.horizon))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TargetBank:
    """Houses, and from where in them targets can be seen.

    Attributes:
      bank: the houses.
      places: float32 [S, T, G, 2], plans.
      present: bool [S, T, G], which of them are used.
    """

    bank: Bank
    places: jax.Array
    present: jax.Array


@dataclass(frozen=True)
class ObjectNavSampler(TaskSampler):
    """Free starts of `ObjectNav` in houses from a bank, and a category that can be found there.

    Attributes:
      task: which also says from where things are seen.
      scenes: the houses; their held-out part is what is held out.
      targets: names of the categories to find.
      starts: how episodes begin.
      horizon: steps.
      nodes: how many corners a roadmap has at most.
    """

    task: ObjectNav
    scenes: Scenes
    targets: tuple[str, ...] = categories.ROBOTHOR_TARGETS
    starts: Starts = ROBOTHOR_STARTS
    horizon: int = 500
    nodes: int = 256

    def __post_init__(self) -> None:
        if not self.targets:
            raise JaxactError("ObjectNav needs at least one target")
        for name in self.targets:
            categories.index(name)

    @property
    def held_out(self) -> ObjectNavSampler:
        """The same in the houses to evaluate in."""
        return replace(self, scenes=self.scenes.held_out)

    def init(self, key: jax.Array) -> TargetBank:
        """Makes the bank of houses, the same for every key, and looks for the targets in them."""
        del key
        bank = build_bank(self.scenes, self.task.house.body, self.nodes)

        def look(scene: Scene) -> tuple[jax.Array, jax.Array]:
            return jax.lax.map(lambda target: self.task.goals(scene, target), self._targets)

        places, present = jax.lax.map(look, bank.scenes)
        return TargetBank(bank, places, present)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        targets: TargetBank = sampler_state
        scene_key, target_key, start_key = jax.random.split(key, 3)
        index, scene, roadmap = targets.bank.draw(scene_key)
        body = self.task.house.body
        blocked = obstacles(scene.boxes, body)
        findable = jnp.any(targets.present[index], axis=1)
        chosen = _choose(target_key, findable)
        places, present = targets.places[index, chosen], targets.present[index, chosen]
        field = goal_field(roadmap, blocked, body.radius, places, present)
        category = self._targets[chosen]
        lattice = self.task.survey(scene, category)
        state = _begin(start_key, self.starts, self.task.house, scene, blocked, field, lattice)
        task_state = self.task.start(roadmap, state, category, places, present, lattice)
        return Episode(state, task_state, jnp.int32(self.horizon))

    @property
    def _targets(self) -> jax.Array:
        return jnp.array([categories.index(name) for name in self.targets], jnp.int32)


def _begin(
    key: jax.Array,
    starts: Starts,
    house: House,
    scene: Scene,
    blocked: jax.Array,
    field: GoalField,
    lattice: Lattice | None = None,
) -> HouseState:
    """Puts the agent down somewhere from where the way to the goal has the length it should."""
    place_key, choice_key, yaw_key = jax.random.split(key, 3)
    radius = house.body.radius
    places, free = free_places(place_key, scene, blocked, radius, starts.grid)
    free, rows = jax.lax.top_k(free.astype(jnp.int32), _MEASURED)
    places, free = places[rows], free > 0
    metres = jax.vmap(lambda place: distance(field, blocked, radius, place)[0])(places)
    can = free & jax.vmap(lambda place: is_reachable(field, blocked, radius, place))(places)
    if lattice is not None:
        step = house.step_size
        can &= jax.vmap(lambda place: lattices.is_reachable(lattice, step, place))(places)
    # The goals of a field are its first nodes without any way left to go.
    goals = jnp.where(field.lengths[:, None] <= 0, field.nodes, jnp.inf)
    crow = jnp.sqrt(jnp.min(jnp.sum((places[:, None] - goals) ** 2, axis=-1), axis=1))
    long_enough = (metres >= starts.least) & (metres >= jnp.float32(starts.ratio) * crow)
    good = can & long_enough & (metres <= starts.greatest)
    # If none is good, one whose way is as nearly so long as can be.
    beyond = jnp.maximum(jnp.maximum(starts.least - metres, metres - starts.greatest), 0)
    nearest = jnp.argmin(jnp.where(can, beyond, jnp.where(free, 1e6, 1e9)))
    chosen = jnp.where(jnp.any(good), _choose(choice_key, good), nearest)
    headings = round(360 / house.turn)
    turns = jax.random.randint(yaw_key, (), 0, headings, jnp.int32).astype(jnp.float32)
    return house.start(scene, places[chosen], turns * jnp.float32(house.turn), starts.pitch)


def _choose(key: jax.Array, good: jax.Array) -> jax.Array:
    """Returns the int32 row of one that is true, each equally likely."""
    draws = jax.random.uniform(key, good.shape, jnp.float32)
    return jnp.argmax(jnp.where(good, draws, -1.0)).astype(jnp.int32)
