"""BabyAI-GoToLocal with PPO and three auxiliary losses, each with a belief of its own.

The beliefs are fused by attention (Ye et al. 2020); the weights are those of AllenAct's ObjectNav.

python -m jaxact.train examples/babyai_gotolocal_auxiliary.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import CPCA, PPO, FusionEntropy, InverseDynamics, TemporalDistance
from jaxact.models import GRU, ActorCritic, InstructedGrid, MultipleBeliefs
from jaxact.schedules import Linear

pomdp = envs_jax.make("BabyAI-GoToLocal-v0")
actions = pomdp.action_space
beliefs = MultipleBeliefs({name: GRU(64) for name in ("inverse", "distance", "cpca")})

experiment = Experiment(
    name="babyai_gotolocal_auxiliary",
    pomdp=pomdp,
    model=ActorCritic(actions, InstructedGrid(), beliefs),
    pipeline=TrainingPipeline(
        stages=(
            Stage(
                losses={
                    "ppo": PPO(clip=0.2),
                    "inverse_dynamics": InverseDynamics(action_space=actions, belief="inverse"),
                    "temporal_distance": TemporalDistance(belief="distance"),
                    "cpca": CPCA(action_space=actions, steps=4, belief="cpca"),
                    "fusion": FusionEntropy(),
                },
                weights={
                    "inverse_dynamics": 0.1,
                    "temporal_distance": 0.4,
                    "cpca": 0.1,
                    "fusion": 0.01,
                },
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
