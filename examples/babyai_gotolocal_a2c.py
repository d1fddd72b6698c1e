"""BabyAI-GoToLocal with A2C: the PPO experiment with another loss, and one pass over each batch.

python -m jaxact.train examples/babyai_gotolocal_a2c.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import A2C
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear

pomdp = envs_jax.make("BabyAI-GoToLocal-v0")

experiment = Experiment(
    name="babyai_gotolocal_a2c",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(Stage(losses={"a2c": A2C(normalize_advantage=True)}, steps=3_000_000),),
        lanes=512,
        rollout_length=16,
        epochs=1,
        minibatches=4,
        learning_rate=Linear(1e-3, 1e-4, steps=4e6),
    ),
)
