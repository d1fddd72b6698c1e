"""PointNav for the rover: drive to a point that is told, and say so."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp

from envs_jax.houses import geodesic
from envs_jax.houses import journey as journeys
from envs_jax.houses.collision import clearance
from envs_jax.houses.draws import draw
from envs_jax.houses.geodesic import GoalField
from envs_jax.houses.journey import Journey
from envs_jax.houses.scene import HALF_SIZE, to_local
from envs_jax.physics.environment import Physics, PhysicsState
from envs_jax.physics.rover import BODY, BOXES, HALF_ARENA, Drive, obstacles, scene
from jaxact.errors import JaxactError
from jaxact.pomdp import POMDP, Episode, Outcome, PyTree, Sensor, Task, TaskSampler
from jaxact.spaces import Box


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PointNavState:
    """Progress of a `PointNav`.

    Attributes:
      goal: float32 [2], a plan.
      journey: how far it is.
    """

    goal: jax.Array
    journey: Journey


@dataclass(frozen=True)
class PointNav(Task):
    """End within some geodesic distance of the goal; whatever the place, to end is to end.

    Rewards are those of `envs_jax.houses.point_nav.PointNav`.

    Attributes:
      drive: tells which actions end the episode.
      radius: metres from the goal within which to end.
      step_penalty: the reward, a negative one, of each step.
      shaping: reward for each metre that the goal comes nearer.
      success_reward: for ending near the goal.
    """

    drive: Drive
    radius: float = 0.2
    step_penalty: float = -0.01
    shaping: float = 1.0
    success_reward: float = 10.0

    def start(self, field: GoalField, state: PhysicsState, goal: jax.Array) -> PointNavState:
        """Returns the first state of an episode.

        Args:
          field: how far the goal is, from `geodesic.goal_field`.
          state: where the rover begins.
          goal: float32 [2], a plan.
        """
        boxes, place = obstacles(state), state.position[:2]
        metres = geodesic.distance(field, boxes, BODY.radius, place)[0]
        way = geodesic.shortest(field, boxes, BODY.radius, place)
        return PointNavState(goal, Journey(field, way, metres, jnp.float32(0), metres))

    def step(
        self,
        task_state: PointNavState,
        before: PhysicsState,
        action: jax.Array,
        after: PhysicsState,
    ) -> tuple[PointNavState, Outcome]:
        """Judges one step; see `Task.step`."""
        old, place = task_state.journey, after.position[:2]
        metres = geodesic.distance(old.field, obstacles(after), BODY.radius, place)[0]
        gone = jnp.sqrt(jnp.sum((place - before.position[:2]) ** 2))
        new = replace(
            old,
            distance=metres,
            walked=old.walked + gone,
            nearest=jnp.minimum(old.nearest, metres),
        )
        ended = self.drive.ends(action)
        success = ended & (metres <= jnp.float32(self.radius)) & jnp.isfinite(old.start_distance)
        # Along x and y; what holds the rover from turning is friction on the shell.
        collided = jnp.any(jnp.abs(after.constraint_force[:2]) > 0)
        return replace(task_state, journey=new), Outcome(
            reward={
                "step": jnp.float32(self.step_penalty),
                "shaping": jnp.float32(self.shaping) * journeys.approach(old, new),
                "success": jnp.where(success, jnp.float32(self.success_reward), 0),
            },
            success={"goal": success},
            terminated=ended | after.diverged,
            metrics={
                **journeys.report(new, success),
                "collided": collided.astype(jnp.float32),
                "diverged": after.diverged.astype(jnp.float32),
            },
        )

    def check(self, pomdp: POMDP) -> None:
        """Refuses a world that is driven in another way."""
        world = pomdp.environment
        if not isinstance(world, Physics) or world.controller != self.drive:
            raise JaxactError(
                f"task.drive is {self.drive}, but the environment is driven by "
                f"{getattr(world, 'controller', None)}: give both the same"
            )


@dataclass(frozen=True)
class ClutteredArena(TaskSampler):
    """Boxes anywhere in the arena, and a start and a goal with a way between them.

    Attributes:
      world: of the rover.
      task: that begins.
      nearest: metres of way that there are at least, if any of the places drawn is so far.
      candidates: places drawn for the start and the goal.
      horizon: steps.
    """

    world: Physics
    task: PointNav
    nearest: float = 1.0
    candidates: int = 24
    horizon: int = 100

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode."""
        del sampler_state
        count = len(BOXES)
        places, turns, spots, yaw = draw(key, [(count, 2), (count,), (self.candidates, 2), ()])
        inside = jnp.float32(2 * HALF_ARENA)
        places = (places - 0.5) * inside
        half = turns * jnp.float32(math.pi / 2)
        zero = jnp.zeros_like(half)
        heights = jnp.array([size[2:] for size in BOXES], jnp.float32)
        begin = partial(
            self.world.start,
            velocity=jnp.zeros(3, jnp.float32),
            mocap_position=jnp.concatenate([places, heights], axis=1),
            mocap_rotation=jnp.stack([jnp.cos(half), zero, zero, jnp.sin(half)], axis=-1),
        )
        boxes = obstacles(begin(jnp.zeros(3, jnp.float32)))
        spots = (spots - 0.5) * (inside - 2 * jnp.float32(BODY.radius))
        room = jax.vmap(lambda spot: jnp.min(clearance(boxes, spot)[0]))(spots)
        # The first with room, or the one with most.
        first = spots[jnp.argmax(jnp.minimum(room, jnp.float32(BODY.radius + 0.01)))]
        facing = (2 * yaw[None] - 1) * jnp.float32(math.pi)
        state = begin(jnp.concatenate([first, facing]))
        roadmap = geodesic.build_roadmap(scene(state), BODY, size=8 * count)
        from_start = geodesic.goal_field(roadmap, boxes, BODY.radius, first[None])
        metres = jax.vmap(lambda spot: geodesic.shortest(from_start, boxes, BODY.radius, spot))(
            spots
        )
        can_be = (room > jnp.float32(BODY.radius)) & jnp.isfinite(metres)
        # Likewise: the first that is far enough, or the farthest.
        metres = jnp.where(can_be, jnp.minimum(metres, jnp.float32(self.nearest)), -1)
        goal = spots[jnp.argmax(metres)]
        goal = jnp.where(jnp.max(metres) > 0, goal, first)
        field = geodesic.goal_field(roadmap, boxes, BODY.radius, goal[None])
        return Episode(state, self.task.start(field, state, goal), jnp.int32(self.horizon))


