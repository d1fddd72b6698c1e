"""BabyAI-GoToLocal with PPO and CPC|A, in the form that tells a step from all others of the batch.

python -m jaxact.train examples/babyai_gotolocal_cpca_softmax.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, CPCASoftmax
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear

pomdp = envs_jax.make("BabyAI-GoToLocal-v0")

experiment = Experiment(
    name="babyai_gotolocal_cpca_softmax",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(
            Stage(
                losses={
                    "ppo": PPO(clip=0.2),
                    "cpca": CPCASoftmax(action_space=pomdp.action_space, steps=4, features=64),
                },
                weights={"cpca": 0.05},
                steps=4_000_000,
            ),
        ),
        # Small minibatches, as all pairs of their steps are compared.
        lanes=256,
        rollout_length=16,
        epochs=2,
        minibatches=8,
        learning_rate=Linear(1e-3, 1e-4, steps=4e6),
    ),
)
