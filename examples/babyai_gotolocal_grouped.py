"""BabyAI-GoToLocal: the expert teaches when to turn but not which way; PPO finds that out.

python -m jaxact.train examples/babyai_gotolocal_grouped.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, GroupedImitation
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear

pomdp = envs_jax.make("BabyAI-GoToLocal-v0")
names = pomdp.environment.action_names
turns = (names.index("left"), names.index("right"))

experiment = Experiment(
    name="babyai_gotolocal_grouped",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(
            Stage(
                losses={"imitation": GroupedImitation((turns,))},
                teacher_forcing=Linear(1.0, 0.0, steps=1.5e5),
                steps=300_000,
            ),
            Stage(losses={"ppo": PPO(clip=0.2)}, steps=1_700_000),
        ),
        lanes=512,
        rollout_length=16,
        epochs=2,
        minibatches=4,
        learning_rate=Linear(1e-3, 1e-4, steps=2e6),
    ),
)
