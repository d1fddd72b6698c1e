"""Worlds under Gymnasium: its own checks, and the same episodes as the world stepped by hand."""

import dataclasses
import importlib.util

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import envs_jax
from jaxact import JaxactError, make_key
from jaxact.gymnasium_adapter import to_gymnasium, to_gymnasium_vector
from jaxact.gymnasium_spaces import to_jax, to_numpy, to_space
from jaxact.spaces import Box, Dict, Discrete, Tuple
from tests.corridor import corridor
from tests.jaxact.test_recording import Shown

POMDP = corridor()
MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP]


@pytest.mark.parametrize(
    "name", ["MiniGrid-Empty-Random-5x5-v0", "MiniGrid-DoorKey-5x5-v0", "BabyAI-GoToRedBall-v0"]
)
def test_gymnasium_finds_no_fault_with_grid_worlds(name):
    check_env(to_gymnasium(envs_jax.make(name), render_mode="rgb_array"))


def test_gymnasium_finds_no_fault_with_a_flat_world():
    env = to_gymnasium(envs_jax.make("MiniGrid-Empty-Random-5x5-v0"), flatten=True)
    check_env(env)
    assert env.observation_space["image"] == gymnasium.spaces.Box(0, 255, (147,), np.uint8)
    again = gymnasium.make(env.spec).unwrapped
    np.testing.assert_array_equal(again.reset()[0]["image"], env.reset(seed=0)[0]["image"])


@pytest.mark.parametrize("seed", [0, 7, 2**32 - 1])
def test_episodes_are_those_of_the_world_stepped_by_hand(seed):
    env = to_gymnasium(POMDP, seed=seed)
    actions = np.random.default_rng(0).integers(0, 2, 12)
    reset, step = jax.jit(POMDP.reset), jax.jit(POMDP.step)
    ends = set()
    for episode in range(4):
        key = jax.random.fold_in(make_key(seed), episode)
        reset_key, step_key = jax.random.split(key)
        state, observation = reset(reset_key)
        seen, info = env.reset()
        np.testing.assert_array_equal(seen["vector"], observation["vector"])
        assert info == {}
        for t, action in enumerate(actions):
            state, expected = step(jax.random.fold_in(step_key, t), state, np.int32(action))
            seen, reward, terminated, truncated, info = env.step(action)
            np.testing.assert_array_equal(seen["vector"], expected.observation["vector"])
            assert reward == float(expected.reward)
            assert (terminated, truncated) == (expected.terminated, expected.truncated)
            assert info == {
                "success": bool(expected.success),
                "is_success": bool(expected.success),
                "reward/success": float(expected.reward_terms["success"]),
                "reward/step": float(expected.reward_terms["step"]),
                "task/distance": float(expected.metrics["distance"]),
            }
            if terminated or truncated:
                ends.add(terminated)
                break
    assert ends


def test_a_seed_begins_its_episodes_again():
    def cells(env, *seeds):
        return [int(env.reset(seed=seed)[0]["vector"].argmax()) for seed in seeds]

    first = cells(to_gymnasium(POMDP, seed=3), *[None] * 8)
    assert len(set(first)) > 1
    assert cells(to_gymnasium(POMDP), 3, *[None] * 7) == first
    assert cells(to_gymnasium(POMDP), None, None, 3, None, 3) == [
        *cells(to_gymnasium(POMDP, seed=0), None, None),
        *first[:2],
        first[0],
    ]


def same(one, other):
    assert data_equivalence(one, other, exact=True), (one, other)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("lanes", [1, 40])
def test_a_vector_is_many_environments_side_by_side(mode, lanes):
    """Beside Gymnasium's own, in values, dtypes and infos."""
    vector = to_gymnasium_vector(POMDP, lanes, autoreset_mode=mode)
    sync = SyncVectorEnv([lambda: to_gymnasium(POMDP)] * lanes, autoreset_mode=mode)
    assert vector.observation_space == sync.observation_space
    assert vector.action_space == sync.action_space
    assert vector.metadata["autoreset_mode"] == sync.metadata["autoreset_mode"]
    generator, finished = np.random.default_rng(1), 0
    for seed in (5, None, [2, *[None] * (lanes - 1)]):
        same(vector.reset(seed=seed), sync.reset(seed=seed))
        for _ in range(25):
            # Mostly to the right: some reach the goal there, others never.
            actions = (generator.random(lanes) < 0.8).astype(np.int64)
            stepped = vector.step(actions)
            same(stepped, sync.step(actions))
            finished += int(np.sum(stepped[2] | stepped[3]))
    assert finished > 3 * lanes


