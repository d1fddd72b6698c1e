"""A robot with two driven wheels among boxes in a square arena, and two ways to drive it.

Each wheel pushes the body along its heading, at its own place, until it rolls as fast as it is
told; both hold against being pushed sideways. The body slides over a level floor and does not tip.
Plans are (x, y) in metres; the yaw is in radians, counterclockwise from +x.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.houses.scene import Scene, make_scene
from envs_jax.houses.state import Body
from envs_jax.physics.environment import Controller, Physics, PhysicsState
from jaxact.spaces import Box, Discrete

RADIUS, TRACK = 0.17, 0.26
BODY = Body(RADIUS, 0.4, 0.3)
# Half the arena's side, and half the width, depth and height of the boxes in it.
HALF_ARENA = 2.5
BOXES = (
    (0.2, 0.2, 0.3),
    (0.2, 0.2, 0.3),
    (0.3, 0.3, 0.3),
    (0.15, 0.6, 0.3),
    (0.15, 0.6, 0.3),
    (0.1, 0.9, 0.3),
)
_WALL = 0.1
# Of the boxes and the walls, RGB in [0, 1].
_COLORS = np.array(
    [
        (0.8, 0.3, 0.2),
        (0.9, 0.7, 0.2),
        (0.3, 0.6, 0.3),
        (0.2, 0.4, 0.8),
        (0.5, 0.3, 0.6),
        (0.3, 0.7, 0.7),
        *[(0.8, 0.8, 0.75)] * 4,
    ],
    np.float32,
)


def rover_model() -> str:
    """Returns the MJCF text of the rover in its arena; the boxes are mocap bodies."""
    boxes = "".join(
        f'<body name="box {i}" mocap="true" pos="{i - 3} 0 {size[2]}">'
        f'<geom type="box" size="{size[0]} {size[1]} {size[2]}" contype="0"/></body>'
        for i, size in enumerate(BOXES)
    )
    walls = "".join(
        f'<geom name="wall {i}" type="plane" size="{2 * HALF_ARENA} 5 1" contype="0" '
        f'pos="{-x * HALF_ARENA} {-y * HALF_ARENA} 0" zaxis="{x} {y} 0"/>'
        for i, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1)))
    )
    return f"""
<mujoco model="rover">
  <option timestep="0.02" iterations="4" ls_iterations="8"/>
  <default><geom friction="0.3 0.005 0.0001"/></default>
  <worldbody>
    {walls}{boxes}
    <body name="rover" pos="0 0 0.2">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="y" type="slide" axis="0 1 0"/>
      <joint name="yaw" type="hinge" axis="0 0 1"/>
      <geom name="shell" type="sphere" size="{RADIUS}" mass="4" conaffinity="0"/>
      <site name="middle"/>
      <site name="left" pos="0 {TRACK / 2} 0"/>
      <site name="right" pos="0 {-TRACK / 2} 0"/>
    </body>
  </worldbody>
  <actuator>
    <velocity name="left wheel" site="left" gear="1 0 0 0 0 0" kv="20" ctrlrange="-1 1"/>
    <velocity name="right wheel" site="right" gear="1 0 0 0 0 0" kv="20" ctrlrange="-1 1"/>
    <velocity name="grip" site="middle" gear="0 1 0 0 0 0" kv="100" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""


def wheels(forward: jax.Array, turn: jax.Array) -> jax.Array:
    """Returns the controls float32 [3] for speeds in metres and radians a second."""
    aside = turn * jnp.float32(TRACK / 2)
    return jnp.stack([forward - aside, forward + aside, jnp.zeros_like(forward)])


@dataclass(frozen=True)
class Moves(Controller):
    """A move ahead, a turn to the left or right, or "end"; each takes all of a step.

    The wheels are led, from how far the rover has come, to where the move is to end.

    Attributes:
      length: metres of a move.
      turn: degrees.
      fastest: metres a second.
      fastest_turn: radians a second.
      stiffness: speed for each metre and radian that is left to go, 1/s.
    """

    length: float = 0.25
    turn: float = 30.0
    fastest: float = 0.75
    fastest_turn: float = 2.0
    stiffness: float = 5.0

    @property
    def action_names(self) -> tuple[str, ...]:
        """Four, the names of the houses."""
        return ("move_ahead", "rotate_left", "rotate_right", "end")

    @property
    def action_space(self) -> Discrete:
        """One of the names."""
        return Discrete(len(self.action_names))

    def ends(self, action: jax.Array) -> jax.Array:
        """Returns a bool scalar: whether an action says that the task is done."""
        return jnp.asarray(action, jnp.int32) == self.action_names.index("end")

    def controls(
        self,
        world: Physics,
        action: jax.Array,
        before: PhysicsState,
        position: jax.Array,
        velocity: jax.Array,
    ) -> jax.Array:
        """Returns speeds of the wheels that lead to the end of the move; see `Controller`."""
        del world, velocity
        action = jnp.asarray(action, jnp.int32)
        ahead = jnp.where(action == 0, jnp.float32(self.length), 0)
        turn = jnp.deg2rad(jnp.float32(self.turn))
        around = jnp.where(action == 1, turn, jnp.where(action == 2, -turn, 0))
        yaw = before.position[2]
        come = jnp.dot(position[:2] - before.position[:2], jnp.stack([jnp.cos(yaw), jnp.sin(yaw)]))
        stiffness = jnp.float32(self.stiffness)
        fastest, fastest_turn = jnp.float32(self.fastest), jnp.float32(self.fastest_turn)
        forward = jnp.clip(stiffness * (ahead - come), -fastest, fastest)
        turning = jnp.clip(stiffness * (yaw + around - position[2]), -fastest_turn, fastest_turn)
        return jnp.where(self.ends(action), 0, wheels(forward, turning))


