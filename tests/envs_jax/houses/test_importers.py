"""Others' files: what is known of them, and one sentence for those that are broken."""

import dataclasses
import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from envs_jax.houses import categories, validity
from envs_jax.houses.importers import habitat, maps, procthor, robothor, scenes
from envs_jax.houses.importers.episodes import NavigationEpisode
from envs_jax.houses.scene import make_scene
from envs_jax.houses.state import Body
from jaxact.errors import JaxactError

PUBLISHED = Path(__file__).parents[4] / "shared" / "data"
LOCOBOT = Body(0.175, 0.9, 0.87)


def published(*parts: str) -> Path:
    path = PUBLISHED.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"{path.name} is not at hand")
    return path


def wall(x: float, z: float, to_x: float, to_z: float, room: str = "room|1") -> dict:
    points = [(x, 0, z), (to_x, 0, to_z), (x, 2.5, z), (to_x, 2.5, to_z)]
    polygon = [dict(zip("xyz", point, strict=True)) for point in points]
    return {"id": f"wall|{room}|{x}|{z}|{to_x}|{to_z}", "polygon": polygon, "roomId": room}


def house() -> dict:
    """Two rooms of 3 by 3 m with a shut door between them and a table with an apple."""
    walls = [wall(0, 0, 0, 3), wall(0, 3, 3, 3), wall(3, 3, 3, 0), wall(3, 0, 0, 0)]
    walls += [wall(3, 0, 3, 3, "room|2"), wall(3, 3, 6, 3, "room|2")]
    walls += [wall(6, 3, 6, 0, "room|2"), wall(6, 0, 3, 0, "room|2")]
    hole = [{"x": 0.5, "y": 0, "z": 0}, {"x": 1.5, "y": 2, "z": 0}]
    pane = [{"x": 1, "y": 1, "z": 0}, {"x": 2, "y": 2, "z": 0}]
    floor = [{"x": x, "y": 0, "z": z} for x, z in ((0, 0), (0, 3), (3, 3), (3, 0))]
    apple = {"assetId": "Apple_1", "id": "Apple|1|1", "children": []}
    apple |= {"position": {"x": 1, "y": 0.8, "z": 1}, "rotation": {"x": 0, "y": 0, "z": 0}}
    table = {"assetId": "Table_1", "id": "DiningTable|1|0", "children": [apple]}
    table |= {"position": {"x": 1, "y": 0.37, "z": 1}, "rotation": {"x": 0, "y": 90, "z": 0}}
    return {
        "metadata": {"schema": "1.0.0"},
        "walls": walls,
        "doors": [
            {
                "id": "door|1|2",
                "wall0": walls[2]["id"],
                "holePolygon": hole,
                "room0": "room|1",
                "room1": "room|2",
                "openable": True,
                "openness": 0,
            }
        ],
        "windows": [{"wall0": walls[0]["id"], "holePolygon": pane}],
        "objects": [table],
        "rooms": [
            {"floorPolygon": floor, "roomType": "Kitchen"},
            {
                "floorPolygon": [{**point, "x": point["x"] + 3} for point in floor],
                "roomType": "Bedroom",
            },
        ],
    }


def test_procthor_house(tmp_path: Path) -> None:
    path = tmp_path / "house.json"
    path.write_text(json.dumps(house()))
    scene = procthor.read_house(path, boxes=20)
    names = [categories.NAMES[i] for i in np.asarray(scene.category) if i]
    assert names == ["Wall"] * 9 + ["Door", "Window", "DiningTable", "Apple"]
    assert scene.boxes.shape == (20, 8)
    np.testing.assert_array_equal(np.asarray(scene.rooms), [[0, 0, 3, 3], [3, 0, 6, 3]])
    assert [categories.ROOMS[i] for i in np.asarray(scene.room_kind)] == ["Kitchen", "Bedroom"]
    door = names.index("Door")
    # The hole is measured from (3, 3) downwards.
    np.testing.assert_allclose(np.asarray(scene.boxes)[door, :3], [3, 1, 2], atol=1e-5)
    assert np.asarray(scene.openable).nonzero()[0].tolist() == [door]
    free, _, _ = validity.free_cells(scene, LOCOBOT)
    assert validity.components(free) == 2
    opened = dataclasses.replace(scene, boxes=scene.other_boxes)
    free, _, _ = validity.free_cells(opened, LOCOBOT)
    assert validity.components(free) == 1
    assert [
        categories.NAMES[i] for i in np.asarray(scene.category)[np.asarray(scene.portable)]
    ] == ["Apple"]
    with pytest.raises(JaxactError, match="13 boxes, more than 12"):
        procthor.read_house(path, boxes=12)


