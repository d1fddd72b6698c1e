"""Pictures of houses for people: maps from above, views from anywhere, readings in colours.

All of them are uint8 [H, W, 3] arrays made by functions that can be jitted and vmapped.
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses.camera import Camera, Pose, eye
from envs_jax.houses.paint import photograph
from envs_jax.houses.rays import look
from envs_jax.houses.scene import CENTER, HALF_SIZE, Scene, box, forward, to_local
from envs_jax.houses.state import Body, HouseState

# Edge of maps, and what small pictures are enlarged to.
PIXELS = 256

_OUTSIDE = (0.09, 0.09, 0.11)
_AGENT, _GOAL = (0.90, 0.15, 0.15), (0.10, 0.65, 0.20)
_TRAJECTORY, _PATH = (0.15, 0.35, 0.90), (0.95, 0.65, 0.10)
# Metres: space round a map's rooms, width of its lines, radius of a goal.
_MARGIN, _LINE, _GOAL_RADIUS = 0.4, 0.05, 0.15
# Depth in metres that is drawn half bright.
_HALF_BRIGHT = 2.5
# Steps round the circle of hues, so that numbers near each other differ.
_GOLDEN_RATIO = 0.61803


def house_map(
    scene: Scene,
    state: HouseState | None = None,
    body: Body | None = None,
    *,
    goal: jax.Array | None = None,
    trajectory: jax.Array | None = None,
    path: jax.Array | None = None,
    pixels: int = PIXELS,
) -> jax.Array:
    """Draws a house from above, +z up and +x to the right, with the ceiling off.

    Args:
      scene: the house.
      state: of the agent to draw; None for none.
      body: of that agent.
      goal: float32 [2] or [G, 2], plans, drawn as green discs.
      trajectory: float32 [T, 2], plans joined by a blue line; none are joined to one that is NaN.
      path: float32 [T, 2], likewise, orange: the way one should go.
      pixels: edge of the picture.
    """
    plan, cell = _plans(scene, pixels)
    canvas = jnp.broadcast_to(jnp.asarray(_OUTSIDE, jnp.float32), (pixels, pixels, 3))
    for room in range(scene.rooms.shape[0]):
        low, high = scene.rooms[room, :2], scene.rooms[room, 2:]
        canvas = _cover(canvas, jnp.all((plan >= low) & (plan < high), axis=-1), scene.surface[0])
    canvas = _draw_boxes(canvas, plan, scene)
    width = jnp.maximum(_LINE, cell)
    for line, color in ((path, _PATH), (trajectory, _TRAJECTORY)):
        if line is not None:
            canvas = _cover(canvas, _distance_to_line(plan, line) < width, color)
    if goal is not None:
        discs = plan[..., None, :] - jnp.reshape(goal, (-1, 2))
        near = jnp.sum(discs**2, axis=-1) < _GOAL_RADIUS**2
        canvas = _cover(canvas, jnp.any(near, axis=-1), _GOAL)
    if state is not None and body is not None:
        canvas = _draw_agent(canvas, plan, state, body)
    return _to_bytes(canvas)


def overview(
    state: HouseState, body: Body, camera: Camera, pose: Pose | None = None, rays: int = 2
) -> jax.Array:
    """Shows the agent, a red box, in its house from anywhere.

    Args:
      state: of the agent and the house.
      body: the agent's.
      camera: takes the picture.
      pose: where the camera is; None for above a corner of the house. From above the ceiling one
        looks into the rooms.
      rays: edge of the square of rays averaged in a pixel.
    """
    scene = state.scene
    position = jnp.stack([state.position[0], jnp.float32(body.height / 2), state.position[1]])
    half = jnp.asarray([body.radius, body.height / 2, body.radius], jnp.float32)
    agent = box(position, half, state.yaw)
    red = jnp.asarray(_AGENT, jnp.float32)
    with_agent = replace(
        scene,
        boxes=jnp.concatenate([scene.boxes, agent[None]]),
        color=jnp.concatenate([scene.color, red[None]]),
    )
    return photograph(camera, above_corner(scene) if pose is None else pose, with_agent, rays)


def above_corner(scene: Scene) -> Pose:
    """Returns where a camera sees all of a house: high above a corner, looking at its middle."""
    low, high = _bounds(scene)
    middle, span = (low + high) / 2, jnp.max(high - low)
    away = jnp.float32(0.62) * span
    position = jnp.stack([middle[0] - away, scene.ceiling + away, middle[1] - away])
    down = jnp.arctan2(position[1], away * jnp.sqrt(jnp.float32(2)))
    return Pose(position, jnp.float32(45), jnp.rad2deg(down))


def strip(
    state: HouseState,
    body: Body,
    camera: Camera,
    *,
    goal: jax.Array | None = None,
    trajectory: jax.Array | None = None,
    path: jax.Array | None = None,
) -> jax.Array:
    """Returns colours, depths and categories that an agent sees, and the map, side by side.

    Args:
      state: of the agent and the house.
      body: the agent's.
      camera: the agent's.
      goal: see `house_map`, as for the rest.
      trajectory: see there.
      path: see there.
    """
    pose, scene = eye(state, body), state.scene
    view = look(camera, pose, scene)
    planes = jnp.arange(3, dtype=jnp.int32)
    category = jnp.concatenate([planes, scene.category])[view.surface]
    world = house_map(scene, state, body, goal=goal, trajectory=trajectory, path=path)
    return beside(
        [
            photograph(camera, pose, scene, 2),
            color_depth(view.depth),
            color_numbers(category),
            world,
        ]
    )


def color_depth(depth: jax.Array) -> jax.Array:
    """Returns depths [H, W] in metres as greys, the nearer the lighter."""
    grey = 1 / (1 + depth / _HALF_BRIGHT)
    return _to_bytes(jnp.broadcast_to(grey[..., None], (*depth.shape, 3)))


def color_numbers(numbers: jax.Array) -> jax.Array:
    """Returns numbers [H, W], of categories or instances, in colours that tell them apart."""
    hues = [colorsys.hsv_to_rgb(i * _GOLDEN_RATIO % 1, 0.65, 0.95) for i in range(1024)]
    hues[0] = (0, 0, 0)
    return jnp.asarray(np.round(255 * np.array(hues)), jnp.uint8)[numbers]


def enlarge(picture: jax.Array) -> jax.Array:
    """Returns a picture at the largest whole multiple of its size that is at most `PIXELS` high."""
    factor = max(1, PIXELS // picture.shape[0])
    return jnp.repeat(jnp.repeat(picture, factor, axis=0), factor, axis=1)


def beside(pictures: Sequence[jax.Array]) -> jax.Array:
    """Returns pictures, enlarged, from left to right on black."""
    large = [enlarge(picture) for picture in pictures]
    height = max(picture.shape[0] for picture in large)
    padded = [
        jnp.pad(
            picture, ((0, height - picture.shape[0]), (0, 8 * (picture is not large[-1])), (0, 0))
        )
        for picture in large
    ]
    return jnp.concatenate(padded, axis=1)


def _bounds(scene: Scene) -> tuple[jax.Array, jax.Array]:
    """Returns the lowest and highest plan, float32 [2] each, of all rooms."""
    used = jnp.all(scene.rooms[:, 2:] > scene.rooms[:, :2], axis=-1)[:, None]
    low = jnp.min(jnp.where(used, scene.rooms[:, :2], jnp.inf), axis=0)
    high = jnp.max(jnp.where(used, scene.rooms[:, 2:], -jnp.inf), axis=0)
    return low, high


def _plans(scene: Scene, pixels: int) -> tuple[jax.Array, jax.Array]:
    """Returns the plan float32 [P, P, 2] of each pixel of a map, and a pixel's edge in metres."""
    low, high = _bounds(scene)
    span = jnp.max(high - low) + 2 * _MARGIN
    across = jnp.asarray((np.arange(pixels) + 0.5) / pixels - 0.5, jnp.float32)
    middle = (low + high) / 2
    x, z = middle[0] + span * across, middle[1] - span * across
    return jnp.stack(jnp.broadcast_arrays(x, z[:, None]), axis=-1), span / pixels


