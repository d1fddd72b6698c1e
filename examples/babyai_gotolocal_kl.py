"""BabyAI-GoToLocal: DAgger, then PPO that is held near what was imitated, ever more loosely.

python -m jaxact.train examples/babyai_gotolocal_kl.py
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, Imitation, KLToReference
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear

pomdp = envs_jax.make("BabyAI-GoToLocal-v0")

experiment = Experiment(
    name="babyai_gotolocal_kl",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(
            Stage(
                losses={"imitation": Imitation()},
                teacher_forcing=Linear(1.0, 0.0, steps=1.5e5),
                steps=300_000,
            ),
            Stage(
                # The reference is the policy as this stage begins; KLToReference(run=…) takes a
                # run's instead.
                losses={"ppo": PPO(clip=0.2), "kl": KLToReference()},
                weights={"kl": Linear(0.2, 0.0, steps=1e6)},
                steps=1_700_000,
                overrides={"learning_rate": Linear(5e-4, 1e-4, steps=1.7e6)},
            ),
        ),
        lanes=512,
        rollout_length=16,
        epochs=2,
        minibatches=4,
        learning_rate=2e-3,
    ),
)
