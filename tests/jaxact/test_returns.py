"""Advantages against numbers worked out by hand, and against a plain loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.returns import (
    episode_means,
    generalized_advantages,
    known_transitions,
    n_step_returns,
    vtrace,
)


def f32(*values):
    return jnp.asarray(values, jnp.float32)


def test_by_hand_without_an_ending():
    # γ = 0.5, λ = 0.5: δ = [1 + 1 − 1, 2 + 2 − 2] = [1, 2]; A₂ = 2, A₁ = 1 + 0.25 · 2.
    advantages = generalized_advantages(
        f32(1, 2),
        f32(1, 2),
        f32(2, 4),
        jnp.array([False, False]),
        jnp.array([False, False]),
        0.5,
        0.5,
    )
    np.testing.assert_allclose(advantages, [1.5, 2.0])


@pytest.mark.parametrize(
    ("terminated", "first"),
    [
        (True, 1 - 1),  # nothing is bootstrapped
        (False, 1 + 0.5 * 8 - 1),  # truncated: the final state's value is
    ],
)
def test_by_hand_at_an_ending(terminated, first):
    advantages = generalized_advantages(
        f32(1, 2),
        f32(1, 2),
        f32(8, 4),
        jnp.array([terminated, False]),
        jnp.array([True, False]),
        0.5,
        0.5,
    )
    # What comes after the ending does not leak into the episode before it.
    np.testing.assert_allclose(advantages, [first, 2.0])


@pytest.mark.parametrize("transform", [lambda f: f, jax.jit])
def test_against_a_loop(transform):
    rng = np.random.default_rng(0)
    shape = (20, 5)
    r, v, w = rng.normal(size=(3, *shape)).astype(np.float32)
    terminated = rng.random(shape) < 0.1
    finished = terminated | (rng.random(shape) < 0.1)
    discount, lambda_ = 0.9, 0.8
    expected = np.zeros(shape)
    running = np.zeros(shape[1])
    for t in reversed(range(shape[0])):
        delta = r[t] + discount * np.where(terminated[t], 0, w[t]) - v[t]
        running = delta + discount * lambda_ * np.where(finished[t], 0, running)
        expected[t] = running
    got = transform(generalized_advantages)(r, v, w, terminated, finished, discount, lambda_)
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-5)


def test_means_begin_anew_with_each_episode():
    finished = jnp.array([[False, True, False, False], [True, False, False, False]]).T
    means = episode_means(f32([4, 2, 1, 3], [1, 2, 4, 6]).T, finished)
    np.testing.assert_allclose(means.T, [[4, 3, 1, 2], [1, 2, 3, 4]])


def draw_window(seed=0, shape=(20, 5)):
    """Rewards, values, log-ratios, and flags, both of which may be true at once."""
    rng = np.random.default_rng(seed)
    r, v, log_ratio = rng.normal(size=(3, *shape)).astype(np.float32)
    terminated, truncated = rng.random((2, *shape)) < 0.15
    return r, v, log_ratio, terminated, truncated


def test_what_came_after_the_last_step_and_after_truncations_is_not_known():
    flags = jnp.array([[0, 0], [0, 1], [1, 0], [1, 1], [0, 0]], bool)
    np.testing.assert_array_equal(known_transitions(*flags.T), [True, False, True, True, False])
    np.testing.assert_array_equal(known_transitions(*flags[2:3].T), [True])


@pytest.mark.parametrize("n", [1, 3, 50])
def test_n_step_returns_against_a_walk_forward(n):
    r, v, _, terminated, truncated = draw_window()
    expected = np.zeros_like(r)
    for t, b in np.ndindex(*r.shape):
        total, weight, row = 0.0, 1.0, t
        for _ in range(n):
            if not terminated[row, b] and (truncated[row, b] or row == len(r) - 1):
                break
            total, weight = total + weight * r[row, b], 0.9 * weight
            if terminated[row, b]:
                weight = 0.0
                break
            row += 1
        expected[t, b] = total + weight * v[row, b]
    known = known_transitions(terminated, truncated)
    got = n_step_returns(r, v, terminated, known, 0.9, n)
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-5)
    assert np.all(np.asarray(got)[~np.asarray(known)] == v[~np.asarray(known)])


@pytest.mark.parametrize(("lambda_", "clip"), [(1.0, 1.0), (0.8, 1.0), (1.0, 0.5)])
def test_vtrace_against_the_papers_sum(lambda_, clip):
    """Equation 1: vs = V(s) + Σ γ^(t−s) (Π c) δ, written out for each s."""
    r, v, log_ratio, terminated, truncated = draw_window()
    length = len(r)
    known = np.asarray(known_transitions(terminated, truncated))
    rho = np.minimum(np.exp(log_ratio), clip)
    values = np.array(v, np.float64)
    for s, b in np.ndindex(*r.shape):
        weight = 1.0
        for t in range(s, length):
            if not known[t, b]:
                break
            after = 0.0 if terminated[t, b] else v[t + 1, b]
            values[s, b] += weight * rho[t, b] * (r[t, b] + 0.9 * after - v[t, b])
            if terminated[t, b]:
                break
            weight *= 0.9 * lambda_ * rho[t, b]
    after = np.where(terminated, 0.0, np.concatenate([values[1:], values[-1:]]))
    advantages = np.where(known, rho * (r + 0.9 * after - v), 0.0)
    got = vtrace(r, v, log_ratio, terminated, known, 0.9, lambda_, clip)
    np.testing.assert_allclose(got.values, values, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(got.advantages, advantages, rtol=1e-4, atol=1e-5)


def test_on_its_own_policy_vtrace_is_the_sum_of_rewards():
    """Remark 1 of the paper, with a window that ends in termination."""
    r, v, log_ratio, *_ = draw_window()
    terminated = np.zeros(r.shape, bool)
    terminated[-1] = True
    known = known_transitions(terminated, np.zeros(r.shape, bool))
    got = vtrace(r, v, np.zeros_like(log_ratio), terminated, known, 0.9)
    expected = n_step_returns(r, v, terminated, known, 0.9, len(r))
    np.testing.assert_allclose(got.values, expected, rtol=1e-4, atol=1e-5)
