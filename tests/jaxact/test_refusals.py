"""What would train in silence without learning what was meant is refused with a sentence."""

import dataclasses

import jax
import pytest

import jaxact
from jaxact import JaxactError, Stage
from jaxact.losses import (
    CPCA,
    DQN,
    PPO,
    Curiosity,
    GroupedImitation,
    Imitation,
    Target,
    TemporalDistance,
)
from jaxact.models import Concatenated, NoMemory, QNetwork, Vector
from jaxact.search_space import uniform
from jaxact.spaces import Discrete
from jaxact.storages import DemonstrationStorage
from tests.corridor import corridor
from tests.tiny import experiment

OFFLINE = {"offline": DemonstrationStorage(losses={"bc": Imitation()}, path="nowhere")}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DQN(n_step=0), "n_step of DQN must be at least 1, got 0"),
        (lambda: Target(every=0), "every of Target must be at least 1, got 0"),
        (lambda: TemporalDistance(pairs=0), "pairs of TemporalDistance must be at least 1"),
        (lambda: CPCA(action_space=Discrete(2), steps=0), "steps of CPCA must be at least 1"),
        (lambda: GroupedImitation(((), (0, 1))), "each of one or more numbers from 0"),
        (lambda: Stage({"ppo": PPO}, 1), r"'ppo' of a stage is no loss .* write PPO\(...\)"),
        (lambda: Stage({"ppo": 0.5}, 1), "'ppo' of a stage is no loss but 0.5"),
        (
            lambda: Stage({}, 1, storages=OFFLINE, teacher_forcing=0.5),
            "teacher_forcing is about rollouts, and a stage that learns from 'offline' alone",
        ),
        (lambda: Stage({}, 1, storages=OFFLINE, exploration=0.5), "exploration is about rollouts"),
        (
            lambda: jaxact.sweep(experiment(), {"pipeline.discount": uniform(0, 1)}, seeds=3),
            r"seeds must be several numbers, such as \(3,\), got 3",
        ),
    ],
)
def test_numbers_and_things_that_mean_nothing(make, message):
    with pytest.raises(JaxactError, match=message):
        make()


def with_losses(losses, **changes):
    whole = experiment()
    pipeline = dataclasses.replace(whole.pipeline, stages=(Stage(losses, 64),))
    return dataclasses.replace(whole, pipeline=pipeline, **changes)


def test_a_rewarding_loss_has_a_name_of_its_own():
    action_space = corridor().action_space
    curious = Curiosity(action_space=action_space, encoder=Concatenated({"vector": Vector((4,))}))
    with_losses({"ppo": PPO(), "curiosity": curious}).check()
    with pytest.raises(JaxactError, match="'success' rewards under its own name, which is that of"):
        with_losses({"ppo": PPO(), "success": curious}).check()


def test_a_policy_is_not_learnt_by_a_model_of_values():
    encoder = Concatenated({"vector": Vector((4,))})
    model = QNetwork(corridor().action_space, encoder, NoMemory())
    wrong = with_losses({"ppo": PPO()}, model=model)
    with pytest.raises(JaxactError, match="PPO learns a policy, but the model's actions are"):
        jax.eval_shape(jaxact.make_train(wrong), jax.random.key(0))
