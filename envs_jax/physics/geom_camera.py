"""Cameras of any MJCF model: pinhole pictures by casting rays at its geoms, without a renderer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.physics.environment import Physics, PhysicsState
from jaxact.errors import JaxactError, check_at_least, unknown
from jaxact.pomdp import PyTree, Sensor
from jaxact.spaces import Box

# Of the geoms that are drawn by default, in MuJoCo's viewer as here.
_GROUPS = 3
_TINY = 1e-12


@dataclass(frozen=True)
class GeomCamera(Sensor):
    """A camera of the model, which moves with its body, and what it sees of planes, spheres,
    capsules, ellipsoids, cylinders and boxes.

    Geoms of groups 0 to 2 are seen unless their alpha is 0; all others are opaque. Colours are
    those of geoms or their materials, without light or texture. Poses are those of the state.

    Attributes:
      world: which has the camera.
      camera: its name.
      kind: "depth" is float32 [H, W, 1], metres along the optical axis; "rgb" is uint8 [H, W, 3];
        "segmentation" is int32 [H, W, 1], the geoms' ids, and −1 where there is none.
      height: pixels.
      width: pixels.
      farthest: metres; what is deeper is not seen, and there the depth is this and RGB is black.

    Raises:
      JaxactError: there is no such camera or kind, the camera is not a fixed one with a vertical
        field of view, or a geom that is to be seen is a mesh, a height field or a distance field.
    """

    world: Physics
    camera: str
    kind: Literal["depth", "rgb", "segmentation"] = "depth"
    height: int = 64
    width: int = 64
    farthest: float = 10.0

    def __post_init__(self) -> None:
        check_at_least(1, "a camera", height=self.height, width=self.width)
        if self.kind not in ("depth", "rgb", "segmentation"):
            raise unknown("kind of picture", self.kind, ("depth", "rgb", "segmentation"))
        model, row = self.world.model, self.world.index("camera", self.camera)
        if model.cam_mode[row] or np.any(model.cam_sensorsize[row]):
            raise JaxactError(
                f"camera {self.camera!r} tracks a target or is given by its sensor's size: "
                "only those of mode fixed with a fovy can be rendered"
            )
        for geom in self._seen:
            if int(model.geom_type[geom]) not in _HITS:
                raise JaxactError(
                    f"geom {model.geom(geom).name or geom!r} is a mesh or a field, which cannot be "
                    "rendered: use planes, spheres, capsules, ellipsoids, cylinders or boxes, or "
                    "put it into a group above 2"
                )

    @property
    def space(self) -> Box:
        """Pictures; see `kind`."""
        size = (self.height, self.width)
        if self.kind == "rgb":
            return Box(0, 255, (*size, 3), jnp.uint8)
        if self.kind == "segmentation":
            return Box(-1, self.world.model.ngeom - 1, (*size, 1), jnp.int32)
        return Box(0.0, self.farthest, (*size, 1))

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the picture."""
        del task_state
        depth, geom = self.hits(state)
        if self.kind == "depth":
            return depth[..., None]
        if self.kind == "segmentation":
            return geom[..., None]
        model = self.world.model
        colors = np.array(model.geom_rgba[:, :3])
        for row in np.flatnonzero(model.geom_matid >= 0):
            colors[row] = model.mat_rgba[model.geom_matid[row], :3]
        table = np.concatenate([colors, np.zeros((1, 3))])
        # Nothing is −1, the last row.
        return jnp.asarray(np.round(255 * np.clip(table, 0, 1)), jnp.uint8)[geom]

    def hits(self, state: PhysicsState) -> tuple[jax.Array, jax.Array]:
        """Returns depths float32 [H, W] and geoms int32 [H, W] of the nearest hits."""
        model, row = self.world.model, self.world.index("camera", self.camera)
        half = math.tan(math.radians(float(model.cam_fovy[row])) / 2)
        across = (2 * np.arange(self.width) + 1 - self.width) * half / self.height
        down = (2 * np.arange(self.height) + 1 - self.height) * half / self.height
        x, y = np.meshgrid(across, -down)
        # Cameras look along −z; with 1 along it a ray's parameter is the depth.
        rays = jnp.asarray(np.stack([x, y, -np.ones_like(x)], -1), jnp.float32)
        eye, turned = _pose(state, model.cam_bodyid[row], model.cam_pos[row], model.cam_quat[row])
        rays = _apply(turned, rays)
        depth = jnp.full((self.height, self.width), self.farthest, jnp.float32)
        nearest = jnp.full((self.height, self.width), -1, jnp.int32)
        for geom in self._seen:
            middle, axes = _pose(
                state, model.geom_bodyid[geom], model.geom_pos[geom], model.geom_quat[geom]
            )
            size = jnp.asarray(model.geom_size[geom], jnp.float32)
            hit = _HITS[int(model.geom_type[geom])]
            distance = hit(_apply(axes.T, eye - middle), _apply(axes.T, rays), size)
            nearest = jnp.where(distance < depth, jnp.int32(geom), nearest)
            depth = jnp.minimum(distance, depth)
        return depth, nearest

    @property
    def _seen(self) -> list[int]:
        model = self.world.model
        alpha = np.array(model.geom_rgba[:, 3])
        for row in np.flatnonzero(model.geom_matid >= 0):
            alpha[row] = model.mat_rgba[model.geom_matid[row], 3]
        return [int(row) for row in np.flatnonzero((alpha > 0) & (model.geom_group < _GROUPS))]


