"""Auxiliary losses against NumPy, episode by episode; they respect episodes and devices."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jaxact.errors import JaxactError
from jaxact.losses import CPCA, CPCASoftmax, FusionEntropy, InverseDynamics, TemporalDistance
from jaxact.losses.windows import first_and_last, goes_on, uniform
from jaxact.models import Vector
from tests.windows import (
    ACTIONS,
    IS_FIRST,
    PROGRESS,
    B,
    F,
    H,
    T,
    assert_same_on_two_devices,
    batch_of,
    normal,
    output_of,
    variables_of,
)

EMBEDDING, BELIEF = normal(0, T, B, F), normal(1, T, B, H)
OUTPUT = output_of(embedding=EMBEDDING, belief=0 * BELIEF, mine=BELIEF)
BATCH = batch_of()
ACTION = np.asarray(BATCH.action)
LOSSES = {
    "inverse dynamics": InverseDynamics(action_space=ACTIONS, belief="mine"),
    "temporal distance": TemporalDistance(pairs=4, longer_than=2, belief="mine"),
    "cpca": CPCA(action_space=ACTIONS, steps=4, hidden=7, belief="mine"),
    "cpca softmax": CPCASoftmax(action_space=ACTIONS, steps=3, hidden=7, features=8, belief="mine"),
}


def episodes():
    """(lane, first, last) of each episode in the window."""
    for lane in range(B):
        starts = sorted({0, *np.flatnonzero(IS_FIRST[:, lane])})
        for start, end in zip(starts, [*starts[1:], T], strict=True):
            yield lane, start, end - 1


def dense(p, x):
    return x @ p["kernel"] + p.get("bias", 0)


def log_softmax(x):
    return x - np.log(np.exp(x).sum(-1, keepdims=True))


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def numpy_inverse_dynamics(loss, p):
    values = []
    for lane, start, end in episodes():
        for t in range(start, end):
            seen = [EMBEDDING[t, lane], EMBEDDING[t + 1, lane], BELIEF[end, lane]]
            values.append(-log_softmax(dense(p["Dense_0"], np.concatenate(seen)))[ACTION[t, lane]])
    return np.mean(values)


def numpy_temporal_distance(loss, p):
    draws, values = np.asarray(uniform(BATCH, loss.pairs, 2)), []
    for lane, start, end in episodes():
        if end - start <= loss.longer_than:
            continue
        for i, j in np.floor(draws[end, lane] * (end - start + 1)).astype(int) + start:
            guess = (
                EMBEDDING[i, lane] @ p["embedding"]["kernel"][:, 0]
                + EMBEDDING[j, lane] @ p["embedding"]["kernel"][:, 1]
                + dense(p["belief"], BELIEF[end, lane])[0]
            )
            values.append(0.5 * ((guess - (j - i)) / (end - start)) ** 2)
    return np.mean(values)


def expectations(p, steps):
    """(lane, t, k, c_{t,k}) of all that count."""
    for lane, start, end in episodes():
        for t in range(start, end + 1):
            h, gru = BELIEF[t, lane], p["expectation"]
            for k in range(1, min(steps, end - t) + 1):
                action = p["actions"]["kernel"][ACTION[t + k - 1, lane]]
                x_r, x_z, x_n = np.split(dense(gru["input"], action), 3)
                h_r, h_z, h_n = np.split(h @ gru["recurrent"], 3)
                z = sigmoid(x_z + h_z)
                new = np.tanh(x_n + sigmoid(x_r + h_r) * (h_n + gru["recurrent_bias"]))
                h = (1 - z) * new + z * h
                yield lane, t, k, h


def numpy_cpca(loss, p):
    order = np.argsort(np.asarray(uniform(BATCH)).ravel())
    others = EMBEDDING.reshape(-1, F)[order].reshape(T, B, F)
    q, values = p["model"], []
    for lane, t, k, c in expectations(p, loss.steps):
        logits = [
            dense(
                q["logit"],
                np.maximum(
                    0, dense(q["of_expected"], c) + dense(q["of_embedding"], x[t + k, lane])
                ),
            )[0]
            for x in (EMBEDDING, others)
        ]
        values.append(-np.log(sigmoid(logits[0])) - np.log(1 - sigmoid(logits[1])))
    return np.mean(values)


def numpy_cpca_softmax(loss, p):
    q, values = p["model"], []

    def perceptron(name, x):
        return dense(q[name], np.maximum(0, dense(q[f"{name}_hidden"], x)))

    candidates = perceptron("of_embedding", EMBEDDING.reshape(-1, F))
    for lane, t, k, c in expectations(p, loss.steps):
        log_probs = log_softmax(candidates @ perceptron("of_expected", c))
        values.append(-log_probs[(t + k) * B + lane])
    return np.mean(values)


FORMULAS = {
    "inverse dynamics": numpy_inverse_dynamics,
    "temporal distance": numpy_temporal_distance,
    "cpca": numpy_cpca,
    "cpca softmax": numpy_cpca_softmax,
}


@pytest.fixture(scope="module")
def variables():
    return {name: variables_of(loss, OUTPUT) for name, loss in LOSSES.items()}


@pytest.mark.parametrize("name", LOSSES)
def test_value_is_the_formula_episode_by_episode(name, variables):
    loss, own = LOSSES[name], variables[name]
    value, _ = jax.jit(lambda v: loss(OUTPUT, BATCH, PROGRESS, v))(own)
    expected = FORMULAS[name](loss, jax.tree.map(np.asarray, own["params"]))
    assert float(value) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    "name", [x if x == "cpca" else pytest.param(x, marks=pytest.mark.slow) for x in LOSSES]
)
def test_lanes_may_be_on_any_number_of_devices(name, variables):
    assert_same_on_two_devices(LOSSES[name], OUTPUT, BATCH, variables[name])


def test_windows_of_one_step_teach_nothing(variables):
    one, batch = jax.tree.map(lambda x: x[:1], OUTPUT), batch_of(is_first=IS_FIRST[:1])

    @jax.jit
    def values(variables):
        return [loss(one, batch, PROGRESS, variables[name])[0] for name, loss in LOSSES.items()]

    assert [float(x) for x in values(variables)] == [0.0] * len(LOSSES)


def test_distances_that_can_be_told_are_told():
    """Where the embedding holds the time, d = φ_j − φ_i makes no error; half of it, half."""
    time = np.broadcast_to(np.arange(T, dtype=np.float32)[:, None, None], (T, B, 1))
    output, loss = output_of(embedding=time, mine=BELIEF), LOSSES["temporal distance"]
    nothing = jnp.zeros((H, 1), jnp.float32), jnp.zeros(1, jnp.float32)

    @jax.jit
    def value(slope):
        kernel = jnp.stack([-slope, slope])[None]
        of_belief = dict(zip(("kernel", "bias"), nothing, strict=True))
        params = {"embedding": {"kernel": kernel}, "belief": of_belief}
        return loss(output, BATCH, PROGRESS, {"params": params})[0]

    right, half, none = (float(value(jnp.float32(x))) for x in (1.0, 0.5, 0.0))
    assert right == 0.0
    assert half == pytest.approx(0.25 * none, rel=1e-5)
    assert none > 0.0


def test_distances_are_learnt_where_observations_show_progress():
    """Walkers along a line, from anywhere on it: where they are tells how far apart two steps are,
    by an embedding that is to be found. In a shuffled window the same observations tell nothing.
    """
    length, lanes, places, loss = 12, 64, 40, TemporalDistance()
    is_first = np.zeros((length, lanes), bool)
    is_first[0] = True
    span = length - 1
    encoder, optimizer = Vector((8,)), optax.adam(0.02)

    def window(key, shuffled):
        start_key, shuffle_key, draw_key = jax.random.split(key, 3)
        start = jax.random.randint(start_key, (lanes,), 0, places - span, jnp.int32)
        place = start + jnp.arange(length, dtype=jnp.int32)[:, None]
        mixed = jax.random.permutation(shuffle_key, place, axis=0, independent=True)
        batch = dataclasses.replace(
            batch_of(is_first=is_first), key=jax.random.split(draw_key, lanes)
        )
        return jax.nn.one_hot(jnp.where(shuffled, mixed, place), places), batch

    def value(params, key, shuffled):
        observation, batch = window(key, shuffled)
        embedding = encoder.apply(params["encoder"], observation)
        output = output_of((length, lanes), embedding=embedding, belief=jnp.zeros_like(embedding))
        return loss(output, batch, PROGRESS, params["loss"])[0]

    def best_constant(key):
        draws = uniform(window(key, False)[1], loss.pairs, 2)[-1]
        i, j = jnp.moveaxis(jnp.floor(draws * length), -1, 0)
        return 0.5 * jnp.var((j - i) / span)

    @jax.jit
    def learnt(key):
        """Squared errors on fresh windows: in order, shuffled, and the best constant's."""
        encoder_key, loss_key, train_key, test_key = jax.random.split(key, 4)
        embedding = jnp.zeros((1, 8), jnp.float32)
        example = output_of((1,), embedding=embedding, belief=embedding)
        params = {
            "encoder": encoder.init(encoder_key, jnp.zeros((1, places), jnp.float32)),
            "loss": loss.init(loss_key, example, {}, jnp.zeros(1, jnp.int32)),
        }

        def trained(shuffled):
            def step(carry, key):
                params, state = carry
                gradient = jax.grad(value)(params, key, shuffled)
                with jax.numpy_dtype_promotion("standard"):
                    updates, state = optimizer.update(gradient, state)
                return (optax.apply_updates(params, updates), state), None

            carry = params, optimizer.init(params)
            (last, _), _ = jax.lax.scan(step, carry, jax.random.split(train_key, 300))
            fresh = jax.random.split(test_key, 20)
            return jnp.mean(jax.vmap(value, (None, 0, None))(last, fresh, shuffled))

        in_order, shuffled = jax.vmap(trained)(jnp.array([False, True]))
        return in_order, shuffled, jnp.mean(jax.vmap(best_constant)(jax.random.split(test_key, 20)))

    in_order, shuffled, constant = map(float, learnt(jax.random.key(0)))
    assert constant == pytest.approx(1 / 12, rel=0.25)
    assert in_order < 0.05 * constant
    assert shuffled > 0.95 * constant


