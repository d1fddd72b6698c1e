"""Stages and the pipeline's arithmetic."""

import pytest

from jaxact import EarlyStopping, JaxactError, Stage, TrainingPipeline
from jaxact.losses import PPO, Curiosity, Imitation
from jaxact.models import Concatenated
from jaxact.spaces import Discrete
from jaxact.storages import Replay


def stage(steps=1000, **fields):
    return Stage({"ppo": PPO()}, steps=steps, **fields)


def test_updates_are_rounded_up():
    first, second = stage(1000), stage(1024, overrides={"rollout_length": 64})
    pipeline = TrainingPipeline((first, second), lanes=16, rollout_length=8)
    assert pipeline.steps_per_update(first) == 128
    assert pipeline.updates(first) == 8  # 7 would be 896
    assert pipeline.steps_per_update(second) == 1024
    assert pipeline.updates(second) == 1
    assert pipeline.total_steps == 8 * 128 + 1024


def test_overrides_hold_for_their_stage_alone():
    first, second = stage(overrides={"epochs": 1, "learning_rate": 0.5}), stage()
    pipeline = TrainingPipeline((first, second), epochs=4)
    assert (pipeline.at(first).epochs, pipeline.at(first).learning_rate) == (1, 0.5)
    assert pipeline.at(second) == pipeline


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"learning_rat": 1.0}, "unknown pipeline field .*nearest is 'learning_rate'"),
        ({"lanes": 8}, "all stages share 'lanes'"),
        ({"optimizer": None}, "all stages share 'optimizer'"),
    ],
)
def test_overrides_name_fields_that_stages_may_have_of_their_own(overrides, message):
    bad = stage(overrides=overrides)
    with pytest.raises(JaxactError, match=message):
        TrainingPipeline((bad,)).at(bad)


def test_weights_name_losses():
    with pytest.raises(JaxactError, match=r"unknown loss .*'pppo'; the nearest is 'ppo'"):
        stage(weights={"pppo": 1.0})


def test_nothing_may_be_empty():
    with pytest.raises(JaxactError, match="a stage needs at least one loss"):
        Stage({}, steps=1)
    with pytest.raises(JaxactError, match="a pipeline needs at least one stage"):
        TrainingPipeline(())


def test_the_expert_is_asked_only_where_it_is_needed():
    assert not stage().needs_expert
    assert stage(teacher_forcing=0.0).needs_expert
    assert Stage({"ppo": PPO(), "imitation": Imitation()}, steps=1).needs_expert


def test_early_stopping_knows_its_metrics():
    with pytest.raises(JaxactError, match=r"unknown early-stopping metric 'succes'; .*'success'"):
        EarlyStopping(0.9, metric="succes")


def test_pipelines_can_be_hashed_and_compared():
    one, other = (TrainingPipeline((stage(weights={"ppo": 2.0}),)) for _ in range(2))
    assert one == other
    assert hash(one) == hash(other)


def test_losses_that_reward_are_not_in_storages_alone():
    curiosity = Curiosity(action_space=Discrete(2), encoder=Concatenated({}))
    held = {"replay": Replay(losses={"curiosity": curiosity}, capacity=64)}
    with pytest.raises(JaxactError, match=r"Curiosity .* of storage 'replay' alone; give the"):
        stage(storages=held)
    both = {"ppo": PPO(), "curiosity": curiosity}
    assert Stage(both, steps=1, storages=held).storages["replay"].losses["curiosity"] == curiosity
