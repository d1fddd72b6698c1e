"""PointNav in RoboTHOR's manner: depth and the goal's direction, PPO, houses never seen before.

python -m jaxact.train examples/robothor_pointnav.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO
from jaxact.models import GRU, ActorCritic, Concatenated, Image, Vector
from jaxact.schedules import Linear

pomdp = envs_jax.make("RoboTHOR-PointNav-v0", resolution=32)
depth = Image(128, channels=(16, 32, 32), sizes=(5, 3, 3), strides=(2, 2, 2))
encoder = Concatenated({"depth": depth, "point_goal": Vector((32, 32))})

experiment = Experiment(
    name="robothor_pointnav",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, encoder, GRU(128), previous_action=True),
    pipeline=TrainingPipeline(
        stages=(Stage(losses={"ppo": PPO(clip=0.2)}, steps=10_000_000),),
        lanes=128,
        rollout_length=64,
        epochs=2,
        minibatches=4,
        learning_rate=Linear(5e-4, 5e-5, steps=1e7),
        max_grad_norm=0.5,
    ),
)
