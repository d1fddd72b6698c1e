"""An experiment so small that starting a process for it takes longer than training it."""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO
from jaxact.models import GRU, ActorCritic, InstructedGrid

pomdp = envs_jax.make("MiniGrid-Empty-Random-5x5-v0")

experiment = Experiment(
    name="tiny",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(32), GRU(32)),
    pipeline=TrainingPipeline(
        stages=(Stage(losses={"ppo": PPO(clip=0.2)}, steps=20_000),),
        lanes=20,
        rollout_length=20,
        minibatches=2,
        learning_rate=1e-3,
    ),
)
