r"""BabyAI-GoToLocal with AllenAct's numbers: the large model, its batches and its lengths.

python -m jaxact.train examples/babyai_gotolocal_paper.py:ppo

A name after the colon is one of `experiments`. The model has 20.3 million parameters, and the
batches were made for GPUs: PPO takes 7 GiB, and 604 million floating-point operations for each
environment step. `--set pipeline.lanes=64 --set model.memory_size=128` is for smaller machines.
`bc_offline` learns from recorded demonstrations alone:

python -m jaxact.collect examples/babyai_gotolocal_paper.py:bc_offline --episodes 1000000 \
    --output demonstrations/gotolocal_partial
"""

from typing import Any

import optax

import envs_jax
from envs_jax.minigrid.partial_expert import partially_observing
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import A2C, PPO, Imitation
from jaxact.models import FiLMActorCritic
from jaxact.schedules import Linear
from jaxact.storages import DemonstrationStorage

# As AllenAct's expert does, this one knows no more of the room than the agent has seen.
pomdp = partially_observing(envs_jax.make("BabyAI-GoToLocal-v0"))
model = FiLMActorCritic(pomdp.action_space)

REINFORCEMENT = 15e6
IMITATION = 7.5e6
# Sixteen batches of demonstrations, each of 32 × 128 steps, in the place of a rollout's
# 128 × 128 steps, which is what the length of the whole was counted in.
OFFLINE = 4 * IMITATION


def _experiment(method: str, stage: Stage, **numbers: Any) -> Experiment:
    shared = {
        "lanes": 128,
        "rollout_length": 128,
        "epochs": 4,
        "minibatches": 4,
        "gae_lambda": 0.99,
        "learning_rate": Linear(1e-3, 0.0, float(stage.steps)),
        "optimizer": optax.adam,
        "optimizer_options": {"eps": 1e-8},
    }
    pipeline = TrainingPipeline((stage,), **(shared | numbers))
    return Experiment(f"babyai_gotolocal_paper_{method}", pomdp, model, pipeline)


def _experiments() -> dict[str, Experiment]:
    imitation, forced_less = {"imitation": Imitation()}, Linear(1.0, 0.0, IMITATION / 2)
    demonstrations = DemonstrationStorage(
        losses=imitation, path="demonstrations/gotolocal_partial", lanes=32, length=128, updates=16
    )
    ppo = Stage({"ppo": PPO(clip=Linear(0.1, 0.0, REINFORCEMENT))}, int(REINFORCEMENT))
    a2c = Stage({"a2c": A2C()}, int(REINFORCEMENT))
    constant = {"learning_rate": 1e-4}
    offline = Stage({}, int(OFFLINE), storages={"demonstrations": demonstrations})
    found = {
        "ppo": _experiment("ppo", ppo, lanes=1536, rollout_length=32, **constant),
        "a2c": _experiment(
            "a2c", a2c, lanes=768, rollout_length=16, epochs=1, minibatches=1, **constant
        ),
        "bc_offline": _experiment("bc_offline", offline),
    }
    for method, forcing in {"bc": None, "dagger": forced_less, "bc_forced": 1.0}.items():
        stage = Stage(imitation, int(IMITATION), teacher_forcing=forcing)
        found[method] = _experiment(method, stage)
    return found


experiments = _experiments()
experiment = experiments["ppo"]
