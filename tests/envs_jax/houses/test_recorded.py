"""Episodes that are drawn, written, read and played again are the same; those at fault are told."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_houses import ROOMS, walls

from envs_jax.houses import presets
from envs_jax.houses.bank import ImportedScenes, stack
from envs_jax.houses.categories import index
from envs_jax.houses.export import draw_episodes
from envs_jax.houses.importers import robothor
from envs_jax.houses.importers.episodes import NavigationEpisode
from envs_jax.houses.importers.scenes import read_scenes, write_scenes
from envs_jax.houses.recorded import find_problems, recorded_sampler
from envs_jax.houses.samplers import ROBOTHOR_STARTS, ObjectNavSampler, PointNavSampler, Starts
from envs_jax.houses.scene import make_scene
from envs_jax.houses.sensors import ObjectGoalSensor, PointGoalSensor
from jaxact import JaxactError, evaluate_expert
from jaxact.pomdp import POMDP

NODES = 48
# A table with a mug on it in each room, the first beside a box that is turned.
THINGS = [(6, 0.3, 4, 0.6, 0.6, 0.6, 20), (6, 0.66, 4, 0.1, 0.12, 0.1, 0)]
THINGS += [(1, 0.3, 2.5, 0.8, 0.6, 0.5, 0), (2.5, 0.4, 1, 0.6, 0.8, 0.4, 30)]
KINDS = [index("Wall")] * 7 + [index(name) for name in ("DiningTable", "Mug", "Sofa", "Sofa")]
HOUSE = make_scene([*walls(), *THINGS], KINDS, ROOMS, size=12, portable=[8])
# The same without a doorway.
SHUT = replace(HOUSE, boxes=HOUSE.boxes.at[6, 1].set(0.25))
HOUSES = ImportedScenes(stack([HOUSE, replace(SHUT, color=SHUT.color / 2)]))
POINT, OBJECT = presets.point_nav("robothor"), presets.object_nav("robothor")


@pytest.fixture(scope="module", params=["point", pytest.param("object", marks=pytest.mark.slow)])
def trip(request, tmp_path_factory):
    """Episodes as they were drawn, and the sampler of what their files say."""
    task = {"point": POINT, "object": OBJECT}[request.param]
    if task is POINT:
        starts = Starts(least=1.0, greatest=8.0)
        sampler = PointNavSampler(task, HOUSES, starts, nodes=NODES)
    else:
        sampler = ObjectNavSampler(task, HOUSES, ("Mug",), ROBOTHOR_STARTS, nodes=NODES)
    episodes, scenes = draw_episodes(sampler, 12, seed=3)
    folder = tmp_path_factory.mktemp(request.param)
    robothor.write_episodes(folder / "episodes.json.gz", episodes)
    write_scenes(folder / "scenes.json.gz", scenes)
    read = robothor.read_episodes(folder / "episodes.json.gz")
    houses = read_scenes(folder / "scenes.json.gz")
    again = recorded_sampler(task, houses, read, nodes=NODES, horizon=120)
    return sampler, episodes, read, again


def test_what_is_read_is_what_was_drawn(trip):
    sampler, episodes, read, again = trip
    assert read == episodes
    assert {episode.difficulty for episode in episodes} == {"easy", "medium", "hard"}
    for episode in episodes:
        assert episode.polyline_length == pytest.approx(episode.length, abs=1e-4)

    longer = replace(again, table=replace(again.table, length=again.table.length + 1))
    computed = replace(longer, stored_lengths=False)

    @jax.jit
    def both():
        keys = jax.random.split(jax.random.key(3, impl="threefry2x32"), 12)
        drawn = jax.vmap(sampler.sample, (0, None))(keys, sampler.init(keys[0]))
        houses = again.init(keys[0])
        listed, stored = (
            jax.vmap(one.listed, (0, None))(jnp.arange(12), houses) for one in (computed, longer)
        )
        return drawn, listed, stored.task.journey.start_distance

    drawn, listed, stored = both()
    np.testing.assert_array_equal(listed.origin, np.arange(12))
    for one, other in ((drawn.environment, listed.environment), (drawn.task, listed.task)):
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-4), one, other)
    np.testing.assert_allclose(stored, drawn.task.journey.start_distance + 1, atol=1e-4)


@pytest.mark.slow
def test_evaluation_plays_each_once_in_order(trip):
    _, episodes, _, again = trip
    sensor = PointGoalSensor() if again.task is POINT else ObjectGoalSensor()
    pomdp = POMDP(again.task.house, again.task, again, {"goal": sensor})
    outcome = evaluate_expert(pomdp, 1000)
    assert outcome.success.all()
    assert outcome.success.shape == (12,)
    lengths = np.array([episode.length for episode in episodes])
    walked = outcome.metrics["task/path_length"]
    longest = np.maximum(np.maximum(lengths, walked), 1e-9)
    spl = np.where(lengths > 0, lengths / longest, walked == 0)
    np.testing.assert_allclose(outcome.metrics["task/spl"], spl, atol=1e-5)
    assert spl.mean() > 0.95
    hard = [episode.difficulty == "hard" for episode in episodes]
    np.testing.assert_array_equal(outcome.kinds["hard"], hard)
    keys = jax.random.split(jax.random.key(0), 200)
    origins = jax.jit(jax.vmap(lambda key: again.sample(key, again.init(key)).origin))(keys)
    assert set(np.asarray(origins).tolist()) == set(range(12))


def test_scenes_are_read_as_they_were_written(tmp_path: Path):
    opened = HOUSE.other_boxes.at[3, 6:].set(jnp.array([0, 1], jnp.float32))
    scene = replace(HOUSE, other_boxes=opened, openable=HOUSE.openable.at[3].set(True))
    houses = {"a": scene, "b": replace(SHUT, ceiling=jnp.float32(2.7))}
    write_scenes(tmp_path / "houses.json", houses)
    read = read_scenes(tmp_path / "houses.json")
    assert list(read) == ["a", "b"]
    jax.tree.map(np.testing.assert_array_equal, read, houses)


FINE = NavigationEpisode("fine", "open", (1.5, 0.9, 3.5), 30.0, goals=((6.5, 0.0, 1.0),))


def test_episodes_that_cannot_be_played_are_told():
    scenes = {"open": HOUSE, "shut": SHUT}
    changes = [
        ({}, ""),
        ({"scene": "opne"}, "unknown scene 'opne'; the nearest is 'open'"),
        ({"position": (1.0, 0.9, 2.5)}, "the start at x = 1, z = 2.5 is not free for a body of"),
        ({"position": (6.0, 0.9, 40.0)}, "the start at x = 6, z = 40 "),
        ({"goals": ((2.5, 0.0, 1.0),)}, "the goal at x = 2.5, z = 1 is not free for a body of"),
        ({"scene": "shut"}, "no way for a body of 0.175 m radius leads from the start at x = 1.5"),
        ({"goals": ()}, "PointNav needs one point to go to, but it has no category with 0"),
        ({"category": "Mug", "goals": ()}, "needs one point to go to, but it looks for 'Mug'"),
    ]
    episodes = [replace(FINE, id=str(i), **change) for i, (change, _) in enumerate(changes)]
    problems = find_problems(POINT, scenes, episodes, nodes=NODES)
    for i, (change, said) in enumerate(changes):
        scene = change.get("scene", "open")
        assert (f"episode '{i}' in scene {scene!r}: " in problems[i]) if said else i not in problems
        assert said in problems.get(i, "")
    with pytest.raises(JaxactError, match=r"unknown scene .* \(of 8 episodes, and 6 more cannot"):
        recorded_sampler(POINT, scenes, episodes, nodes=NODES)
    with pytest.raises(JaxactError, match="at least one"):
        recorded_sampler(POINT, scenes, [])
    with pytest.raises(JaxactError, match="more than 4 corners: give a greater `nodes`"):
        recorded_sampler(POINT, scenes, episodes[:1], nodes=4)


def test_targets_that_cannot_be_found_are_told():
    seen_from = tuple((6.0, 0.0, z) for z in (2.5, 3.0, 4.0))
    mug = replace(FINE, category="Mug", goals=())
    changes = [
        ({}, ""),
        ({"goals": seen_from}, ""),
        ({"goals": seen_from[2:]}, "the Mug cannot be seen from anywhere that is free for a body"),
        ({"scene": "shut"}, "no way for a body of 0.175 m radius leads from the start at x = 1.5"),
        ({"category": "Mugg"}, "unknown category 'Mugg'; the nearest is 'Mug'"),
        ({"category": "Apple"}, "there is no Apple in that scene"),
        ({"category": "", "goals": FINE.goals}, "ObjectNav needs a category to find"),
    ]
    episodes = [replace(mug, id=str(i), **change) for i, (change, _) in enumerate(changes)]
    problems = find_problems(OBJECT, {"open": HOUSE, "shut": SHUT}, episodes, nodes=NODES)
    assert set(problems) == {i for i, (_, said) in enumerate(changes) if said}
    for i, (_, said) in enumerate(changes):
        assert said in problems.get(i, "")


def test_other_tasks_and_sensors_are_refused(trip):
    again = trip[-1]
    house, wanted = again.task.house, {"goal": ObjectGoalSensor(("Apple",))}
    if again.task is OBJECT:
        with pytest.raises(JaxactError, match=r"sensors\.goal\.targets lacks Mug"):
            POMDP(house, again.task, again, wanted)
        with pytest.raises(JaxactError, match=r"sampler\.task\.sight is"):
            POMDP(house, replace(OBJECT, sight=replace(OBJECT.sight, distance=2.0)), again, {})
    else:
        with pytest.raises(JaxactError, match="episodes of PointNav, but the task is ObjectNav"):
            POMDP(house, replace(OBJECT, house=house), again, {})
