"""An environment of Gymnasium, simulated outside of JAX: PPO on CartPole-v1, solved from 475 on.

python -m jaxact.train examples/gymnasium_cartpole.py
"""

from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.from_gymnasium import from_gymnasium
from jaxact.losses import PPO
from jaxact.models import ActorCritic, Concatenated, NoMemory, Vector
from jaxact.schedules import Linear

LANES = 16
STEPS = 100_000
CLIP = Linear(0.2, 0.0, float(STEPS))

pomdp = from_gymnasium("CartPole-v1", simulators=LANES)

experiment = Experiment(
    name="gymnasium_cartpole",
    pomdp=pomdp,
    model=ActorCritic(
        pomdp.action_space, Concatenated({"observation": Vector((64, 64))}), NoMemory()
    ),
    pipeline=TrainingPipeline(
        stages=(Stage(losses={"ppo": PPO(clip=CLIP, clip_value=False)}, steps=STEPS),),
        lanes=LANES,
        rollout_length=32,
        epochs=8,
        minibatches=2,
        discount=0.98,
        gae_lambda=0.8,
        learning_rate=Linear(1e-3, 0.0, float(STEPS)),
    ),
)