def test_lanes_do_not_depend_on_each_other():
    one, many = to_gymnasium_vector(POMDP, 1, seed=4), to_gymnasium_vector(POMDP, 5, seed=2)
    seen, others = one.reset()[0]["vector"], many.reset()[0]["vector"]
    for action in [1] * 30:
        np.testing.assert_array_equal(seen[0], others[2])
        seen = one.step(np.array([action]))[0]["vector"]
        others = many.step(np.array([0, 0, action, 1, 1]))[0]["vector"]


def test_pictures_are_rendered():
    pomdp = dataclasses.replace(POMDP, sensors={"a": Shown(), "b": Shown()})
    env = to_gymnasium(pomdp, render_mode="rgb_array")
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.render()
    cell = int(env.reset()[0]["a"].argmax())
    frame = env.render()
    assert frame.shape == (20, 30 + 8 + 30, 3)
    assert frame[0, 0, 0] == frame[0, -1, 0] == 40 * cell + 10
    vector = to_gymnasium_vector(pomdp, 3, render_mode="rgb_array")
    vector.reset()
    frames = vector.render()
    assert len(frames) == 3
    np.testing.assert_array_equal(frames[0], frame)
    assert to_gymnasium(pomdp).render() is None


def test_values_of_all_spaces_go_both_ways():
    space = Dict(
        {
            "move": Tuple((Discrete(3), Box(-1.0, 1.0, (2,)))),
            "grip": Box(0, 4, (2, 2), "uint8"),
        }
    )
    theirs = to_space(space)
    theirs.seed(0)
    for value in (theirs.sample() for _ in range(20)):
        mine = to_jax(space, value, ())
        assert bool(space.contains(mine))
        structure = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), mine)
        assert structure == space.structure
        back = to_numpy(space, mine, flatten=False)
        assert back in theirs
        same(back, dict(value))
    flat = to_numpy(space, mine, flatten=True)
    assert flat in to_space(space, flatten=True)
    np.testing.assert_array_equal(flat["grip"], value["grip"].ravel())


@pytest.mark.parametrize("action", [2, -1, 0.5, [0, 1]])
def test_bad_actions_are_told(action):
    env = to_gymnasium(POMDP)
    env.reset()
    with pytest.raises(JaxactError, match="expected an action of 0 to 1"):
        env.step(action)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"render_mode": "human"}, "unknown render mode 'human'; the nearest is 'rgb_array'"),
        ({"render_mode": "rgb_array"}, "nothing to render"),
        ({"num_envs": 0}, "num_envs must be at least 1"),
        ({"autoreset_mode": AutoresetMode.DISABLED}, "NEXT_STEP or SAME_STEP"),
    ],
)
def test_bad_options_are_told(options, message):
    with pytest.raises(JaxactError, match=message):
        to_gymnasium_vector(POMDP, **{"num_envs": 2} | options)


def test_bad_resets_are_told():
    vector = to_gymnasium_vector(POMDP, 2)
    with pytest.raises(gymnasium.error.ResetNeeded):
        vector.step(np.zeros(2, np.int64))
    with pytest.raises(JaxactError, match="expected 2 seeds, but got 3"):
        vector.reset(seed=[1, 2, 3])
    with pytest.raises(JaxactError, match="reset_mask"):
        vector.reset(options={"reset_mask": np.ones(2, bool)})


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("stable_baselines3") is None,
    reason="Stable-Baselines3 is not installed (pip install -e '.[adapters]')",
)
def test_stable_baselines3_learns():
    from stable_baselines3 import PPO
    from stable_baselines3.common import env_checker
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.monitor import Monitor

    world = envs_jax.make("MiniGrid-Empty-5x5-v0")
    env_checker.check_env(to_gymnasium(world, flatten=True))
    env = Monitor(to_gymnasium(world, flatten=True))
    model = PPO("MultiInputPolicy", env, n_steps=256, learning_rate=1e-3, seed=0, device="cpu")
    before, _ = evaluate_policy(model, env, 20, deterministic=False)
    model.learn(6_000)
    after, _ = evaluate_policy(model, env, 20, deterministic=False)
    assert after > before + 0.1
