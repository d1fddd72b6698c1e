"""Episodes out of a list, such as a data set's file, in houses from anywhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses import categories
from envs_jax.houses.bank import ImportedScenes, Scenes, stack
from envs_jax.houses.collision import is_free, obstacles
from envs_jax.houses.environment import check_house
from envs_jax.houses.geodesic import GoalField, Roadmap, build_roadmap, goal_field
from envs_jax.houses.importers.episodes import NavigationEpisode
from envs_jax.houses.object_nav import ObjectNav, ObjectNavState, check_sight
from envs_jax.houses.point_nav import PointNav, PointNavState
from envs_jax.houses.scene import Scene
from envs_jax.houses.sensors import ObjectGoalSensor
from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import POMDP, Episode, TaskSampler

# So many episodes are looked at side by side when they are checked.
_BATCH = 256


@dataclass(frozen=True, eq=False)
class EpisodeTable:
    """N episodes as arrays; equal only to itself.

    Attributes:
      scene: int32 [N], the row of the house.
      start: float32 [N, 4], plan (x, z), yaw and pitch.
      category: int32 [N], index into `categories.NAMES`; 0 for a point.
      target: int32 [N], which of the U targets it has.
      target_scene: int32 [U], the row of each target's house.
      target_category: int32 [U].
      goals: float32 [U, G, 2], plans, the goals of each target.
      present: bool [U, G], which of them are used; where none is, it is left to the scene from
        where the category is seen.
      length: float32 [N], metres of the shortest way as stored; NaN where it is not.
      difficulty: int32 [N], index into `difficulties`.
      difficulties: names.
    """

    scene: np.ndarray
    start: np.ndarray
    category: np.ndarray
    target: np.ndarray
    target_scene: np.ndarray
    target_category: np.ndarray
    goals: np.ndarray
    present: np.ndarray
    length: np.ndarray
    difficulty: np.ndarray
    difficulties: tuple[str, ...]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RecordedHouses:
    """The houses of listed episodes.

    Attributes:
      scenes: with a leading axis [S].
      roadmaps: likewise.
      fields: how far the targets of `ObjectNav` are, with a leading axis [U]; None for points.
    """

    scenes: Scene
    roadmaps: Roadmap
    fields: GoalField | None


@dataclass(frozen=True)
class RecordedSampler(TaskSampler):
    """Episodes of `PointNav` or `ObjectNav` out of a list, each as likely; see `recorded_sampler`.

    Evaluation plays each of the list once, in order.

    Attributes:
      task: whose house has the body.
      scenes: the houses.
      table: the episodes.
      evaluation: those to evaluate on; None for the same.
      stored_lengths: whether SPL counts with the shortest lengths of the file, where it has them,
        or always with those in the scene as it is here. Shaping is always by the latter.
      horizon: steps.
      nodes: how many corners a roadmap has at most.
    """

    task: PointNav | ObjectNav
    scenes: Scenes
    table: EpisodeTable
    evaluation: RecordedSampler | None = None
    stored_lengths: bool = True
    horizon: int = 500
    nodes: int = 128

    def check(self, pomdp: POMDP) -> None:
        """Refuses other dynamics and eyes than the task's, and sensors that lack a target."""
        check_house("sampler.task.house", self.task.house, pomdp)
        if isinstance(self.task, ObjectNav):
            check_sight(self.task, pomdp)
        if not isinstance(pomdp.task, type(self.task)):
            raise JaxactError(
                f"the sampler has episodes of {type(self.task).__name__}, "
                f"but the task is {type(pomdp.task).__name__}"
            )
        wanted = {categories.NAMES[row] for row in self.table.category.tolist() if row}
        for name, sensor in pomdp.sensors.items():
            if isinstance(sensor, ObjectGoalSensor) and not wanted <= set(sensor.targets):
                missing = ", ".join(sorted(wanted - set(sensor.targets)))
                raise JaxactError(
                    f"sensors.{name}.targets lacks {missing}: it must have all that the sampler's "
                    "episodes are to find"
                )

    @property
    def held_out(self) -> RecordedSampler:
        """`evaluation`, if there is one."""
        return self if self.evaluation is None else self.evaluation

    @property
    def count(self) -> int:
        """N, how many episodes there are."""
        return len(self.table.scene)

    def init(self, key: jax.Array) -> RecordedHouses:
        """Makes the roadmaps, and looks for targets; the same for every key."""
        del key
        table, task, body = self.table, self.task, self.task.house.body
        scenes = self.scenes.load()
        roadmaps = jax.lax.map(lambda scene: build_roadmap(scene, body, self.nodes), scenes)
        if isinstance(task, PointNav):
            return RecordedHouses(scenes, roadmaps, None)

        told = table.present.any(axis=1)

        def survey(target: tuple[jax.Array, ...]) -> GoalField:
            row, category, goals, present = target
            scene, roadmap = jax.tree.map(lambda leaf: leaf[row], (scenes, roadmaps))
            blocked = obstacles(scene.boxes, body)
            if not told.all():
                seen_from, there = task.goals(scene, category)
                goals = jnp.concatenate([goals, seen_from])
                present = jnp.concatenate([present, there & ~jnp.any(present)])
            # Others are of another floor, or of a house that is not quite this one.
            present &= jax.vmap(lambda goal: is_free(blocked, body.radius, goal))(goals)
            return goal_field(roadmap, blocked, body.radius, goals, present)

        columns = table.target_scene, table.target_category, table.goals, table.present
        fields = jax.lax.map(survey, tuple(jnp.asarray(column) for column in columns))
        return RecordedHouses(scenes, roadmaps, fields)

    def sample(self, key: jax.Array, sampler_state: RecordedHouses) -> Episode:
        """Draws one of the list."""
        index = jax.random.randint(key, (), 0, self.count, jnp.int32)
        return self.listed(index, sampler_state)

    def listed(self, index: jax.Array, sampler_state: RecordedHouses) -> Episode:
        """Returns one of the list; its origin is the index."""
        table, task, houses = self.table, self.task, sampler_state
        row, target, start, length = (
            jnp.asarray(column)[index]
            for column in (table.scene, table.target, table.start, table.length)
        )
        scene, roadmap = jax.tree.map(lambda leaf: leaf[row], (houses.scenes, houses.roadmaps))
        blocked = obstacles(scene.boxes, task.house.body)
        state = task.house.start(scene, start[:2], start[2], start[3])
        task_state: PointNavState | ObjectNavState
        if isinstance(task, PointNav):
            goal = jnp.asarray(table.goals)[target, 0]
            field = goal_field(roadmap, blocked, task.house.body.radius, goal[None])
            task_state = task.start(field, state, goal)
        else:
            category = jnp.asarray(table.category)[index]
            field = jax.tree.map(lambda leaf: leaf[target], houses.fields)
            task_state = task.start(field, state, category, task.survey(scene, category))
        if self.stored_lengths:
            journey = task_state.journey
            length = jnp.where(jnp.isnan(length), journey.start_distance, length)
            task_state = replace(task_state, journey=replace(journey, start_distance=length))
        return Episode(state, task_state, jnp.int32(self.horizon), index)

    def kinds(self, origin: jax.Array) -> dict[str, jax.Array]:
        """The difficulties, by the names that the file gives them."""
        level = jnp.asarray(self.table.difficulty)[origin]
        return {name: level == i for i, name in enumerate(self.table.difficulties) if name}


