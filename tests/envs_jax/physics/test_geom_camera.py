"""Pictures of a model's geoms, beside rays that MuJoCo casts in C."""

import math

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from envs_jax.physics.environment import Physics
from envs_jax.physics.geom_camera import GeomCamera
from jaxact.errors import JaxactError

MODEL = """
<mujoco>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <geom type="plane" size="0 0 1" rgba="0 0 1 1"/>
    <geom type="sphere" size=".3" pos="2 .9 .4" rgba="1 0 0 1"/>
    <geom type="capsule" size=".15 .3" pos="2 .2 .6" euler="30 20 0"/>
    <geom type="ellipsoid" size=".2 .3 .4" pos="2.2 -.4 .5" euler="0 30 40"/>
    <geom type="cylinder" size=".2 .25" pos="1.8 -1 .5" euler="40 30 0"/>
    <geom type="sphere" size=".2" pos="1 0 .7" rgba="1 1 1 0"/>
    <body pos="0 0 .8">
      <joint name="turn" axis=".1 .2 1"/>
      <geom type="box" size=".1 .2 .1" pos="1.4 .3 .2" euler="20 30 40"/>
      <camera name="eye" pos="-.5 0 .2" xyaxes="0 -1 0 .2 0 1" fovy="60"/>
    </body>
  </worldbody>
  <actuator><motor joint="turn" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
H, W = 48, 64
ANGLES = (0.0, 0.15, -0.3)
KINDS = ("depth", "rgb", "segmentation")


@pytest.fixture(scope="module")
def world():
    return Physics(MODEL)


@pytest.fixture(scope="module")
def pictures(world):
    """All that is seen at each angle, from one program."""

    def see(angle):
        state = world.start(angle[None], jnp.zeros(1))
        seen = {kind: GeomCamera(world, "eye", kind, H, W).observe(state, ()) for kind in KINDS}
        return {**seen, "hits": GeomCamera(world, "eye", height=H, width=W).hits(state)}

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(see))(jnp.array(ANGLES)))


def test_pictures_are_what_mujocos_rays_hit(world, pictures):
    depths, geoms = pictures["hits"]
    data = mujoco.MjData(world.model)
    half = math.tan(math.radians(60) / 2)
    for lane, angle in enumerate(ANGLES):
        data.qpos[:] = angle
        mujoco.mj_forward(world.model, data)
        turned, hit = data.cam_xmat[0].reshape(3, 3), np.zeros(1, np.int32)
        wanted, ids = np.full((H, W), 10.0), np.full((H, W), -1)
        for i, j in np.ndindex(H, W):
            ray = turned @ [(2 * j + 1 - W) / H * half, (H - 2 * i - 1) / H * half, -1]
            t = mujoco.mj_ray(world.model, data, data.cam_xpos[0], ray, None, 1, -1, hit)
            if 0 <= t < 10:
                wanted[i, j], ids[i, j] = t, hit[0]
        same = np.asarray(geoms[lane]) == ids
        assert same.mean() > 0.999
        assert np.abs(np.asarray(depths[lane]) - wanted)[same].max() < 1e-3
        assert {0, 1, 2, 3, 4, 6} <= set(ids.ravel())


def test_kinds_of_pictures(world, pictures):
    for kind in KINDS:
        space = GeomCamera(world, "eye", kind, H, W).space
        assert pictures[kind].shape == (len(ANGLES), *space.shape)
        assert pictures[kind].dtype == space.dtype
    depth, geoms = pictures["hits"]
    assert np.array_equal(pictures["depth"][..., 0], depth)
    assert np.array_equal(pictures["segmentation"][..., 0], geoms)
    assert np.all(pictures["rgb"][geoms == 0] == (0, 0, 255))
    assert np.all(pictures["rgb"][geoms == -1] == 0)


def test_what_cannot_be_rendered_is_refused(world):
    with pytest.raises(JaxactError, match="camera of the model 'eyes'; the nearest is 'eye'"):
        GeomCamera(world, "eyes")
    with pytest.raises(JaxactError, match="kind of picture"):
        GeomCamera(world, "eye", "deep")
    field = MODEL.replace(
        "<worldbody>",
        '<asset><hfield name="hill" nrow="2" ncol="2" size="1 1 1 1"/></asset>'
        '<worldbody><geom type="hfield" hfield="hill"/>',
    )
    with pytest.raises(JaxactError, match="is a mesh or a field"):
        GeomCamera(Physics(field), "eye")
