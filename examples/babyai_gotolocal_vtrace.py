"""BabyAI-GoToLocal with IMPALA's V-trace, on a replay of the last rollouts.

python -m jaxact.train examples/babyai_gotolocal_vtrace.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import VTrace
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear
from jaxact.storages import Replay

pomdp = envs_jax.make("BabyAI-GoToLocal-v0")
replay = Replay(
    losses={"vtrace": VTrace()},
    capacity=64,
    lanes=128,
    length=16,
    stride=16,
    updates=8,
    start_after=32_000,
)

experiment = Experiment(
    name="babyai_gotolocal_vtrace",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(Stage(losses={}, storages={"replay": replay}, steps=4_000_000),),
        lanes=512,
        rollout_length=16,
        learning_rate=Linear(1e-3, 1e-4, steps=4e6),
    ),
)
