"""Recording: which episodes, in what order, and what is left after a kill."""

import dataclasses
import json
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import JaxactError, Policy, demonstration_writer
from jaxact.collect import collect, collect_named
from jaxact.demonstration_writer import DemonstrationWriter
from jaxact.demonstrations import Demonstrations
from jaxact.episode_assembly import EpisodeAssembly
from jaxact.episode_stream import episode_keys, stream_keys
from jaxact.evaluation import held_out_keys
from jaxact.models import GRU, ActorCritic, Concatenated, Vector
from jaxact.pomdp import ExpertAction
from jaxact.train_state import make_key
from tests.corridor import ReachEnd, corridor
from tests.jaxact.test_demonstrations import flip
from tests.tiny import Undemonstrated

LENGTH, HORIZON = 16, 12
EPISODES = 1000


@dataclasses.dataclass(frozen=True)
class Hesitant(ReachEnd):
    """Its expert abstains in every third cell, so that lengths differ and some are in vain."""

    def expert(self, key, task_state, state):
        advice = super().expert(key, task_state, state)
        policy = 0.25 + 0.5 * jax.nn.one_hot(advice.action, 2, dtype=jnp.float32)
        return ExpertAction(advice.action, state % 3 != 0, policy)


POMDP = dataclasses.replace(corridor(LENGTH, HORIZON), task=Hesitant())
MODEL = ActorCritic(POMDP.action_space, Concatenated({"vector": Vector((8,))}), GRU(8))


@pytest.fixture(autouse=True)
def small_shards(monkeypatch):
    """A shard has some 1,500 of the corridor's steps."""
    monkeypatch.setattr(demonstration_writer, "SHARD_BYTES", 1 << 18)


def record(path, episodes=EPISODES, **options):
    """All with final observations, so that one program serves them all."""
    options = {"world": "corridor", "progress": False, "final_observations": True} | options
    return collect(POMDP, path, episodes, **options)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demonstration_writer, "SHARD_BYTES", 1 << 18)
        return record(tmp_path_factory.mktemp("recorded") / "set")


@pytest.fixture(scope="module")
def simulated():
    """The stream's episodes, each played by itself to its end: steps [HORIZON, N], and lengths."""
    _, key = stream_keys(0)

    @jax.jit
    @jax.vmap
    def play(number):
        sample_key, step_key = episode_keys(key, number)
        state = POMDP.begin(POMDP.sampler.sample(sample_key, ()))

        def advance(state, _):
            act_key, world_key = jax.random.split(jax.random.fold_in(step_key, state.steps))
            expert_key, random_key = jax.random.split(act_key)
            advice = POMDP.expert(expert_key, state)
            random = POMDP.action_space.sample(random_key)
            action = jnp.where(advice.valid, advice.action, random)
            observation = POMDP.observe(state)["vector"]
            state, step = POMDP.step(world_key, state, action)
            return state, (observation, action, advice.valid, step)

        return jax.lax.scan(advance, state, None, HORIZON)[1]

    observation, action, valid, step = jax.tree.map(np.asarray, play(jnp.arange(EPISODES)))
    length = np.argmax(step.finished, axis=1) + 1
    return observation, action, valid, step, length


def test_episode_k_is_recorded_if_k_is_below_n(recorded, simulated):
    """Each as it is by itself, however long; so the lengths are those of the distribution."""
    observation, action, valid, step, length = simulated
    assert recorded.episodes == recorded.played == EPISODES
    assert recorded.steps == length.sum()
    assert len(recorded.shards) > 3
    assert len(np.unique(length)) == HORIZON
    assert 0 < step.truncated[np.arange(EPISODES), length - 1].sum() < EPISODES
    for k, episode in enumerate(recorded):
        n = length[k]
        np.testing.assert_array_equal(episode["observation.vector"], observation[k, :n])
        np.testing.assert_array_equal(episode["action"], action[k, :n])
        np.testing.assert_array_equal(episode["valid"], valid[k, :n])
        for name in ("reward", "terminated", "truncated", "success"):
            np.testing.assert_array_equal(episode[name], getattr(step, name)[k, :n])
        for name, term in step.reward_terms.items():
            np.testing.assert_array_equal(episode[f"reward_terms.{name}"], term[k, :n])
        agrees = episode["policy"].argmax(axis=1) == episode["action"]
        assert agrees[episode["valid"]].all()
        np.testing.assert_array_equal(np.sort(episode["policy"], axis=1), [[0.25, 0.75]] * n)
        final = step.observation["vector"][k, n - 1]
        np.testing.assert_array_equal(episode["final_observation.vector"], final)


