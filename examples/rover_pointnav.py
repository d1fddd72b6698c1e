"""PointNav by physics: a rover drives to points among boxes, with lidar and PPO.

python -m jaxact.train examples/rover_pointnav.py

`rover_pointnav.py:velocities` trains the same rover at the same task with continuous actions, and
`:randomized` with other masses, frictions and motors in every episode.
"""

from dataclasses import replace

import envs_jax
from envs_jax.physics import Physics, Randomized
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO
from jaxact.models import GRU, ActorCritic, Concatenated, Vector
from jaxact.pomdp import POMDP
from jaxact.schedules import Linear

_STEPS = 2_000_000


def _experiment(name: str, pomdp: POMDP) -> Experiment:
    parts = {"goal": Vector((32,)), "lidar": Vector((64, 64)), "speed": Vector((32,))}
    return Experiment(
        name=name,
        pomdp=pomdp,
        model=ActorCritic(pomdp.action_space, Concatenated(parts), GRU(64), previous_action=True),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={"ppo": PPO(clip=0.2)}, steps=_STEPS),),
            lanes=64,
            rollout_length=64,
            learning_rate=Linear(5e-4, 5e-5, steps=_STEPS),
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

experiments = {
    "moves": _experiment("rover_pointnav", _MOVES),
    "velocities": _experiment(
        "rover_pointnav_velocities", envs_jax.make("Physics-PointNav-v0", control="velocities")
    ),
    "randomized": _experiment("rover_pointnav_randomized", _randomized(_MOVES)),
}
experiment = experiments["moves"]
