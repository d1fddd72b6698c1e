"""Brax's environments as worlds: the steps of the originals, and rewards that add up."""

import importlib.util
import sys
import warnings

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
from envs_jax import brax_worlds
from jaxact import JaxactError
from jaxact.testing import check_pomdp

# Registered under these names in Gymnasium, of Brax's that have a threshold.
GYMNASIUM = {
    "ant": "Ant-v5",
    "halfcheetah": "HalfCheetah-v5",
    "hopper": "Hopper-v5",
    "inverted_double_pendulum": "InvertedDoublePendulum-v5",
    "inverted_pendulum": "InvertedPendulum-v5",
    "swimmer": "Swimmer-v5",
}


def original(name, **options):
    """Returns Brax's own environment, with jitted reset and step."""
    env = brax_worlds.Simulator("brax", name, options).theirs
    # It is traced under the promotion that Brax is written for; what it uses warns of itself.
    with jax.numpy_dtype_promotion("standard"), warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        state = jax.eval_shape(env.reset, jax.random.PRNGKey(0))
        step = jax.jit(env.step).trace(state, jnp.zeros(env.action_size, jnp.float32)).lower()
    return env, step.compile()


def play(name, steps=5, **options):
    """Plays random actions in both, from the same state; returns the rows of both."""
    pomdp = envs_jax.make(f"Brax-{name}-v0", **options)
    _, their_step = original(name, **{"backend": "generalized", **options})
    state, _ = jax.jit(pomdp.reset)(jax.random.PRNGKey(3))
    theirs, step = state.environment, jax.jit(pomdp.step)
    rows = []
    for key in jax.random.split(jax.random.PRNGKey(4), steps):
        action = pomdp.action_space.sample(key)
        theirs = their_step(theirs, action)
        state, result = step(key, state, action)
        rows.append((result, theirs))
    return rows


def assert_same_steps(rows, rtol):
    for ours, theirs in rows:
        np.testing.assert_allclose(ours.observation["observation"], theirs.obs, rtol, 1e-5)
        np.testing.assert_allclose(ours.reward, theirs.reward, rtol, 1e-5)
        terms = np.sum([np.asarray(x) for x in ours.reward_terms.values()])
        np.testing.assert_allclose(terms, theirs.reward, rtol, 1e-5)
        assert bool(ours.terminated) == bool(theirs.done)


def test_ids_are_those_of_brax():
    assert {f"Brax-{name}-v0" for name in brax_worlds.NAMES} <= set(envs_jax.ids())
    _, names = brax_worlds._brax()
    assert set(brax_worlds.NAMES) == set(names)


def test_thresholds_are_those_of_gymnasium():
    found = {ours: gymnasium.spec(theirs).reward_threshold for ours, theirs in GYMNASIUM.items()}
    assert found == brax_worlds._THRESHOLDS
    lengths = {gymnasium.spec(theirs).max_episode_steps for theirs in GYMNASIUM.values()}
    assert lengths == {brax_worlds.HORIZON}


def test_a_world_without_physics_has_the_steps_of_the_original():
    check_pomdp(envs_jax.make("Brax-fast-v0"), steps=3, lanes=2)
    rows = play("fast")
    assert_same_steps(rows, 1e-6)
    assert float(rows[-1][1].reward) > 0.0
    assert set(rows[0][0].reward_terms) == {"reward"}


def test_episodes_are_truncated_at_the_horizon():
    pomdp = envs_jax.make("Brax-fast-v0", horizon=2)
    state, _ = pomdp.reset(jax.random.key(0))
    flags = []
    for _ in range(2):
        state, step = pomdp.step(jax.random.key(0), state, jnp.ones(1, jnp.float32))
        flags.append((bool(step.terminated), bool(step.truncated)))
    assert flags == [(False, False), (False, True)]


def test_parts_of_an_observation_are_sensors():
    pomdp = envs_jax.make("Brax-fast-v0", obs_mode="dict_pixels_state")
    shapes = {name: space.shape for name, space in pomdp.observation_space.spaces.items()}
    pixels = {f"pixels/view_{view}": (4, 4, 3) for view in range(2)}
    assert shapes == {"state": (2,), **pixels}
    _, observation = pomdp.reset(jax.random.key(0))
    assert {name: x.shape for name, x in observation.items()} == shapes