def _apply(matrix: jax.Array, vectors: jax.Array) -> jax.Array:
    # Sums of products, since a matrix product may be rounded to fewer bits on an accelerator.
    return jnp.sum(matrix * vectors[..., None, :], axis=-1)


def _matrix(q: jax.Array) -> jax.Array:
    w, x, y, z = q
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])


def _pose(
    state: PhysicsState, body: int, place: np.ndarray, quaternion: np.ndarray
) -> tuple[jax.Array, jax.Array]:
    turned = _matrix(state.body_rotation[int(body)])
    own = _matrix(jnp.asarray(quaternion, jnp.float32))
    at = state.body_position[int(body)] + _apply(turned, jnp.asarray(place, jnp.float32))
    return at, jnp.sum(turned[:, :, None] * own[None], axis=1)


def _first(*candidates: tuple[jax.Array, jax.Array]) -> jax.Array:
    """Returns the least parameter that counts and is not behind, and infinity if there is none."""
    ahead = [jnp.where(counts & (t >= 0), t, jnp.inf) for t, counts in candidates]
    return jnp.min(jnp.stack(ahead), axis=0)


def _roots(a: jax.Array, b: jax.Array, c: jax.Array) -> list[tuple[jax.Array, jax.Array]]:
    """Returns both roots of a t² + 2 b t + c, and whether there are any."""
    inside = b * b - a * c
    real = (inside >= 0) & (a > _TINY)
    root, a = jnp.sqrt(jnp.maximum(inside, 0)), jnp.maximum(a, _TINY)
    return [((-b - root) / a, real), ((-b + root) / a, real)]


def _ball(eye: jax.Array, rays: jax.Array, radius: jax.Array) -> list[tuple[jax.Array, jax.Array]]:
    return _roots(
        jnp.sum(rays * rays, -1), jnp.sum(rays * eye, -1), jnp.sum(eye * eye) - radius * radius
    )


def _plane(eye: jax.Array, rays: jax.Array, size: jax.Array) -> jax.Array:
    down = rays[..., 2]
    t = -eye[2] / jnp.where(down < -_TINY, down, -1.0)
    at = jnp.abs(eye[:2] + t[..., None] * rays[..., :2])
    # A half-width of 0 is one without end. Planes are seen from above.
    return _first((t, (down < -_TINY) & jnp.all((at <= size[:2]) | (size[:2] <= 0), axis=-1)))


def _sphere(eye: jax.Array, rays: jax.Array, size: jax.Array) -> jax.Array:
    return _first(*_ball(eye, rays, size[0]))


def _ellipsoid(eye: jax.Array, rays: jax.Array, size: jax.Array) -> jax.Array:
    return _first(*_ball(eye / size, rays / size, jnp.float32(1)))


def _side(eye: jax.Array, rays: jax.Array, size: jax.Array) -> list[tuple[jax.Array, jax.Array]]:
    roots = _ball(eye[:2], rays[..., :2], size[0])
    return [(t, real & (jnp.abs(eye[2] + t * rays[..., 2]) <= size[1])) for t, real in roots]


def _capsule(eye: jax.Array, rays: jax.Array, size: jax.Array) -> jax.Array:
    hits = _side(eye, rays, size)
    for end in (-1.0, 1.0):
        roots = _ball(eye.at[2].add(-end * size[1]), rays, size[0])
        hits += [(t, real & (end * (eye[2] + t * rays[..., 2]) >= size[1])) for t, real in roots]
    return _first(*hits)


def _cylinder(eye: jax.Array, rays: jax.Array, size: jax.Array) -> jax.Array:
    hits = _side(eye, rays, size)
    level = jnp.abs(rays[..., 2]) < _TINY
    for end in (-1.0, 1.0):
        t = (end * size[1] - eye[2]) / jnp.where(level, 1.0, rays[..., 2])
        at = eye[:2] + t[..., None] * rays[..., :2]
        hits.append((t, ~level & (jnp.sum(at * at, -1) <= size[0] * size[0])))
    return _first(*hits)


def _box(eye: jax.Array, rays: jax.Array, size: jax.Array) -> jax.Array:
    rays = jnp.where(jnp.abs(rays) < _TINY, _TINY, rays)
    low, high = (-size - eye) / rays, (size - eye) / rays
    near, far = jnp.max(jnp.minimum(low, high), -1), jnp.min(jnp.maximum(low, high), -1)
    return _first((near, near <= far), (far, near <= far))


# By MuJoCo's numbers of kinds of geoms (mjtGeom).
_HITS: dict[int, Callable[[jax.Array, jax.Array, jax.Array], jax.Array]] = {
    0: _plane,
    2: _sphere,
    3: _capsule,
    4: _ellipsoid,
    5: _cylinder,
    6: _box,
}
