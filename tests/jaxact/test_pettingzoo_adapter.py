"""Worlds under PettingZoo: its own checks, and the same episodes as the world stepped by hand."""

import jax
import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

import envs_jax
from jaxact import JaxactError, make_key
from jaxact.pettingzoo_adapter import to_pettingzoo
from tests.corridor import corridor
from tests.crowd import crowd

POMDP = crowd(3)


def test_pettingzoo_finds_no_fault_with_a_world_of_ones_own():
    parallel_api_test(to_pettingzoo(POMDP), num_cycles=60)


@pytest.mark.parametrize(
    "name",
    [
        "Markov-StagHunt-v0",
        "Markov-Harvest-v0",
        "Markov-Escalation-v0",
        "MultiGrid-Soccer4HEnv10x15N2-v0",
        "MultiGrid-Collect4HEnv10x10N2-v0",
    ],
)
def test_pettingzoo_finds_no_fault(name):
    env = to_pettingzoo(envs_jax.make(name, horizon=20), render_mode="rgb_array", name=name)
    parallel_api_test(env, num_cycles=60)
    assert env.render().ndim == 3


def test_pettingzoo_finds_the_same_seeds_alike():
    parallel_seed_test(lambda: to_pettingzoo(POMDP))


@pytest.mark.parametrize("seed", [0, 2**32 - 1])
def test_episodes_are_those_of_the_world_stepped_by_hand(seed):
    env = to_pettingzoo(POMDP, seed=seed)
    reset, step_by_hand = jax.jit(POMDP.reset), jax.jit(POMDP.step)
    generator = np.random.default_rng(0)
    ends = set()
    for episode in range(4):
        key = jax.random.fold_in(make_key(seed), episode)
        reset_key, step_key = jax.random.split(key)
        state, observation = reset(reset_key)
        seen, infos = env.reset()
        assert infos == {"agent_0": {}, "agent_1": {}, "agent_2": {}}
        t = 0
        while env.agents:
            for i, agent in enumerate(env.agents):
                np.testing.assert_array_equal(seen[agent]["vector"], observation["vector"][i])
            action = generator.integers(0, 2, 3)
            key = jax.random.fold_in(step_key, t)
            state, step = step_by_hand(key, state, np.int32(action))
            observation, t = step.observation, t + 1
            given = {f"agent_{i}": action[i] for i in (2, 0, 1)}
            seen, rewards, terminations, truncations, infos = env.step(given)
            for i, agent in enumerate(env.possible_agents):
                assert rewards[agent] == float(step.reward[i])
                assert terminations[agent] == bool(step.terminated)
                assert truncations[agent] == bool(step.truncated)
                assert infos[agent] == {
                    "success": bool(step.success),
                    "reward/success": float(step.reward_terms["success"][i]),
                    "reward/step": float(step.reward_terms["step"][i]),
                    "task/distance": float(step.metrics["distance"]),
                }
        ends |= {bool(step.terminated)}
    assert ends


def test_what_cannot_be_is_refused():
    with pytest.raises(JaxactError, match="has one without an axis of agents; use to_gymnasium"):
        to_pettingzoo(corridor())
    with pytest.raises(JaxactError, match="nothing to render"):
        to_pettingzoo(POMDP, render_mode="rgb_array")
    env = to_pettingzoo(POMDP)
    with pytest.raises(JaxactError, match="call reset"):
        env.step({})
    env.reset()
    with pytest.raises(JaxactError, match=r"of agent_0, agent_1, agent_2 was .* of agent_1"):
        env.step({"agent_1": 0})
