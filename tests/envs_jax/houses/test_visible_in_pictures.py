"""What AI2-THOR's rule calls visible is in the picture, and what is not in it is not visible."""

import jax
import jax.numpy as jnp
import numpy as np
from small_houses import BODY, cluttered, free_plans

from envs_jax.houses.camera import Camera
from envs_jax.houses.collision import obstacles
from envs_jax.houses.environment import House
from envs_jax.houses.rays import FIRST_BOX
from envs_jax.houses.visibility import ROBOTHOR_SIGHT, is_visible
from envs_jax.houses.vision import InstanceSensor

# Fine enough for a mug at a metre to have some two hundred pixels.
CAMERA = Camera(96, 128, ROBOTHOR_SIGHT.field_of_view)
HOUSE = House(BODY, ("move_ahead", "end"))
POSES = 96


def test_visible_things_are_in_the_picture():
    scene = cluttered(0)
    boxes = np.asarray(obstacles(scene.boxes, BODY))
    plans = free_plans(0, boxes, BODY.radius, POSES)
    turns = np.arange(POSES, dtype=np.float32)
    sensor = InstanceSensor(CAMERA, BODY)
    rows = jnp.arange(scene.boxes.shape[0], dtype=jnp.int32)

    @jax.jit
    def look(plan, yaw, pitch):
        state = HOUSE.start(scene, plan, yaw, pitch)

        def sees(row):
            wanted = (rows == row) & scene.present
            return is_visible(ROBOTHOR_SIGHT, BODY, scene.boxes, wanted, plan, yaw, pitch)

        picture = sensor.observe(state, None).reshape(-1)
        pixels = jnp.zeros(FIRST_BOX + len(rows), jnp.int32).at[picture].add(1)[FIRST_BOX:]
        return jax.vmap(sees)(rows), pixels

    each = [look(*pose) for pose in zip(plans, turns * 37 % 360, turns % 3 * 30, strict=True)]
    visible, pixels = (np.stack(parts) for parts in zip(*each, strict=True))
    assert visible.sum() >= 30
    # The ray to a visibility point meets the thing first. Only a sliver falls between pixels.
    assert (pixels[visible] > 0).all()
    # The other way round it does not hold: things in the picture can be too far.
    assert (pixels[~visible] > 0).any()
