"""ManipulaTHOR's ArmPointNav by physics: a robot fetches a ball and carries it elsewhere, by PPO.

python -m jaxact.train examples/arm_point_nav.py:easy

A name after the colon is one of `experiments`: `easy` takes the ball as soon as the hand is near
it, and ends the episode by itself; in `full`, the default, the agent has actions for both, and
`disturbance` charges for other balls that are moved, besides.
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO
from jaxact.models import GRU, ActorCritic, Concatenated, Normalized, Vector
from jaxact.pomdp import POMDP
from jaxact.schedules import Linear

_STEPS = 10_000_000


def _experiment(name: str, pomdp: POMDP) -> Experiment:
    encoder = Normalized(Concatenated({sensor: Vector((64, 64)) for sensor in pomdp.sensors}))
    return Experiment(
        name=name,
        pomdp=pomdp,
        model=ActorCritic(pomdp.action_space, encoder, GRU(128), previous_action=True),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={"ppo": PPO(clip=0.1)}, steps=_STEPS),),
            lanes=64,
            rollout_length=128,
            learning_rate=Linear(3e-4, 0.0, steps=_STEPS),
            max_grad_norm=0.5,
        ),
    )


experiments = {
    "full": _experiment("arm_point_nav", envs_jax.make("Physics-ArmPointNav-v0")),
    "easy": _experiment("arm_point_nav_easy", envs_jax.make("Physics-ArmPointNav-v0", easy=True)),
    "disturbance": _experiment(
        "arm_point_nav_disturbance", envs_jax.make("Physics-ArmPointNav-v0", disturbance=15.0)
    ),
}
experiment = experiments["full"]