def _cover(
    canvas: jax.Array, where: jax.Array, color: jax.Array | tuple[float, float, float]
) -> jax.Array:
    return jnp.where(where[..., None], jnp.asarray(color, jnp.float32), canvas)


def _draw_boxes(canvas: jax.Array, plan: jax.Array, scene: Scene) -> jax.Array:
    """Paints each pixel in the colour of the highest box there."""

    def highest(
        carry: tuple[jax.Array, jax.Array], thing: tuple[jax.Array, jax.Array]
    ) -> tuple[tuple[jax.Array, jax.Array], None]:
        canvas, height = carry
        row, color = thing
        inside = jnp.all(jnp.abs(to_local(row[None], plan)[..., 0, :]) <= row[HALF_SIZE][::2], -1)
        top = row[CENTER][1] + row[HALF_SIZE][1]
        over = inside & (top > height)
        return (_cover(canvas, over, color), jnp.where(over, top, height)), None

    ground = jnp.zeros(plan.shape[:-1], jnp.float32)
    (canvas, _), _ = jax.lax.scan(highest, (canvas, ground), (scene.boxes, scene.color))
    return canvas


def _distance_to_line(plan: jax.Array, line: jax.Array) -> jax.Array:
    """Returns how far pixels [P, P, 2] are from a polyline [T, 2], pieces with a NaN left out."""

    def nearer(least: jax.Array, piece: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        start, end = piece
        way = end - start
        squared = jnp.maximum(jnp.sum(way**2), jnp.float32(1e-12))
        share = jnp.clip(jnp.sum((plan - start) * way, axis=-1) / squared, 0, 1)
        apart = jnp.sum((plan - start - share[..., None] * way) ** 2, axis=-1)
        return jnp.where(apart < least, apart, least), None

    nowhere = jnp.full(plan.shape[:-1], jnp.inf, jnp.float32)
    least, _ = jax.lax.scan(nearer, nowhere, (line[:-1], line[1:]))
    return jnp.sqrt(least)


def _draw_agent(canvas: jax.Array, plan: jax.Array, state: HouseState, body: Body) -> jax.Array:
    """Paints the agent's circle, and a white wedge where it looks."""
    offset = plan - state.position
    distance = jnp.sqrt(jnp.sum(offset**2, axis=-1))
    ahead = jnp.sum(offset * forward(state.yaw), axis=-1)
    inside = distance < body.radius
    canvas = _cover(canvas, inside, _AGENT)
    return _cover(canvas, inside & (ahead > 0.85 * distance), (1.0, 1.0, 1.0))


def _to_bytes(colors: jax.Array) -> jax.Array:
    return (jnp.clip(colors, 0, 1) * 255 + jnp.float32(0.5)).astype(jnp.uint8)
