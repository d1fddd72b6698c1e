"""Bodies that move by physics: any MuJoCo model, stepped by MJX.

`Physics` is the environment; its starts and sensors are for any model. There are ids of Gymnasium's
MuJoCo environments, with its observations and rewards, and of robots of our own: a rover that
drives to points among boxes, by moves or by velocities, an arm that reaches for targets, a hand
over a table that reaches, pushes, and picks and places, and a mobile arm that fetches and carries.
"""

from envs_jax.physics.catalogue import gymnasium_body as gymnasium_body
from envs_jax.physics.environment import Controller as Controller
from envs_jax.physics.environment import Physics as Physics
from envs_jax.physics.environment import PhysicsState as PhysicsState
from envs_jax.physics.environment import Variation as Variation
from envs_jax.physics.geom_camera import GeomCamera as GeomCamera
from envs_jax.physics.locomotion import NoisyStart as NoisyStart
from envs_jax.physics.locomotion import RunForward as RunForward
from envs_jax.physics.locomotion import RunUpright as RunUpright
from envs_jax.physics.locomotion import WholeBodySensor as WholeBodySensor
from envs_jax.physics.manipulation import MoveObject as MoveObject
from envs_jax.physics.randomization import Randomized as Randomized
from envs_jax.physics.reach import Reach as Reach
from envs_jax.physics.sensors import BodySensor as BodySensor
from envs_jax.physics.sensors import JointSensor as JointSensor
from envs_jax.physics.sensors import ModelSensor as ModelSensor

__all__ = [
    "BodySensor",
    "Controller",
    "GeomCamera",
    "JointSensor",
    "ModelSensor",
    "MoveObject",
    "NoisyStart",
    "Physics",
    "PhysicsState",
    "Randomized",
    "Reach",
    "RunForward",
    "RunUpright",
    "Variation",
    "WholeBodySensor",
    "gymnasium_body",
]
