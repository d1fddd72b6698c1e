"""Random scenes and poses to look at, and a ray caster in float64 to compare with."""

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses import categories
from envs_jax.houses.camera import Camera, Pose
from envs_jax.houses.rays import CEILING, FIRST_BOX, FLOOR, NOTHING
from envs_jax.houses.scene import NOWHERE, Scene
from envs_jax.houses.state import Body, HouseState

CEILING_HEIGHT = 2.6
BODY = Body(radius=0.175, height=0.9, camera_height=0.87)
SIZE = 8.0


def scene(seed: int, boxes: int = 36, padding: int = 4) -> Scene:
    """Boxes of all sizes, turned anyhow, in a room of 8 × 8 metres with four walls."""
    random = np.random.default_rng(seed)
    loose = boxes - 4
    half = random.uniform(0.05, 0.6, (loose, 3))
    center = random.uniform(0.3, SIZE - 0.3, (loose, 3))
    # Half of them stand on the floor, the others hang anywhere.
    center[:, 1] = np.where(random.random(loose) < 0.5, half[:, 1], random.uniform(0.3, 2.3, loose))
    yaw = np.where(random.random(loose) < 0.3, 90.0, random.uniform(0, 360, loose))
    middle, high = SIZE / 2, CEILING_HEIGHT / 2
    wall_center = [(middle, high, 0), (middle, high, SIZE), (0, high, middle), (SIZE, high, middle)]
    wall_half = [(middle, high, 0.05)] * 2 + [(0.05, high, middle)] * 2
    turned = np.radians(np.concatenate([np.zeros(4), yaw]))
    turned = np.stack([np.cos(turned), np.sin(turned)], axis=-1)
    centers, halves = np.concatenate([wall_center, center]), np.concatenate([wall_half, half])
    nowhere = np.tile([NOWHERE] * 3 + [0, 0, 0, 1, 0], (padding, 1))
    rows = np.concatenate([np.concatenate([centers, halves, turned], axis=-1), nowhere])
    rows = rows.astype(np.float32)
    count = boxes + padding
    category = np.zeros(count, np.int32)
    category[:4] = categories.index("Wall")
    category[4:boxes] = random.integers(6, len(categories.NAMES), loose)
    fields = Scene(
        boxes=rows,
        other_boxes=rows,
        category=category,
        color=random.uniform(0.2, 1, (count, 3)).astype(np.float32),
        openable=np.zeros(count, bool),
        portable=np.zeros(count, bool),
        opened=np.zeros(count, bool),
        rooms=np.float32([[0, 0, SIZE, SIZE], [0, 0, 0, 0]]),
        room_kind=np.int32([1, 0]),
        ceiling=np.float32(CEILING_HEIGHT),
        surface=np.float32([[0.6, 0.5, 0.4], [0.9, 0.9, 0.9]]),
    )
    return jax.tree.map(jnp.asarray, fields)


def state(seed: int, boxes: int = 36, pitch: float | None = None) -> HouseState:
    """A scene with an agent somewhere in it, perhaps within a box."""
    random = np.random.default_rng(seed + 1000)
    return HouseState(
        scene=scene(seed, boxes),
        position=jnp.asarray(random.uniform(1, SIZE - 1, 2), jnp.float32),
        yaw=jnp.float32(random.uniform(0, 360)),
        pitch=jnp.float32(random.choice([-20, 0, 30]) if pitch is None else pitch),
        collided=jnp.bool_(False),
        last_action=jnp.int32(4),
        held=jnp.int32(-1),
    )


def stacked(trees: list) -> object:
    """Trees of one structure as one, with a leading axis."""
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *trees)


def directions(camera: Camera, pose: Pose) -> np.ndarray:
    """Rays as vectors float64 [H, W, 3] of the house, going one metre along the camera's axis."""
    up = np.tan(np.radians(camera.vertical_fov) / 2)
    right = up * camera.width / camera.height
    if camera.horizontal_fov is not None:
        right = np.tan(np.radians(camera.horizontal_fov) / 2)
    ys = up * (1 - (np.arange(camera.height) + 0.5) / camera.height * 2)
    xs = right * ((np.arange(camera.width) + 0.5) / camera.width * 2 - 1)
    yaw, pitch = np.radians(float(pose.yaw)), np.radians(float(pose.pitch))
    forward = [np.sin(yaw) * np.cos(pitch), -np.sin(pitch), np.cos(yaw) * np.cos(pitch)]
    upward = [np.sin(yaw) * np.sin(pitch), np.cos(pitch), np.cos(yaw) * np.sin(pitch)]
    rightward = [np.cos(yaw), 0, -np.sin(yaw)]
    x, y = np.meshgrid(xs, ys)
    parts = zip((x, y, np.ones_like(x)), (rightward, upward, forward), strict=True)
    return sum(part[..., None] * np.array(axis) for part, axis in parts)


def cast(
    origin: np.ndarray, rays: np.ndarray, scene: Scene, near: float
) -> tuple[np.ndarray, np.ndarray]:
    """Depths and numbers of surfaces, one ray [..., 3] at a time in float64, by face distances."""
    with np.errstate(divide="ignore", invalid="ignore"):
        down, ceiling = rays[..., 1], float(scene.ceiling)
        depth = np.where(down < 0, -origin[1] / down, np.inf)
        surface = np.where(down < 0, FLOOR, NOTHING)
        above = np.where(down > 0, (ceiling - origin[1]) / down, np.inf)
        surface = np.where(above < depth, CEILING, surface)
        depth = np.minimum(depth, above)
        for row, values in enumerate(np.asarray(scene.boxes, np.float64)):
            cosine, sine = values[6:]
            turn = np.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])
            start, ray = turn @ (origin - values[:3]), rays @ turn.T
            low, high = (-values[3:6] - start) / ray, (values[3:6] - start) / ray
            enter = np.minimum(low, high).max(axis=-1)
            leave = np.maximum(low, high).min(axis=-1)
            nearer = (enter <= leave) & (enter > near) & (enter < depth)
            depth = np.where(nearer, enter, depth)
            surface = np.where(nearer, FIRST_BOX + row, surface)
    return depth, surface
