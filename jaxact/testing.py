"""A smoke test for one's own worlds: `check_pomdp(pomdp)` finds what training would trip over."""

from __future__ import annotations

import re
from typing import Any

import chex
import jax
import jax.numpy as jnp

from jaxact.overrides import numbers, with_numbers
from jaxact.pomdp import POMDP, FinishedEpisodes, State, Step
from jaxact.spaces import Agents


def check_pomdp(pomdp: POMDP, *, seed: int = 0, lanes: int = 4, steps: int = 16) -> None:
    """Checks a POMDP's shapes, dtypes, purity, spaces, flags, tracing and bounds.

    Args:
      pomdp: to be checked.
      seed: of the episodes played with random actions.
      lanes: how many.
      steps: how many of each.

    Raises:
      AssertionError: with a sentence that says what is wrong.
      JaxactError: the world is simulated outside of JAX, so that its parts are not pure.
    """
    pomdp.check_in_jax("these checks are")
    assert hash(pomdp) == hash(pomdp), "the POMDP is not hashable"
    key = jax.random.key(seed)
    state, observation = jax.jit(pomdp.reset)(key)
    action = pomdp.action_space.sample(key)
    _check_structure(pomdp, state, observation, action)
    _check_purity(pomdp, state, action)
    _check_batch(pomdp, key, lanes, steps)
    _check_expert(pomdp, key, state)
    _check_numbers(pomdp, key, action)
    _check_sampler(pomdp, key, state)


def _signature(tree: Any) -> Any:
    return jax.tree.map(lambda x: (jnp.shape(x), jnp.result_type(x), _is_weak(x)), tree)


def _is_weak(x: Any) -> bool:
    return bool(getattr(getattr(x, "aval", x), "weak_type", False))


def _form(dtype: str, shape: tuple[int, ...]) -> str:
    return f"{dtype}{list(shape)}" if shape else f"a {dtype} scalar"


def _is_scalar(x: jax.Array, dtype: Any) -> bool:
    return x.dtype == dtype and x.shape == ()


def _check_structure(
    pomdp: POMDP, state: State, observation: dict[str, jax.Array], action: Any
) -> None:
    space = pomdp.observation_space
    for name, expected in space.structure.items():
        seen = observation[name]
        assert (seen.shape, seen.dtype) == (expected.shape, expected.dtype), (
            f"sensor {name!r} returns {seen.dtype}{list(seen.shape)}, "
            f"but its space says {expected.dtype}{list(expected.shape)}"
        )
        assert bool(space.spaces[name].contains(seen)), (
            f"the first reading of sensor {name!r} lies outside its space"
        )
    assert bool(pomdp.action_space.contains(action)), "the action space does not contain its sample"
    after, step = pomdp.step(jax.random.key(1), state, action)
    assert _signature(after) == _signature(state), (
        "step changes the structure, shapes or dtypes of the state (a weakly typed number counts): "
        f"{_first_difference(state, after)}"
    )
    _check_step(step, _agent_axis(pomdp))


def _agent_axis(pomdp: POMDP) -> tuple[int, ...]:
    """The shape of what each agent has one of."""
    return (pomdp.num_agents,) if isinstance(pomdp.action_space, Agents) else ()


def _check_step(step: Step, each: tuple[int, ...]) -> None:
    for name in ("terminated", "truncated", "success"):
        flag = getattr(step, name)
        assert _is_scalar(flag, jnp.bool_), f"{name} must be a bool scalar"
    rewards = {name: (value, each) for name, value in step.reward_terms.items()}
    metrics = {f"metric {name}": (value, ()) for name, value in step.metrics.items()}
    for name, (value, shape) in {**rewards, **metrics}.items():
        assert (value.dtype, value.shape) == (jnp.float32, shape), (
            f"{name} must be {_form('float32', shape)}, it is {value.dtype}{list(value.shape)}"
        )
    assert step.reward.dtype == jnp.float32, "the reward must be float32"


def _check_purity(pomdp: POMDP, state: State, action: Any) -> None:
    key = jax.random.key(2)
    plain = pomdp.step(key, state, action)
    again = pomdp.step(key, state, action)
    chex.assert_trees_all_equal(
        _with_plain_keys(plain),
        _with_plain_keys(again),
        custom_message="step is not a pure function",
    )
    compiled = jax.jit(lambda k, s, a: pomdp.step(k, s, a))(key, state, action)
    chex.assert_trees_all_close(
        _with_plain_keys(plain),
        _with_plain_keys(compiled),
        rtol=1e-5,
        custom_message="step differs under jit from step without",
    )


