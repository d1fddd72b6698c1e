"""ArmPointNav: drive to an object, take it with the arm, and bring it to a point that is told.

Source: ManipulaTHOR (Ehsani et al. 2021, https://arxiv.org/abs/2104.11213); rewards, success and
metrics are those of AllenAct's `ArmPointNavTask` and `EasyArmPointNavTask`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.physics.environment import Physics, PhysicsState, check_model
from envs_jax.physics.mobile_arm import (
    BALL,
    HALF_TABLE,
    OBJECT,
    OTHERS,
    ArmMoves,
    gap,
    holds,
)
from envs_jax.physics.reach import drawn_between
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, Episode, Outcome, PyTree, Sensor, Task, TaskSampler
from jaxact.spaces import Box

# Metres that another ball may move before it counts as moved, and that no distance is below.
_MOVED, _LEAST = 0.01, 1e-9


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ArmPointNavState:
    """Progress of an `ArmPointNav`; lengths are metres.

    Attributes:
      goal: float32 [3].
      start: float32 scalar, from the object to the goal at first.
      to_object: float32 scalar, from the hand to the object.
      to_goal: float32 scalar, from the object to the goal.
      others: float32 [2, 3], where the other balls were at first.
      disturbance: float32 scalar, how far they are from there, in sum.
      held: bool scalar.
      steps: int32 scalar, taken.
      pickup_steps: int32 scalar, until the object was taken; all, while it was not.
      chosen: float32 [actions], how often each action was.
      succeeded: float32 [actions], how often it was not blocked or in vain.
    """

    goal: jax.Array
    start: jax.Array
    to_object: jax.Array
    to_goal: jax.Array
    others: jax.Array
    disturbance: jax.Array
    held: jax.Array
    steps: jax.Array
    pickup_steps: jax.Array
    chosen: jax.Array
    succeeded: jax.Array


@dataclass(frozen=True)
class ArmPointNav(Task):
    """End with the object in the hand and near the goal along each axis.

    With the easy moves that ends the episode by itself. To end elsewhere is to end, too.

    Attributes:
      world: of the mobile arm.
      near: metres along each axis.
      step_penalty: the reward, a negative one, of each step.
      failure_penalty: likewise of an action that was blocked, picks up nothing or ends in vain.
      pickup_reward: for the object, once.
      success_reward: for ending at the goal.
      shaping: reward for each metre that the hand comes nearer to the object, or it to the goal.
      disturbance: cost of each metre that other balls come away from their places.
    """

    world: Physics
    near: float = 0.1
    step_penalty: float = -0.01
    failure_penalty: float = -0.03
    pickup_reward: float = 5.0
    success_reward: float = 10.0
    shaping: float = 1.0
    disturbance: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.world.controller, ArmMoves):
            raise JaxactError(
                "task.world has to be the mobile arm's, with ArmMoves as its controller, got "
                f"{self.world.controller}"
            )

    @property
    def moves(self) -> ArmMoves:
        """The world's controller."""
        assert isinstance(self.world.controller, ArmMoves)
        return self.world.controller

    def place(self, state: PhysicsState) -> jax.Array:
        """Returns where the object is, float32 [3]."""
        return state.site_position[self.world.index("site", OBJECT)]

    def others(self, state: PhysicsState) -> jax.Array:
        """Returns where the other balls are, float32 [2, 3]."""
        return jnp.stack([state.site_position[self.world.index("site", x)] for x in OTHERS])

    def start(self, state: PhysicsState, goal: jax.Array) -> ArmPointNavState:
        """Returns the first state of an episode with a goal float32 [3]."""
        to_goal = jnp.linalg.norm(goal - self.place(state))
        none = jnp.zeros(len(self.moves.action_names), jnp.float32)
        return ArmPointNavState(
            goal=goal,
            start=to_goal,
            to_object=jnp.linalg.norm(gap(self.world, state)),
            to_goal=to_goal,
            others=self.others(state),
            disturbance=jnp.float32(0),
            held=holds(state),
            steps=jnp.int32(0),
            pickup_steps=jnp.int32(0),
            chosen=none,
            succeeded=none,
        )

    def step(
        self,
        task_state: ArmPointNavState,
        before: PhysicsState,
        action: jax.Array,
        after: PhysicsState,
    ) -> tuple[ArmPointNavState, Outcome]:
        """Judges one step; see `Task.step`."""
        old, moves = task_state, self.moves
        held = holds(after)
        off = old.goal - self.place(after)
        is_there = held & jnp.all(jnp.abs(off) < jnp.float32(self.near))
        ends = moves.is_action(action, "end")
        success = is_there & (ends | moves.easy)
        failed = (
            moves.blocked(action, before, after)
            | (moves.is_action(action, "pickup") & ~held)
            | (ends & ~success)
        )
        is_chosen = jnp.arange(len(moves.action_names)) == jnp.asarray(action, jnp.int32)
        is_chosen = is_chosen.astype(jnp.float32)
        away = jnp.linalg.norm(self.others(after) - old.others, axis=-1)
        steps = old.steps + 1
        new = ArmPointNavState(
            goal=old.goal,
            start=old.start,
            to_object=jnp.linalg.norm(gap(self.world, after)),
            to_goal=jnp.linalg.norm(off),
            others=old.others,
            disturbance=jnp.sum(away),
            held=held,
            steps=steps,
            pickup_steps=jnp.where(old.held, old.pickup_steps, steps),
            chosen=old.chosen + is_chosen,
            succeeded=old.succeeded + jnp.where(failed, 0, is_chosen),
        )
        nearer = old.to_object - new.to_object + old.to_goal - new.to_goal
        disturbed = new.disturbance - old.disturbance
        return new, Outcome(
            reward={
                "step": jnp.float32(self.step_penalty),
                "failure": jnp.where(failed, jnp.float32(self.failure_penalty), 0),
                "pickup": jnp.where(held & ~old.held, jnp.float32(self.pickup_reward), 0),
                "shaping": jnp.float32(self.shaping) * nearer,
                "disturbance": -jnp.float32(self.disturbance) * disturbed,
                "success": jnp.where(success, jnp.float32(self.success_reward), 0),
            },
            success={"goal": success},
            terminated=ends | success | after.diverged,
            metrics={
                **self._report(new, away, success),
                "diverged": after.diverged.astype(jnp.float32),
            },
        )

    def check(self, pomdp: POMDP) -> None:
        """Refuses an environment of another model, or one that is moved in another way."""
        check_model(pomdp, self.world, "task.world")
        moves = getattr(pomdp.environment, "controller", None)
        if moves != self.moves:
            raise JaxactError(
                f"task.world is moved by {self.moves}, but the environment by {moves}: give both "
                "the same"
            )

    def _report(
        self, state: ArmPointNavState, away: jax.Array, success: jax.Array
    ) -> dict[str, jax.Array]:
        moved = jnp.sum(away > _MOVED)
        steps = state.steps.astype(jnp.float32)
        rates = state.succeeded / jnp.maximum(state.chosen, 1)
        shares = state.chosen / steps
        names = self.moves.action_names
        return {
            "object_to_goal": state.to_goal,
            "hand_to_object": state.to_object,
            "distance_left": state.to_goal / jnp.maximum(state.start, _LEAST),
            "picked_up": state.held.astype(jnp.float32),
            "pickup_steps": state.pickup_steps.astype(jnp.float32),
            "objects_moved": moved.astype(jnp.float32),
            "disturbance": state.disturbance,
            "success_without_disturbance": (success & (moved == 0)).astype(jnp.float32),
            "actions_succeeded": jnp.sum(state.succeeded) / steps,
            **{f"chosen/{name}": shares[i] for i, name in enumerate(names)},
            **{f"succeeded/{name}": rates[i] for i, name in enumerate(names)},
        }


