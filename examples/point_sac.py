"""A world of continuous actions, made here, and soft actor-critic: a point is steered to a goal.

python -m jaxact.train examples/point_sac.py
"""

import dataclasses

import jax
import jax.numpy as jnp

from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import SAC, Critic, Target
from jaxact.models import ActorCritic, Concatenated, NoMemory, Vector
from jaxact.pomdp import POMDP, Environment, Episode, Outcome, Sensor, Task, TaskSampler
from jaxact.spaces import Box
from jaxact.storages import Replay


@dataclasses.dataclass(frozen=True)
class Square(Environment):
    """Its state is a point, float32[2] in [-1, 1]; an action is its move."""

    @property
    def action_space(self):
        """The move, in the units of the square."""
        return Box(-0.3, 0.3, (2,))

    def step(self, key, state, action):
        """Moves the point, no further than to the walls."""
        return jnp.clip(state + action, -1.0, 1.0)


@dataclasses.dataclass(frozen=True)
class ReachPoint(Task):
    """The task's state is the point to reach."""

    radius: float = 0.15

    def step(self, task_state, before, action, after):
        """Pays for arriving, and takes something for every step by the distance."""
        distance = jnp.linalg.norm(after - task_state)
        reached = distance < self.radius
        reward = {"success": reached.astype(jnp.float32), "distance": -0.1 * distance}
        return task_state, Outcome(reward, {"reached": reached}, reached, {})


@dataclasses.dataclass(frozen=True)
class Anywhere(TaskSampler):
    """Both points are anywhere."""

    def sample(self, key, sampler_state):
        """Draws the two points."""
        start, goal = jax.random.uniform(key, (2, 2), jnp.float32, -1.0, 1.0)
        return Episode(environment=start, task=goal, horizon=jnp.int32(20))


@dataclasses.dataclass(frozen=True)
class Points(Sensor):
    """Both points."""

    @property
    def space(self):
        """Four coordinates."""
        return Box(-1, 1, (4,), "float32")

    def observe(self, state, task_state):
        """Returns the point and the goal."""
        return jnp.concatenate([state, task_state])


pomdp = POMDP(Square(), ReachPoint(), Anywhere(), {"points": Points()})
critic = Critic(Concatenated({"points": Vector((64,))}), (64,))
replay = Replay(
    losses={"sac": SAC(critic=critic, discount=0.95, target=Target(rate=0.02))},
    capacity=4096,
    lanes=128,
    length=2,
    updates=8,
    start_after=1_000,
)

experiment = Experiment(
    name="point_sac",
    pomdp=pomdp,
    model=ActorCritic(
        pomdp.action_space,
        Concatenated({"points": Vector((64, 64))}),
        NoMemory(),
        squashed=True,
    ),
    pipeline=TrainingPipeline(
        stages=(Stage(losses={}, storages={"replay": replay}, steps=40_000),),
        lanes=16,
        rollout_length=8,
        learning_rate=1e-3,
        max_grad_norm=10.0,
    ),
)
