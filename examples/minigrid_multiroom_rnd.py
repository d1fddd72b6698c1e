"""MiniGrid-MultiRoom-N4-S5 with PPO and random network distillation's reward for what is new.

python -m jaxact.train examples/minigrid_multiroom_rnd.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, RandomNetworkDistillation
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear

pomdp = envs_jax.make("MiniGrid-MultiRoom-N4-S5-v1")
novelty = RandomNetworkDistillation(encoder=InstructedGrid(64))

experiment = Experiment(
    name="minigrid_multiroom_rnd",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(
            Stage(
                losses={"ppo": PPO(clip=0.2), "novelty": novelty},
                # Less and less, so that in the end the task alone counts.
                rewards={"novelty": Linear(0.01, 0.0, steps=4e6)},
                steps=4_000_000,
            ),
        ),
        lanes=256,
        rollout_length=32,
        epochs=2,
        minibatches=4,
        learning_rate=Linear(1e-3, 1e-4, steps=4e6),
    ),
)
