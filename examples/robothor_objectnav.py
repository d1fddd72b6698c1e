"""ObjectNav in RoboTHOR's manner: imitation before PPO, or PPO alone, in houses never seen before.

python -m jaxact.train examples/robothor_objectnav.py

A name after the colon is one of `experiments`: `robothor_objectnav.py:ppo` is the same without the
expert. The agent sees depth and which pixels show what it is to find, as a perfect detector would
tell it, so that what it has to learn is where to look.
"""

from collections.abc import Sequence

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, Imitation
from jaxact.models import GRU, ActorCritic, Concatenated, Embedding, Image
from jaxact.schedules import Linear

_STEPS, _IMITATION = 3_000_000, 750_000

_pomdp = envs_jax.make("RoboTHOR-ObjectNav-v0", observation=("depth", "goal_mask"), resolution=32)


def _image(features: int, channels: tuple[int, int, int]) -> Image:
    return Image(features, channels=channels, sizes=(5, 3, 3), strides=(2, 2, 2))


def _experiment(name: str, stages: Sequence[Stage]) -> Experiment:
    parts = {
        "depth": _image(128, (16, 32, 32)),
        "goal_mask": _image(64, (4, 8, 16)),
        "object_goal": Embedding(16, 12),
    }
    return Experiment(
        name=name,
        pomdp=_pomdp,
        model=ActorCritic(_pomdp.action_space, Concatenated(parts), GRU(192), previous_action=True),
        pipeline=TrainingPipeline(
            stages=tuple(stages),
            lanes=128,
            rollout_length=64,
            epochs=2,
            minibatches=4,
            learning_rate=Linear(5e-4, 5e-5, steps=_STEPS),
            max_grad_norm=0.5,
        ),
    )


_ppo = PPO(clip=0.2)
_dagger = Stage(
    {"imitation": Imitation()}, _IMITATION, teacher_forcing=Linear(1.0, 0.0, _IMITATION // 2)
)
experiments = {
    "imitation_to_ppo": _experiment(
        "robothor_objectnav", [_dagger, Stage({"ppo": _ppo}, _STEPS - _IMITATION)]
    ),
    "ppo": _experiment("robothor_objectnav_ppo", [Stage({"ppo": _ppo}, _STEPS)]),
}
experiment = experiments["imitation_to_ppo"]