def recorded_sampler(
    task: PointNav | ObjectNav,
    scenes: Mapping[str, Scene],
    episodes: Sequence[NavigationEpisode],
    *,
    evaluation: RecordedSampler | None = None,
    stored_lengths: bool = True,
    horizon: int = 500,
    nodes: int = 128,
) -> RecordedSampler:
    """Makes a sampler of exactly these episodes, in their order, and checks each of them.

    Args:
      task: what is to be done in them.
      scenes: the houses by the names that the episodes have for them; not all need be used.
      episodes: as read from files, see `importers.robothor` and `importers.habitat`. Only plans
        count: houses have one floor.
      evaluation: the sampler of the episodes to evaluate on; None for the same.
      stored_lengths: see `RecordedSampler`.
      horizon: steps.
      nodes: how many corners a roadmap has at most; scenes with more are refused.

    Raises:
      JaxactError: an episode cannot be played, for example because its start is not free or its
        goal cannot be reached; `find_problems` returns all of them.
    """
    sampler, problems = _examined(task, scenes, episodes, nodes)
    if problems:
        more = f", and {len(problems) - 1} more cannot be played" if len(problems) > 1 else ""
        raise JaxactError(f"{next(iter(problems.values()))} (of {len(episodes)} episodes{more})")
    if sampler is None:
        raise JaxactError("a sampler of recorded episodes needs at least one")
    return replace(sampler, evaluation=evaluation, stored_lengths=stored_lengths, horizon=horizon)


