"""A pole on a cart is balanced, by PPO or soft actor-critic: Gymnasium's InvertedPendulum on MJX.

python -m jaxact.train examples/physics_pendulum.py

A name after the colon is one of `experiments`: `physics_pendulum.py:sac`. An episode succeeds with
a return of 950, Gymnasium's threshold; 1,000 is the most there is.
"""

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, SAC, Critic, Target
from jaxact.models import ActorCritic, Concatenated, NoMemory, Vector
from jaxact.schedules import Linear
from jaxact.storages import Replay

_POMDP = envs_jax.make("Physics-InvertedPendulum-v0")
_ENCODER = Concatenated({"joints": Vector((64, 64))})
_PPO_STEPS, _SAC_STEPS = 300_000, 60_000

# Returns grow to 100: the value has to get there, and its error must not drown the policy's.
_ppo = PPO(clip=0.2, clip_value=False, entropy=0.0, value=0.01)
_replay = Replay(
    losses={"sac": SAC(critic=Critic(_ENCODER, (64,)), discount=0.99, target=Target(rate=0.01))},
    capacity=50_000,
    lanes=128,
    length=2,
    updates=32,
    start_after=2_000,
)

experiments = {
    "ppo": Experiment(
        name="physics_pendulum_ppo",
        pomdp=_POMDP,
        model=ActorCritic(_POMDP.action_space, _ENCODER, NoMemory()),
        pipeline=TrainingPipeline(
            stages=(Stage(losses={"ppo": _ppo}, steps=_PPO_STEPS),),
            lanes=64,
            rollout_length=64,
            epochs=8,
            minibatches=4,
            learning_rate=Linear(1e-3, 1e-4, steps=_PPO_STEPS),
        ),
    ),
    "sac": Experiment(
        name="physics_pendulum_sac",
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