@dataclass(frozen=True)
class Velocities(Controller):
    """The speed ahead and that of turning left, each in [−1, 1] of the fastest.

    Where both are within `idle`, the action says that the task is done, as with habitat-lab's
    `VelocityAction`, whose bounds (`VelocityControlActionConfig`: 0.025 of 0.25 m/s and 1 of 10°/s)
    are the same share. There an action is stretched from 0 m/s on; here it can go backwards.

    Attributes:
      fastest: metres a second.
      fastest_turn: radians a second.
      idle: share of the fastest.
    """

    fastest: float = 0.5
    fastest_turn: float = 1.5
    idle: float = 0.1

    @property
    def action_space(self) -> Box:
        """Two speeds."""
        return Box(-1.0, 1.0, (2,))

    def ends(self, action: jax.Array) -> jax.Array:
        """Returns a bool scalar: whether an action says that the task is done."""
        return jnp.all(jnp.abs(action) < jnp.float32(self.idle))

    def controls(
        self,
        world: Physics,
        action: jax.Array,
        before: PhysicsState,
        position: jax.Array,
        velocity: jax.Array,
    ) -> jax.Array:
        """Returns speeds of the wheels; see `Controller`."""
        del world, before, position, velocity
        action = jnp.clip(jnp.asarray(action, jnp.float32), -1, 1)
        fastest = jnp.array([self.fastest, self.fastest_turn], jnp.float32)
        forward, turn = action * fastest
        return wheels(forward, turn)


Drive = Moves | Velocities
DRIVES: dict[str, Drive] = {"moves": Moves(), "velocities": Velocities()}
# Substeps of 20 ms in a step: a move has a second, and speeds are told five times a second.
_SUBSTEPS: dict[type[Drive], int] = {Moves: 50, Velocities: 10}


def rover(drive: Drive) -> Physics:
    """Returns the rover's world, driven in one of two ways."""
    return Physics(rover_model(), _SUBSTEPS[type(drive)], drive)


def obstacles(state: PhysicsState) -> jax.Array:
    """Returns the boxes and walls as the rows of a house's `Scene.boxes`, float32 [N, 8].

    A house's plan (x, z) is here (x, y). Its yaw grows clockwise, so that the sine is negative.
    """
    sizes = np.asarray(BOXES, np.float32)[:, [0, 2, 1]]
    x, y, z = state.mocap_position.T
    # Of a turn about the vertical axis, the quaternion has half the angle.
    w, turned = state.mocap_rotation[:, 0], state.mocap_rotation[:, 3]
    cosine, sine = w**2 - turned**2, 2 * w * turned
    places = jnp.stack([x, z, y], axis=-1)
    boxes = jnp.concatenate([places, jnp.asarray(sizes), jnp.stack([cosine, -sine], -1)], axis=-1)
    return jnp.concatenate([boxes, jnp.asarray(_walls())])


def scene(state: PhysicsState) -> Scene:
    """Returns the arena as a house of one room."""
    count = len(BOXES) + 4
    half = HALF_ARENA
    empty = make_scene([(0.0,) * 7] * count, [0] * count, [(-half, -half, half, half)])
    boxes = obstacles(state)
    return replace(empty, boxes=boxes, other_boxes=boxes, color=jnp.asarray(_COLORS))


def _walls() -> np.ndarray:
    out = HALF_ARENA + _WALL
    rows = [(side * out, 0.3, 0.0, _WALL, 0.3, out + _WALL, 1.0, 0.0) for side in (-1, 1)]
    rows += [(0.0, 0.3, side * out, out + _WALL, 0.3, _WALL, 1.0, 0.0) for side in (-1, 1)]
    return np.array(rows, np.float32)
