"""Demonstrations to Minari and back, with data sets in a directory of the test's own."""

import dataclasses
import sys
import warnings

import numpy as np
import pytest

from jaxact import JaxactError, demonstration_writer
from jaxact.demonstration_writer import DemonstrationWriter
from jaxact.demonstrations import Demonstrations
from tests.jaxact.test_demonstrations import DESCRIPTION, OBSERVATIONS, SHARDS, shard

NAMES = {"agent/view": "view"}  # HDF5 takes a slash for a group


def write(path, **changes):
    """Demonstrations of the two shards; observations have names that HDF5 can do with."""
    spaces = {NAMES.get(name, name): space for name, space in OBSERVATIONS.spaces.items()}
    space = dataclasses.replace(OBSERVATIONS, spaces=spaces)
    # Minari has no place for the reward's components.
    changes = {"reward_terms": ()} | changes
    description = dataclasses.replace(DESCRIPTION, observation_space=space, **changes)
    writer = DemonstrationWriter(path, description)
    for number, lengths in enumerate(SHARDS):
        arrays = shard(lengths, number)
        arrays |= {n.replace("agent/view", "view"): x for n, x in arrays.items()}
        writer.write(arrays, 0)
    return writer.finish()


def test_without_minari_it_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "minari", None)
    monkeypatch.delitem(sys.modules, "jaxact.minari_adapter", raising=False)
    with pytest.raises(
        JaxactError, match=r"need the package minari: pip install 'jaxact\[minari\]"
    ):
        import jaxact.minari_adapter  # noqa: F401


@pytest.fixture
def adapter(monkeypatch, tmp_path):
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    from jaxact import minari_adapter

    return minari_adapter


@pytest.mark.parametrize("shard_bytes", [1 << 20, 1])
def test_there_and_back_is_what_it_was(adapter, monkeypatch, tmp_path, shard_bytes):
    ours = write(tmp_path / "set")
    monkeypatch.setattr(adapter, "_AT_ONCE", 2)
    dataset = adapter.to_minari(ours, "test/there-v0", author="somebody")
    assert (dataset.total_episodes, dataset.total_steps) == (5, 15)
    monkeypatch.setattr(demonstration_writer, "SHARD_BYTES", shard_bytes)
    back = adapter.from_minari("test/there-v0", tmp_path / "back")
    assert len(back.shards) == (1 if shard_bytes > 1 else 5)
    back.verify()
    assert back.description.action_space == ours.description.action_space
    assert back.description.actor == {"kind": "minari", "dataset": "test/there-v0"}
    for one, other in zip(ours, back, strict=True):
        assert one.keys() == other.keys()
        for name in one:
            np.testing.assert_array_equal(one[name], other[name], strict=True)
    with pytest.raises(JaxactError, match="Minari cannot create 'test/there-v0'"):
        adapter.to_minari(ours, "test/there-v0")


def test_final_observations_are_needed(adapter, tmp_path):
    with pytest.raises(JaxactError, match="has no final observations, which Minari wants"):
        adapter.to_minari(write(tmp_path / "set", final_observations=False), "test/none-v0")


def test_what_is_not_there(adapter, tmp_path):
    with pytest.raises(JaxactError, match="Minari cannot load 'test/nothing-v0'"):
        adapter.from_minari("test/nothing-v0", tmp_path / "set")


def test_data_of_others(adapter, tmp_path):
    """Texts, wide numbers, no infos, and an episode that was cut off without a flag."""
    import gymnasium
    import minari
    from minari.data_collector import EpisodeBuffer

    spaces = gymnasium.spaces
    episodes = [
        EpisodeBuffer(
            observations={
                "mission": ["go"] * (steps + 1),
                "inner": {"x": np.arange(steps + 1.0)},
            },
            actions=np.zeros(steps, np.int64),
            rewards=[0.5] * steps,
            terminations=[False] * (steps - 1) + [steps == 2],
            truncations=[False] * steps,
        )
        for steps in (2, 3)
    ]
    with warnings.catch_warnings(action="ignore"):
        minari.create_dataset_from_buffers(
            "others-v0",
            episodes,
            action_space=spaces.Discrete(2),
            observation_space=spaces.Dict(
                {
                    "mission": spaces.Text(10),
                    "inner": spaces.Dict({"x": spaces.Box(-9.0, 9.0, (), np.float64)}),
                }
            ),
        )
    with pytest.raises(JaxactError, match="jaxact has no space like Gymnasium's Text"):
        adapter.from_minari("others-v0", tmp_path / "set")

    from jaxact.spaces import Box
    from tests.corridor import CellAndGoal, corridor

    @dataclasses.dataclass(frozen=True)
    class Reading(CellAndGoal):
        """A sensor with the space that it is given."""

        box: Box = dataclasses.field(default_factory=lambda: Box(0, 5, ()))

        @property
        def space(self):
            return self.box

    words = Reading(box=Box(0, 255, (2,), "int32"))
    pomdp = dataclasses.replace(corridor(), sensors={"inner.x": Reading(), "mission": words})
    encode = {"mission": lambda text: np.frombuffer(text.encode(), np.uint8)}
    taken = adapter.from_minari("others-v0", tmp_path / "set", pomdp=pomdp, encode=encode)
    taken.check(pomdp)
    taken.verify()
    loaded = taken.load()
    np.testing.assert_array_equal(loaded.first_step, [0, 2, 5])
    np.testing.assert_array_equal(loaded.observation["mission"], [[103, 111]] * 5)
    np.testing.assert_array_equal(loaded.observation["inner.x"], np.float32([0, 1, 0, 1, 2]))
    np.testing.assert_array_equal(loaded.final_observation["inner.x"], np.float32([2, 3]))
    np.testing.assert_array_equal(loaded.terminated, [0, 1, 0, 0, 0])
    np.testing.assert_array_equal(loaded.truncated, [0, 0, 0, 0, 1])
    assert loaded.valid.all()
    assert Demonstrations(tmp_path / "set").description.seed is None

    narrow = dataclasses.replace(pomdp, sensors={"inner.x": Reading(box=Box(0, 1, ()))})
    with pytest.raises(JaxactError, match=r"has values from 0.0 to 2.0, which are not all in Box"):
        adapter.from_minari("others-v0", tmp_path / "other", pomdp=narrow)
