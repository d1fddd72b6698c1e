"""What `Experiment.check` finds before anything compiles."""

import dataclasses

import pytest

from jaxact import JaxactError, Stage
from jaxact.losses import PPO, Imitation
from tests.corridor import corridor
from tests.tiny import Undemonstrated, experiment


def one_stage(**fields):
    return (Stage(**{"losses": {"ppo": PPO()}, "steps": 64} | fields),)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lanes": 0}, "stage 0: lanes must be at least 1, got 0"),
        ({"epochs": 0}, "stage 0: epochs must be at least 1, got 0"),
        ({"minibatches": 0}, "stage 0: minibatches must be at least 1, got 0"),
        ({"rollout_length": -1}, "stage 0: rollout_length must be at least 1, got -1"),
        ({"stages": one_stage(steps=0)}, "stage 0: steps must be at least 1, got 0"),
        ({"lanes": 11, "minibatches": 4}, "11 lanes do not divide .* that does is 12"),
        (
            {"stages": one_stage(overrides={"minibatchs": 2})},
            "unknown pipeline field .*'minibatchs'; the nearest is 'minibatches'",
        ),
    ],
)
def test_sizes_that_cannot_work(settings, message):
    with pytest.raises(JaxactError, match=message):
        experiment(**settings).check()


def test_lanes_divide_among_devices_too():
    experiment(lanes=8, minibatches=2).check(devices=4)
    with pytest.raises(JaxactError, match=r"8 lanes .* 2 minibatches on 3 device.* is 6"):
        experiment(lanes=8, minibatches=2).check(devices=3)


@pytest.mark.parametrize(
    "stages",
    [one_stage(losses={"imitation": Imitation()}), one_stage(teacher_forcing=0.5)],
    ids=["imitation", "teacher forcing"],
)
def test_an_expert_where_there_is_none(stages):
    pomdp = dataclasses.replace(corridor(), task=Undemonstrated())
    assert not pomdp.has_expert
    with pytest.raises(JaxactError, match="Undemonstrated has no method expert"):
        experiment(pomdp, stages=stages).check()
    experiment(pomdp, stages=one_stage()).check()


def test_experiments_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        experiment().name = "other"