def change(record: Any, path: tuple, value: object) -> None:
    for step in path[:-1]:
        record = record[step]
    record[path[-1]] = value


def _changed(*path: str | int, value: object) -> dict:
    changed = house()
    change(changed, path, value)
    return changed


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (_changed("metadata", value={}), "has no 'schema'"),
        (_changed("metadata", "schema", value="2.0"), "schema '2.0' is not supported"),
        (_changed("walls", value=None), "'walls' of the house must be a list"),
        (_changed("walls", value=[]), "needs walls"),
        (_changed("walls", 0, "polygon", value=[]), "wall 0 must be an upright rectangle"),
        (_changed("doors", 0, "wall0", value="no"), "door 0 is in 'no', which is no wall"),
        (_changed("objects", 0, "position", value={"x": 1}), "has no 'y'"),
        (_changed("objects", 0, "id", value="What|1"), "unknown asset 'Table_1'"),
        (_changed("objects", 0, "position", "x", value=float("nan")), "must be a finite number"),
        (_changed("objects", 0, "position", "x", value=10**400), "must be a finite number of at"),
        (_changed("objects", 0, "position", "x", value=True), "must be a finite number, not True"),
        (_changed("objects", 0, "children", value=3), r"'children' of object 0 .*must be a list"),
        (_changed("objects", 0, "children", 0, "id", value=3), "'id' of child 0 of object 0"),
        (
            _changed("walls", 1, "id", value=house()["walls"][0]["id"]),
            "wall 1 has the id .*another",
        ),
        (_changed("doors", 0, "holePolygon", 1, "x", value=9), "from 0.5 to 9 m along .* is 3 m"),
        (_changed("doors", 0, "holePolygon", 1, "y", value=-1), "from -1 to 0 m up"),
        (_changed("doors", value={}), "'doors' of the house must be a list"),
        (_changed("rooms", value=[]), "needs rooms"),
        (_changed("rooms", 0, "floorPolygon", value=[]), "room 0 must have at least four corners"),
        ([], "the house must be an object"),
    ],
)
def test_procthor_says_what_is_wrong(tmp_path: Path, content: object, said: str) -> None:
    path = tmp_path / "house.json"
    path.write_text(json.dumps(content))
    with pytest.raises(JaxactError, match=said):
        procthor.read_house(path)


def test_broken_files(tmp_path: Path) -> None:
    path = tmp_path / "broken.json.gz"
    for data, said in (
        (b"{", "no JSON"),
        (gzip.compress(b"[1, 2]" * 99)[:-9], "cut off or damaged"),
        (b"\x1f\x8bnonsense", "gzip"),
        (b"\xff\xfe\xfa", "no JSON"),
        (b"{}", "must be a list of episodes"),
    ):
        path.write_bytes(data)
        with pytest.raises(JaxactError, match=said):
            robothor.read_episodes(path)
    path.write_bytes(b"[" * 200_000)
    with pytest.raises(JaxactError, match="no JSON"):
        habitat.read_episodes(path)
    with pytest.raises(JaxactError, match=r"cannot read .*missing"):
        robothor.read_episodes(tmp_path / "missing")


