"""BabyAI-GoToLocal with DAgger on soft targets: the expert gives probabilities, not an action.

python -m jaxact.train examples/babyai_gotolocal_soft.py
"""

import dataclasses

import jax

import envs_jax
from envs_jax.minigrid.tasks import GoToTask
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import Imitation
from jaxact.models import GRU, ActorCritic, InstructedGrid
from jaxact.schedules import Linear


@dataclasses.dataclass(frozen=True)
class Smoothed(GoToTask):
    """The task with an expert that is not quite sure: 1 − ε for its action, ε over all of them."""

    epsilon: float = 0.1

    def expert(self, key, task_state, state):
        """Returns the expert's action, and the whole policy to imitate."""
        advice = super().expert(key, task_state, state)
        actions = pomdp.action_space.n
        chosen = jax.nn.one_hot(advice.action, actions)
        policy = (1.0 - self.epsilon) * chosen + self.epsilon / actions
        return dataclasses.replace(advice, policy=policy)


pomdp = envs_jax.make("BabyAI-GoToLocal-v0")
pomdp = dataclasses.replace(pomdp, task=Smoothed(**vars(pomdp.task)))

experiment = Experiment(
    name="babyai_gotolocal_soft",
    pomdp=pomdp,
    model=ActorCritic(pomdp.action_space, InstructedGrid(), GRU(128)),
    pipeline=TrainingPipeline(
        stages=(
            Stage(
                losses={"imitation": Imitation()},
                teacher_forcing=Linear(1.0, 0.0, steps=5e5),
                steps=1_500_000,
            ),
        ),
        lanes=512,
        rollout_length=16,
        epochs=4,
        minibatches=8,
        learning_rate=Linear(1e-3, 1e-4, steps=1.5e6),
    ),
)