def test_steps_of_an_episode():
    first, last = first_and_last(jnp.asarray(IS_FIRST))
    for lane, start, end in episodes():
        assert (np.asarray(first)[start : end + 1, lane] == start).all()
        assert (np.asarray(last)[start : end + 1, lane] == end).all()
    for k in (1, 3, T, T + 2):
        inside = np.asarray(goes_on(jnp.asarray(IS_FIRST), k))
        expected = np.zeros((T, B), bool)
        for lane, start, end in episodes():
            expected[start : max(start, end + 1 - k), lane] = True
        np.testing.assert_array_equal(inside, expected)


def test_an_unknown_belief_is_named():
    loss = dataclasses.replace(LOSSES["cpca"], belief="yours")
    with pytest.raises(JaxactError, match=r"unknown feature of the model.*'yours'.*mine"):
        variables_of(loss, OUTPUT)


def test_entropy_of_the_fusion():
    weights = np.random.default_rng(3).dirichlet(np.ones(3), (T, B)).astype(np.float32)
    named = dict(zip("abc", np.moveaxis(weights, -1, 0), strict=True))

    @jax.jit
    def graded(fusion):
        def loss(fusion):
            return FusionEntropy()(output_of(fusion=fusion), BATCH, PROGRESS)

        return jax.value_and_grad(loss, has_aux=True)(fusion)

    (loss, parts), _ = graded(named)
    assert float(loss) == pytest.approx((weights * np.log(weights)).sum(-1).mean(), rel=1e-5)
    assert float(parts["weight/b"]) == pytest.approx(weights[..., 1].mean(), rel=1e-5)
    certain = {name: jnp.full((T, B), name == "a", jnp.float32) for name in "abc"}
    (loss, _), gradient = graded(certain)
    assert float(loss) == 0.0
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(gradient))
