"""Small houses for tests: two rooms, a doorway and clutter, and the body that walks in them."""

import jax
import numpy as np

from envs_jax.houses.categories import index
from envs_jax.houses.scene import Scene, make_scene
from envs_jax.houses.state import Body

BODY = Body(radius=0.175, height=0.9, camera_height=0.87)
WIDTH, DEPTH, THIN = 8.0, 5.0, 0.1


def walls(door: float = 2.0, gap: float = 0.9) -> list[tuple[float, ...]]:
    """Two rooms of 4 by 5 m, side by side along x, with a doorway of a width at a depth z."""
    middle, tall = WIDTH / 2, 2.5
    return [
        (middle, tall / 2, 0, WIDTH + THIN, tall, THIN, 0),
        (middle, tall / 2, DEPTH, WIDTH + THIN, tall, THIN, 0),
        (0, tall / 2, DEPTH / 2, THIN, tall, DEPTH, 0),
        (WIDTH, tall / 2, DEPTH / 2, THIN, tall, DEPTH, 0),
        (middle, tall / 2, (door - gap / 2) / 2, THIN, tall, door - gap / 2, 0),
        (middle, tall / 2, (door + gap / 2 + DEPTH) / 2, THIN, tall, DEPTH - door - gap / 2, 0),
        (middle, 2.25, door, THIN, 0.5, gap, 0),
    ]


ROOMS = ((0, 0, WIDTH / 2, DEPTH), (WIDTH / 2, 0, WIDTH, DEPTH))


def cluttered(seed: int, pieces: int = 12, size: int = 24) -> Scene:
    """Two rooms with furniture at random, half of it turned, and a mug and an apple on top."""
    rng = np.random.default_rng(seed)
    boxes = walls(door=rng.uniform(0.8, DEPTH - 0.8))
    kinds = [index("Wall")] * len(boxes)
    for piece in range(pieces):
        size_x, size_z = rng.uniform(0.2, 1.3, 2)
        height = rng.uniform(0.3, 1.2)
        x, z = rng.uniform(0.3, WIDTH - 0.3), rng.uniform(0.3, DEPTH - 0.3)
        if abs(x - WIDTH / 2) < 1.2:
            x += 1.2 * np.sign(x - WIDTH / 2)
        yaw = rng.uniform(0, 90) if piece % 2 else 0.0
        boxes.append((x, height / 2, z, size_x, height, size_z, yaw))
        kinds.append(index("Sofa"))
        if piece < 2:
            boxes.append((x, height + 0.06, z, 0.1, 0.12, 0.1, yaw))
            kinds.append(index(("Mug", "Apple")[piece]))
    return make_scene(boxes, kinds, ROOMS, size=max(size, len(boxes)))


def free_plans(seed: int, boxes: np.ndarray, radius: float, count: int) -> np.ndarray:
    """Plans at random at which the octagons around all boxes leave a body room, float64."""
    rng = np.random.default_rng(seed)
    boxes = np.asarray(boxes, np.float64)
    found: list[np.ndarray] = []
    while len(found) < count:
        plan = rng.uniform((0, 0), (WIDTH, DEPTH))
        offset = plan - boxes[:, [0, 2]]
        local = np.abs(
            np.stack(
                [
                    boxes[:, 6] * offset[:, 0] - boxes[:, 7] * offset[:, 1],
                    boxes[:, 7] * offset[:, 0] + boxes[:, 6] * offset[:, 1],
                ],
                axis=-1,
            )
        )
        beyond = local - boxes[:, [3, 5]]
        grown = np.maximum(beyond.max(axis=-1), beyond.sum(axis=-1) / np.sqrt(2))
        if grown.min() > radius + 0.002:
            found.append(plan)
    return np.array(found, np.float32)


def stack(trees: list) -> object:
    """Makes a batch of pytrees."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *trees)
