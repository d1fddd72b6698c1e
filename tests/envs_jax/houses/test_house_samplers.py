"""Episodes begin where the body fits, at the distance that was asked for, in the split's houses."""

import dataclasses

import jax
import numpy as np
import pytest
from small_houses import cluttered

import envs_jax
from envs_jax.houses import categories, lattice
from envs_jax.houses.bank import GeneratedScenes, ImportedScenes, stack
from envs_jax.houses.collision import is_free, obstacles
from envs_jax.houses.environment import House
from envs_jax.houses.generator import APARTMENT
from envs_jax.houses.object_nav import ObjectNav
from envs_jax.houses.point_nav import PointNav
from envs_jax.houses.samplers import ObjectNavSampler, PointNavSampler, Starts
from envs_jax.houses.state import Body
from jaxact.errors import JaxactError
from jaxact.overrides import override

BODY = Body(0.175, 0.9, 0.87)
HOUSE = House(BODY, ("move_ahead", "rotate_left", "rotate_right", "end"))


def test_point_nav_in_imported_houses() -> None:
    houses = stack([cluttered(0), cluttered(1, size=32)])
    starts = Starts(least=1.5, greatest=4.0)
    sampler = PointNavSampler(PointNav(HOUSE), ImportedScenes(houses), starts, nodes=128)
    assert sampler.held_out == sampler
    bank = jax.jit(sampler.init)(jax.random.key(0))
    assert bank.size == 2
    keys = jax.random.split(jax.random.key(1), 32)
    episodes = jax.jit(jax.vmap(sampler.sample, (0, None)))(keys, bank)
    state, task = episodes.environment, episodes.task
    length = np.asarray(task.journey.start_distance)
    assert np.mean((length >= 1.5) & (length <= 4.0)) > 0.9
    assert np.isfinite(length).all()
    crow = np.hypot(*np.asarray(state.position - task.goal).T)
    assert (length >= crow - 1e-3).all()
    assert np.asarray(jax.vmap(_fits)(state)).all()
    np.testing.assert_allclose(np.asarray(state.position) % 0.25, 0, atol=1e-5)
    assert set(np.asarray(state.yaw)) <= set(np.arange(0, 360, 30.0))
    assert len({np.asarray(row).tobytes() for row in task.goal}) == 32


def _fits(state) -> jax.Array:
    return is_free(obstacles(state.scene.boxes, BODY), BODY.radius, state.position)


@pytest.mark.slow
def test_object_nav_in_imported_houses() -> None:
    houses = stack([cluttered(0), cluttered(1)])
    task = ObjectNav(HOUSE)
    sampler = ObjectNavSampler(task, ImportedScenes(houses), ("Mug", "Television"), nodes=128)
    bank = jax.jit(sampler.init)(jax.random.key(0))
    assert not np.asarray(bank.findable)[:, 1].any()
    keys = jax.random.split(jax.random.key(1), 16)
    episodes = jax.jit(jax.vmap(sampler.sample, (0, None)))(keys, bank)
    assert (np.asarray(episodes.task.category) == categories.index("Mug")).all()
    assert (np.asarray(episodes.environment.pitch) == 30).all()
    assert np.asarray(jax.vmap(_fits)(episodes.environment)).all()


def test_held_out_houses_are_others() -> None:
    scenes = GeneratedScenes(APARTMENT, count=3, held_out_count=2)
    sampler = PointNavSampler(PointNav(HOUSE), scenes)
    assert sampler.held_out.scenes == dataclasses.replace(scenes, split="val", count=2)
    assert sampler.held_out.held_out == sampler.held_out
    assert hash(sampler) != hash(sampler.held_out)
    with pytest.raises(JaxactError, match="unknown split"):
        GeneratedScenes(APARTMENT, split="dev")
    with pytest.raises(JaxactError, match="at least one"):
        stack([])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (("environment.turn=10.0",), "task.house.turn is 30.0, but environment.turn is 10.0"),
        (
            ("environment.turn=10.0", "task.house.turn=10.0"),
            "sampler.task.house.turn is 30.0, but environment.turn is 10.0",
        ),
        (("task.sight.distance=1.5",), "sampler.task.sight is .*distance=1.0.*, but task.sight is"),
        (("sensors.depth.body.camera_height=1.0",), "camera's body is .* but environment.body is"),
    ],
)
def test_parts_that_disagree_are_refused(changes: tuple[str, ...], said: str) -> None:
    pomdp = envs_jax.make("RoboTHOR-ObjectNav-v0")
    with pytest.raises(JaxactError, match=said):
        override(pomdp, changes)
    alike = [f"{part}.turn=10.0" for part in ("environment", "task.house", "sampler.task.house")]
    assert override(pomdp, alike).environment.turn == 10


@pytest.mark.slow
def test_targets_seen_from_pockets_alone_are_not_asked_for() -> None:
    sampler = envs_jax.make("iTHOR-ObjectNav-v0").sampler.held_out
    bank = jax.jit(sampler.init)(jax.random.key(0))
    findable, moves = np.asarray(bank.findable), np.asarray(bank.lattices.moves)
    sees, walks = ((moves == move).any((2, 3, 4)) for move in (lattice.SEES, lattice.AHEAD))
    assert (sees & ~walks).any()
    assert not (findable & ~walks).any()
    assert findable.sum() > 0.8 * sees.sum()


@pytest.mark.slow
def test_ways_are_as_long_as_in_robothor() -> None:
    """RoboTHOR's: 3.77 m on average in its training split, 3.37 m in the validation split."""
    scenes = GeneratedScenes(APARTMENT, count=64)
    sampler = ObjectNavSampler(ObjectNav(HOUSE), scenes)
    bank = jax.jit(sampler.init)(jax.random.key(0))
    assert not np.asarray(bank.bank.roadmaps.overflow).any()
    keys = jax.random.split(jax.random.key(1), 512)
    episodes = jax.jit(jax.vmap(sampler.sample, (0, None)))(keys, bank)
    length = np.asarray(episodes.task.journey.start_distance)
    assert np.isfinite(length).all()
    assert 3.0 < length.mean() < 4.0
    assert np.asarray(jax.vmap(_fits)(episodes.environment)).all()
    # Nearly every thing that the houses have can be found.
    categories_there = np.asarray(bank.bank.scenes.category)
    there = np.stack(
        [(categories_there == categories.index(name)).any(1) for name in sampler.targets], 1
    )
    assert np.asarray(bank.findable)[there].mean() > 0.99
