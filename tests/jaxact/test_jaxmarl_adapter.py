"""Worlds behind JaxMARL's interface: its protocol, and the steps of the world itself.

What needs JaxMARL is its spaces, its own automatic reset and its wrappers; all else is tested
without it.
"""

import importlib.util
import sys
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
from jaxact import JaxactError
from jaxact.jaxmarl_adapter import to_jaxmarl
from tests.corridor import corridor
from tests.crowd import crowd
from tests.tiny import assert_same

POMDP = crowd(3)
ENV = to_jaxmarl(POMDP, flatten=False)
AGENTS = ["agent_0", "agent_1", "agent_2"]


@pytest.fixture(scope="module")
def jaxmarl():
    if importlib.util.find_spec("jaxmarl") is None:
        pytest.skip("jaxmarl is not installed (pip install -e '.[adapters]')")
    with warnings.catch_warnings():
        # Of packages that it imports.
        warnings.simplefilter("ignore")
        import jaxmarl
        import jaxmarl.wrappers.baselines
    return jaxmarl


def actions(t):
    """Of the last agent first: the order of the keys does not matter."""
    return {f"agent_{i}": (t + i) % 4 // 2 for i in (2, 0, 1)}


def play(env, steps=30):
    # JaxMARL's algorithms make keys of this old kind.
    keys = jax.random.split(jax.random.PRNGKey(1), steps + 1)
    rows = [env.reset(keys[0])]
    for t, key in enumerate(keys[1:]):
        rows.append(env.step(key, rows[-1][1], actions(t)))
    return keys, rows


def by_agent(observation):
    return {a: jax.tree.map(lambda x, i=i: x[i], observation) for i, a in enumerate(AGENTS)}


def test_steps_are_those_of_the_world_and_reset_at_the_end():
    keys, rows = play(ENV)
    reset, step = jax.jit(POMDP.reset), jax.jit(POMDP.step)
    state, observation = reset(keys[0])
    assert_same(rows[0], (by_agent(observation), state))
    ends = 0
    for t, (key, row) in enumerate(zip(keys[1:], rows[1:], strict=True)):
        step_key, reset_key = jax.random.split(key)
        action = jnp.int32([actions(t)[agent] for agent in AGENTS])
        state, expected = step(step_key, state, action)
        observation = expected.observation
        if bool(expected.finished):
            ends += 1
            state, observation = reset(reset_key)
        assert_same(row[:2], (by_agent(observation), state))
        _, _, rewards, dones, infos = row
        assert_same(rewards, by_agent(expected.reward))
        assert_same(dones, dict.fromkeys([*AGENTS, "__all__"], expected.finished))
        assert_same(infos["reward/step"], expected.reward_terms["step"])
        for name, value in {
            "success": expected.success,
            "terminated": expected.terminated,
            "truncated": expected.truncated,
            "task/distance": expected.metrics["distance"],
        }.items():
            assert_same(infos[name], jnp.full(3, value))
    assert ends > 1


def test_a_step_without_reset_and_one_to_a_given_state():
    key = jax.random.key(0)
    _, state = ENV.reset(key)
    for t in range(10):
        before, (observation, state, _, dones, _) = state, ENV.step_env(key, state, actions(t))
        assert_same(observation, ENV.get_obs(state))
    assert bool(dones["__all__"])
    assert int(state.steps) == 10
    _, other = ENV.reset(jax.random.key(1))
    observation, state, *_ = ENV.step(key, before, actions(9), other)
    assert_same((observation, state), (ENV.get_obs(other), other))


def test_observations_are_vectors_unless_they_are_to_be_readings():
    pomdp = envs_jax.make("Markov-Harvest-v0")
    flat, _ = to_jaxmarl(pomdp).reset(jax.random.key(3))
    whole, _ = to_jaxmarl(pomdp, flatten=False).reset(jax.random.key(3))
    for agent in ("agent_0", "agent_1"):
        assert flat[agent].dtype == jnp.float32
        np.testing.assert_array_equal(flat[agent], np.ravel(whole[agent]["map"]))


def test_without_jaxmarl_there_are_no_spaces_but_all_else(monkeypatch):
    monkeypatch.setitem(sys.modules, "jaxmarl", None)
    monkeypatch.setitem(sys.modules, "jaxmarl.environments", None)
    assert (ENV.name, ENV.num_agents, ENV.agents) == ("POMDP", 3, AGENTS)
    assert ENV.agent_classes == {"agents": AGENTS}
    _, state = ENV.reset(jax.random.key(0))
    assert_same(ENV.get_avail_actions(state), dict.fromkeys(AGENTS, jnp.ones(2, bool)))
    for space in (ENV.action_space, ENV.observation_space):
        with pytest.raises(JaxactError, match="not installed"):
            space("agent_0")


def test_a_world_of_one_agent_is_refused():
    with pytest.raises(JaxactError, match="has one without an axis of agents; use to_gymnax"):
        to_jaxmarl(corridor())


@pytest.mark.parametrize(
    "name", ["Markov-StagHunt-v0", "Markov-Harvest-v0", "Markov-Escalation-v0"]
)
def test_spaces_are_jaxmarls(jaxmarl, name):
    spaces = jaxmarl.environments.spaces
    pomdp = envs_jax.make(name)
    for flatten in (False, True):
        env = to_jaxmarl(pomdp, flatten=flatten)
        observations, _ = env.reset(jax.random.key(0))
        for agent in env.agents:
            assert isinstance(env.action_space(agent), spaces.Discrete)
            assert env.action_space(agent).n == 4
            space = env.observation_space(agent)
            assert isinstance(space, spaces.Box if flatten else spaces.Dict)
            assert bool(space.contains(observations[agent]))


def test_it_resets_as_jaxmarls_own_environments_do(jaxmarl):
    """Their base class steps what has `step_env`, `reset` and `get_obs`."""
    theirs = jaxmarl.environments.MultiAgentEnv.step.__wrapped__
    step = jax.jit(lambda *inputs: theirs(ENV, *inputs))
    keys, rows = play(ENV)
    ends = 0
    for t, (key, row) in enumerate(zip(keys[1:], rows[1:], strict=True)):
        assert_same(row, step(key, rows[t][1], actions(t)))
        ends += bool(row[3]["__all__"])
    assert ends > 1


def test_jaxmarls_own_wrappers_wrap_it(jaxmarl):
    wrappers = jaxmarl.wrappers.baselines
    with jax.numpy_dtype_promotion("standard"):
        env = wrappers.LogWrapper(to_jaxmarl(POMDP))
        key = jax.random.PRNGKey(0)
        _, state = env.reset(key)
        lengths = set()
        for t in range(30):
            _, state, *_, info = env.step(jax.random.fold_in(key, t), state, actions(t))
            lengths |= set(np.asarray(info["returned_episode_lengths"]).astype(int))
            assert {x.shape for x in info.values()} == {(3,)}
        assert 10 in lengths
        many = wrappers.CTRolloutManager(to_jaxmarl(POMDP), 4)
        observations, states = many.batch_reset(key)
        chosen = {agent: many.batch_sample(key, agent) for agent in AGENTS}
        observations, _, rewards, *_ = many.batch_step(key, states, chosen)
        # The reading, and who it is one-hot; of all agents together without.
        assert observations["agent_1"].shape == (4, 12 + 3)
        assert observations["__all__"].shape == (4, 36)
        np.testing.assert_allclose(rewards["__all__"], sum(rewards[agent] for agent in AGENTS))
