"""A hand with two fingers over a table with a cube, moved along x, y and z as Meta-World's is.

The coordinates, the hand's bounds and where it begins are those of Meta-World's Sawyer tasks (Yu et
al. 2019, https://arxiv.org/abs/1910.10897): the table's top is at z = 0, and the robot stands at
y = 0 and looks along +y. What carries the hand is not simulated: it has no weight, and motors hold
its speed along each axis. Each finger touches by two balls, four points that hold a cube upright.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.physics.environment import Controller, Physics, PhysicsState
from jaxact.spaces import Box

GRIP, CUBE = "grip", "cube"
# Metres: where the hand begins, half the cube's side, and each open finger from the middle.
HOME = (0.0, 0.6, 0.2)
HALF_CUBE = 0.02
OPEN = 0.05


def _finger(name: str, side: int) -> str:
    return f"""
      <body name="{name} finger" pos="{side * 0.012} 0 0">
        <joint name="{name} finger" type="slide" axis="{side} 0 0" range="0 {OPEN}" damping="2"/>
        <geom class="pad" pos="0 0.012 0"/>
        <geom class="pad" pos="0 -0.012 0"/>
        <geom class="looks" type="capsule" fromto="0 0 0.02 0 0 0.08" size="0.01"/>
      </body>"""


# The table is touched by the cube alone: the hand's range ends above it.
HAND = f"""
<mujoco model="hand">
  <option timestep="0.01" iterations="5" ls_iterations="8"/>
  <default>
    <default class="pad">
      <geom type="sphere" size="0.012" mass="0.05" friction="1.5" contype="2" conaffinity="0"/>
    </default>
    <default class="looks"><geom mass="0" contype="0" conaffinity="0"/></default>
  </default>
  <worldbody>
    <geom name="table" type="plane" size="1 1 0.1" friction="0.6" conaffinity="0"/>
    <body name="hand" pos="{HOME[0]} {HOME[1]} {HOME[2]}" gravcomp="1">
      <joint name="x" type="slide" axis="1 0 0" range="-0.5 0.5"/>
      <joint name="y" type="slide" axis="0 1 0" range="-0.2 0.4"/>
      <joint name="z" type="slide" axis="0 0 1" range="{HALF_CUBE - HOME[2]} 0.3"/>
      <geom class="looks" type="box" size="0.06 0.02 0.015" pos="0 0 0.095" mass="0.9"/>
      <site name="{GRIP}"/>{_finger("right", 1)}{_finger("left", -1)}
    </body>
    <body name="{CUBE}" pos="0 0.6 {HALF_CUBE}">
      <freejoint name="{CUBE}"/>
      <geom type="box" size="{HALF_CUBE} {HALF_CUBE} {HALF_CUBE}" mass="0.1" friction="0.6"
        contype="0" conaffinity="3"/>
    </body>
  </worldbody>
  <actuator>
    <velocity name="x" joint="x" kv="60" ctrlrange="-0.5 0.5"/>
    <velocity name="y" joint="y" kv="60" ctrlrange="-0.5 0.5"/>
    <velocity name="z" joint="z" kv="60" ctrlrange="-0.5 0.5"/>
    <position name="right finger" joint="right finger" kp="200" ctrlrange="-0.02 {OPEN}"/>
    <position name="left finger" joint="left finger" kp="200" ctrlrange="-0.02 {OPEN}"/>
  </actuator>
</mujoco>
"""


@dataclass(frozen=True)
class HandControl(Controller):
    """How fast the hand goes along x, y and z, and how far both fingers close, float32 [4].

    Each number is in [−1, 1]: a speed of its motor's fastest, and from open to closed as far as it
    goes. Closed on something, the fingers press it, as they are told to go beyond each other.
    """

    @property
    def action_space(self) -> Box:
        """Three speeds and the grip."""
        return Box(-1.0, 1.0, (4,))

    def controls(
        self,
        world: Physics,
        action: jax.Array,
        before: PhysicsState,
        position: jax.Array,
        velocity: jax.Array,
    ) -> jax.Array:
        """Returns speeds, and where the fingers are to be; see `Controller`."""
        del before, position, velocity
        action = jnp.clip(jnp.asarray(action, jnp.float32), -1, 1)
        # A finger's least is closed, and 1 is to close.
        shares = jnp.concatenate([action[:3], -action[3:], -action[3:]])
        return world.stretched(shares)


def hand() -> Physics:
    """Returns the hand's world: 50 actions a second, each of at most 1 cm along each axis."""
    return Physics(HAND, 2, HandControl())
