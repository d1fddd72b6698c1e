"""What a camera sees of a house: every ray against every box in sight, in closed form.

A ray meets a box where it has entered all three pairs of its faces and left none. What is compared
is not the depths at which it does so but their inverses: along the picture the inverse depth of a
plane is linear, so that no pixel divides, and the nearest surface has the greatest. Boxes are
walked by a loop that carries one int32 a ray: positive floats are ordered as their bits are, so the
bits of an inverse depth with the surface's number in the lowest 8 (of more than 253 boxes: 10) make
the nearest surface the greatest integer. This rounds depths by at most one part in 2¹⁶ (2¹⁴). Floor
and ceiling are planes.

Most boxes of a house are behind the camera or beside the picture. They are left out, and of many
pictures those in which about as many are left are taken together, so that none waits for others.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses.camera import Camera, Pose, Rays
from envs_jax.houses.comparisons import greater, lesser
from envs_jax.houses.scene import CENTER, COSINE, HALF_SIZE, SINE, Scene
from jaxact.compaction import together
from jaxact.errors import JaxactError

# Numbers of surfaces; box i is FIRST_BOX + i.
NOTHING, FLOOR, CEILING, FIRST_BOX = 0, 1, 2, 3

# Boxes that one pass takes; more was measured to be no faster.
_UNROLL = 2
# Of the pictures that are taken together, for each of a CPU's cores that a device has: what they
# carry stays in its cache.
_RAYS_A_CORE = 1 << 14
# Metres by which a box has to be out of sight, so that rounding never hides one.
_MARGIN = np.float32(1e-2)
# The least share of a ray that goes ahead, of those by which boxes are told to be out of sight.
_LEVEL = np.float32(0.05)
# An inverse depth that is no bound.
_UNBOUNDED = np.float32(1e30)
# Metres: the least distance of a face's plane.
_LEAST = np.float32(1e-9)
# Added to directions: a ray exactly along a face would otherwise meet it at ∞ − ∞.
_AJAR = np.float32(1e-9)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class View:
    """The nearest surface along each ray.

    Attributes:
      depth: float32 [H, W], metres along the camera's axis; ∞ where there is nothing.
      surface: int32 [H, W], its number: NOTHING, FLOOR, CEILING, or FIRST_BOX + a box's row.
    """

    depth: jax.Array
    surface: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Hits:
    """Where rays meet the surfaces of a `View`.

    Attributes:
      depth: float32 [H, W], exact to float32's rounding.
      face: int32 [H, W]: 0 to 5 for the faces that look along +x, −x, +y, −y, +z, −z of the box's
        axes.
      u: float32 [H, W], metres along the face, from its middle; on floor and ceiling the house's x.
      v: float32 [H, W], metres across it, on upright faces upwards; on floor and ceiling z.
    """

    depth: jax.Array
    face: jax.Array
    u: jax.Array
    v: jax.Array


def look(camera: Camera, pose: Pose, scene: Scene) -> View:
    """Returns what a camera sees. For depths that can be differentiated, see `locate`.

    A camera does not see the box that it is in, nor floor and ceiling from outside of the house.

    Raises:
      JaxactError: there are more than 1021 boxes.
    """
    # What is nearest has no derivative, and the loop below none that goes backwards.
    pose, scene = jax.lax.stop_gradient((pose, scene))
    rays = camera.rays(pose.pitch)
    bits = _bits(scene.boxes.shape[0])
    last = np.int32((1 << bits) - 1)

    def pack(inverse: jax.Array, surface: jax.Array | np.int32) -> jax.Array:
        # Of two that are rounded to the same the one with the lower number is seen.
        return jax.lax.bitcast_convert_type(inverse, jnp.int32) & ~last | (last - surface)

    floor, ceiling = _planes(rays, pose, scene)
    planes = greater(pack(1 / floor, np.int32(FLOOR)), pack(1 / ceiling, np.int32(CEILING)))
    nearest = np.float32(1 / camera.near)

    def nearer(key: jax.Array, rays: Rays, box: _Bounds, surface: jax.Array) -> jax.Array:
        cosine, sine = box.turn[0], box.turn[1]
        x, y, z = rays.x, rays.y[:, None], rays.z[:, None]

        # Each a number of the column and one of the row, added for the pixel.
        def along_x(share: jax.Array, free: jax.Array) -> jax.Array:
            return share * cosine * x + (free - share * sine * z)

        def along_z(share: jax.Array, free: jax.Array) -> jax.Array:
            return share * sine * x + (free + share * cosine * z)

        enter = box.enter[1] * y + box.free[1]
        enter = lesser(enter, along_x(box.enter[0], box.free[0]))
        enter = lesser(enter, along_z(box.enter[2], box.free[2]))
        leave = greater(box.leave[0, 1] * y, box.leave[1, 1] * y)
        for share in (box.leave[0], box.leave[1]):
            leave = greater(leave, along_x(share[0], jnp.float32(0)))
            leave = greater(leave, along_z(share[2], jnp.float32(0)))
        met = (enter >= leave) & (enter < nearest)
        return greater(key, jnp.where(met, pack(enter, surface), 0))

    bounds, in_sight = _bounds(pose, scene.boxes), _in_sight(pose, rays, scene.boxes)
    key = _walk(camera, nearer, planes, rays, bounds, in_sight)
    seen = (key & ~last) > 0
    # The middle of what was rounded to the same number.
    rounded = key & ~last | np.int32(1 << (bits - 1))
    inverse = jax.lax.bitcast_convert_type(rounded, jnp.float32)
    return View(
        depth=jnp.where(seen, 1 / inverse, jnp.float32(jnp.inf)),
        surface=jnp.where(seen, last - (key & last), np.int32(NOTHING)),
    )


def locate(camera: Camera, pose: Pose, scene: Scene, view: View) -> Hits:
    """Returns where exactly a camera's rays meet what they are known to see.

    The depth is differentiable in the pose almost everywhere.

    Args:
      camera: as for `look`.
      pose: as for `look`.
      scene: as for `look`.
      view: what `look` returned.
    """
    rays = camera.rays(pose.pitch)
    shape = (camera.height, camera.width)
    row = jnp.maximum(view.surface - FIRST_BOX, 0)
    # One box a ray, its 8 numbers leading.
    box = jnp.moveaxis(_seen_from(pose, scene.boxes)[row], -1, 0)
    enters, _ = _slabs(box, rays, 1 / (rays.y + _AJAR)[:, None])
    entry = [jnp.broadcast_to(enter, shape) for enter in enters]
    # Written out: XLA does not fuse an argmax with what goes on around it.
    sideways = jnp.where(entry[0] >= entry[2], jnp.int32(0), jnp.int32(2))
    axis = jnp.where(entry[1] > jnp.maximum(entry[0], entry[2]), jnp.int32(1), sideways)
    x, z = _turned(box, rays)
    direction = (x, jnp.broadcast_to(rays.y[:, None], shape), z)
    # The faces that a ray enters by look against it.
    faces = 2 * axis + (_along(direction, axis) > 0).astype(jnp.int32)

    floor, ceiling = (
        jnp.broadcast_to(plane[:, None], shape) for plane in _planes(rays, pose, scene)
    )
    on_floor = view.surface == FLOOR
    on_box = view.surface >= FIRST_BOX
    plane = jnp.where(on_floor, floor, jnp.where(view.surface == CEILING, ceiling, jnp.inf))
    depth = jnp.where(on_box, _along(entry, axis), plane)

    reach = jnp.where(depth < jnp.inf, depth, jnp.float32(0))
    point = [reach * way - middle for way, middle in zip(direction, box[CENTER], strict=True)]
    # The face's own two axes: z and y on faces along x, x and z along y, x and y along z.
    u = _along((point[2], point[0], point[0]), axis)
    v = _along((point[1], point[2], point[1]), axis)
    cosine, sine = jnp.cos(jnp.deg2rad(pose.yaw)), jnp.sin(jnp.deg2rad(pose.yaw))
    forward = rays.z[:, None]
    plan_x = pose.position[0] + reach * (cosine * rays.x + sine * forward)
    plan_z = pose.position[2] + reach * (cosine * forward - sine * rays.x)
    return Hits(
        depth=depth,
        face=jnp.where(on_box, faces, jnp.where(on_floor, jnp.int32(2), jnp.int32(3))),
        u=jnp.where(on_box, u, plan_x),
        v=jnp.where(on_box, v, plan_z),
    )


def _bits(boxes: int) -> int:
    """Returns how many bits number the surfaces of a house of so many boxes."""
    for bits in (8, 10):
        if boxes + FIRST_BOX <= 1 << bits:
            return bits
    raise JaxactError(f"a house has at most {(1 << 10) - FIRST_BOX} boxes; got {boxes}")


def _walk(
    camera: Camera,
    nearer: Callable[[jax.Array, Rays, _Bounds, jax.Array], jax.Array],
    planes: jax.Array,
    rays: Rays,
    boxes: _Bounds,
    in_sight: jax.Array,
) -> jax.Array:
    """Returns the keys of what is nearest, int32 [H, W], past the boxes in sight.

    Args:
      camera: what the picture is taken with.
      nearer: (keys [H, W], rays, one box, its number) -> keys with the box.
      planes: int32 [H], the keys of floor and ceiling.
      rays: the camera's.
      boxes: [N].
      in_sight: bool [N].
    """
    height, width = camera.height, camera.width

    @together
    def walk(planes: jax.Array, rays: Rays, boxes: _Bounds, in_sight: jax.Array) -> jax.Array:
        order, count = _first_those(in_sight)
        pictures = jnp.argsort(-count)
        size = _pictures_at_once(camera, len(count))
        groups = jnp.pad(pictures, (0, -len(count) % size), mode="edge").reshape(-1, size)

        def take(group: jax.Array) -> jax.Array:
            numbers = order[group]
            found = jax.tree.map(lambda x: x[group[:, None], numbers], boxes)
            seen_by = jax.tree.map(lambda x: x[group], rays)

            def few(i: jax.Array, keys: jax.Array) -> jax.Array:
                for step in range(_UNROLL):
                    at = _UNROLL * i + step
                    box, number = jax.tree.map(
                        lambda x, at=at: jax.lax.dynamic_index_in_dim(x, at, 1, keepdims=False),
                        (found, numbers),
                    )
                    keys = jax.vmap(nearer)(keys, seen_by, box, FIRST_BOX + number)
                return keys

            start = jnp.broadcast_to(planes[group][:, :, None], (size, height, width))
            passes = (jnp.max(count[group]) + _UNROLL - 1) // _UNROLL
            return jax.lax.fori_loop(0, passes, few, start)

        keys = jax.lax.map(take, groups).reshape(-1, height, width)
        return keys[jnp.argsort(pictures)]

    return walk(planes, rays, boxes, in_sight)


def _pictures_at_once(camera: Camera, pictures: int) -> int:
    """Returns how many pictures are taken together, each as long as any of them sees more boxes."""
    if jax.default_backend() != "cpu":
        return pictures
    rays = _RAYS_A_CORE * max(1, (os.cpu_count() or 1) // jax.local_device_count())
    return max(1, min(pictures, rays // (camera.height * camera.width)))


def _first_those(mask: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns which are those of a mask bool [B, N], and how many they are, int32 [B].

    The first is int32 [B, M], M the next multiple of `_UNROLL`: the indices of those, in order,
    and then 0.
    """
    pictures, boxes = mask.shape
    rank = jnp.cumsum(mask, axis=1, dtype=jnp.int32)
    order = jnp.zeros((pictures, boxes + -boxes % _UNROLL), jnp.int32)
    picture = jnp.arange(pictures, dtype=jnp.int32)[:, None]
    place = jnp.where(mask, rank - 1, order.shape[1])
    indices = jnp.broadcast_to(jnp.arange(boxes, dtype=jnp.int32), mask.shape)
    return order.at[picture, place].set(indices, mode="drop"), rank[:, -1]


