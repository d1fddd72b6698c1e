"""Bodies that move by physics: any MuJoCo model, stepped by MJX.

`Physics` is the environment; tasks, starts and sensors are for any model, and the ids are those of
Gymnasium's MuJoCo environments, with its observations and rewards.
"""

from envs_jax.physics.catalogue import gymnasium_body as gymnasium_body
from envs_jax.physics.environment import Physics as Physics
from envs_jax.physics.environment import PhysicsState as PhysicsState
from envs_jax.physics.locomotion import NoisyStart as NoisyStart
from envs_jax.physics.locomotion import RunForward as RunForward
from envs_jax.physics.sensors import BodySensor as BodySensor
from envs_jax.physics.sensors import JointSensor as JointSensor
from envs_jax.physics.sensors import ModelSensor as ModelSensor

__all__ = [
    "BodySensor",
    "JointSensor",
    "ModelSensor",
    "NoisyStart",
    "Physics",
    "PhysicsState",
    "RunForward",
    "gymnasium_body",
]
