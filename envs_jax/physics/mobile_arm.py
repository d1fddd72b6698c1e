"""A robot that drives, with an arm that ends in a magnet, between two tables with balls on them.

Its moves are those of ManipulaTHOR's ArmPointNav (Ehsani et al. 2021,
https://arxiv.org/abs/2104.11213), as AllenAct has them. x and y are level and z is up, in metres;
the arm's own x is to the right, its y up and its z ahead, as in AI2-THOR. Of the robot its base
and its hand touch things, but for the links between them, which are slides without weight. Balls do
not turn, so that they lie where they are put. The magnet is a spring of which the activation says
whether it holds.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.physics.environment import Controller, Physics, PhysicsState
from jaxact.spaces import Discrete

OBJECT, HAND = "object", "hand"
OTHERS = ("other 0", "other 1")
# Metres: half of the room's side, half of a table's sides, radii of the base and of the balls.
HALF_ROOM = 2.0
HALF_TABLE = (0.25, 0.35, 0.25)
BASE, BALL = 0.2, 0.04
# From the middle of the hand, how far the magnet reaches, besides the radius of a ball.
MAGNET = 0.06
# The joints of the base, x, y and yaw, and those of the arm; and metres and radians a second.
_BASE_JOINTS, _JOINTS = 3, 7
_FASTEST = (2.5, 2.5, 10.0, 1.0, 1.0, 1.0, 1.0)
# Speed for each metre or radian that is left to go, 1/s.
_STIFFNESS = 24.0
_ARM_STEP = 0.05
# Newtons, or newton metres, for a metre or radian a second.
_STRENGTHS = {
    "x": 600,
    "y": 600,
    "yaw": 80,
    "arm height": 150,
    "arm x": 80,
    "arm y": 80,
    "arm z": 80,
}


def _joint(name: str, axis: str, kind: str = "slide", limits: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}" axis="{axis}" damping="{_STRENGTHS[name]}"'
        f"{limits and f' range={limits!r}'}/>"
    )


def mobile_arm_model() -> str:
    """Returns the MJCF text; the tables are mocap bodies."""
    walls = "".join(
        f'<geom class="wall" type="plane" size="{2 * HALF_ROOM} 5 1" '
        f'pos="{-x * HALF_ROOM} {-y * HALF_ROOM} 0" zaxis="{x} {y} 0"/>'
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))
    )
    tables = "".join(
        f'<body name="table {i}" mocap="true" pos="{2 * i - 1} 0 {HALF_TABLE[2]}">'
        f'<geom class="table" type="box" size="{HALF_TABLE[0]} {HALF_TABLE[1]} {HALF_TABLE[2]}"/>'
        "</body>"
        for i in range(2)
    )
    balls = "".join(
        f'<body name="{name}"><joint name="{name} x" type="slide" axis="1 0 0"/>'
        f'<joint name="{name} y" type="slide" axis="0 1 0"/>'
        f'<joint name="{name} z" type="slide" axis="0 0 1"/>'
        f'<geom class="ball"/><site name="{name}"/></body>'
        for name in (OBJECT, *OTHERS)
    )
    # As much force for a metre a second that is told as the damping takes: the speed is held.
    motors = "".join(
        f'<motor name="{joint}" joint="{joint}" gear="{strength}" ctrlrange="-10 10"/>'
        for joint, strength in _STRENGTHS.items()
    )
    magnet = "".join(
        f'<general name="magnet {axis}" site="{OBJECT}" refsite="{HAND}" gear="{gear} 0 0 0" '
        'dyntype="integrator" gaintype="affine" gainprm="0 -100 -7" ctrlrange="0 10" '
        'actlimited="true" actrange="0 1"/>'
        for axis, gear in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"))
    )
    # Bits: 1, what the hand and balls touch; 2, balls; 4, the hand; 8, what the base touches.
    return f"""
<mujoco model="mobile arm">
  <option timestep="0.02" iterations="5" ls_iterations="8"/>
  <default>
    <geom condim="1"/>
    <default class="wall"><geom contype="8" conaffinity="0"/></default>
    <default class="table"><geom contype="9" conaffinity="0"/></default>
    <default class="link">
      <geom type="sphere" size="0.03" mass="0.2" contype="0" conaffinity="0"/>
    </default>
    <default class="ball">
      <geom type="sphere" size="{BALL}" mass="0.15" condim="3" friction="0.8" contype="2"
        conaffinity="7"/>
    </default>
  </default>
  <worldbody>
    <geom type="plane" size="4 4 1" contype="1" conaffinity="0"/>
    {walls}{tables}
    <body name="base" pos="0 0 {BASE}" gravcomp="1">
      {_joint("x", "1 0 0")}{_joint("y", "0 1 0")}{_joint("yaw", "0 0 1", "hinge")}
      <geom type="sphere" size="{BASE}" mass="8" contype="0" conaffinity="8"/>
      <body pos="0 0 0.4" gravcomp="1">
        {_joint("arm height", "0 0 1", limits="-0.3 0.6")}<geom class="link" mass="0.5"/>
        <body gravcomp="1">
          {_joint("arm x", "0 -1 0", limits="-0.4 0.4")}<geom class="link"/>
          <body gravcomp="1">
            {_joint("arm y", "0 0 1", limits="-0.3 0.3")}<geom class="link"/>
            <body name="{HAND}" pos="0.3 0 0" gravcomp="1">
              {_joint("arm z", "1 0 0", limits="0.0 0.5")}
              <geom type="sphere" size="0.05" mass="0.3" contype="4" conaffinity="1"/>
              <site name="{HAND}"/>
            </body>
          </body>
        </body>
      </body>
    </body>
    {balls}
  </worldbody>
  <contact><exclude body1="{OBJECT}" body2="{HAND}"/></contact>
  <actuator>{motors}{magnet}</actuator>
