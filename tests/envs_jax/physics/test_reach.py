"""Reach, with an arm and with a rover, and models that are another in every episode."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import envs_jax
from envs_jax.physics import Physics, Randomized, Reach, Variation
from envs_jax.physics.reach import AnyPose, TargetSensor
from envs_jax.physics.rover import Velocities, rover
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP
from jaxact.testing import check_pomdp

POMDP_ = envs_jax.make("Physics-Reach-v0")
ARM = POMDP_.environment
KEY = jax.random.key(0)


def test_targets_are_where_the_tip_can_be():
    reset = jax.jit(jax.vmap(POMDP_.reset))
    state, observation = reset(jax.random.split(KEY, 64))
    target = np.asarray(state.task.target)
    # The shoulder is 0.3 m up, and the arm 0.55 m long.
    away = np.linalg.norm(target - [0, 0, 0.3], axis=-1)
    assert 0.1 < away.min() < away.max() <= 0.55 + 1e-6
    data = mujoco.MjData(ARM.model)
    data.qpos[:] = state.environment.position[5]
    mujoco.mj_kinematics(ARM.model, data)
    gap = target[5] - data.site("tip").xpos
    np.testing.assert_allclose(observation["target"][5], [*target[5], *gap], atol=1e-6)
    assert float(state.task.distance[5]) == pytest.approx(np.linalg.norm(gap), abs=1e-6)


def test_a_reached_target_is_paid_and_ends_the_episode():
    task = POMDP_.task
    state = jax.jit(ARM.start)(jnp.zeros(3, jnp.float32), jnp.zeros(3, jnp.float32))
    tip = task.place(state)
    np.testing.assert_allclose(tip, [0, 0, 0.85], atol=1e-6)
    for away, reached in ((0.04, True), (0.06, False)):
        begun = replace(task.start(state, tip + jnp.float32([away, 0, 0])), distance=jnp.float32(1))
        _, outcome = task.step(begun, state, jnp.float32([1, -1, 0]), state)
        assert bool(outcome.terminated) == bool(outcome.success["reached"]) == reached
        assert float(outcome.reward["shaping"]) == pytest.approx(1 - away, abs=1e-5)
        assert float(outcome.reward["success"]) == reached
        assert float(outcome.reward["effort"]) == pytest.approx(-2e-3)


def test_another_models_site_is_refused():
    with pytest.raises(JaxactError, match="unknown site of the model 'tap'; the nearest is 'tip'"):
        Reach(ARM, "tap")
    world = rover(Velocities())
    with pytest.raises(JaxactError, match="another model than the environment"):
        replace(POMDP_, environment=world)


def test_factors_are_within_their_ranges_and_each_its_own():
    sampler = Randomized(POMDP_.sampler, ARM, mass=(0.5, 2.0), gain=(0.9, 1.1))
    episodes = jax.jit(jax.vmap(sampler.sample, (0, None)))(jax.random.split(KEY, 32), ())
    drawn = episodes.environment.variation
    assert (drawn.mass.shape, drawn.gain.shape) == ((32, ARM.model.nbody), (32, 3))
    np.testing.assert_array_equal(drawn.friction, 1)
    for values, low, high in ((drawn.mass, 0.5, 2.0), (drawn.gain, 0.9, 1.1)):
        assert low <= values.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < values.max() <= high
        assert len(np.unique(values)) == values.size
    assert isinstance(sampler.held_out, Randomized)
    with pytest.raises(JaxactError, match="range of mass must be of factors 0 < low <= high"):
        Randomized(POMDP_.sampler, ARM, mass=(0.0, 1.0))


# A ball that is drawn over a floor, with a pole hinged to it.
CART = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <geom type="plane" size="5 5 1" friction="0.4"/>
    <body name="cart" pos="0 0 0.1">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint type="slide" axis="0 0 1"/>
      <geom type="sphere" size="0.1" mass="2" friction="0.4"/>
      <body name="bob">
        <joint type="hinge" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0.3" size="0.02" mass="0.5" contype="0"
          conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <velocity joint="x" kv="3" ctrlrange="-3 3"/>
  </actuator>
</mujoco>
"""


@pytest.mark.slow
def test_a_varied_model_moves_as_mujocos_with_the_same_numbers():
    world = Physics(CART)
    nominal = world.model
    varied = Variation(
        mass=jnp.float32([1, 1.7, 0.6]),
        friction=jnp.float32([2.0, 0.5, 1]),
        gain=jnp.float32([1.4]),
    )
    model = mujoco.MjModel.from_xml_string(CART)
    model.body_mass *= varied.mass
    model.body_inertia *= np.asarray(varied.mass)[:, None]
    model.body_subtreemass[:] = [nominal.body_mass @ varied.mass] * 2 + [model.body_mass[2]]
    model.geom_friction *= np.asarray(varied.friction)[:, None]
    model.actuator_gainprm *= float(varied.gain[0])
    model.actuator_biasprm *= float(varied.gain[0])
    ways = {}
    step = jax.jit(world.step)
    rest = jnp.zeros(3, jnp.float32)
    for name, variation, peer in (("varied", varied, model), ("nominal", None, nominal)):
        state = world.start(rest, rest, variation=variation)
        data = mujoco.MjData(peer)
        for _ in range(60):
            data.ctrl[:] = 2.0
            mujoco.mj_step(peer, data)
            state = step(KEY, state, jnp.float32([2.0]))
        np.testing.assert_allclose(state.position, data.qpos, atol=1e-3)
        ways[name] = data.qpos.copy()
    assert np.abs(ways["varied"] - ways["nominal"]).max() > 0.05


@pytest.mark.slow
def test_a_rover_can_reach_too():
    world = rover(Velocities())
    task = Reach(world, site="middle", radius=0.3)
    sampler = Randomized(AnyPose(world, task), world, mass=(0.8, 1.2), friction=(0.5, 2.0))
    pomdp = POMDP(world, task, sampler, {"target": TargetSensor(task)})
    check_pomdp(pomdp, lanes=2, steps=4)


@pytest.mark.slow
def test_it_is_sound():
    check_pomdp(POMDP_, lanes=2, steps=4)