def test_procthor_published_house() -> None:
    assets = procthor.read_assets(published("procthor", "asset-database-slim.json.gz"))
    assert len(assets) == 1653
    scene = procthor.read_house(published("procthor", "house_100.json"), assets)
    names = np.array(categories.NAMES)[np.asarray(scene.category)]
    assert (names == "Wall").sum() == 13
    assert (~np.isin(names, ["Wall", "Door"])).sum() == 19
    free, _, _ = validity.free_cells(scene, LOCOBOT, 0.25)
    assert validity.components(free) == 1
    # Our own count, of multiples of 0.25 m with the door to the outside shut: it pins what is read,
    # and is nobody else's number.
    assert int(free.sum()) == 223


def test_procthor_stages_of_generation() -> None:
    assets = procthor.read_assets(published("procthor", "asset-database-slim.json.gz"))
    files = sorted(published("procthor", "partial_houses").glob("*.json"))
    assert len(files) == 5
    for path in files:
        scene = procthor.read_house(path, assets)
        assert np.asarray(scene.present).all(), path


def test_robothor_episodes_are_read_and_written(tmp_path: Path) -> None:
    secret = NavigationEpisode("a", "House_0", (1.0, 0.9, 2.5), 30.0, 30.0, "Apple")
    corners = ((1.0, 0.0, 2.5), (1.0, 0.0, 4.5), (2.5, 0.0, 4.5))
    known = dataclasses.replace(secret, id="b", path=corners, length=3.5, difficulty="easy")
    assert known.polyline_length == 3.5
    point = dataclasses.replace(known, id="c", category="", goals=corners[-1:], pitch=0.0)
    episodes = [secret, known, point]
    for name in ("episodes.json", "episodes.json.gz"):
        robothor.write_episodes(tmp_path / name, episodes)
        assert robothor.read_episodes(tmp_path / name) == episodes
    assert {path.name for path in tmp_path.iterdir()} == {"episodes.json", "episodes.json.gz"}
    with pytest.raises(JaxactError, match="'c' in scene 'House_0' must have a category"):
        robothor.write_episodes(tmp_path / name, [dataclasses.replace(point, goals=())])
    with pytest.raises(JaxactError, match=r"cannot write .*missing"):
        robothor.write_episodes(tmp_path / "missing" / name, episodes)


def test_robothor_angles_in_full(tmp_path: Path) -> None:
    """As in data sets of PointNav; the horizon may be left out."""
    record = {"id": "a", "scene": "b", "initial_position": {"x": 0, "y": 1, "z": 2}}
    record |= {"initial_orientation": {"x": 0, "y": 90, "z": 0}, "object_type": None}
    record |= {"target_position": {"x": 3, "y": 0, "z": 4}}
    path = tmp_path / "episodes.json"
    path.write_text(json.dumps([record]))
    (episode,) = robothor.read_episodes(path)
    assert (episode.yaw, episode.pitch, episode.goals) == (90.0, 0.0, ((3.0, 0.0, 4.0),))


EPISODE = NavigationEpisode(
    "a", "b", (0.0, 1.0, 2.0), 90.0, 30.0, "Mug", (), ((0.0, 0.0, 2.0), (1.0, 0.0, 2.0)), 1.0
)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ((0,), [], "episode 0 must be an object"),
        ((1, "id"), "a", "episodes 0 and 1 of scene 'b' have the same id 'a'"),
        ((1, "id"), 3, "'id' of episode 1 must be a string"),
        ((1, "object_type"), "", "episode 1 must have either an 'object_type' to find or a"),
        ((1, "target_position"), {}, "episode 1 must have either"),
        ((0, "initial_position"), [0, 1, 2], "'initial_position' of episode 0 must be an object"),
        ((0, "initial_position", "z"), 1e30, "'z' of episode 0 must be a finite number of at most"),
        ((0, "initial_position", "z"), None, "'z' of episode 0 must be a finite number, not None"),
        ((0, "initial_orientation"), {}, "'initial_orientation' of episode 0 has no 'y'"),
        ((0, "initial_horizon"), "30", "'initial_horizon' of episode 0 must be a finite number"),
        ((0, "shortest_path"), [], "'shortest_path' of episode 0 must have a corner"),
        ((0, "shortest_path", 1), 3, "episode 0 must be an object, not 3"),
        ((0, "shortest_path_length"), -1, "must not be negative, but is -1"),
    ],
)
def test_robothor_says_what_is_wrong(path: tuple, value: object, said: str, tmp_path: Path) -> None:
    file = tmp_path / "episodes.json"
    robothor.write_episodes(file, [EPISODE, dataclasses.replace(EPISODE, id="c")])
    records = json.loads(file.read_text())
    change(records, path, value)
    file.write_text(json.dumps(records))
    with pytest.raises(JaxactError, match=f"episodes.json: .*{said}"):
        robothor.read_episodes(file)


