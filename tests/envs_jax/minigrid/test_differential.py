"""Step by step, the worlds do what the Python package does."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest
from minigrid_reference import PACKAGE_IDS, compare, play, play_as_expert, python_env

import envs_jax
from envs_jax.minigrid import interop, rules


def record(names: list[str], episodes: int, seed: int, **options: int) -> list:
    """Records episodes, every other one scrambled, of every world."""
    rng = np.random.default_rng(seed)
    return [
        play(
            python_env(name, **options),
            rng,
            seed=int(rng.integers(2**31)),
            prefix=int(rng.choice([0, 0, 5, 20])),
            scrambled=episode % 2 == 1,
        )
        for name in names
        for episode in range(episodes)
    ]


def test_all_worlds_agree_step_by_step():
    recordings = record(PACKAGE_IDS, episodes=2, seed=0)
    assert compare(recordings, size=25) == 2 * len(PACKAGE_IDS) * 48
    answers = [recording.answers for recording in recordings]
    both = [(a["terminated"] & a["truncated"]).any() for a in answers]
    assert sum(both) >= 3
    assert sum(a["terminated"].any() for a in answers) >= 20
    assert sum((a["reward"] > 0).any() for a in answers) >= 10
    assert any((a["reward"] < 0).any() for a in answers)


@pytest.mark.slow
def test_all_worlds_agree_over_many_steps():
    compared = 0
    # Which rules were seen to be kept, and which to be broken.
    kept, broken = set(), set()
    for seed in range(1, 4):
        recordings = record(PACKAGE_IDS, episodes=72, seed=seed)
        compared += compare(recordings)
        for recording in recordings:
            rule = int(getattr(recording.state.task, "rule", rules.PLAY))
            reward, terminated = recording.answers["reward"], recording.answers["terminated"]
            kept |= {rule} if (reward > 0).any() else set()
            broken |= {rule} if (terminated & (reward == 0)).any() else set()
    assert compared >= 10_000 * len(PACKAGE_IDS)
    assert kept == set(range(8))
    assert broken >= {rules.FETCH, rules.GO_NEXT_TO, rules.PUT_NEAR, rules.MATCH}


@pytest.mark.slow
def test_all_worlds_agree_where_the_expert_goes():
    rng = np.random.default_rng(4)
    envs = []
    for name in PACKAGE_IDS:
        for _ in range(24):
            envs.append(python_env(name))
            envs[-1].reset(seed=int(rng.integers(2**31)))
    recordings = play_as_expert(envs, rng, size=25)
    assert compare(recordings, size=25) == 24 * 48 * len(PACKAGE_IDS)
    won = [(recording.answers["reward"] > 0).any() for recording in recordings]
    assert np.mean(won) >= 0.8


@pytest.mark.parametrize("view_size", [3, 5])
def test_smaller_views_agree(view_size):
    names = ["MiniGrid-FourRooms-v0", "MiniGrid-Empty-8x8-v0"]
    compare(record(names, episodes=8, seed=view_size, agent_view_size=view_size))


@pytest.mark.parametrize("name", PACKAGE_IDS)
def test_a_made_world_is_the_imported_one(name):
    env = python_env(name)
    env.reset(seed=0)
    pomdp, state = interop.from_minigrid(env)
    made = envs_jax.make(name)
    assert replace(pomdp, sampler=made.sampler) == made
    assert made.sampler.max_steps in (None, env.max_steps)
    assert state.horizon == env.max_steps


def first_of_each_kind() -> list[str]:
    """Worlds that differ in the types of their parts, which make what a state consists of."""
    kinds: dict[tuple[type, ...], str] = {}
    for name in PACKAGE_IDS:
        made = envs_jax.make(name)
        kinds.setdefault((type(made.environment), type(made.task), type(made.sampler)), name)
    return list(kinds.values())


FIRST = first_of_each_kind()


@pytest.mark.parametrize(
    "name", [x if x in FIRST else pytest.param(x, marks=pytest.mark.slow) for x in PACKAGE_IDS]
)
def test_episodes_of_a_made_world_have_the_shapes_of_imported_ones(name):
    env = python_env(name)
    env.reset(seed=0)
    _, state = interop.from_minigrid(env)
    begun, _ = jax.eval_shape(envs_jax.make(name).reset, jax.random.key(0))
    assert jax.tree.map(lambda x: (x.shape, x.dtype), begun) == jax.tree.map(
        lambda x: (x.shape, x.dtype), state
    )
