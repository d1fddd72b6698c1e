"""Joint policies against tables of probabilities in NumPy, and the loss that coordinates them."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxact.agents import as_lanes
from jaxact.distributions import Categorical
from jaxact.losses import Batch, Cordial, Progress
from jaxact.models import ActorCriticOutput, CentralActor, SyncActor
from jaxact.team_distributions import JointCategorical, MixtureOfMarginals, joint_log_probs

TIMES, LANES, COMPONENTS, ACTIONS = 2, 3, 2, 4


def softmax(x):
    e = np.exp(x - x.max(-1, keepdims=True))
    return e / e.sum(-1, keepdims=True)


def drawn(agents, seed=0):
    """One distribution of each kind, and the tables [T, B, n, …, n] of their probabilities."""
    generator = np.random.default_rng(seed)

    def normal(*shape):
        return generator.normal(size=(TIMES, LANES, *shape)).astype(np.float32)

    own, weights = normal(agents, COMPONENTS, ACTIONS), normal(COMPONENTS)
    whole, alone = normal(ACTIONS**agents), normal(agents, ACTIONS)
    mixture = np.zeros((TIMES, LANES, *(ACTIONS,) * agents))
    product = np.zeros_like(mixture)
    for actions in itertools.product(range(ACTIONS), repeat=agents):
        place = (slice(None), slice(None), *actions)
        for k in range(COMPONENTS):
            term = softmax(weights)[..., k]
            for i, a in enumerate(actions):
                term = term * softmax(own[:, :, i, k])[..., a]
            mixture[place] += term
        product[place] = np.prod(
            [softmax(alone[:, :, i])[..., a] for i, a in enumerate(actions)], axis=0
        )

    def for_each(x):
        return jnp.repeat(jnp.asarray(x)[:, :, None], agents, axis=2)

    return {
        "sync": (MixtureOfMarginals(jnp.asarray(own), for_each(weights), agents), mixture),
        "central": (
            JointCategorical(for_each(whole), agents),
            softmax(whole).reshape(mixture.shape),
        ),
        "marginal": (Categorical(jnp.asarray(alone)), product),
    }


@pytest.mark.parametrize("agents", [2, 3])
def test_tables_are_those_of_the_definitions(agents):
    for name, (distribution, table) in drawn(agents).items():
        found = jnp.exp(joint_log_probs(distribution, agents))
        assert found.shape == (TIMES, LANES, 1, *table.shape[2:])
        np.testing.assert_allclose(found[:, :, 0], table, rtol=2e-5, err_msg=name)
        laid_out = joint_log_probs(as_lanes(distribution, 2), agents)
        np.testing.assert_allclose(jnp.exp(laid_out), table, rtol=2e-5, err_msg=name)
        if agents == 2:
            rank = {"sync": COMPONENTS, "central": ACTIONS, "marginal": 1}[name]
            np.testing.assert_array_equal(np.linalg.matrix_rank(table, tol=1e-6), rank)


@pytest.mark.parametrize("name", ["sync", "central"])
def test_teams_are_told_what_the_tables_say(name):
    agents = 3
    distribution, table = drawn(agents)[name]
    action = np.random.default_rng(1).integers(ACTIONS, size=(TIMES, LANES, agents))
    expected = np.zeros((TIMES, LANES))
    for t, b in itertools.product(range(TIMES), range(LANES)):
        expected[t, b] = np.log(table[(t, b, *action[t, b])])
    entropy = -(table * np.log(table)).sum((2, 3, 4))
    best = table.reshape(TIMES, LANES, -1).argmax(-1)
    mode = np.stack(np.unravel_index(best, (ACTIONS,) * agents), -1)
    given = jnp.asarray(action, jnp.int32)
    for team, a, m in (
        (distribution, given, mode),
        (as_lanes(distribution, 2), as_lanes(given, 2), mode.reshape(TIMES, -1)),
    ):
        shape = a.shape

        def each(x, shape=shape):
            return np.repeat(x, agents, axis=-1).reshape(shape)

        np.testing.assert_allclose(team.log_prob(a), each(expected), rtol=1e-5)
        np.testing.assert_allclose(team.entropy(), each(entropy), rtol=1e-5)
        np.testing.assert_array_equal(team.mode(), m)
    other = drawn(agents, seed=5)["central"][0]
    if name == "central":
        q = np.exp(joint_log_probs(other, agents))[:, :, 0]
        kl = (table * np.log(table / q)).sum((2, 3, 4))
        np.testing.assert_allclose(distribution.kl(other)[..., 0], kl, rtol=1e-4)


@pytest.mark.parametrize("name", ["sync", "central"])
def test_draws_are_as_frequent_as_the_table_says(name):
    distribution, table = drawn(2)[name]
    keys = jax.random.split(jax.random.key(0), 20_000)
    action = np.asarray(jax.jit(jax.vmap(distribution.sample))(keys))
    assert action.shape == (20_000, TIMES, LANES, 2)
    assert action.dtype == np.int32
    for t, b in itertools.product(range(TIMES), range(LANES)):
        counts = np.zeros((ACTIONS, ACTIONS))
        np.add.at(counts, tuple(action[:, t, b].T), 1)
        np.testing.assert_allclose(counts / 20_000, table[t, b], atol=0.017)


def batch_of(kinds):
    """A batch of lanes with their agents inside, of which only what `Cordial` reads is there."""
    lanes = kinds.shape[1]
    nothing = jnp.zeros((TIMES, lanes), jnp.float32)
    return Batch(
        **dict.fromkeys(
            (
                *("previous_action", "action", "log_prob", "value", "reward", "reward_terms"),
                *("truncated", "advantage", "normalized_advantage", "returns", "is_first"),
            ),
            nothing,
        ),
        terminated=nothing,
        observation={"coordination": kinds},
        memory=(),
        expert=None,
        key=nothing,
        axis_name=None,
    )


@pytest.mark.parametrize("agents", [2, 3])
def test_cordial_is_the_mean_over_cells_of_the_matrix(agents):
    kinds = np.random.default_rng(3).integers(3, size=(TIMES, LANES, *(ACTIONS,) * agents))
    batch = batch_of(jnp.repeat(jnp.asarray(kinds, jnp.uint8), agents, axis=1))
    progress = Progress(jnp.float32(0), jnp.float32(0))
    for name, (distribution, table) in drawn(agents).items():
        losses, invalid, variation = [], [], []
        for t, b in itertools.product(range(TIMES), range(LANES)):
            p, m = table[t, b], kinds[t, b]
            losses.append(-0.5 * (np.log(p[m == 1]).mean() + np.log(p[m == 2]).mean()))
            invalid.append(p[m == 0].sum())
            marginals = [p.sum(tuple(j for j in range(agents) if j != i)) for i in range(agents)]
            product = marginals[0]
            for marginal in marginals[1:]:
                product = np.multiply.outer(product, marginal)
            variation.append(0.5 * np.abs(p - product).sum())

        def loss(distribution):
            output = ActorCriticOutput(as_lanes(distribution, 2), batch.value, {})
            return Cordial()(output, batch, progress)

        value, parts = loss(distribution)
        np.testing.assert_allclose(value, np.mean(losses), rtol=1e-5, err_msg=name)
        np.testing.assert_allclose(parts["invalid_probability"], np.mean(invalid), rtol=1e-4)
        np.testing.assert_allclose(
            parts["total_variation"], np.mean(variation), rtol=1e-3, atol=1e-6
        )
        check_grads(lambda d: loss(d)[0], (distribution,), order=1, modes="rev", rtol=1e-2)


@pytest.mark.parametrize("actor", [CentralActor(ACTIONS), SyncActor(ACTIONS, COMPONENTS)])
def test_actors_of_teams_give_every_agent_one_distribution(actor):
    features = jax.random.normal(jax.random.key(0), (LANES, 2, 5), jnp.float32)
    distribution, params = actor.init_with_output(jax.random.key(1), features)
    shared = distribution.logits if isinstance(actor, CentralActor) else distribution.weights
    assert shared.shape[:2] == (LANES, 2)
    np.testing.assert_array_equal(shared[:, 0], shared[:, 1])
    # At first it is nearly uniform, and what one agent remembers counts for both.
    np.testing.assert_allclose(distribution.entropy(), 2 * np.log(ACTIONS), atol=0.02)
    changed = actor.apply(params, features.at[0, 1].add(1.0))
    again = changed.logits if isinstance(actor, CentralActor) else changed.weights
    assert not np.allclose(again[0, 0], shared[0, 0])
    np.testing.assert_array_equal(again[1:], shared[1:])