def test_robothor_published_validation_paths() -> None:
    files = sorted(published("robothor", "val", "episodes").glob("*.json.gz"))
    episodes = [episode for path in files for episode in robothor.read_episodes(path)]
    assert len(episodes) == 120 * len(files)
    for episode in episodes:
        assert episode.length == pytest.approx(episode.polyline_length, abs=1e-9)
        assert (np.array(episode.position)[::2] % 0.25 == 0).all()
        assert episode.pitch == 30
        assert episode.yaw % 30 == 0
        assert episode.category in categories.ROBOTHOR_TARGETS


@pytest.mark.slow
def test_robothor_all_published_files() -> None:
    files = sorted(published("robothor").glob("*/episodes/*.json.gz"))
    counts = {split: 0 for split in ("debug", "train", "val", "test")}
    for path in files:
        episodes = robothor.read_episodes(path)
        counts[path.parts[-3]] += len(episodes)
        assert all((episode.path is None) == (path.parts[-3] == "test") for episode in episodes)
    assert counts == {"debug": 4, "train": 54_000, "val": 1_200, "test": 2_040}


def habitat_file(path: Path, **changes: object) -> Path:
    goal = {"position": [1.0, 0.5, -2.0], "object_category": "bed"}
    goal["view_points"] = [{"agent_state": {"position": [1.0, 0.0, -1.0]}, "iou": 1.0}]
    half = float(np.sqrt(0.5))
    found = {"episode_id": "7", "scene_id": "hm3d/a/A.glb", "object_category": "bed", "goals": []}
    found |= {"start_position": [0.0, 0.0, 3.0], "start_rotation": [0.0, half, 0.0, half]}
    found |= {"info": {"geodesic_distance": 5.5}}
    point = {**found, "episode_id": 8, "object_category": None}
    point |= {"goals": [{"position": [0.0, 0.0, -4.0]}]}
    data = {"episodes": [found, point], "goals_by_category": {"A.glb_bed": [goal]}}
    path.write_text(json.dumps({**data, **changes}))
    return path