@dataclass(frozen=True)
class TwoTables(TaskSampler):
    """The object on one of two tables, its goal over the other, and another ball on each.

    The robot stands between them, its arm drawn in, and looks anywhere.

    Attributes:
      world: of the mobile arm.
      task: that begins.
      horizon: steps.
    """

    world: Physics
    task: ArmPointNav
    horizon: int = 200

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        side_key, table_key, ball_key, other_key, robot_key, goal_key = jax.random.split(key, 6)
        # Rows are the object's table and the goal's: one on the left, one on the right.
        is_left = jax.random.bernoulli(side_key)
        inwards = jnp.where(is_left, jnp.float32([1, -1]), jnp.float32([-1, 1]))[:, None]
        toward = jnp.concatenate([inwards, jnp.ones((2, 1), jnp.float32)], axis=1)
        tables = drawn_between(table_key, (-1.5, -0.8), (-1.0, 0.8), 2) * toward
        x, y, z = HALF_TABLE
        margin, top = 0.05, jnp.full((2, 1), 2 * z + BALL, jnp.float32)
        # The object and the goal are in a near quarter of their tables, other balls across.
        near = drawn_between(ball_key, (0.0, margin - y), (x - margin, -2 * BALL), 2)
        across = drawn_between(other_key, (margin - x, 2 * BALL), (x - margin, y - margin), 2)
        spots, others = (
            jnp.concatenate([tables + toward * part, top], axis=1) for part in (near, across)
        )
        robot = drawn_between(robot_key, (-0.3, -0.8, -math.pi), (0.3, 0.8, math.pi), 1)[0]
        raised = drawn_between(goal_key, (0.0, 0.0, 0.05), (0.0, 0.0, 0.3), 1)[0]
        arm = jnp.zeros(4, jnp.float32)
        state = self.world.start(
            jnp.concatenate([robot, arm, spots[0], others.reshape(-1)]),
            jnp.zeros(self.world.model.nv, jnp.float32),
            mocap_position=jnp.concatenate([tables, jnp.full_like(top, z)], axis=1),
        )
        return Episode(state, self.task.start(state, spots[1] + raised), jnp.int32(self.horizon))


