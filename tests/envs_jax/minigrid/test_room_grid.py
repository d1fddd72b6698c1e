"""The rooms of RoomGrid levels: helpers do what the package's do, with the same chances."""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from minigrid.core.roomgrid import RoomGrid as PackageRoomGrid
from scipy.stats import chi2_contingency

from envs_jax.minigrid import tiles
from envs_jax.minigrid.samplers.room_grid import DOWN, LEFT, RIGHT, UP, Layout, RoomGrid

GRID = RoomGrid(6, 3, 3)
WALLS = int(np.prod(GRID.walls))


class PackageLevel(PackageRoomGrid):
    """The package's rooms, built by `build`."""

    def __init__(self, build: Any) -> None:
        from minigrid.core.mission import MissionSpace

        self._build = build
        space = MissionSpace(mission_func=lambda: "")
        super().__init__(room_size=6, num_rows=3, num_cols=3, mission_space=space)

    def _gen_grid(self, width: int, height: int) -> None:
        super()._gen_grid(width, height)
        self._build(self)


def layouts(count: int, draws: int, build: Any) -> Layout:
    """Builds `count` layouts; `build` takes the bare one and that many draws."""

    def one(key: jax.Array) -> Layout:
        numbers = jax.random.uniform(key, (WALLS + draws,), jnp.float32)
        return build(GRID.closed(numbers[:WALLS].reshape(GRID.walls)), numbers[WALLS:])

    return jax.device_get(jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), count)))


def alike(ours: list[Any], theirs: list[Any]) -> bool:
    """Whether two samples may have one distribution; rare values are pooled."""
    first, second = Counter(ours), Counter(theirs)
    kept = [value for value in first | second if first[value] + second[value] >= 20]
    table = np.array([[sample[value] for value in kept] for sample in (first, second)])
    rest = np.array([[len(ours)], [len(theirs)]]) - table.sum(axis=1, keepdims=True)
    table = np.concatenate([table, rest], axis=1)
    table = table[:, table.sum(axis=0) > 0]
    return table.shape[1] < 2 or chi2_contingency(table).pvalue > 1e-5


def test_rooms_are_connected_as_often_by_as_many_doors_as_in_the_package():
    def build(layout: Layout, draws: jax.Array) -> Layout:
        layout = GRID.remove_wall(layout, (1, 1), UP)
        layout, _ = GRID.add_door(layout, (2, 1), LEFT, tiles.RED, True)
        return GRID.connect_all(layout, draws.reshape(GRID.walls))

    ours = layouts(4000, WALLS, build)
    assert ours.valid.all()
    assert not ours.joined[:, 0, -1].any()
    assert not ours.joined[:, 1, :, -1].any()
    counts = np.isin(ours.plane & tiles.TYPE_MASK, [tiles.CLOSED_DOOR, tiles.LOCKED_DOOR])
    looks = [
        tuple(code >> 4 for code in plane[plane & 15 == tiles.CLOSED_DOOR][:2])
        for plane in ours.plane
    ]

    def package_build(env: Any) -> None:
        env.remove_wall(1, 1, 3)
        env.add_door(2, 1, 2, "red", True)
        env.connect_all()

    env = PackageLevel(package_build)
    their_counts, their_walls, their_looks = [], [], []
    for seed in range(600):
        env.reset(seed=seed)
        image = env.grid.encode()
        doors = (image[..., 0] == 4) & (image[..., 2] == 1)
        their_counts.append(int((image[..., 0] == 4).sum()))
        their_walls.append(tuple(bool(room.doors[0]) for row in env.room_grid for room in row))
        their_looks.append(tuple(image[doors][:2, 1].tolist()))
    assert alike(counts.sum(axis=(1, 2)).tolist(), their_counts)
    assert alike([tuple(map(int, look)) for look in looks], their_looks)
    our_walls = [tuple(walls[0].T.reshape(-1).tolist()) for walls in ours.joined]
    for wall in range(9):
        assert alike([w[wall] for w in our_walls], [w[wall] for w in their_walls])


def test_a_room_between_locked_ones_cannot_be_connected():
    def build(layout: Layout, draws: jax.Array) -> Layout:
        layout, _ = GRID.add_door(layout, (1, 0), RIGHT, tiles.RED, True)
        layout, _ = GRID.add_door(layout, (0, 1), DOWN, tiles.RED, True)
        return GRID.connect_all(layout, draws.reshape(GRID.walls))

    assert not layouts(200, WALLS, build).valid.any()