def _in_sight(pose: Pose, rays: Rays, boxes: jax.Array) -> jax.Array:
    """Returns bool [N], false of boxes that are wholly beyond one of the picture's edges.

    True of all where a ray points level with the picture's plane, or behind it.
    """
    boxes = _seen_from(pose, boxes)
    (own_x, middle_y, own_z), (half_x, half_y, half_z) = boxes[:, CENTER].T, boxes[:, HALF_SIZE].T
    cosine, sine = boxes[:, COSINE], boxes[:, SINE]
    corner_x = own_x + half_x * np.array([[-1], [-1], [1], [1]], np.float32)
    corner_z = own_z + half_z * np.array([[-1], [1], [-1], [1]], np.float32)
    right, ahead = cosine * corner_x + sine * corner_z, cosine * corner_z - sine * corner_x
    least = jnp.min(rays.z)
    shown = jnp.maximum(least, _LEVEL)
    sideways = jnp.max(jnp.abs(rays.x)) / shown
    up = rays.y / jnp.maximum(rays.z, _LEVEL)

    def beyond(distance: jax.Array) -> jax.Array:
        return jnp.all(distance < -_MARGIN, axis=0)

    out = beyond(ahead) | beyond(sideways * ahead - right) | beyond(sideways * ahead + right)
    out |= beyond(middle_y + half_y - jnp.min(up) * ahead)
    out |= beyond(jnp.max(up) * ahead - (middle_y - half_y))
    return ~out | (least < _LEVEL)


