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
from envs_jax.houses.bank import CANDIDATES, Bank, Scenes, build_bank, free_places
from envs_jax.houses.collision import obstacles
from envs_jax.houses.draws import draw, first_true, pick
from envs_jax.houses.environment import House, check_house
from envs_jax.houses.geodesic import GoalField, Roadmap, goal_field, shortest
from envs_jax.houses.lattice import Lattice
from envs_jax.houses.object_nav import ObjectNav, check_sight
from envs_jax.houses.point_nav import PointNav
from envs_jax.houses.scene import Scene
from envs_jax.houses.state import HouseState
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, Episode, PyTree, TaskSampler

# Of so many of the places that are free it is looked whether they can be the goal.
_GOALS = 4
# From so many of the places that are free the way to the goal is measured.
_MEASURED = 8
# Random numbers that a start takes: places, which of them, and a heading.
_START = ((CANDIDATES, 3), (_MEASURED,), ())


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

    def check(self, pomdp: POMDP) -> None:
        """Refuses an environment with other dynamics than the task's `house`."""
        check_house("sampler.task.house", self.task.house, pomdp)

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
        which, places, *for_start = draw(key, [(), (CANDIDATES, 3), *_START])
        row = pick(which, bank.size)
        house: Bank = jax.tree.map(lambda leaf: leaf[row], bank)
        radius = self.task.house.body.radius
        blocked = obstacles(house.scenes.boxes, self.task.house.body)
        places, free = free_places(places, house.scenes, blocked, radius, 0.0)
        rows, there = first_true(free, _GOALS)
        places = places[rows]
        ways = jax.vmap(lambda place: shortest(house.middles, blocked, radius, place))(places)
        joined = there & (ways < jnp.inf)
        # Where none will do, the middle is a place that most of the house can be reached from.
        goal = jnp.where(jnp.any(joined), places[jnp.argmax(joined)], house.middles.nodes[0])
        field = goal_field(house.roadmaps, blocked, radius, goal[None])
        state = _begin(for_start, self.starts, self.task.house, house.scenes, blocked, field)
        return Episode(state, self.task.start(field, state, goal), jnp.int32(self.horizon))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TargetBank:
    """Houses, and how far it is in them to where targets can be seen.

    Attributes:
      bank: the houses.
      fields: with leading axes [S, T].
      findable: bool [S, T], whether there is such a place and the agent can walk to it.
      lattices: with leading axes [S, T], the shortest walks there; None where the agent does not
        stay on a lattice.
    """

    bank: Bank
    fields: GoalField
    findable: jax.Array
    lattices: Lattice | None


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

    def check(self, pomdp: POMDP) -> None:
        """Refuses other dynamics than the task's `house`, and other eyes than its `sight`."""
        check_house("sampler.task.house", self.task.house, pomdp)
        check_sight(self.task, pomdp)

    @property
    def held_out(self) -> ObjectNavSampler:
        """The same in the houses to evaluate in."""
        return replace(self, scenes=self.scenes.held_out)

    def init(self, key: jax.Array) -> TargetBank:
        """Makes the bank of houses, the same for every key, and looks for the targets in them."""
        del key
        bank = build_bank(self.scenes, self.task.house.body, self.nodes)

        body = self.task.house.body

        def look(house: tuple[Scene, Roadmap]) -> tuple[GoalField, jax.Array, Lattice | None]:
            scene, roadmap = house
            blocked = obstacles(scene.boxes, body)

            def survey(target: jax.Array) -> tuple[GoalField, jax.Array, Lattice | None]:
                places, present = self.task.goals(scene, target)
                field = goal_field(roadmap, blocked, body.radius, places, present)
                lattice = self.task.survey(scene, target)
                findable = jnp.any(present)
                if lattice is not None:
                    # It may be seen from places alone that no step leads to.
                    findable &= jnp.any(lattice.moves == lattices.AHEAD)
                return field, findable, lattice

            return jax.lax.map(survey, self._targets)

        return TargetBank(bank, *jax.lax.map(look, (bank.scenes, bank.roadmaps)))

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        targets: TargetBank = sampler_state
        which, target, *for_start = draw(key, [(), (len(self.targets),), *_START])
        row = pick(which, targets.bank.size)
        chosen = _choose(target, targets.findable[row])
        scene = jax.tree.map(lambda leaf: leaf[row], targets.bank.scenes)
        field, lattice = jax.tree.map(
            lambda leaf: leaf[row, chosen], (targets.fields, targets.lattices)
        )
        blocked = obstacles(scene.boxes, self.task.house.body)
        category = self._targets[chosen]
        state = _begin(for_start, self.starts, self.task.house, scene, blocked, field, lattice)
        task_state = self.task.start(field, state, category, lattice)
        return Episode(state, task_state, jnp.int32(self.horizon))

    @property
    def _targets(self) -> jax.Array:
        return jnp.array([categories.index(name) for name in self.targets], jnp.int32)


def _begin(
    draws: list[jax.Array],
    starts: Starts,
    house: House,
    scene: Scene,
    blocked: jax.Array,
    field: GoalField,
    lattice: Lattice | None = None,
) -> HouseState:
    """Puts the agent down somewhere from where the way to the goal has the length it should."""
    place_draws, choice, heading = draws
    radius = house.body.radius
    places, free = free_places(place_draws, scene, blocked, radius, starts.grid)
    rows, free = first_true(free, _MEASURED)
    places = places[rows]
    metres = jax.vmap(lambda place: shortest(field, blocked, radius, place))(places)
    can = free & (metres < jnp.inf)
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
    chosen = jnp.where(jnp.any(good), _choose(choice, good), nearest)
    turns = pick(heading, round(360 / house.turn)).astype(jnp.float32)
    return house.start(scene, places[chosen], turns * jnp.float32(house.turn), starts.pitch)


def _choose(draws: jax.Array, good: jax.Array) -> jax.Array:
    """Returns the int32 row of one that is true, each equally likely, by uniform `draws` [K]."""
    return jnp.argmax(jnp.where(good, draws, -1.0)).astype(jnp.int32)
