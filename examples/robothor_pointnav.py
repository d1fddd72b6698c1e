"""PointNav in RoboTHOR's manner: depth and the goal's direction, PPO, houses never seen before.

python -m jaxact.train examples/robothor_pointnav.py

A name after the colon is one of `experiments`: `robothor_pointnav.py:noisy` has motors that err as
RoboTHOR's LoCoBot's do, and `:blind` no camera, which tells what seeing is worth.
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO
from jaxact.models import GRU, ActorCritic, Concatenated, Image, Vector
from jaxact.schedules import Linear

_STEPS = 10_000_000
_GOAL = Vector((32, 32))
_DEPTH = Image(128, channels=(16, 32, 32), sizes=(5, 3, 3), strides=(2, 2, 2))


def _experiment(name: str, *, sees: bool = True, noisy: bool = False) -> Experiment:
    pomdp = envs_jax.make(
        "RoboTHOR-PointNav-v0",
        observation=("depth",) if sees else (),
        resolution=32,
        noisy=noisy,
    )
    parts = {"depth": _DEPTH, "point_goal": _GOAL} if sees else {"point_goal": _GOAL}
    return Experiment(
        name=name,
        pomdp=pomdp,
        model=ActorCritic(pomdp.action_space, Concatenated(parts), GRU(128), previous_action=True),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={"ppo": PPO(clip=0.2)}, steps=_STEPS),),
            lanes=128,
            rollout_length=64,
            epochs=2,
            minibatches=4,
            learning_rate=Linear(5e-4, 5e-5, steps=_STEPS),
            max_grad_norm=0.5,
        ),
    )


experiments = {
    "depth": _experiment("robothor_pointnav"),
    "noisy": _experiment("robothor_pointnav_noisy", noisy=True),
    "blind": _experiment("robothor_pointnav_blind", sees=False),
}
experiment = experiments["depth"]
