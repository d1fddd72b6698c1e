"""Gymnasium's bodies walk, run, swim, hop and reach on MJX, by PPO or soft actor-critic.

python -m jaxact.train examples/physics_locomotion.py:hopper

A name after the colon is one of `experiments`: a body, or with SAC `hopper_sac`. Observations are
normalised by statistics that are learnt beside the policy. No episode counts as a success where
Gymnasium has no threshold: the return is what is learnt.
"""

from collections.abc import Mapping
from types import MappingProxyType

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, SAC, Critic, Target
from jaxact.models import ActorCritic, Concatenated, NoMemory, Normalized, Vector
from jaxact.pomdp import POMDP
from jaxact.schedules import Linear
from jaxact.storages import Replay

_BODIES = {
    "inverted_double_pendulum": "InvertedDoublePendulum",
    "reacher": "Reacher",
    "swimmer": "Swimmer",
    "half_cheetah": "HalfCheetah",
    "hopper": "Hopper",
    "walker2d": "Walker2d",
    "ant": "Ant",
    "humanoid": "Humanoid",
}
# A swimmer that looks less far ahead than its strokes last learns to wriggle on the spot.
_DISCOUNTS: Mapping[str, float] = MappingProxyType({"swimmer": 0.9999})
_PPO_STEPS, _SAC_STEPS = 3_000_000, 300_000


def _encoder(pomdp: POMDP) -> Normalized:
    return Normalized(Concatenated({name: Vector((64, 64)) for name in pomdp.sensors}))


def _ppo(name: str, pomdp: POMDP) -> Experiment:
    return Experiment(
        name=f"physics_locomotion_{name}",
        pomdp=pomdp,
        model=ActorCritic(pomdp.action_space, _encoder(pomdp), NoMemory()),
        pipeline=TrainingPipeline(
            stages=(
                Stage(
                    losses={"ppo": PPO(clip=0.2, clip_value=False, entropy=0.0, value=0.01)},
                    steps=_PPO_STEPS,
                ),
            ),
            lanes=64,
            rollout_length=64,
            epochs=10,
            minibatches=16,
            discount=_DISCOUNTS.get(name, 0.99),
            learning_rate=Linear(3e-4, 0.0, steps=_PPO_STEPS),
            max_grad_norm=0.5,
        ),
    )


def _sac(name: str, pomdp: POMDP) -> Experiment:
    encoder, discount = _encoder(pomdp), _DISCOUNTS.get(name, 0.99)
    sac = SAC(critic=Critic(encoder, (64,)), discount=discount, target=Target(rate=0.005))
    replay = Replay(
        losses={"sac": sac}, capacity=300_000, lanes=256, length=2, updates=64, start_after=5_000
    )
    return Experiment(
        name=f"physics_locomotion_{name}_sac",
        pomdp=pomdp,
        model=ActorCritic(pomdp.action_space, encoder, NoMemory(), squashed=True),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={}, storages={"replay": replay}, steps=_SAC_STEPS),),
            lanes=16,
            rollout_length=4,
            discount=discount,
            learning_rate=1e-3,
            max_grad_norm=10.0,
        ),
    )


_WORLDS = {name: envs_jax.make(f"Physics-{body}-v0") for name, body in _BODIES.items()}
experiments = {
    **{name: _ppo(name, pomdp) for name, pomdp in _WORLDS.items()},
    **{f"{name}_sac": _sac(name, pomdp) for name, pomdp in _WORLDS.items()},
}
experiment = experiments["swimmer"]
