"""Brax's arm of two joints reaches for a target, by PPO or soft actor-critic.

python -m jaxact.train examples/brax_reacher.py

A name after the colon is one of `experiments`: `brax_reacher.py:sac`. The reward is minus the
distance to the target, `dist`, and a cost of acting, `ctrl`; episodes here are of 50 steps, as
Gymnasium's. There is no end but the horizon, and none counts as a success.
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, SAC, Critic, Target
from jaxact.models import ActorCritic, Concatenated, NoMemory, Normalized, Vector
from jaxact.schedules import Linear
from jaxact.storages import Replay

_POMDP = envs_jax.make("Brax-reacher-v0", horizon=50)
# Velocities are hundreds of times as large as what is left to the target.
_ENCODER = Normalized(Concatenated({"observation": Vector((64, 64))}))
_PPO_STEPS, _SAC_STEPS = 400_000, 40_000

_replay = Replay(
    losses={"sac": SAC(critic=Critic(_ENCODER, (64,)), discount=0.95, target=Target(rate=0.02))},
    capacity=40_000,
    lanes=128,
    length=2,
    updates=16,
    start_after=2_000,
)

experiments = {
    "ppo": Experiment(
        name="brax_reacher_ppo",
        pomdp=_POMDP,
        model=ActorCritic(_POMDP.action_space, _ENCODER, NoMemory(), squashed=True),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={"ppo": PPO(clip=0.2, entropy=0.0)}, steps=_PPO_STEPS),),
            lanes=128,
            rollout_length=25,
            epochs=8,
            minibatches=4,
            discount=0.95,
            learning_rate=Linear(1e-3, 1e-4, steps=_PPO_STEPS),
        ),
    ),
    "sac": Experiment(
        name="brax_reacher_sac",
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
