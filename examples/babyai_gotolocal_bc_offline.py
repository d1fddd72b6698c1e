r"""BabyAI-GoToLocal from demonstrations alone: behaviour cloning off the policy, without a world.

python -m jaxact.collect examples/babyai_gotolocal_bc_offline.py --episodes 1000000 \
    --output demonstrations/gotolocal_partial
python -m jaxact.train examples/babyai_gotolocal_bc_offline.py
"""

import envs_jax
from envs_jax.minigrid.partial_expert import partially_observing
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import Imitation
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear
from jaxact.storages import DemonstrationStorage

# Like BabyAI's own expert, this one knows no more of the room than the agent has seen.
pomdp = partially_observing(envs_jax.make("BabyAI-GoToLocal-v0"))
demonstrations = DemonstrationStorage(
    losses={"imitation": Imitation()},
    path="demonstrations/gotolocal_partial",
    lanes=64,
    length=16,
    updates=8,
)

experiment = Experiment(
    name="babyai_gotolocal_bc_offline",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(Stage({}, steps=4_000_000, storages={"demonstrations": demonstrations}),),
        lanes=512,
        rollout_length=16,
        learning_rate=Linear(1e-3, 1e-4, steps=4e6),
    ),
)