def _seen_from(pose: Pose, boxes: jax.Array) -> jax.Array:
    """Returns boxes as `Scene.boxes`, but from where the camera is and turned with its yaw.

    The centre is given along the box's own axes, from the camera.
    """
    offset = boxes[:, CENTER] - pose.position
    cosine, sine = boxes[:, COSINE], boxes[:, SINE]
    own_x = cosine * offset[:, 0] - sine * offset[:, 2]
    own_z = sine * offset[:, 0] + cosine * offset[:, 2]
    turned = jnp.deg2rad(pose.yaw)
    camera_cosine, camera_sine = jnp.cos(turned), jnp.sin(turned)
    return jnp.stack(
        [
            own_x,
            offset[:, 1],
            own_z,
            *jnp.moveaxis(boxes[:, HALF_SIZE], -1, 0),
            cosine * camera_cosine + sine * camera_sine,
            sine * camera_cosine - cosine * camera_sine,
        ],
        axis=-1,
    )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Bounds:
    """Bounds of the inverse depths at which rays are in boxes, as shares of their directions.

    Along one of a box's own axes a ray is between its two faces where its inverse depth is at most
    `enter` · direction + `free` and at least `leave` · direction, of both.

    Attributes:
      turn: float32 [N, 2], the cosine and the sine of the yaw, as seen from the camera.
      enter: float32 [N, 3], by the axis; one over the way to the nearer face, 0 between the faces.
      free: float32 [N, 3], `_UNBOUNDED` between the faces, else 0.
      leave: float32 [N, 2, 3], one over the ways to the faces that are left, which are two between
        the faces, and else twice the same.
    """

    turn: jax.Array
    enter: jax.Array
    free: jax.Array
    leave: jax.Array


