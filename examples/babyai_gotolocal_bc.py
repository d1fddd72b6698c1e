"""BabyAI-GoToLocal with behaviour cloning on the agent's own states.

python -m jaxact.train examples/babyai_gotolocal_bc.py
"""

import envs_jax
from envs_jax.minigrid.partial_expert import partially_observing
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import Imitation
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear

# Like BabyAI's own expert, this one knows no more of the room than the agent has seen.
pomdp = partially_observing(envs_jax.make("BabyAI-GoToLocal-v0"))

experiment = Experiment(
    name="babyai_gotolocal_bc",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(Stage(losses={"imitation": Imitation()}, steps=1_500_000),),
        lanes=512,
        rollout_length=16,
        epochs=4,
        minibatches=8,
        learning_rate=Linear(1e-3, 1e-4, steps=1.5e6),
    ),
)