@dataclass(frozen=True)
class WaysSensor(Sensor):
    """The ways from the hand to the object and from it to the goal, as the robot sees them.

    They are float32 [6], metres: twice ahead, to the left and up.

    Attributes:
      task: whose they are.
    """

    task: ArmPointNav

    @property
    def space(self) -> Box:
        """Numbers without bounds."""
        return Box(-math.inf, math.inf, (6,))

    def observe(self, state: PhysicsState, task_state: ArmPointNavState) -> jax.Array:
        """Returns the reading."""
        task = self.task
        ways = jnp.stack([gap(task.world, state), task_state.goal - task.place(state)])
        return seen_from(state.position[2], ways).reshape(-1)


@dataclass(frozen=True)
class ArmSensor(Sensor):
    """The arm's height, x, y and z, metres, and 1 where it holds the object, float32 [5]."""

    @property
    def space(self) -> Box:
        """Numbers without bounds."""
        return Box(-math.inf, math.inf, (5,))

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        del task_state
        return jnp.append(state.position[3:7], holds(state).astype(jnp.float32))


@dataclass(frozen=True)
class TablesSensor(Sensor):
    """The ways to the tables' middles, ahead and to the left, and how the robot looks at them.

    It is float32 [6]: metres, and the cosine and sine of the robot's yaw; tables stand straight.
    """

    @property
    def space(self) -> Box:
        """Numbers without bounds."""
        return Box(-math.inf, math.inf, (6,))

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        del task_state
        yaw = state.position[2]
        # In one order, whichever has the object.
        tables = state.mocap_position[jnp.argsort(state.mocap_position[:, 0]), :2]
        ways = seen_from(yaw, tables - state.position[:2])
        return jnp.concatenate([ways.reshape(-1), jnp.stack([jnp.cos(yaw), jnp.sin(yaw)])])


def seen_from(yaw: jax.Array, ways: jax.Array) -> jax.Array:
    """Returns ways float32 [N, 2 or 3] in the frame of who looks along a yaw: ahead and left."""
    cosine, sine = jnp.cos(yaw), jnp.sin(yaw)
    ahead = cosine * ways[:, 0] + sine * ways[:, 1]
    left = cosine * ways[:, 1] - sine * ways[:, 0]
    return jnp.concatenate([jnp.stack([ahead, left], axis=1), ways[:, 2:]], axis=1)