@dataclass(frozen=True)
class GoalSensor(Sensor):
    """Metres to the goal, and the cosine and sine of its bearing to the left, float32 [3]."""

    @property
    def space(self) -> Box:
        """Three numbers without bounds."""
        return Box(-math.inf, math.inf, (3,))

    def observe(self, state: PhysicsState, task_state: PointNavState) -> jax.Array:
        """Returns the reading."""
        yaw = state.position[2]
        x, y = task_state.goal - state.position[:2]
        metres = jnp.sqrt(x**2 + y**2)
        bearing = jnp.arctan2(y, x) - yaw
        return jnp.stack([metres, jnp.cos(bearing), jnp.sin(bearing)])


@dataclass(frozen=True)
class SpeedSensor(Sensor):
    """How fast the rover goes, float32 [3]: ahead and to the left in m/s, to the left in rad/s."""

    @property
    def space(self) -> Box:
        """Three numbers without bounds."""
        return Box(-math.inf, math.inf, (3,))

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        del task_state
        cosine, sine = jnp.cos(state.position[2]), jnp.sin(state.position[2])
        x, y, turn = state.velocity
        return jnp.stack([cosine * x + sine * y, cosine * y - sine * x, turn])


@dataclass(frozen=True)
class LidarSensor(Sensor):
    """Metres from the rover's axis to what is around it, float32 [rays], at most `reach`.

    The first ray leads ahead, the others follow counterclockwise.

    Attributes:
      rays: how many.
      reach: metres.
    """

    rays: int = 24
    reach: float = 3.0

    @property
    def space(self) -> Box:
        """Metres."""
        return Box(0.0, self.reach, (self.rays,))

    def observe(self, state: PhysicsState, task_state: PyTree) -> jax.Array:
        """Returns the reading."""
        del task_state
        boxes = obstacles(state)
        angles = state.position[2] + jnp.linspace(
            0, 2 * math.pi, self.rays, endpoint=False, dtype=jnp.float32
        )
        ways = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1)
        start = to_local(boxes, state.position[:2])
        turned = to_local(boxes.at[:, :3].set(0), ways)
        turned = jnp.where(jnp.abs(turned) < 1e-9, 1e-9, turned)
        half = boxes[:, HALF_SIZE][:, ::2]
        enters = jnp.max(-start / turned - half / jnp.abs(turned), axis=-1)
        leaves = jnp.min(-start / turned + half / jnp.abs(turned), axis=-1)
        hit = (enters <= leaves) & (leaves >= 0)
        metres = jnp.where(hit, jnp.maximum(enters, 0), jnp.inf)
        return jnp.minimum(jnp.min(metres, axis=-1), jnp.float32(self.reach))