def test_the_state_stepped_from_is_left_as_it_was():
    class Writing:
        """Writes into the metrics that it is given, as Brax's environments do."""

        action_size = 1

        def step(self, state, action):
            state["metrics"].update(x=action[0])
            return state

    simulator = brax_worlds.Simulator("brax", "writing")
    state = {"metrics": {"x": jnp.float32(0)}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(brax_worlds, "_load", lambda simulator: Writing())
        after = simulator.step(jax.random.key(0), state, jnp.ones(1, jnp.float32))
    assert float(state["metrics"]["x"]) == 0.0
    assert float(after["metrics"]["x"]) == 1.0


def test_an_episode_succeeds_from_the_threshold_on():
    class After:
        reward, done, metrics = jnp.float32(2), jnp.float32(0), {}

    task = brax_worlds.SimulatorReward(threshold=3.0)
    total, outcome = task.step(jnp.float32(0), None, None, After)
    assert not bool(outcome.success["threshold"])
    _, outcome = task.step(total, None, None, After)
    assert bool(outcome.success["threshold"])


def test_unusual_horizons_and_options_have_no_threshold(monkeypatch):
    monkeypatch.setattr(brax_worlds, "_pomdp", lambda simulator, task, horizon: task)
    assert brax_worlds.brax_world("hopper", backend="mjx").threshold == 3800.0
    assert brax_worlds.brax_world("hopper", horizon=100).threshold is None
    assert brax_worlds.brax_world("hopper", healthy_reward=2.0).threshold is None
    assert brax_worlds.brax_world("walker2d").threshold is None


@pytest.mark.parametrize(
    ("name", "options", "sentence"),
    [
        ("ants", {}, r"unknown environment of brax 'ants'; the nearest is 'ant'"),
        ("fast", {"backend": "mjz"}, r"unknown backend of Brax 'mjz'; the nearest is 'mjx'"),
        ("swimmer", {"backend": "mjx"}, r"brax cannot make 'swimmer' with .*: Unsupported backend"),
        ("fast", {"obs_mode": "smell"}, r"brax cannot make 'fast' with .*'smell'"),
    ],
)
def test_what_cannot_be_made_is_refused(name, options, sentence):
    with pytest.raises(JaxactError, match=sentence):
        brax_worlds.brax_world(name, **options)


def test_actions_of_other_shapes_are_refused():
    pomdp = envs_jax.make("Brax-fast-v0")
    state, _ = jax.eval_shape(pomdp.reset, jax.random.key(0))
    with pytest.raises(JaxactError, match=r"'fast' has the shape \(\d,\), not \(9,\)"):
        jax.eval_shape(pomdp.step, jax.random.key(0), state, jnp.zeros(9, jnp.float32))


def test_samplers_that_cannot_be_are_refused():
    with pytest.raises(JaxactError, match="horizon of a simulator's episodes must be at least 1"):
        brax_worlds.brax_world("fast", horizon=0)
    pomdp = envs_jax.make("Brax-fast-v0")
    other = brax_worlds.Resets(brax_worlds.Simulator("brax", "ant"))
    with pytest.raises(JaxactError, match="the sampler's episodes are of"):
        type(pomdp)(pomdp.environment, pomdp.task, other, pomdp.sensors)


def test_playground_is_asked_for_when_it_is_not_there(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco_playground", None)
    with pytest.raises(JaxactError, match="pip install playground"):
        brax_worlds.playground_world("CartpoleSwingup")


@pytest.mark.slow
@pytest.mark.parametrize("name", brax_worlds.NAMES)
def test_steps_are_those_of_the_original_and_components_sum_to_the_reward(name):
    rows = play(name)
    assert_same_steps(rows, 1e-3)
    ours, _ = rows[0]
    components = brax_worlds._WEIGHTS.get(name)
    expected = {"reward"} if components is None else {n.removeprefix("reward_") for n in components}
    assert set(ours.reward_terms) - {"bonus"} == expected
    # What is in the reward is no task metric too.
    assert not [metric for metric in ours.metrics if metric.startswith("reward_")]


@pytest.mark.slow
@pytest.mark.parametrize("backend", brax_worlds.BACKENDS)
def test_every_backend_steps(backend):
    assert_same_steps(play("inverted_pendulum", backend=backend), 1e-3)
    for name in brax_worlds.NAMES:
        if name == "swimmer" and backend != "generalized":
            continue
        pomdp = envs_jax.make(f"Brax-{name}-v0", backend=backend)
        state, _ = jax.eval_shape(pomdp.reset, jax.random.key(0))
        after, _ = jax.eval_shape(pomdp.step, jax.random.key(0), state, pomdp.action_space.zeros())
        assert jax.tree.map(lambda x: (x.shape, x.dtype), after) == jax.tree.map(
            lambda x: (x.shape, x.dtype), state
        )


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("mujoco_playground") is None,
    reason="MuJoCo Playground is not installed (pip install playground)",
)
def test_playground():
    pomdp = brax_worlds.playground_world("CartpoleBalance", impl="jax")
    check_pomdp(pomdp, steps=3, lanes=2)
    assert pomdp.sampler.horizon == 1000
