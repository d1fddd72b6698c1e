"""MiniGrid-DoorKey-5x5 with R2D2: recurrent double DQN on a prioritised replay of sequences.

python -m jaxact.train examples/minigrid_doorkey_r2d2.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import DQN, Target
from jaxact.models import GRU, InstructedGrid, QNetwork
from jaxact.schedules import Linear
from jaxact.storages import PrioritizedReplay

pomdp = envs_jax.make("MiniGrid-DoorKey-5x5-v0")

replay = PrioritizedReplay(
    losses={"dqn": DQN(n_step=5, rescale=True, target=Target(every=200))},
    capacity=2048,
    lanes=64,
    length=16,
    burn_in=8,
    stride=8,
    updates=4,
    start_after=20_000,
)

experiment = Experiment(
    name="minigrid_doorkey_r2d2",
    pomdp=pomdp,
    model=QNetwork(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(
            Stage(
                losses={},
                storages={"replay": replay},
                steps=400_000,
                exploration=Linear(1.0, 0.05, steps=2e5),
            ),
        ),
        lanes=64,
        rollout_length=16,
        learning_rate=5e-4,
        max_grad_norm=10.0,
    ),
)
