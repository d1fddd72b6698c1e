"""MiniGrid-Empty-Random-6x6, seen whole, with DQN as first published: no double, dueling or n-step.

python -m jaxact.train examples/minigrid_empty_dqn.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import DQN, Target
from jaxact.models import InstructedGrid, NoMemory, QNetwork
from jaxact.schedules import Linear
from jaxact.storages import Replay

pomdp = envs_jax.make("MiniGrid-Empty-Random-6x6-v0", observation="full")
# Ways are short: at 0.99 the values of all actions would be nearly the same.
replay = Replay(
    losses={"dqn": DQN(discount=0.9, double=False, target=Target(every=200))},
    capacity=2048,
    lanes=128,
    length=2,
    updates=8,
    start_after=2_000,
)

experiment = Experiment(
    name="minigrid_empty_dqn",
    pomdp=pomdp,
    model=QNetwork(pomdp.action_space, InstructedGrid(64), NoMemory(), dueling=False),
    pipeline=TrainingPipeline(
        stages=(
            Stage(
                losses={},
                storages={"replay": replay},
                steps=80_000,
                exploration=Linear(1.0, 0.05, steps=4e4),
            ),
        ),
        lanes=16,
        rollout_length=8,
        learning_rate=5e-4,
        max_grad_norm=10.0,
    ),
)
