"""Episodes that samplers draw, as lists that can be written to files and played again."""

from __future__ import annotations

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses import categories
from envs_jax.houses.bank import GeneratedScenes, Scenes
from envs_jax.houses.collision import obstacles
from envs_jax.houses.geodesic import path
from envs_jax.houses.importers.episodes import NavigationEpisode, Point
from envs_jax.houses.object_nav import ObjectNav
from envs_jax.houses.samplers import ObjectNavSampler, PointNavSampler, TargetBank
from envs_jax.houses.scene import Scene
from envs_jax.houses.state import HouseState
from jaxact.errors import JaxactError

# The height of AI2-THOR's agents' middle above the floor, which their episodes have as y.
_MIDDLE = 0.9
# At most so many corners of a shortest way.
_CORNERS = 64
_DIFFICULTIES = ("easy", "medium", "hard")


def draw_episodes(
    sampler: PointNavSampler | ObjectNavSampler, count: int, *, seed: int = 0
) -> tuple[list[NavigationEpisode], dict[str, Scene]]:
    """Draws episodes from a sampler, for `importers.robothor.write_episodes`.

    A third each of them is "easy", "medium" and "hard", by the length of the shortest way.

    Args:
      sampler: to draw from; its `held_out` draws those to evaluate on.
      count: how many.
      seed: of the draws.

    Returns:
      The episodes, and the houses that they are in, by name, for `importers.scenes.write_scenes`.

    Raises:
      JaxactError: `count` is not positive.
    """
    if count < 1:
        raise JaxactError(f"count must be at least 1, got {count}")
    task, body = sampler.task, sampler.task.house.body

    def one(key: jax.Array, bank: Any) -> tuple[HouseState, Any, jax.Array, jax.Array]:
        episode = sampler.sample(key, bank)
        state, task_state = episode.environment, episode.task
        blocked = obstacles(state.scene.boxes, body)
        field = task_state.journey.field
        corners = path(field, blocked, body.radius, state.position, _CORNERS)
        if isinstance(task, ObjectNav):
            goals, _ = task.goals(state.scene, task_state.category)
        else:
            goals = task_state.goal[None]
        # A goal that is closer to a thing than ways are led is the last corner too.
        away = jnp.sum((field.nodes[: len(goals)] - corners[-1]) ** 2, axis=-1)
        last = jnp.argmin(jnp.where(field.lengths[: len(goals)] < jnp.inf, away, jnp.inf))
        return state, task_state, corners, goals[last]

    @jax.jit
    def draw(keys: jax.Array) -> tuple[Scene, tuple[HouseState, Any, jax.Array, jax.Array]]:
        bank = sampler.init(keys[0])
        houses = bank.bank if isinstance(bank, TargetBank) else bank
        return houses.scenes, jax.lax.map(lambda key: one(key, bank), keys)

    key = jax.random.key(seed, impl="threefry2x32")
    houses, drawn = jax.device_get(draw(jax.random.split(key, count)))
    states, task_states, corners, goals = drawn
    names = _names(sampler.scenes, houses)
    lengths = task_states.journey.start_distance
    bounds = np.quantile(lengths, (1 / 3, 2 / 3))
    episodes, scenes = [], {}
    for i in range(count):
        scene = jax.tree.map(lambda leaf, i=i: leaf[i], states.scene)
        name = names[_fingerprint(scene)]
        scenes[name] = scene
        category = ""
        target: tuple[Point, ...] = (_point(goals[i]),)
        if isinstance(task, ObjectNav):
            category, target = categories.NAMES[task_states.category[i]], ()
        episodes.append(
            NavigationEpisode(
                id=f"{name}_{category}_{i}" if category else f"{name}_{i}",
                scene=name,
                position=_point(states.position[i], _MIDDLE),
                yaw=float(states.yaw[i]),
                pitch=float(states.pitch[i]),
                category=category,
                goals=target,
                path=_way([*corners[i], goals[i]]),
                length=float(lengths[i]),
                difficulty=_DIFFICULTIES[int(np.sum(lengths[i] > bounds))],
            )
        )
    return episodes, scenes


def _names(scenes: Scenes, houses: Scene) -> dict[bytes, str]:
    """Returns what each of some houses [S] is called, by its fingerprint."""
    split = scenes.split if isinstance(scenes, GeneratedScenes) else "house"
    names: dict[bytes, str] = {}
    for row in range(len(houses.boxes)):
        scene = jax.tree.map(lambda leaf, row=row: leaf[row], houses)
        names.setdefault(_fingerprint(scene), f"{split}_{row}")
    return names


def _fingerprint(scene: Scene) -> bytes:
    return b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(scene))


def _point(plan: np.ndarray, height: float = 0.0) -> Point:
    x, z = plan.tolist()
    return x, height, z


def _way(plans: list[np.ndarray]) -> tuple[Point, ...]:
    """Returns the corners of a way without those that repeat the one before."""
    pairs = itertools.pairwise(plans)
    return (_point(plans[0]), *(_point(b) for a, b in pairs if not np.array_equal(a, b)))