def test_where_the_expert_abstains_the_step_is_not_valid(recorded):
    loaded = recorded.load()
    cell = loaded.observation["vector"][:, :LENGTH].argmax(axis=1)
    np.testing.assert_array_equal(loaded.valid, cell % 3 != 0)
    assert 0.3 < loaded.action[~loaded.valid].mean() < 0.7


def test_more_episodes_are_a_longer_piece_of_the_same_stream(recorded, tmp_path):
    fewer = record(tmp_path / "set", 100)
    assert fewer.episodes == 100
    for one, other in zip(fewer, recorded, strict=False):
        np.testing.assert_array_equal(one["observation.vector"], other["observation.vector"])


def test_successful_only_takes_the_first_of_them(simulated, tmp_path):
    *_, step, length = simulated
    success = step.success[np.arange(EPISODES), length - 1]
    kept = record(tmp_path / "set", 300, successful_only=True)
    assert kept.episodes == 300
    assert kept.played == np.flatnonzero(success)[299] + 1
    lengths = [len(episode["reward"]) for episode in kept]
    np.testing.assert_array_equal(lengths, length[success][:300])


def test_no_success_is_said_at_once():
    assembly = EpisodeAssembly(first=0, wanted=9, shard_steps=4, successful_only=True)
    none = {name: np.zeros((2, 2), bool) for name in ("success", "terminated")}
    number, ends = np.array([[0, 1], [0, 1]]), np.array([[False, False], [True, True]])
    step = np.array([[0, 0], [1, 1]])
    assembly.add(none | {"number": number, "step": step, "truncated": ends, "active": step >= 0})
    with pytest.raises(JaxactError, match="none of 2 episodes in a row succeeded: nothing to rec"):
        assembly.take()


class Killed(Exception):
    pass


def kill_at(monkeypatch, shard):
    """Makes recording end within the given shard, when some of it is on the disk."""
    write_array = demonstration_writer._write_array

    def write(path, array):
        if f"{shard:05d}" in path.parent.name and path.name == "reward.npy":
            raise Killed
        return write_array(path, array)

    monkeypatch.setattr(demonstration_writer, "_write_array", write)


def files_of(path):
    return {x.relative_to(path): x.read_bytes() for x in path.rglob("*") if x.is_file()}


@pytest.mark.parametrize("who", ["expert", "policy"])
def test_resumed_is_bit_for_bit_what_was_not_interrupted(monkeypatch, tmp_path, who, policy):
    options = {"policy": policy, "greedy": True} if who == "policy" else {}
    whole = record(tmp_path / "whole", **options)
    for shard in (0, 2, 3):
        with monkeypatch.context() as patch:
            kill_at(patch, shard)
            with pytest.raises(Killed):
                record(tmp_path / "killed", **options)
        with pytest.raises(JaxactError, match="is not complete: it has"):
            Demonstrations(tmp_path / "killed")
    again = record(tmp_path / "killed", **options)
    assert len(again.shards) == len(whole.shards) > 3
    assert files_of(tmp_path / "killed") == files_of(tmp_path / "whole")
    assert again.description.actor["kind"] == who


@pytest.fixture(scope="module")
def policy():
    zeros = POMDP.observation_space.zeros()["vector"][None]
    params = jax.jit(MODEL.init)(
        jax.random.key(0),
        {"vector": zeros},
        MODEL.initial_memory(1),
        jnp.zeros(1, jnp.int32),
        jnp.ones(1, bool),
    )
    return Policy(MODEL, params, POMDP.action_space)


def test_policies_begin_each_episode_afresh(tmp_path, policy):
    """Every action of a greedy policy is the one it chooses when it plays the episode alone."""
    recorded = record(tmp_path / "set", 300, policy=policy, greedy=True)
    assert recorded.load().valid.all()
    output = jax.jit(policy.output)
    for episode in list(recorded)[-3:]:
        memory = policy.initial_memory()
        for observation, action in zip(
            episode["observation.vector"], episode["action"], strict=True
        ):
            chosen, model = output({"vector": jnp.asarray(observation)}, memory)
            assert chosen.distribution.mode() == action
            memory = dataclasses.replace(
                memory, model=model, previous_action=jnp.int32(action), is_first=jnp.bool_(False)
            )