def find_problems(
    task: PointNav | ObjectNav,
    scenes: Mapping[str, Scene],
    episodes: Sequence[NavigationEpisode],
    *,
    nodes: int = 128,
) -> dict[int, str]:
    """Says which episodes cannot be played, in a sentence each.

    Args:
      task: what is to be done in them.
      scenes: the houses by name.
      episodes: to check.
      nodes: how many corners a roadmap has at most.

    Returns:
      What is wrong, by the episode's place in the list.
    """
    return _examined(task, scenes, episodes, nodes)[1]


def _examined(
    task: PointNav | ObjectNav,
    scenes: Mapping[str, Scene],
    episodes: Sequence[NavigationEpisode],
    nodes: int,
) -> tuple[RecordedSampler | None, dict[int, str]]:
    """Returns the sampler of the episodes that can be tried, if any, and what is wrong with which.

    Episodes whose description is at fault are not in the sampler; others with faults are.
    """
    problems = {}
    for i, episode in enumerate(episodes):
        fault = _fault(task, scenes, episode)
        if fault:
            problems[i] = f"{_name(episode)}: {fault}"
    places = [i for i in range(len(episodes)) if i not in problems]
    if not places:
        return None, problems
    kept = [episodes[i] for i in places]
    used = {episode.scene: scenes[episode.scene] for episode in kept}
    houses = ImportedScenes(stack(list(used.values())))
    sampler = RecordedSampler(task, houses, _table(kept, list(used)), nodes=nodes)
    for place, fault in _faults_in_scenes(sampler).items():
        problems[places[place]] = f"{_name(kept[place])}: {fault}"
    return sampler, dict(sorted(problems.items()))


def _name(episode: NavigationEpisode) -> str:
    return f"episode {episode.id!r} in scene {episode.scene!r}"


def _fault(
    task: PointNav | ObjectNav, scenes: Mapping[str, Scene], episode: NavigationEpisode
) -> str:
    """Says what is wrong with an episode's description, wherever things are."""
    if episode.scene not in scenes:
        return str(unknown("scene", episode.scene, scenes))
    if isinstance(task, PointNav):
        if len(episode.goals) != 1 or episode.category:
            found = f"looks for {episode.category!r}" if episode.category else "has no category"
            return f"PointNav needs one point to go to, but it {found} with {len(episode.goals)}"
        return ""
    if not episode.category:
        return "ObjectNav needs a category to find, but it has only a point to go to"
    if episode.category not in categories.NAMES:
        return str(unknown("category", episode.category, categories.NAMES))
    scene = scenes[episode.scene]
    there = np.asarray(scene.category)[np.asarray(scene.present)]
    if (task.rule == "visible" or not episode.goals) and not np.any(
        there == categories.index(episode.category)
    ):
        return f"there is no {episode.category} in that scene"
    return ""


