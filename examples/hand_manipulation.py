"""A hand over a table reaches, pushes, and picks and places a cube: Meta-World's tasks, PPO or SAC.

python -m jaxact.train examples/hand_manipulation.py

A name after the colon is one of `experiments`: `hand_manipulation.py:pick_place`, or with SAC
`hand_manipulation.py:pick_place_sac`. Episodes are of 200 steps, not of Meta-World's 500.
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, SAC, Critic, Target
from jaxact.models import ActorCritic, Concatenated, NoMemory, Vector
from jaxact.pomdp import POMDP
from jaxact.schedules import Linear
from jaxact.storages import Replay

_HORIZON = 200
_WORLDS = {
    "reach": envs_jax.make("Physics-Reach-v0", robot="hand", horizon=_HORIZON),
    "push": envs_jax.make("Physics-Push-v0", horizon=_HORIZON),
    "pick_place": envs_jax.make("Physics-PickPlace-v0", horizon=_HORIZON),
}
_PPO_STEPS = {"reach": 1_000_000, "push": 5_000_000, "pick_place": 20_000_000}
_SAC_STEPS = {"reach": 100_000, "push": 500_000, "pick_place": 1_000_000}


def _encoder(pomdp: POMDP) -> Concatenated:
    return Concatenated({name: Vector((128, 128)) for name in pomdp.sensors})


def _ppo(name: str, pomdp: POMDP) -> Experiment:
    steps = _PPO_STEPS[name]
    return Experiment(
        name=f"hand_manipulation_{name}",
        pomdp=pomdp,
        model=ActorCritic(pomdp.action_space, _encoder(pomdp), NoMemory()),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={"ppo": PPO(clip=0.2, entropy=1e-3)}, steps=steps),),
            lanes=128,
            rollout_length=64,
            epochs=8,
            minibatches=4,
            learning_rate=Linear(1e-3, 5e-5, steps=steps),
        ),
    )


def _sac(name: str, pomdp: POMDP) -> Experiment:
    encoder = _encoder(pomdp)
    replay = Replay(
        losses={
            "sac": SAC(critic=Critic(encoder, (128,)), discount=0.98, target=Target(rate=0.01))
        },
        capacity=200_000,
        lanes=256,
        length=2,
        updates=32,
        start_after=5_000,
    )
    return Experiment(
        name=f"hand_manipulation_{name}_sac",
        pomdp=pomdp,
        model=ActorCritic(pomdp.action_space, encoder, NoMemory(), squashed=True),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={}, storages={"replay": replay}, steps=_SAC_STEPS[name]),),
            lanes=16,
            rollout_length=8,
            learning_rate=1e-3,
            max_grad_norm=10.0,
        ),
    )


experiments = {
    **{name: _ppo(name, pomdp) for name, pomdp in _WORLDS.items()},
    **{f"{name}_sac": _sac(name, pomdp) for name, pomdp in _WORLDS.items()},
}
experiment = experiments["push"]