def test_habitat_episodes(tmp_path: Path) -> None:
    path = tmp_path / "episodes.json"
    found, point = habitat.read_episodes(habitat_file(path))
    assert found.position == (0.0, 0.0, -3.0)
    # A quarter to the left of −z there is −x, which is 270 degrees clockwise of +z here.
    assert found.yaw == pytest.approx(270)
    assert found.category == "Bed"
    assert found.goals == ((1.0, 0.0, 1.0),)
    assert found.length == 5.5
    assert point.category == ""
    assert point.goals == ((0.0, 0.0, 4.0),)
    assert set(habitat.CATEGORIES.values()) <= set(categories.NAMES)
    for yaw in (0.0, 30.0, 200.0, 359.0):
        assert habitat.yaw_of(habitat.rotation_of(yaw)) == pytest.approx(yaw)
    for changes, said in (
        ({"episodes": []}, "folder 'content'"),
        ({"goals_by_category": {}}, "looks for 'A.glb_bed'"),
        ({"goals_by_category": [1]}, "must be an object"),
        ({"episodes": None}, "must be a list"),
    ):
        with pytest.raises(JaxactError, match=said):
            habitat.read_episodes(habitat_file(path, **changes))


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("episodes", 0), None, "episode 0 must be an object"),
        (("episodes", 0, "episode_id"), None, "'episode_id' of episode 0 must be a string"),
        (("episodes", 1, "episode_id"), "7", "have the same id '7'"),
        (("episodes", 0, "start_position"), [0, 1], "must have 3 numbers, not 2"),
        (("episodes", 0, "start_position", 2), float("nan"), "must be a finite number"),
        (("episodes", 0, "start_rotation"), [0, 0, 0, 0], "must be a unit quaternion"),
        (("episodes", 0, "start_rotation"), None, "'start_rotation' of episode 0 must be a list"),
        (("episodes", 0, "info"), [1], "'info' of episode 0 must be an object"),
        (("episodes", 0, "info", "geodesic_distance"), float("inf"), "must be a finite number"),
        (("episodes", 0, "info", "geodesic_distance"), -1, "must not be negative"),
        (("episodes", 1, "goals"), [], "episode 1 has no goals"),
        (("episodes", 1, "goals"), {"a": 1}, "'goals' of episode 1 must be a list"),
        (("episodes", 1, "goals", 0), 3, "goal 0 of episode 1 must be an object"),
        (("goals_by_category", "A.glb_bed"), 3, "'A.glb_bed' of 'goals_by_category' must be a"),
        (("goals_by_category", "A.glb_bed", 0, "view_points", 0), {}, "has no 'agent_state'"),
    ],
)
def test_habitat_says_what_is_wrong(path: tuple, value: object, said: str, tmp_path: Path) -> None:
    file = habitat_file(tmp_path / "episodes.json")
    data = json.loads(file.read_text())
    change(data, path, value)
    file.write_text(json.dumps(data))
    with pytest.raises(JaxactError, match=f"episodes.json: .*{said}"):
        habitat.read_episodes(file)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("format",), "2", "format '2' is not supported, only 'jaxact-scenes-1'"),
        (("scenes", "a"), [], "scene 'a' must be an object"),
        (("scenes", "a", "rows"), 10**40, "'rows' of scene 'a' must be 1 … 100,000"),
        (("scenes", "a", "rows"), True, "'rows' of scene 'a' must be a whole number, not True"),
        (("scenes", "a", "rooms"), [], "scene 'a' needs rooms"),
        (("scenes", "a", "rooms", 0, "kind"), "Attic", "room 0 of scene 'a': unknown kind 'Attic'"),
        (("scenes", "a", "boxes", 1, "row"), 0, "'row' of box 1 of scene 'a' must be one of 0 … 2"),
        (("scenes", "a", "boxes", 1, "category"), "Mugg", "unknown category 'Mugg'; the nearest"),
        (("scenes", "a", "boxes", 1, "box"), [0] * 7, "must have 8 numbers, not 7"),
        (("scenes", "a", "boxes", 1, "box", 7), 2, "must be a centre, half sizes"),
        (("scenes", "a", "boxes", 1, "opened"), 1, "must be true or false, not 1"),
    ],
)
def test_scenes_say_what_is_wrong(path: tuple, value: object, said: str, tmp_path: Path) -> None:
    file = tmp_path / "scenes.json"
    boxes = [(0, 1, 0, 1, 2, 3, 30), (0, 1, 4, 1, 2, 3, 0)]
    scenes.write_scenes(file, {"a": make_scene(boxes, [3, 4], [(0, 0, 4, 4)], size=3)})
    data = json.loads(file.read_text())
    change(data, path, value)
    file.write_text(json.dumps(data))
    with pytest.raises(JaxactError, match=f"scenes.json: .*{said}"):
        scenes.read_scenes(file)