def _table(episodes: Sequence[NavigationEpisode], names: list[str]) -> EpisodeTable:
    rows = {name: row for row, name in enumerate(names)}
    # Episodes share targets: a category in a house, or goals that are the same.
    targets: dict[tuple, int] = {}
    which = [
        targets.setdefault((rows[e.scene], e.category, e.goals), len(targets)) for e in episodes
    ]
    most = max(len(goals) for _, _, goals in targets)
    plans = np.zeros((len(targets), most, 2), np.float32)
    present = np.zeros((len(targets), most), bool)
    for i, (_, _, goals) in enumerate(targets):
        for k, (x, _, z) in enumerate(goals):
            plans[i, k] = x, z
            present[i, k] = True

    def number(category: str) -> int:
        return categories.index(category) if category else 0

    difficulties = sorted({e.difficulty for e in episodes})
    return EpisodeTable(
        scene=np.array([rows[e.scene] for e in episodes], np.int32),
        start=np.array(
            [(e.position[0], e.position[2], e.yaw % 360, e.pitch) for e in episodes], np.float32
        ),
        category=np.array([number(e.category) for e in episodes], np.int32),
        target=np.array(which, np.int32),
        target_scene=np.array([row for row, _, _ in targets], np.int32),
        target_category=np.array([number(category) for _, category, _ in targets], np.int32),
        goals=plans,
        present=present,
        length=np.array([np.nan if e.length is None else e.length for e in episodes], np.float32),
        difficulty=np.array([difficulties.index(e.difficulty) for e in episodes], np.int32),
        difficulties=tuple(difficulties),
    )


def _faults_in_scenes(sampler: RecordedSampler) -> dict[int, str]:
    """Says what is wrong with episodes in the scenes as they are, by their places."""
    sampler = replace(sampler, stored_lengths=False)
    task, table, radius = sampler.task, sampler.table, sampler.task.house.body.radius

    @jax.jit
    def look() -> tuple[jax.Array, ...]:
        houses = sampler.init(jax.random.key(0))

        def one(index: jax.Array) -> tuple[jax.Array, ...]:
            episode = sampler.listed(index, houses)
            state, task_state = episode.environment, episode.task
            blocked = obstacles(state.scene.boxes, task.house.body)
            journey = task_state.journey
            goal = task_state.goal if isinstance(task, PointNav) else state.position
            return (
                is_free(blocked, radius, state.position),
                is_free(blocked, radius, goal),
                jnp.any(journey.field.lengths < jnp.inf),
                journey.start_distance < jnp.inf,
                houses.roadmaps.overflow[jnp.asarray(table.scene)[index]],
            )

        return jax.lax.map(one, jnp.arange(sampler.count, dtype=jnp.int32), batch_size=_BATCH)

    start_free, goal_free, somewhere, reachable, overflow = (np.asarray(x) for x in look())
    body = f"a body of {radius:g} m radius"
    faults = {}
    for i in range(sampler.count):
        x, z, _, _ = table.start[i].tolist()
        category = categories.NAMES[table.category[i]]
        goal = f"the {category}"
        if isinstance(task, PointNav):
            goal = "the goal at x = {:g}, z = {:g}".format(*table.goals[table.target[i], 0])
        if overflow[i]:
            faults[i] = f"the scene has more than {sampler.nodes} corners: give a greater `nodes`"
        elif not start_free[i]:
            faults[i] = f"the start at x = {x:g}, z = {z:g} is not free for {body}"
        elif not goal_free[i]:
            faults[i] = f"{goal} is not free for {body}"
        elif not somewhere[i]:
            faults[i] = f"{goal} cannot be seen from anywhere that is free for {body}"
        elif not reachable[i]:
            faults[i] = f"no way for {body} leads from the start at x = {x:g}, z = {z:g} to {goal}"
    return faults
