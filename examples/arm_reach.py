"""An arm of three joints brings its tip to drawn points, moved by torques: PPO or SAC.

python -m jaxact.train examples/arm_reach.py

A name after the colon is one of `experiments`: `arm_reach.py:sac`.
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, SAC, Critic, Target
from jaxact.models import ActorCritic, Concatenated, NoMemory, Vector
from jaxact.schedules import Linear
from jaxact.storages import Replay

_POMDP = envs_jax.make("Physics-Reach-v0")
_ENCODER = Concatenated({name: Vector((128, 128)) for name in _POMDP.sensors})
_PPO_STEPS, _SAC_STEPS = 4_000_000, 300_000

_replay = Replay(
    losses={"sac": SAC(critic=Critic(_ENCODER, (128,)), discount=0.98, target=Target(rate=0.01))},
    capacity=200_000,
    lanes=256,
    length=2,
    updates=32,
    start_after=5_000,
)

experiments = {
    "ppo": Experiment(
        name="arm_reach_ppo",
        pomdp=_POMDP,
        model=ActorCritic(_POMDP.action_space, _ENCODER, NoMemory()),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={"ppo": PPO(clip=0.2, entropy=0.003)}, steps=_PPO_STEPS),),
            lanes=128,
            rollout_length=32,
            epochs=8,
            minibatches=4,
            learning_rate=Linear(5e-4, 2e-5, steps=_PPO_STEPS),
        ),
    ),
    "sac": Experiment(
        name="arm_reach_sac",
        pomdp=_POMDP,
        model=ActorCritic(_POMDP.action_space, _ENCODER, NoMemory(), squashed=True),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={}, storages={"replay": _replay}, steps=_SAC_STEPS),),
            lanes=16,
            rollout_length=8,
            learning_rate=1e-3,
            max_grad_norm=10.0,
        ),
    ),
}
experiment = experiments["ppo"]
