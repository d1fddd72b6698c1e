"""BabyAI-GoToLocal with PPO alone.

python -m jaxact.train examples/babyai_gotolocal_ppo.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear

pomdp = envs_jax.make("BabyAI-GoToLocal-v0")

experiment = Experiment(
    name="babyai_gotolocal_ppo",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(Stage(losses={"ppo": PPO(clip=0.2)}, steps=2_000_000),),
        lanes=512,
        rollout_length=16,
        epochs=4,
        minibatches=8,
        learning_rate=Linear(1e-3, 1e-4, steps=2e6),
    ),
)