def _bounds(pose: Pose, boxes: jax.Array) -> _Bounds:
    """Returns the bounds of boxes [N, 8] for a camera."""
    boxes = _seen_from(pose, boxes)
    middle, half = boxes[:, CENTER], boxes[:, HALF_SIZE]

    def inverse(way: jax.Array) -> jax.Array:
        least = jnp.where(way < 0, -_LEAST, _LEAST)
        return 1 / jnp.where(jnp.abs(way) < _LEAST, least, way)

    low, high = middle - half, middle + half
    to_low, to_high = inverse(low), inverse(high)
    beyond, short = low > 0, high < 0
    between = ~(beyond | short)
    return _Bounds(
        turn=boxes[:, COSINE : SINE + 1],
        enter=jnp.where(beyond, to_low, jnp.where(short, to_high, 0.0)),
        free=jnp.where(between, _UNBOUNDED, np.float32(0)),
        leave=jnp.stack(
            [jnp.where(short, to_low, to_high), jnp.where(beyond, to_high, to_low)], axis=1
        ),
    )


def _turned(box: jax.Array, rays: Rays) -> tuple[jax.Array, jax.Array]:
    """Returns the rays' x and z, float32 [H, W], along the box's own axes."""
    cosine, sine = box[COSINE], box[SINE]
    forward = rays.z[:, None]
    return cosine * rays.x - sine * forward, sine * rays.x + cosine * forward


def _slabs(
    box: jax.Array, rays: Rays, vertical: jax.Array
) -> tuple[list[jax.Array], list[jax.Array]]:
    """Returns the depths at which rays enter and leave the space between each pair of faces.

    Args:
      box: float32 [8] or, one for each ray, [8, H, W], as seen from the camera.
      rays: the camera's.
      vertical: float32 [H, 1], the inverse of their y.
    """
    x, z = _turned(box, rays)
    inverses = (1 / (x + _AJAR), vertical, 1 / (z + _AJAR))
    middles = [box[CENTER][i] * inverse for i, inverse in enumerate(inverses)]
    halves = [box[HALF_SIZE][i] * jnp.abs(inverse) for i, inverse in enumerate(inverses)]
    return (
        [middle - half for middle, half in zip(middles, halves, strict=True)],
        [middle + half for middle, half in zip(middles, halves, strict=True)],
    )


def _planes(rays: Rays, pose: Pose, scene: Scene) -> tuple[jax.Array, jax.Array]:
    """Returns the depths, float32 [H], of the floor and of the ceiling; ∞ where not in sight."""
    height = pose.position[1]
    nowhere = jnp.float32(jnp.inf)
    down, up = jnp.minimum(rays.y, -_AJAR), jnp.maximum(rays.y, _AJAR)
    floor = jnp.where((rays.y < 0) & (height > 0), height / -down, nowhere)
    ceiling = jnp.where(
        (rays.y > 0) & (height < scene.ceiling), (scene.ceiling - height) / up, nowhere
    )
    return floor, ceiling


def _along(values: Sequence[jax.Array], axis: jax.Array) -> jax.Array:
    """Returns, of three arrays [H, W], the one that an axis [H, W] says."""
    return jnp.where(axis == 0, values[0], jnp.where(axis == 1, values[1], values[2]))
