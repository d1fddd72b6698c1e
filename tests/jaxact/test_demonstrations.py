"""Demonstrations on the disk: what was written is what is read, or it is said what is wrong."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest

from jaxact import JaxactError
from jaxact.demonstration_spaces import space_from_json, space_to_json
from jaxact.demonstration_writer import DemonstrationWriter
from jaxact.demonstrations import (
    MANIFEST,
    Demonstrations,
    Description,
    world_parts,
)
from jaxact.spaces import Box, Dict, Discrete, Tuple
from tests.corridor import CellAndGoal, ReachEnd, corridor
from tests.tiny import Undemonstrated

OBSERVATIONS = Dict(
    {
        "agent/view": Box(0, 255, (2, 2), "uint8"),
        "vector": Box(-np.inf, np.inf, (3,)),
        "word": Discrete(5),
    }
)
ACTIONS = Dict({"arm": Box(-1, 1, (2,)), "hand": Tuple((Discrete(2), Discrete(3)))})
DESCRIPTION = Description(
    "a world", {"kind": "expert"}, 0, ACTIONS, OBSERVATIONS, True, ("step", "goal.reached")
)
SHARDS = ((3, 1, 4), (2, 5))


def shard(lengths, seed):
    """Random arrays of episodes of these lengths."""
    random, steps = np.random.default_rng(seed), sum(lengths)
    arrays = {}
    for name, one in DESCRIPTION.fields().items():
        count = steps if one.per == "step" else len(lengths)
        arrays[name] = random.integers(0, 2, (count, *one.shape)).astype(one.dtype)
    ends = np.cumsum(lengths) - 1
    arrays["first_step"] = ends - np.array(lengths) + 1
    arrays["terminated"] = np.isin(np.arange(steps), ends[:-1])
    arrays["truncated"] = np.isin(np.arange(steps), ends[-1:])
    return arrays


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("demonstrations") / "set"
    writer = DemonstrationWriter(path, DESCRIPTION)
    for number, lengths in enumerate(SHARDS):
        writer.write(shard(lengths, number), 0)
    writer.finish()
    return path


@pytest.fixture
def copied(written, tmp_path):
    return shutil.copytree(written, tmp_path / "set")


def test_what_was_written_is_read(written):
    opened = Demonstrations(written)
    assert dataclasses.replace(opened.description) == DESCRIPTION
    assert (opened.episodes, opened.steps) == (5, 15)
    opened.verify()
    for number, lengths in enumerate(SHARDS):
        for name, array in shard(lengths, number).items():
            assert isinstance(opened.shards[number][name], np.memmap)
            np.testing.assert_array_equal(opened.shards[number][name], array)


def test_loading_joins_the_shards(written):
    loaded = Demonstrations(written).load()
    parts = [shard(lengths, number) for number, lengths in enumerate(SHARDS)]

    def joined(name):
        return np.concatenate([part[name] for part in parts])

    np.testing.assert_array_equal(loaded.first_step, [0, 3, 4, 8, 10, 15])
    assert loaded.first_step.dtype == np.int32
    np.testing.assert_array_equal(
        loaded.observation["agent/view"], joined("observation.agent/view")
    )
    np.testing.assert_array_equal(loaded.action["hand"][1], joined("action.hand.1"))
    np.testing.assert_array_equal(loaded.valid, joined("valid"))
    assert loaded.final_observation is not None
    final = loaded.final_observation["vector"]
    np.testing.assert_array_equal(final, joined("final_observation.vector"))
    assert list(loaded.reward_terms) == ["step", "goal.reached"]
    np.testing.assert_array_equal(
        loaded.reward_terms["goal.reached"], joined("reward_terms.goal.reached")
    )
    assert loaded.policy is None
    assert jax.tree.structure(loaded.action) == jax.tree.structure(ACTIONS.structure)


def test_episodes_one_after_the_other(written):
    episodes = list(Demonstrations(written))
    assert [len(episode["reward"]) for episode in episodes] == [3, 1, 4, 2, 5]
    second = shard(SHARDS[1], 1)
    np.testing.assert_array_equal(episodes[4]["reward"], second["reward"][2:])
    last = second["final_observation.word"][1]
    np.testing.assert_array_equal(episodes[4]["final_observation.word"], last)


@pytest.mark.parametrize("space", [OBSERVATIONS, ACTIONS, Box(0, 1, (), "bool")])
def test_spaces_survive_json(space):
    assert space_from_json(json.loads(json.dumps(space_to_json(space)))) == space


def flip(path):
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


def edit(path, **changes):
    manifest = json.loads(path.read_text())
    path.write_text(json.dumps(manifest | changes))


@pytest.mark.parametrize(
    ("file", "damage", "message"),
    [
        ("shard-00001/action.arm.npy", lambda x: x.unlink(), "action.arm.npy is missing"),
        (
            "shard-00000/reward.npy",
            lambda x: x.write_bytes(x.read_bytes()[:-4]),
            "reward.npy has 156 bytes, but 160 were written",
        ),
        (
            "shard-00000/reward.npy",
            lambda x: x.write_bytes(b"x" * 160),
            "reward.npy is not a .npy file any more",
        ),
        (
            "shard-00000/reward.npy",
            lambda x: np.save(x, np.zeros(8, np.int32)),
            r"reward.npy was altered: it has int32\[8\] where float32\[8\] were written",
        ),
        ("shard-00001", shutil.rmtree, "observation.agent%2Fview.npy is missing"),
        (MANIFEST, lambda x: x.unlink(), "holds no demonstrations: it has no demonstrations.json"),
        (MANIFEST, lambda x: x.write_text("{"), "demonstrations.json cannot be read"),
        (MANIFEST, lambda x: x.write_text("{}"), "is of format None; this version of jaxact reads"),
        (MANIFEST, lambda x: x.write_text('{"format": 1}'), "it lacks action_space, actor"),
        (MANIFEST, lambda x: edit(x, action_space={"type": "Ring"}), "describes no space with"),
    ],
)
def test_damage_is_seen_on_opening(copied, file, damage, message):
    damage(copied / file)
    with pytest.raises(JaxactError, match=message) as error:
        Demonstrations(copied)
    assert "\n" not in str(error.value)


def test_altered_contents_are_seen_by_verify(copied):
    flip(copied / "shard-00001" / "reward.npy")
    opened = Demonstrations(copied)
    for look in (opened.verify, opened.load):
        with pytest.raises(JaxactError, match=r"shard-00001.reward.npy was altered: its check"):
            look()


def test_what_was_written_in_the_first_format_is_read(tmp_path):
    writer = DemonstrationWriter(tmp_path, dataclasses.replace(DESCRIPTION, reward_terms=()))
    writer.write(shard((3, 2), 0), 0)
    writer.finish()
    manifest = json.loads((tmp_path / MANIFEST).read_text())
    first = {name: manifest[name] for name in manifest.keys() - {"reward_terms", "expert_policy"}}
    (tmp_path / MANIFEST).write_text(json.dumps(first | {"format": 1}))
    loaded = Demonstrations(tmp_path).load()
    assert (loaded.episodes, loaded.reward_terms, loaded.policy) == (2, {}, None)
    with pytest.raises(JaxactError, match="its format is 1, but 2 was asked for; choose another"):
        DemonstrationWriter(tmp_path, dataclasses.replace(DESCRIPTION, reward_terms=()))


def test_episodes_have_to_end_where_it_is_said(tmp_path):
    arrays = shard((3, 2), 0)
    writer = DemonstrationWriter(tmp_path, DESCRIPTION)
    writer.write(arrays | {"first_step": np.array([0, 2])}, 0)
    with pytest.raises(JaxactError, match="is not consistent: its episodes do not end where"):
        writer.finish().verify()


def test_another_worlds_spaces(tmp_path):
    pomdp = corridor()
    description = Description(
        "corridor",
        {"kind": "expert"},
        0,
        pomdp.action_space,
        pomdp.observation_space,
        settings={"world_parts": world_parts(pomdp)},
    )
    writer = DemonstrationWriter(tmp_path, description)
    arrays = {n: np.zeros((1, *x.shape), x.dtype) for n, x in description.fields().items()}
    writer.write(arrays | {"terminated": np.ones(1, bool)}, 1)
    opened = writer.finish()
    opened.check(pomdp)
    assert opened.load(pomdp).episodes == 1
    elsewhere = dataclasses.replace(pomdp, sampler=corridor(horizon=3).sampler)
    opened.check(elsewhere)
    poorer = dataclasses.replace(elsewhere, task=ReachEnd(step_penalty=-1.0))
    with pytest.warns(UserWarning, match=r"another world .* task \(ReachEnd with other set"):
        opened.check(poorer)
    silent = dataclasses.replace(elsewhere, task=Undemonstrated())
    with pytest.warns(UserWarning, match=r"another task \(ReachEnd, here Undemonstrated\): what"):
        opened.check(silent)
    with pytest.raises(JaxactError, match=r"observation 'vector' of .*shape=.12,.*shape=.16,"):
        opened.check(corridor(8))
    other = dataclasses.replace(pomdp, sensors={"vectr": CellAndGoal()})
    with pytest.raises(JaxactError, match=r"unknown observation in .* 'vectr'; the near"):
        opened.load(other)
    described = dataclasses.replace(description, action_space=Discrete(5))
    opened.description = described
    with pytest.raises(JaxactError, match=r"with actions Discrete\(n=5\), but this world takes"):
        opened.check(pomdp)


def test_what_the_format_cannot_hold():
    narrow = dataclasses.replace(
        DESCRIPTION, observation_space=Dict({"x": Box(0, 1, (2,), "bfloat16")})
    )
    with pytest.raises(JaxactError, match=r"observation.x has dtype bfloat16, which .npy"):
        narrow.fields()

    soft = dataclasses.replace(DESCRIPTION, expert_policy=True)
    with pytest.raises(JaxactError, match="policy is of discrete actions, not of Dict"):
        soft.fields()
    with pytest.raises(JaxactError, match="cannot be recorded with a space like None"):
        space_to_json(None)
