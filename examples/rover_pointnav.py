"""PointNav by physics: a rover drives to points among boxes, with lidar and PPO.

python -m jaxact.train examples/rover_pointnav.py

`rover_pointnav.py:velocities` trains the same rover at the same task with continuous actions,
`:velocities_sac` does so by soft actor-critic, and `:randomized` gives it other masses, frictions
and motors in every episode.
"""

from dataclasses import replace

import envs_jax
from envs_jax.physics import Physics, Randomized
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, SAC, Critic, Target
from jaxact.models import GRU, ActorCritic, Concatenated, NoMemory, Vector
from jaxact.pomdp import POMDP
from jaxact.schedules import Linear
from jaxact.storages import Replay

_STEPS, _SAC_STEPS = 2_000_000, 500_000
_ENCODER = Concatenated({"goal": Vector((32,)), "lidar": Vector((64, 64)), "speed": Vector((32,))})
_replay = Replay(
    losses={"sac": SAC(critic=Critic(_ENCODER, (128,)), discount=0.99, target=Target(rate=0.01))},
    capacity=300_000,
    lanes=256,
    length=2,
    updates=32,
    start_after=5_000,
)


def _experiment(name: str, pomdp: POMDP) -> Experiment:
    return Experiment(
        name=name,
        pomdp=pomdp,
        model=ActorCritic(pomdp.action_space, _ENCODER, GRU(64), previous_action=True),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={"ppo": PPO(clip=0.2)}, steps=_STEPS),),
            lanes=64,
            rollout_length=64,
            learning_rate=Linear(5e-4, 5e-5, steps=_STEPS),
        ),
    )


def _soft_actor_critic(name: str, pomdp: POMDP) -> Experiment:
    return Experiment(
        name=name,
        pomdp=pomdp,
        model=ActorCritic(pomdp.action_space, _ENCODER, NoMemory(), squashed=True),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={}, storages={"replay": _replay}, steps=_SAC_STEPS),),
            lanes=16,
            rollout_length=8,
            learning_rate=1e-3,
            max_grad_norm=10.0,
        ),
    )


def _randomized(pomdp: POMDP) -> POMDP:
    world = pomdp.environment
    assert isinstance(world, Physics)
    sampler = Randomized(
        pomdp.sampler, world, mass=(0.7, 1.4), friction=(0.3, 3.0), gain=(0.7, 1.4)
    )
    return replace(pomdp, sampler=sampler)


_MOVES = envs_jax.make("Physics-PointNav-v0")
_VELOCITIES = envs_jax.make("Physics-PointNav-v0", control="velocities")

experiments = {
    "moves": _experiment("rover_pointnav", _MOVES),
    "velocities": _experiment("rover_pointnav_velocities", _VELOCITIES),
    "velocities_sac": _soft_actor_critic("rover_pointnav_velocities_sac", _VELOCITIES),
    "randomized": _experiment("rover_pointnav_randomized", _randomized(_MOVES)),
}
experiment = experiments["moves"]
