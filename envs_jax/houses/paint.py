"""What surfaces look like: their own colours, lit by one far light, with bricks on them.

XLA may round where a ray meets a surface differently in programs of other shapes, in the last bit;
very rarely this changes a colour by one step, or the brick at a pixel on a joint.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses.camera import Camera, Pose
from envs_jax.houses.rays import Hits, View, locate, look
from envs_jax.houses.scene import COSINE, SINE, Scene

SKY = (0.55, 0.70, 0.85)
# Where the light comes from; the four sides of a box differ in brightness.
_LIGHT = np.array([0.40, 0.75, 0.53], np.float32)
_AMBIENT, _LAMBERT = np.float32(0.70), np.float32(0.30)
# Metres of a brick, and how much bricks differ in brightness.
_BRICK = np.array([0.6, 0.2], np.float32)
_CONTRAST = np.float32(0.3)
# Metres of depth at which the differences have faded to a half: farther off bricks are smaller than
# pixels and would flicker.
_FADES = np.float32(4)


def photograph(camera: Camera, pose: Pose, scene: Scene, rays: int = 1) -> jax.Array:
    """Returns a picture uint8 [H, W, 3].

    Args:
      camera: takes it.
      pose: where the camera is.
      scene: the house.
      rays: edge of the square of rays whose colours are averaged in a pixel.
    """
    finer = camera.finer(rays)
    view = look(finer, pose, scene)
    colors = paint(scene, view, locate(finer, pose, scene, view))
    blocks = colors.reshape(camera.height, rays, camera.width, rays, 3)
    averaged = jnp.mean(blocks, axis=(1, 3))
    return (jnp.clip(averaged, 0, 1) * 255 + jnp.float32(0.5)).astype(jnp.uint8)


def paint(scene: Scene, view: View, hits: Hits) -> jax.Array:
    """Returns the colours, float32 [H, W, 3], of what is seen.

    Args:
      scene: the house.
      view: the surface along each ray.
      hits: where the rays meet it.
    """
    color = _lit(scene).reshape(-1, 3)[view.surface * 6 + hits.face]
    tone = 1 + _CONTRAST * _bricks(hits.u, hits.v) / (1 + (hits.depth / _FADES) ** 2)
    return color * tone[..., None]


def _lit(scene: Scene) -> jax.Array:
    """Returns the colour float32 [N + 3, 6, 3] of each surface's six faces under the light."""
    sky = jnp.asarray(SKY, jnp.float32)[None]
    colors = jnp.concatenate([sky, scene.surface, scene.color])
    unturned = jnp.zeros(3, jnp.float32)
    cosine = jnp.concatenate([unturned + 1, scene.boxes[:, COSINE]])
    sine = jnp.concatenate([unturned, scene.boxes[:, SINE]])
    along_x = cosine * _LIGHT[0] - sine * _LIGHT[2]
    along_z = sine * _LIGHT[0] + cosine * _LIGHT[2]
    along_y = jnp.full_like(along_x, _LIGHT[1])
    # Negative as well as positive: what is turned away from the light is darker, but not black.
    toward = jnp.stack([along_x, -along_x, along_y, -along_y, along_z, -along_z], axis=-1)
    return colors[:, None] * (_AMBIENT + _LAMBERT * toward)[..., None]


def _bricks(u: jax.Array, v: jax.Array) -> jax.Array:
    """Returns a tone in [−1/2, 1/2] for each brick of a wall; u is along it, v upwards."""
    row = jnp.floor(v / _BRICK[1])
    # Each row is staggered by half a brick.
    brick = jnp.floor(u / _BRICK[0] + row / 2)
    number = 5 * row.astype(jnp.int32) + 3 * brick.astype(jnp.int32)
    return (number & 7).astype(jnp.float32) / 7 - jnp.float32(0.5)