@pytest.mark.parametrize("room", [(0, 0), (1, 1), (2, 1)])
def test_the_agent_and_objects_are_placed_as_in_the_package(room):
    def build(layout: Layout, draws: jax.Array) -> Layout:
        layout = GRID.remove_wall(layout, (1, 1), LEFT)
        layout, _ = GRID.place(layout, room, tiles.tile(tiles.BALL, tiles.BLUE), draws[0])
        layout = GRID.place_agent(layout, room, draws[1])
        layout, _ = GRID.place(layout, room, tiles.tile(tiles.KEY, tiles.BLUE), draws[2])
        return layout

    def package_build(env: Any) -> None:
        env.remove_wall(1, 1, 2)
        env.add_object(*room, "ball", "blue")
        env.place_agent(*room)
        env.add_object(*room, "key", "blue")

    ours = layouts(4000, 3, build)
    assert ours.valid.all()
    env = PackageLevel(package_build)
    theirs: list[tuple] = []
    for seed in range(1000):
        env.reset(seed=seed)
        kinds = env.grid.encode()[..., 0]
        cells = [tuple(np.argwhere(kinds == kind)[0].tolist()) for kind in (6, 5)]
        pose = (*map(int, env.agent_pos), int(env.agent_dir))
        theirs.append((*cells, pose))
    kinds = ours.plane & tiles.TYPE_MASK
    mine = [
        (
            *(tuple(np.argwhere(plane == kind)[0].tolist()) for kind in (tiles.BALL, tiles.KEY)),
            (*agent.tolist(), int(direction)),
        )
        for plane, agent, direction in zip(kinds, ours.agent, ours.direction, strict=True)
    ]
    for part in range(3):
        assert alike([level[part] for level in mine], [level[part] for level in theirs])
    distance = [abs(b[0] - p[0]) + abs(b[1] - p[1]) for b, _, p in mine]
    assert alike(distance, [abs(b[0] - p[0]) + abs(b[1] - p[1]) for b, _, p in theirs])
    assert min(abs(k[0] - p[0]) + abs(k[1] - p[1]) for _, k, p in mine) == 2


@pytest.mark.parametrize("unique", [False, True])
def test_distractors_are_as_random_as_in_the_package(unique):
    placing = partial(GRID.add_distractors, unique=unique)

    def build(layout: Layout, draws: jax.Array) -> Layout:
        layout, _ = GRID.place(layout, (1, 0), tiles.tile(tiles.BOX, tiles.RED), draws[0])
        return placing(layout, draws[1:].reshape(-1, 2))[0]

    ours = layouts(4000, 1 + 2 * 8, build)
    assert ours.valid.all()
    images = tiles.ENCODING[ours.plane]
    assert (np.isin(images[..., 0], (5, 6, 7)).sum(axis=(1, 2)) == 9).all()

    def package_build(env: Any) -> None:
        env.add_object(1, 0, "box", "red")
        env.add_distractors(num_distractors=8, all_unique=unique)

    env = PackageLevel(package_build)
    theirs = []
    for seed in range(600):
        env.reset(seed=seed)
        theirs.append(env.grid.encode())
    counts = [[looks(image) for image in images] for images in (images[:2400], theirs)]
    assert alike([len(set(look)) for look in counts[0]], [len(set(look)) for look in counts[1]])
    flat = [[value for look in side for value in look] for side in counts]
    assert alike(*flat)
    rooms = [
        [int(np.isin(image[:6, :6, 0], (5, 6, 7)).sum()) for image in side]
        for side in (images, theirs)
    ]
    assert alike(*rooms)
    if unique:
        assert all(len(set(look)) == 9 for look in counts[0])


def looks(image: np.ndarray) -> list[tuple[int, int]]:
    return [(kind, color) for kind, color, _ in image.reshape(-1, 3).tolist() if kind in (5, 6, 7)]


def test_random_sides_are_those_with_a_neighbour_and_no_door():
    def build(layout: Layout, draws: jax.Array) -> jax.Array:
        layout, _ = GRID.add_door(layout, (1, 0), DOWN, tiles.RED, False)
        computed = (jnp.int32(1), jnp.int32(0))
        free = GRID.free_sides(layout, computed)
        return free, GRID.free_sides(layout, (0, 2)), GRID.random_side(layout, (1, 0), draws[0])

    free, corner, sides = layouts(400, 1, build)
    assert (free == [True, False, True, False]).all()
    assert (corner == [True, False, False, True]).all()
    assert set(sides.tolist()) == {RIGHT, LEFT}
    assert 140 < (sides == RIGHT).sum() < 260
