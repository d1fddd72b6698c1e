"""Contacts of capsules with a plane are those of MuJoCo in C, however steep the capsule is."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from envs_jax.physics.capsules import capsules_as_in_c
from envs_jax.physics.models import device_model, host_model, mjx

# The floor is turned, so that no axis of the world is its normal.
MODEL = """
<mujoco>
  <worldbody>
    <geom type="plane" size="5 5 1" euler="20 -35 10" margin="9"/>
    <body pos="0.2 0.1 1">
      <freejoint/>
      <geom type="capsule" size="0.1 0.4" margin="9"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("corrected", [True, False])
def test_frames_are_those_of_c(corrected):
    host, model = host_model(MODEL), jax.tree.map(jnp.asarray, device_model(MODEL))
    turns = np.random.default_rng(0).normal(size=(200, 4))
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)

    def meet(turn):
        data = mjx().make_data(model)
        data = data.replace(qpos=data.qpos.at[3:7].set(turn))
        contact = mjx().collision(model, mjx().kinematics(model, data))._impl.contact
        return contact.dist, contact.pos, contact.frame

    with jax.numpy_dtype_promotion("standard"):
        if corrected:
            with capsules_as_in_c():
                ours = jax.jit(jax.vmap(meet))(jnp.asarray(turns, jnp.float32))
        else:
            ours = jax.jit(jax.vmap(meet))(jnp.asarray(turns, jnp.float32))
    off = []
    for turn, distance, place, frame in zip(turns, *map(np.asarray, ours), strict=True):
        data = mujoco.MjData(host)
        data.qpos[3:7] = turn
        mujoco.mj_forward(host, data)
        there = sorted(data.contact, key=lambda contact: contact.dist)
        order = np.argsort(distance)
        np.testing.assert_allclose(distance[order], [x.dist for x in there], atol=2e-6)
        np.testing.assert_allclose(place[order], [x.pos for x in there], atol=2e-6)
        frames = np.stack([x.frame.reshape(3, 3) for x in there])
        off.append(np.abs(frame[order] - frames).max())
    same = np.mean(np.array(off) < 2e-5)
    # MJX's own are others for one direction in eight, and are there again afterwards.
    assert same == 1 if corrected else 0.8 < same < 0.95
