"""BabyAI-GoToLocal with GAIL: PPO is rewarded for passing as a demonstrator, and for nothing else.

python -m jaxact.collect BabyAI-GoToLocal-v0 --episodes 20000 --output demonstrations/gotolocal
python -m jaxact.train examples/babyai_gotolocal_gail.py
"""

import dataclasses

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import GAIL, PPO
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear
from jaxact.storages import DemonstrationStorage

pomdp = envs_jax.make("BabyAI-GoToLocal-v0")
policy = GAIL(action_space=pomdp.action_space, encoder=InstructedGrid(), logit_reward=True)
demonstrators = dataclasses.replace(policy, demonstrations=True)
demonstrations = DemonstrationStorage(
    losses={"gail": demonstrators},
    path="demonstrations/gotolocal",
    lanes=128,
    length=16,
    updates=8,
)

experiment = Experiment(
    name="babyai_gotolocal_gail",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(
            Stage(
                losses={"ppo": PPO(clip=0.2), "gail": policy},
                rewards={"success": 0.0},
                storages={"demonstrations": demonstrations},
                steps=4_000_000,
            ),
        ),
        lanes=512,
        rollout_length=16,
        epochs=2,
        minibatches=4,
        learning_rate=Linear(1e-3, 1e-4, steps=4e6),
    ),
)