</mujoco>
"""


_ARM_NAMES = ("arm_height", "arm_x", "arm_y", "arm_z")
_MOVE_NAMES = (
    *(f"{name}_{sign}" for name in _ARM_NAMES for sign in ("plus", "minus")),
    "move_ahead",
    "rotate_right",
    "rotate_left",
)


@dataclass(frozen=True)
class ArmMoves(Controller):
    """Moves of the arm along its axes or in height, of the base ahead or round, and "pickup".

    Each takes all of a step. What moves is led to the pose that the move is to end in; where
    something is in the way it stays there, while AI2-THOR takes a move back that failed. The arm
    stands at multiples of 0.05 m; where it was stopped between them it goes to the nearest.

    Attributes:
      easy: the magnet takes the object by itself, and there are neither "pickup" nor "end".
      ahead: metres of a move ahead.
      turn: degrees.
      tolerance: metres, or radians, off the end of a move within which it succeeded.
    """

    easy: bool = False
    ahead: float = 0.2
    turn: float = 45.0
    tolerance: float = 0.025

    @property
    def action_names(self) -> tuple[str, ...]:
        """Eleven moves, and "pickup" and "end" if it is not easy."""
        return _MOVE_NAMES if self.easy else (*_MOVE_NAMES, "pickup", "end")

    @property
    def action_space(self) -> Discrete:
        """One of the names."""
        return Discrete(len(self.action_names))

    def is_action(self, action: jax.Array, name: str) -> jax.Array:
        """Returns a bool scalar: whether an action has a name; none has one that there is not."""
        if name not in self.action_names:
            return jnp.bool_(False)
        return jnp.asarray(action, jnp.int32) == self.action_names.index(name)

    def end(self, action: jax.Array, position: jax.Array) -> jax.Array:
        """Returns where a move is to lead, float32 [7]: x, y, yaw, height and the arm's x, y, z.

        Args:
          action: that is taken.
          position: float32 [nq], of the joints before.
        """
        chosen = jnp.asarray(action, jnp.int32)
        ahead = jnp.where(self.is_action(action, "move_ahead"), jnp.float32(self.ahead), 0)
        yaw, turn = position[2], jnp.deg2rad(jnp.float32(self.turn))
        right = self.is_action(action, "rotate_right").astype(jnp.float32)
        left = self.is_action(action, "rotate_left").astype(jnp.float32)
        way = jnp.stack([ahead * jnp.cos(yaw), ahead * jnp.sin(yaw), turn * (left - right)])
        signs = jnp.float32([1, -1])[chosen % 2]
        moved = jnp.arange(_JOINTS - _BASE_JOINTS) == chosen // 2
        arm = jnp.round(position[_BASE_JOINTS:_JOINTS] / _ARM_STEP) + jnp.where(moved, signs, 0)
        return jnp.concatenate([position[:_BASE_JOINTS] + way, _ARM_STEP * arm])

    def blocked(self, action: jax.Array, before: PhysicsState, after: PhysicsState) -> jax.Array:
        """Returns a bool scalar: whether something kept a step from ending where it was to."""
        off = self.end(action, before.position) - after.position[:_JOINTS]
        return jnp.any(jnp.abs(off) > jnp.float32(self.tolerance))

    def controls(
        self,
        world: Physics,
        action: jax.Array,
        before: PhysicsState,
        position: jax.Array,
        velocity: jax.Array,
    ) -> jax.Array:
        """Returns speeds that lead to the end of the move, and the magnet's; see `Controller`."""
        del velocity
        fastest = jnp.array(_FASTEST, jnp.float32)
        left = self.end(action, before.position) - position[:_JOINTS]
        speeds = jnp.clip(jnp.float32(_STIFFNESS) * left, -fastest, fastest)
        is_near = jnp.linalg.norm(gap(world, before)) < jnp.float32(MAGNET + BALL)
        takes = is_near & (self.is_action(action, "pickup") | self.easy)
        return jnp.concatenate([speeds, jnp.full(3, jnp.where(takes, jnp.float32(10), 0))])


def mobile_arm(*, easy: bool = False) -> Physics:
    """Returns the robot's world: each of its steps takes 0.2 s."""
    return Physics(mobile_arm_model(), 10, ArmMoves(easy))


def gap(world: Physics, state: PhysicsState) -> jax.Array:
    """Returns the way from the hand to the object, float32 [3]."""
    rows = [world.index("site", name) for name in (OBJECT, HAND)]
    return state.site_position[rows[0]] - state.site_position[rows[1]]


def holds(state: PhysicsState) -> jax.Array:
    """Returns a bool scalar: whether the magnet has the object."""
    return state.activation[0] > 0.5
