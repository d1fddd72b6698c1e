"""MiniGrid-DoorKey-5x5 with PQN: Q-learning from rollouts, no replay and no target network.

python -m jaxact.train examples/minigrid_doorkey_pqn.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PQN
from jaxact.models import GRU, InstructedGrid, QNetwork
from jaxact.schedules import Linear

pomdp = envs_jax.make("MiniGrid-DoorKey-5x5-v0")

experiment = Experiment(
    name="minigrid_doorkey_pqn",
    pomdp=pomdp,
    model=QNetwork(pomdp.action_space, InstructedGrid(), GRU(128), layer_norm=True),
    pipeline=TrainingPipeline(
        stages=(
            Stage(
                losses={"pqn": PQN()},
                steps=1_000_000,
                exploration=Linear(1.0, 0.05, steps=3e5),
            ),
        ),
        lanes=128,
        rollout_length=32,
        epochs=2,
        minibatches=4,
        gae_lambda=0.8,
        learning_rate=Linear(5e-4, 5e-5, steps=1e6),
        max_grad_norm=10.0,
    ),
)
