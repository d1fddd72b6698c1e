"""BabyAI-GoToLocal, "go to the red ball" among eight objects: DAgger first, then PPO.

python -m jaxact.train examples/babyai_gotolocal.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, Imitation
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear

pomdp = envs_jax.make("BabyAI-GoToLocal-v0")

experiment = Experiment(
    name="babyai_gotolocal",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(
            Stage(
                losses={"imitation": Imitation()},
                teacher_forcing=Linear(1.0, 0.0, steps=3e5),
                steps=600_000,
                overrides={"learning_rate": Linear(2e-3, 1e-3, steps=6e5)},
            ),
            Stage(
                losses={"ppo": PPO(clip=0.2)},
                steps=1_400_000,
                overrides={"learning_rate": Linear(5e-4, 1e-4, steps=1.4e6)},
            ),
        ),
        lanes=512,
        rollout_length=16,
        epochs=2,
        minibatches=4,
    ),
)