def test_occupancy_map(tmp_path: Path) -> None:
    free = np.zeros((20, 30), bool)
    free[2:18, 3:28] = True
    free[8:12, 10:12] = False
    np.save(tmp_path / "map.npy", free)
    scene = maps.read_occupancy(tmp_path / "map.npy", 0.1)
    cells, x, z = validity.free_cells(scene, Body(1e-3, 0.9, 0.87), 0.1)
    assert cells.sum() == free.sum()
    i, k = np.nonzero(cells)
    assert free[np.round(-z[k] / 0.1).astype(int), np.round(x[i] / 0.1).astype(int)].all()
    with pytest.raises(JaxactError, match="more than 2"):
        maps.read_occupancy(tmp_path / "map.npy", 0.1, boxes=2)
    np.save(tmp_path / "map.npy", np.zeros((3, 3), bool))
    with pytest.raises(JaxactError, match="nowhere to go"):
        maps.read_occupancy(tmp_path / "map.npy", 0.1)
    np.save(tmp_path / "map.npy", np.zeros(3))
    with pytest.raises(JaxactError, match="map of two axes"):
        maps.read_occupancy(tmp_path / "map.npy", 0.1)
    with pytest.raises(JaxactError, match="cell must be a positive number of metres, got nan"):
        maps.read_occupancy(tmp_path / "map.npy", float("nan"))
    (tmp_path / "map.npy").write_bytes(b"nonsense")
    with pytest.raises(JaxactError, match="no NumPy array"):
        maps.read_occupancy(tmp_path / "map.npy", 0.1)


def test_reachable_points(tmp_path: Path) -> None:
    points = np.array([[x, z] for x in range(4) for z in range(5) if (x, z) != (1, 2)]) * 0.25
    np.save(tmp_path / "points.npy", points)
    scene = maps.read_reachable(tmp_path / "points.npy")
    cells, x, z = validity.free_cells(scene, Body(0.1, 0.9, 0.87), 0.25)
    i, k = np.nonzero(cells)
    assert {(a, b) for a, b in zip(x[i], z[k], strict=True)} == {(a, b) for a, b in points}
    np.save(tmp_path / "points.npy", points + 0.1)
    with pytest.raises(JaxactError, match=r"grid of 0.25 m"):
        maps.read_reachable(tmp_path / "points.npy")
    for far, said in ((np.nan, "finite"), (1e30, "of at most"), (4000, "over 15999 by 15999")):
        np.save(tmp_path / "points.npy", np.array([[0.25, 0.25], [far, far]]))
        with pytest.raises(JaxactError, match=said):
            maps.read_reachable(tmp_path / "points.npy")
    np.savez(tmp_path / "points.npz", points)
    whole = (tmp_path / "points.npz").read_bytes()
    for data, said in ((whole, "archive of several"), (whole[:99], "no NumPy array")):
        (tmp_path / "points.npz").write_bytes(data)
        with pytest.raises(JaxactError, match=said):
            maps.read_reachable(tmp_path / "points.npz")


def test_published_maps() -> None:
    for name, share, islands in (("skokloster-castle", 0.500, 1), ("van-gogh-room", 0.324, 1)):
        binary = np.load(published("habitat_sim", f"{name}_topdown_binary.npy"))
        path = published("habitat_sim", f"{name}_topdown_islands.npy")
        assert np.array_equal(binary, np.load(path) >= 0)
        assert binary.mean() == pytest.approx(share, abs=5e-4)
        scene = maps.read_occupancy(path, 0.1)
        cells, _, _ = validity.free_cells(scene, Body(1e-3, 0.9, 0.87), 0.1)
        assert cells.sum() == binary.sum()
        assert validity.components(cells) == islands


def test_published_layouts() -> None:
    files = sorted(published("alfred", "layouts").glob("*.npy"))
    assert len(files) == 120
    for path in files[::10]:
        scene = maps.read_reachable(path)
        cells, _, _ = validity.free_cells(scene, Body(0.12, 0.9, 0.87), 0.25)
        assert cells.sum() == len(np.unique(np.load(path), axis=0)), path