def _with_plain_keys(tree: Any) -> Any:
    """Returns a tree with the numbers of PRNG keys in their place, which NumPy can compare."""

    def plain(x: Any) -> Any:
        is_key = jax.dtypes.issubdtype(jnp.result_type(x), jax.dtypes.prng_key)
        return jax.random.key_data(x) if is_key else x

    return jax.tree.map(plain, tree)


def _check_batch(pomdp: POMDP, key: jax.Array, lanes: int, steps: int) -> None:
    chex.clear_trace_counter()
    step = jax.jit(jax.vmap(chex.assert_max_traces(_fresh_step(pomdp), n=1)))
    state, observation = jax.jit(jax.vmap(pomdp.reset))(jax.random.split(key, lanes))
    inside = jax.jit(jax.vmap(pomdp.observation_space.contains))
    for t in range(steps):
        keys = jax.random.split(jax.random.fold_in(key, t), lanes)
        action = jax.vmap(pomdp.action_space.sample)(keys)
        last, (state, result) = state, step(keys, state, action)
        observation = result.observation
        assert bool(jnp.all(inside(observation))), f"a reading leaves its space after {t + 1} steps"
        nothing = jnp.zeros((lanes, *_agent_axis(pomdp)), jnp.float32)
        total = sum(result.reward_terms.values(), start=nothing)
        assert bool(jnp.all(jnp.isfinite(result.reward))), "a reward is not finite"
        assert bool(jnp.allclose(result.reward, total)), "the reward is not the sum of its terms"
        assert bool(jnp.all(result.truncated == (last.steps + 1 >= last.horizon))), (
            "truncated is not steps >= horizon"
        )


def _fresh_step(pomdp: POMDP) -> Any:
    """Returns a function object of its own, so that its traces are counted from zero."""

    def step(key: jax.Array, state: State, action: Any) -> tuple[State, Step]:
        return pomdp.step(key, state, action)

    return step


def _check_expert(pomdp: POMDP, key: jax.Array, state: State) -> None:
    if not pomdp.has_expert:
        return
    advice = jax.jit(pomdp.expert)(key, state)
    expected = pomdp.action_space.structure
    chex.assert_trees_all_equal_shapes_and_dtypes(advice.action, expected)
    each = _agent_axis(pomdp)
    assert (advice.valid.dtype, advice.valid.shape) == (jnp.bool_, each), (
        f"the expert's `valid` must be {_form('bool', each)}"
    )
    if bool(jnp.all(advice.valid)):
        assert bool(pomdp.action_space.contains(advice.action)), (
            "the expert's action is not in the action space"
        )


def _check_numbers(pomdp: POMDP, key: jax.Array, action: Any) -> None:
    def play(values: Any) -> Any:
        traced = with_numbers(pomdp, values)
        state, _ = traced.reset(key)
        advice = traced.expert(key, state) if pomdp.has_expert else None
        return traced.step(key, state, action), advice

    try:
        jax.eval_shape(play, numbers(pomdp))
    except (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError) as error:
        found = re.search(r"the argument values\['([^']+)'\]", str(error))
        name = found[1] if found else "a float of the POMDP"
        raise AssertionError(
            f"{name} decides in Python what is computed, but floats are data in training: compute "
            "with jnp.asarray(...) of it, or have its class set numbers_are_structure"
        ) from None


def _check_sampler(pomdp: POMDP, key: jax.Array, state: State) -> None:
    before = pomdp.sampler.init(key)
    finished = FinishedEpisodes(
        mask=jnp.ones((1, 1), bool),
        success=jnp.ones((1, 1), bool),
        episode_return=jnp.ones((1, 1), jnp.float32),
        length=jnp.ones((1, 1), jnp.int32),
        task=jax.tree.map(lambda x: x[None, None], state.task),
        origin=jax.tree.map(lambda x: x[None, None], state.origin),
        mean_error=jnp.ones((1, 1), jnp.float32),
    )
    after = pomdp.sampler.update(before, finished)
    assert _signature(after) == _signature(before), (
        "the sampler's update changes the structure, shapes or dtypes of its state"
    )


def _first_difference(before: Any, after: Any) -> str:
    pairs = zip(
        jax.tree_util.tree_leaves_with_path(_signature(before), is_leaf=_is_entry),
        jax.tree_util.tree_leaves_with_path(_signature(after), is_leaf=_is_entry),
        strict=False,
    )
    for (path, old), (_, new) in pairs:
        if old != new:
            return f"{jax.tree_util.keystr(path)} was {old}, is {new} (shape, dtype, weak)"
    return "the tree structures differ"


def _is_entry(x: Any) -> bool:
    return isinstance(x, tuple) and len(x) == 3 and isinstance(x[2], bool)
