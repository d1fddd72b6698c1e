"""Distributions against closed forms and frequencies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxact.distributions import Categorical, DiagonalNormal, Distribution, Joint, SquashedNormal
from jaxact.errors import JaxactError


def test_categorical_matches_its_probabilities():
    logits = jnp.log(jnp.array([0.1, 0.2, 0.0, 0.7], jnp.float32))
    distribution = Categorical(jnp.broadcast_to(logits, (20_000, 4)))
    draws = np.asarray(distribution.sample(jax.random.key(0)))
    frequency = np.bincount(draws, minlength=4) / len(draws)
    np.testing.assert_allclose(frequency, [0.1, 0.2, 0.0, 0.7], atol=0.015)
    assert frequency[2] == 0
    np.testing.assert_allclose(Categorical(logits[:2]).probabilities, [1 / 3, 2 / 3], rtol=1e-6)


def test_categorical_closed_forms():
    distribution = Categorical(jnp.array([[0.0, 1.0, -1.0]], jnp.float32))
    p = np.exp([0, 1, -1]) / np.exp([0, 1, -1]).sum()
    np.testing.assert_allclose(distribution.log_prob(jnp.array([2])), [np.log(p[2])], rtol=1e-6)
    np.testing.assert_allclose(distribution.entropy(), [-(p * np.log(p)).sum()], rtol=1e-6)
    assert int(distribution.mode()[0]) == 1


def test_categorical_never_leaves_its_support():
    logits = jnp.array([[0.0, -1e9], [-1e9, 0.0]], jnp.float32)
    for seed in range(50):
        np.testing.assert_array_equal(Categorical(logits).sample(jax.random.key(seed)), [0, 1])


def test_normal_against_scipy():
    mean, log_std = jnp.array([0.5, -1.0]), jnp.array([0.2, -0.3])
    distribution = DiagonalNormal(mean, log_std)
    x = jnp.array([0.0, 0.1])
    reference = stats.norm(np.asarray(mean), np.exp(np.asarray(log_std)))
    np.testing.assert_allclose(distribution.log_prob(x), reference.logpdf(x).sum(), rtol=1e-5)
    np.testing.assert_allclose(distribution.entropy(), reference.entropy().sum(), rtol=1e-5)


def test_joint_adds_up_its_parts():
    a = Categorical(jnp.zeros((3, 2), jnp.float32))
    b = DiagonalNormal(jnp.zeros((3, 1)), jnp.zeros(1))
    joint = Joint({"a": a, "b": b})
    action = joint.sample(jax.random.key(0))
    assert action["a"].shape == (3,)
    assert action["b"].shape == (3, 1)
    np.testing.assert_allclose(
        joint.log_prob(action), a.log_prob(action["a"]) + b.log_prob(action["b"])
    )
    np.testing.assert_allclose(joint.entropy(), a.entropy() + b.entropy())


def test_kl_of_categoricals_is_the_sum_over_actions():
    rng = np.random.default_rng(0)
    p, q = rng.dirichlet(np.ones(4), 3), rng.dirichlet(np.ones(4), 3)
    kl = Categorical(jnp.log(jnp.float32(p)) + 3.0).kl(Categorical(jnp.log(jnp.float32(q))))
    np.testing.assert_allclose(kl, stats.entropy(p, q, axis=-1), rtol=1e-5)


def test_kl_of_normals_is_the_mean_log_ratio():
    p = DiagonalNormal(jnp.array([0.5, -1.0]), jnp.array([0.2, -0.3]))
    q = DiagonalNormal(jnp.array([0.1, 0.0]), jnp.array([0.0, 0.4]))
    nodes, weights = np.polynomial.hermite_e.hermegauss(20)
    expected = 0.0
    for mean, log_std, other_mean, other_log_std in zip(
        *map(np.asarray, (p.mean, p.log_std, q.mean, q.log_std)), strict=True
    ):
        x = mean + np.exp(log_std) * nodes
        ours, theirs = (
            stats.norm(mean, np.exp(log_std)),
            stats.norm(other_mean, np.exp(other_log_std)),
        )
        log_ratio = ours.logpdf(x) - theirs.logpdf(x)
        expected += (weights * log_ratio).sum() / weights.sum()
    assert float(p.kl(q)) == pytest.approx(expected, rel=1e-5)
    assert float(p.kl(p)) == 0.0
    squashed = [SquashedNormal(x.mean, x.log_std, jnp.float32(0), jnp.float32(2)) for x in (p, q)]
    assert float(squashed[0].kl(squashed[1])) == pytest.approx(expected, rel=1e-5)


def test_kl_of_joints_adds_up_and_others_say_that_they_have_none():
    a, b = (Categorical(normal) for normal in jax.random.normal(jax.random.key(0), (2, 3, 4)))
    c, d = (
        DiagonalNormal(jnp.zeros((3, 1)), jnp.zeros(1)),
        DiagonalNormal(jnp.ones((3, 1)), jnp.ones(1)),
    )
    joint = Joint({"x": a, "y": c}).kl(Joint({"x": b, "y": d}))
    np.testing.assert_allclose(joint, a.kl(b) + c.kl(d))

    class Uncommon(Categorical):
        kl = Distribution.kl

    with pytest.raises(JaxactError, match="Uncommon has no closed form"):
        Uncommon(a.logits).kl(b)
