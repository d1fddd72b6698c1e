"""Joint policies against tables of probabilities in NumPy, and the loss that coordinates them."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.agents import as_lanes
from jaxact.distributions import Categorical
from jaxact.losses import Batch, Cordial, Progress
from jaxact.models import ActorCriticOutput, CentralActor, SyncActor
from jaxact.team_distributions import JointCategorical, MixtureOfMarginals, joint_log_probs

TIMES, LANES, COMPONENTS, ACTIONS = 2, 3, 2, 4


def softmax(x):
    e = np.exp(x - x.max(-1, keepdims=True))
    return e / e.sum(-1, keepdims=True)


def parameters(agents, seed=0):
    """Of one distribution of each kind, float32 arrays [T, B, ...]."""
    generator = np.random.default_rng(seed)

    def normal(*shape):
        return generator.normal(size=(TIMES, LANES, *shape)).astype(np.float32)

    return {
        "sync": (normal(agents, COMPONENTS, ACTIONS), normal(COMPONENTS)),
        "central": (normal(ACTIONS**agents),),
        "marginal": (normal(agents, ACTIONS),),
    }


def made(name, given, agents):
    def for_each(x):
        return jnp.repeat(jnp.asarray(x)[:, :, None], agents, axis=2)

    match name:
        case "sync":
            return MixtureOfMarginals(jnp.asarray(given[0]), for_each(given[1]), agents)
        case "central":
            return JointCategorical(for_each(given[0]), agents)
    return Categorical(jnp.asarray(given[0]))


def table_of(name, given, agents):
    """Probabilities [T, B, n, …, n] by the definitions."""
    given = [x.astype(np.float64) for x in given]
    if name == "central":
        return softmax(given[0]).reshape(TIMES, LANES, *(ACTIONS,) * agents)
    own, weights = given if name == "sync" else (given[0][:, :, :, None], np.zeros((1, 1, 1)))
    own, weights = softmax(own), softmax(weights)
    table = np.zeros((TIMES, LANES, *(ACTIONS,) * agents))
    for actions in itertools.product(range(ACTIONS), repeat=agents):
        each = [own[:, :, i, :, a] for i, a in enumerate(actions)]
        table[(slice(None), slice(None), *actions)] = (weights * np.prod(each, axis=0)).sum(-1)
    return table


def drawn(agents, seed=0):
    """One distribution of each kind, and its table."""
    return {
        name: (made(name, given, agents), table_of(name, given, agents))
        for name, given in parameters(agents, seed).items()
    }


@functools.partial(jax.jit, static_argnums=1)
def tables(distribution, agents):
    laid_out = joint_log_probs(as_lanes(distribution, 2), agents)
    return jnp.exp(joint_log_probs(distribution, agents)), jnp.exp(laid_out)


@pytest.mark.parametrize("agents", [2, 3])
def test_tables_are_those_of_the_definitions(agents):
    for name, (distribution, table) in drawn(agents).items():
        found, laid_out = tables(distribution, agents)
        assert found.shape == (TIMES, LANES, 1, *table.shape[2:])
        np.testing.assert_allclose(found[:, :, 0], table, rtol=2e-5, err_msg=name)
        np.testing.assert_allclose(laid_out, table, rtol=2e-5, err_msg=name)
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

        log_prob, found, likeliest = jax.jit(lambda d, a: (d.log_prob(a), d.entropy(), d.mode()))(
            team, a
        )
        np.testing.assert_allclose(log_prob, each(expected), rtol=1e-5)
        np.testing.assert_allclose(found, each(entropy), rtol=1e-5)
        np.testing.assert_array_equal(likeliest, m)
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
    for name, (_, table) in drawn(agents).items():
        invalid, variation = [], []
        for t, b in itertools.product(range(TIMES), range(LANES)):
            p, m = table[t, b], kinds[t, b]
            invalid.append(p[m == 0].sum())
            product = p.sum(tuple(range(1, agents)))
            for i in range(1, agents):
                marginal = p.sum(tuple(j for j in range(agents) if j != i))
                product = np.multiply.outer(product, marginal)
            variation.append(0.5 * np.abs(p - product).sum())

        @jax.jit
        def loss(given, name=name):
            output = ActorCriticOutput(as_lanes(made(name, given, agents), 2), batch.value, {})
            return Cordial()(output, batch, progress)

        def expected(given, name=name):
            table = np.log(table_of(name, given, agents))
            return -0.5 * np.mean(
                [
                    table[t, b][kinds[t, b] == 1].mean() + table[t, b][kinds[t, b] == 2].mean()
                    for t, b in itertools.product(range(TIMES), range(LANES))
                ]
            )

        given = parameters(agents)[name]
        (value, parts), slopes = jax.jit(jax.value_and_grad(loss, has_aux=True))(given)
        np.testing.assert_allclose(value, expected(given), rtol=1e-5, err_msg=name)
        np.testing.assert_allclose(parts["invalid_probability"], np.mean(invalid), rtol=1e-4)
        np.testing.assert_allclose(
            parts["total_variation"], np.mean(variation), rtol=1e-3, atol=1e-6
        )
        # Along a few directions, against differences of what NumPy says, in double precision.
        generator = np.random.default_rng(4)
        for _ in range(3):
            ways = [generator.normal(size=x.shape) for x in given]
            ahead, behind = (
                expected([x + e * way for x, way in zip(given, ways, strict=True)])
                for e in (1e-5, -1e-5)
            )
            slope = sum((np.asarray(d) * way).sum() for d, way in zip(slopes, ways, strict=True))
            np.testing.assert_allclose(slope, (ahead - behind) / 2e-5, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("actor", [CentralActor(ACTIONS), SyncActor(ACTIONS, COMPONENTS)])
def test_actors_of_teams_give_every_agent_one_distribution(actor):
    features = jax.random.normal(jax.random.key(0), (LANES, 2, 5), jnp.float32)
    distribution, params = jax.jit(actor.init_with_output)(jax.random.key(1), features)
    shared = distribution.logits if isinstance(actor, CentralActor) else distribution.weights
    assert shared.shape[:2] == (LANES, 2)
    np.testing.assert_array_equal(shared[:, 0], shared[:, 1])
    # At first it is nearly uniform, and what one agent remembers counts for both.
    np.testing.assert_allclose(distribution.entropy(), 2 * np.log(ACTIONS), atol=0.02)
    changed = jax.jit(actor.apply)(params, features.at[0, 1].add(1.0))
    again = changed.logits if isinstance(actor, CentralActor) else changed.weights
    assert not np.allclose(again[0, 0], shared[0, 0])
    np.testing.assert_array_equal(again[1:], shared[1:])
