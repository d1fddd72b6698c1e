"""Losses that learn from an expert, or stay near a policy, solve the corridor; in one program.

Weights are numbers, so that each entry of `SETTINGS` is a run with losses of its own.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import Experiment, Stage, TrainingPipeline, make_train
from jaxact.losses import (
    PPO,
    Advisor,
    AdvisorImitation,
    GroupedImitation,
    Imitation,
    KLToReference,
    VTrace,
)
from jaxact.models import ActorCritic, Concatenated, NoMemory
from jaxact.pomdp import ExpertAction
from jaxact.spaces import Discrete
from jaxact.train_state import make_key
from tests.corridor import Corridor, ReachEnd, corridor
from tests.tiny import Plain

LANES, LENGTH, UPDATES = 16, 8, 60
# The first two actions go left and the last two right; of either two the expert prefers the first.
PREFERENCE = np.array([0.8, 0.2], np.float32)
ENTROPY = -float((PREFERENCE * np.log(PREFERENCE)).sum())


@dataclass(frozen=True)
class Doubled(Corridor):
    @property
    def action_space(self):
        return Discrete(4)

    def step(self, key, state, action):
        return super().step(key, state, action // 2)


@dataclass(frozen=True)
class Preferring(ReachEnd):
    def expert(self, key, task_state, state):
        advice = super().expert(key, task_state, state)
        policy = jnp.kron(jax.nn.one_hot(advice.action, 2), PREFERENCE)
        return ExpertAction(2 * advice.action, advice.valid, policy)


LOSSES = {
    "imitation": Imitation(),
    "groups": GroupedImitation(((0, 1), (2, 3))),
    "warm_start": AdvisorImitation(alpha=4.0),
    "advisor": Advisor(reinforcement=PPO(clip=0.2), alpha=4.0),
    "ppo": PPO(clip=0.2),
    "vtrace": VTrace(discount=0.95),
    "kl": KLToReference(),
}
SETTINGS = {
    "policies of an expert": {"imitation": 1.0},
    "groups of actions": {"groups": 1.0},
    "ADVISOR's warm start": {"warm_start": 1.0},
    "ADVISOR": {"advisor": 1.0},
    "V-trace": {"vtrace": 1.0},
    "PPO": {"ppo": 1.0},
    "PPO near where it began": {"ppo": 1.0, "kl": 0.1},
}


@pytest.fixture(scope="module")
def trained():
    pomdp = replace(corridor(), environment=Doubled(), task=Preferring())
    encoder = Concatenated({"vector": Plain()})
    model = ActorCritic(pomdp.action_space, encoder, NoMemory(), auxiliary_actor=True)
    weights = dict.fromkeys(LOSSES, 0.0)
    stage = Stage(LOSSES, UPDATES * LANES * LENGTH, weights=weights)
    pipeline = TrainingPipeline(
        (stage,), lanes=LANES, rollout_length=LENGTH, minibatches=2, epochs=2, learning_rate=2e-2
    )
    numbers = [
        {f"pipeline.stages.0.weights.{n}": jnp.float32(x) for n, x in (weights | setting).items()}
        for setting in SETTINGS.values()
    ]
    keys = jnp.stack([make_key(0)] * len(SETTINGS))
    train = jax.jit(jax.vmap(make_train(Experiment("all", pomdp, model, pipeline))))
    _, metrics = train(keys, jax.tree.map(lambda *xs: jnp.stack(xs), *numbers))
    return {
        setting: {name: np.asarray(x[index]) for name, x in metrics.items()}
        for index, setting in enumerate(SETTINGS)
    }


def success(metrics, part):
    return metrics["episodes/success"][part].sum() / metrics["episodes/count"][part].sum()


@pytest.mark.parametrize("name", SETTINGS)
def test_the_corridor_is_learnt(trained, name):
    assert success(trained[name], slice(0, 3)) < 0.75
    assert success(trained[name], slice(-10, None)) > 0.95


def test_whole_policies_are_imitated_and_groups_leave_the_choice_open(trained):
    """Measured by the cross-entropy with the expert's policy, which is at least its entropy."""
    soft = trained["policies of an expert"]["losses/imitation/cross_entropy"][-5:].mean()
    assert soft == pytest.approx(ENTROPY, abs=0.05)
    groups = trained["groups of actions"]
    assert groups["losses/groups/cross_entropy"][-5:].mean() < 0.05
    assert groups["losses/imitation/cross_entropy"][-5:].mean() > ENTROPY + 0.1


@pytest.mark.parametrize("name", ["ADVISOR's warm start", "ADVISOR"])
def test_advisor_follows_the_expert_the_more_it_is_understood(trained, name):
    (loss,) = SETTINGS[name]
    weight = trained[name][f"losses/{loss}/imitation_weight"]
    assert weight[0] < 0.1 < 0.6 < weight[-1]


def test_a_policy_stays_near_its_reference_while_it_learns(trained):
    free, held = (trained[name]["losses/kl/kl"] for name in ("PPO", "PPO near where it began"))
    assert free[0] == pytest.approx(held[0], abs=0.05)
    assert held[-5:].mean() < 0.5 * free[-5:].mean()
