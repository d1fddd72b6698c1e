"""Advantages against numbers worked out by hand, and against a plain loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.returns import episode_means, generalized_advantages


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
