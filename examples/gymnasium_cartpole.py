"""An environment of Gymnasium, simulated outside of JAX: PPO on CartPole-v1, solved from 475 on.

python -m jaxact.train examples/gymnasium_cartpole.py
"""

from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.from_gymnasium import from_gymnasium
from jaxact.losses import PPO
from jaxact.models import ActorCritic, Concatenated, NoMemory, Vector
from jaxact.schedules import Linear

LANES = 32
STEPS = 100_000

pomdp = from_gymnasium("CartPole-v1", simulators=LANES)

experiment = Experiment(
    name="gymnasium_cartpole",
    pomdp=pomdp,
    model=ActorCritic(
        pomdp.action_space, Concatenated({"observation": Vector((64, 64))}), NoMemory()
    ),
    pipeline=TrainingPipeline(
        # The value of a whole episode is then about 1.
        stages=(Stage(losses={"ppo": PPO(clip=0.2)}, steps=STEPS, rewards={"reward": 0.02}),),
        lanes=LANES,
        rollout_length=32,
        epochs=8,
        minibatches=4,
        discount=0.98,
        learning_rate=Linear(1e-3, 0.0, float(STEPS)),
    ),
)
