"""BabyAI-GoToLocal with PPO alone.

python -m jaxact.train examples/babyai_gotolocal_ppo.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO
from jaxact.models import GRU, ActorCritic, InstructedGrid

pomdp = envs_jax.make("BabyAI-GoToLocal-v0")

experiment = Experiment(
    name="babyai_gotolocal_ppo",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(Stage(losses={"ppo": PPO(clip=0.2)}, steps=15_000_000),),
        learning_rate=1e-3,
    ),
)