def test_a_finished_set_is_left_alone(tmp_path):
    record(tmp_path / "set", 50)
    before = {x: x.stat().st_mtime_ns for x in (tmp_path / "set").rglob("*")}
    assert record(tmp_path / "set", 50).episodes == 50
    assert before == {x: x.stat().st_mtime_ns for x in (tmp_path / "set").rglob("*")}


def test_an_altered_shard_is_seen_when_recording_goes_on(recorded, tmp_path):
    copied = shutil.copytree(recorded.path, tmp_path / "set")
    flip(copied / "shard-00001" / "action.npy")
    with pytest.raises(JaxactError, match=r"shard-00001.action.npy was altered: its checksum is"):
        record(copied)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": 1}, "holds other demonstrations: its seed is 0, but 1 was asked for"),
        (
            {"episodes": 60},
            "other demonstrations: its settings is {'episodes': 50}, but {'episodes': 60} was",
        ),
        ({"final_observations": False}, "its final observations is True, but False was asked for"),
    ],
)
def test_other_demonstrations_are_not_mixed_in(tmp_path, options, message):
    record(tmp_path, 50)
    with pytest.raises(JaxactError, match=message):
        record(tmp_path, **{"episodes": 50} | options)


def test_what_cannot_be_recorded(tmp_path):
    silent = dataclasses.replace(POMDP, task=Undemonstrated())
    with pytest.raises(JaxactError, match="Undemonstrated has no expert: give a policy to record"):
        collect(silent, tmp_path, 5, world="x")
    with pytest.raises(JaxactError, match="episodes must be at least 1, got 0"):
        record(tmp_path, 0)
    (tmp_path / "other.txt").write_text("")
    with pytest.raises(JaxactError, match="is not empty, and holds no demonstrations to go on"):
        record(tmp_path, 5)
    with pytest.raises(JaxactError, match="cannot write to"):
        record(tmp_path / "other.txt" / "set", 5)


FILE = """
import dataclasses
from tests.jaxact.test_collect import POMDP
from tests.tiny import experiment as make

experiment = dataclasses.replace(make(), pomdp=POMDP)
"""


def test_worlds_experiments_and_what_is_neither(tmp_path, capsys):
    file = tmp_path / "small.py"
    file.write_text(FILE)
    collect_named(str(file), tmp_path / "set", 40, final_observations=True)
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "compiling"
    assert printed[-2].startswith("recording  40/40 episodes")
    assert printed[-1].startswith(f"{tmp_path / 'set'}: 40 of 40 episodes played, ")
    assert Demonstrations(tmp_path / "set").description.world == "corridor"
    with pytest.raises(JaxactError, match="unknown world or experiment 'BabyAI-GoToLocl-v0'; the"):
        collect_named("BabyAI-GoToLocl-v0", tmp_path / "none", 4)
    with pytest.raises(JaxactError, match="is not a run's directory, so it has no checkpoint"):
        collect_named(str(file), tmp_path / "none", 4, checkpoint="best")


def test_the_manifest_says_what_it_is_of(recorded):
    manifest = json.loads((recorded.path / "demonstrations.json").read_text())
    assert manifest["actor"] == {"kind": "expert"}
    assert (manifest["world"], manifest["seed"]) == ("corridor", 0)
    assert manifest["settings"]["episodes"] == manifest["episodes"] == EPISODES
    assert manifest["fields"]["observation.vector"] == {
        "per": "step",
        "shape": [2 * LENGTH],
        "dtype": "float32",
    }
    assert manifest["reward_terms"] == ["step", "success"]
    assert manifest["expert_policy"]
    assert sum(shard["steps"] for shard in manifest["shards"]) == manifest["steps"]
    recorded.verify()


def test_streams_share_no_key_with_evaluation_or_training():
    _, key = stream_keys(0)
    mine, _ = jax.vmap(episode_keys, (None, 0))(key, jnp.arange(500))
    held_out, _ = held_out_keys(0, 500)
    trained = jax.random.split(make_key(0), 500)
    words = [jax.random.key_data(keys).tolist() for keys in (mine, held_out, trained)]
    flat = [tuple(word) for part in words for word in part]
    assert len(set(flat)) == len(flat)


def test_writers_refuse_an_empty_set(tmp_path, recorded):
    writer = DemonstrationWriter(tmp_path / "set", recorded.description)
    with pytest.raises(JaxactError, match="would be empty: no episode was recorded"):
        writer.finish()
