"""MiniGrid-Empty-8x8 with three objectives: to arrive, to come nearer, and not to turn too much.

python -m jaxact.train examples/minigrid_empty_shaped.py \
    --set pipeline.stages.0.rewards.effort=0.1
"""

import dataclasses

import jax.numpy as jnp

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear
from jaxact.shaping import Potential, Shaped

GOAL = (6, 6)


def nearness(state, task_state):
    """Minus the steps to the goal, in units of ten; a potential changes no policy's rank."""
    distance = jnp.sum(jnp.abs(state.position - jnp.array(GOAL, jnp.int32)))
    return -0.1 * distance.astype(jnp.float32)


def effort(before, action, after, task_state, next_task_state):
    """A price on turning; unlike a potential it changes what is best."""
    return -(before.direction != after.direction).astype(jnp.float32)


pomdp = envs_jax.make("MiniGrid-Empty-8x8-v0")
shaped = Shaped(pomdp.task, {"nearness": Potential(nearness), "effort": effort})
pomdp = dataclasses.replace(pomdp, task=shaped)

experiment = Experiment(
    name="minigrid_empty_shaped",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(64), GRU(64)),
    pipeline=TrainingPipeline(
        stages=(
            Stage(
                losses={"ppo": PPO(clip=0.2)},
                # Each component is logged by its name; weights are numbers that can be swept.
                rewards={"success": 1.0, "nearness": 0.5, "effort": 0.01},
                steps=300_000,
            ),
        ),
        lanes=64,
        rollout_length=32,
        epochs=4,
        minibatches=4,
        learning_rate=Linear(1e-3, 1e-4, steps=3e5),
    ),
)
