"""Losses against NumPy: values by the papers' formulas, gradients by finite differences."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.distributions import Categorical
from jaxact.errors import JaxactError
from jaxact.losses import (
    A2C,
    PPO,
    Advisor,
    AdvisorImitation,
    Batch,
    GroupedImitation,
    Imitation,
    Progress,
)
from jaxact.models import ActorCriticOutput
from jaxact.pomdp import ExpertAction
from jaxact.schedules import Linear

T, B, N = 3, 2, 4
PROGRESS = Progress(jnp.float32(50.0), jnp.float32(150.0))


def draw(seed=0):
    """A batch and an output, as NumPy arrays in double precision."""
    rng = np.random.default_rng(seed)
    normal = {
        name: rng.normal(size=(T, B))
        for name in ("advantage", "normalized_advantage", "returns", "value", "new_value")
    }
    return normal | {
        "logits": rng.normal(size=(T, B, N)),
        "auxiliary": rng.normal(size=(T, B, N)),
        "action": rng.integers(0, N, (T, B)),
        "log_prob": np.log(rng.uniform(0.1, 0.6, (T, B))),
        "expert": rng.integers(0, N, (T, B)),
        "valid": np.array([[True, False], [True, True], [False, True]]),
    }


def batch_of(x, valid=None):
    zeros = jnp.zeros((T, B), jnp.float32)
    flags = jnp.zeros((T, B), bool)
    valid = x["valid"] if valid is None else valid
    return Batch(
        observation={},
        previous_action=None,
        is_first=flags,
        memory=(),
        action=jnp.asarray(x["action"], jnp.int32),
        log_prob=jnp.asarray(x["log_prob"], jnp.float32),
        value=jnp.asarray(x["value"], jnp.float32),
        reward=zeros,
        reward_terms={},
        terminated=flags,
        truncated=flags,
        advantage=jnp.asarray(x["advantage"], jnp.float32),
        normalized_advantage=jnp.asarray(x["normalized_advantage"], jnp.float32),
        returns=jnp.asarray(x["returns"], jnp.float32),
        expert=ExpertAction(jnp.asarray(x["expert"], jnp.int32), jnp.asarray(valid)),
        key=jax.random.split(jax.random.key(0), B),
        axis_name=None,
    )


def loss_of(loss, batch):
    """The loss as a function of logits and values, and of the auxiliary actor's logits."""

    def value(logits, values, auxiliary=None):
        auxiliary = (
            jnp.asarray(draw()["auxiliary"], jnp.float32) if auxiliary is None else auxiliary
        )
        extras = {"auxiliary_distribution": Categorical(auxiliary)}
        return loss(ActorCriticOutput(Categorical(logits), values, extras), batch, PROGRESS)

    return value


def log_softmax(logits):
    shifted = logits - logits.max(-1, keepdims=True)
    return shifted - np.log(np.exp(shifted).sum(-1, keepdims=True))


def log_prob_and_entropy(logits, action):
    log_probs = log_softmax(logits)
    chosen = np.take_along_axis(log_probs, action[..., None], -1)[..., 0]
    return chosen, -(np.exp(log_probs) * log_probs).sum(-1)


def numpy_ppo(x, clip=0.1, entropy=0.01, clip_value=True, normalize=True):
    log_prob, h = log_prob_and_entropy(x["logits"], x["action"])
    ratio = np.exp(log_prob - x["log_prob"])
    advantage = x["normalized_advantage"] if normalize else x["advantage"]
    surrogate = np.minimum(ratio * advantage, np.clip(ratio, 1 - clip, 1 + clip) * advantage)
    error = (x["new_value"] - x["returns"]) ** 2
    if clip_value:
        near = x["value"] + np.clip(x["new_value"] - x["value"], -clip, clip)
        error = np.maximum(error, (near - x["returns"]) ** 2)
    return -surrogate.mean() + 0.5 * 0.5 * error.mean() - entropy * h.mean()


def numpy_a2c(x, normalize=False):
    log_prob, h = log_prob_and_entropy(x["logits"], x["action"])
    advantage = x["normalized_advantage"] if normalize else x["advantage"]
    error = (x["new_value"] - x["returns"]) ** 2
    return -(advantage * log_prob).mean() + 0.5 * 0.5 * error.mean() - 0.01 * h.mean()


def numpy_imitation(x):
    log_prob, _ = log_prob_and_entropy(x["logits"], x["expert"])
    return -log_prob[x["valid"]].sum() / x["valid"].sum()


def numpy_grouped(x, groups=((0, 2),)):
    log_probs = log_softmax(x["logits"])
    of = {a: next((g for g in groups if a in g), (a,)) for a in range(N)}
    steps = [
        -np.log(sum(np.exp(log_probs[t, b, a]) for a in of[x["expert"][t, b]]))
        for t, b in zip(*np.nonzero(x["valid"]), strict=True)
    ]
    return np.mean(steps)


def advisor_weight(x, alpha, bound=0.0):
    log_prob, _ = log_prob_and_entropy(x["auxiliary"], x["expert"])
    return np.exp(alpha * log_prob) * x["valid"] * (np.exp(log_prob) >= bound)


def numpy_advisor_imitation(x, alpha=0.0, bound=0.0):
    auxiliary, _ = log_prob_and_entropy(x["auxiliary"], x["expert"])
    main, _ = log_prob_and_entropy(x["logits"], x["expert"])
    weight = advisor_weight(x, alpha, bound)
    return -auxiliary[x["valid"]].mean() - (weight * main).mean()


def numpy_advisor(x, alpha=8.0, bound=0.0, entropy=0.01):
    """With A2C on raw advantages."""
    log_prob, h = log_prob_and_entropy(x["logits"], x["action"])
    rest = 1 - advisor_weight(x, alpha, bound)
    policy = (rest * (-x["advantage"] * log_prob - entropy * h)).mean()
    value = 0.5 * 0.5 * ((x["new_value"] - x["returns"]) ** 2).mean()
    return numpy_advisor_imitation(x, alpha, bound) + policy + value


def finite_differences(function, x, name, size=1e-5):
    gradient = np.zeros_like(x[name])
    for index in np.ndindex(*gradient.shape):
        ends = []
        for sign in (1, -1):
            moved = x[name].copy()
            moved[index] += sign * size
            ends.append(function({**x, name: moved}))
        gradient[index] = (ends[0] - ends[1]) / (2 * size)
    return gradient


CASES = {
    "ppo": (PPO(), numpy_ppo),
    "ppo, wide clip": (PPO(clip=0.5), lambda x: numpy_ppo(x, clip=0.5)),
    "ppo, value not clipped": (PPO(clip_value=False), lambda x: numpy_ppo(x, clip_value=False)),
    "ppo, raw advantages": (
        PPO(normalize_advantage=False),
        lambda x: numpy_ppo(x, normalize=False),
    ),
    "ppo, schedules": (
        PPO(clip=Linear(0.4, 0.0, 100.0), entropy=Linear(0.0, 1.0, 200.0)),
        lambda x: numpy_ppo(x, clip=0.2, entropy=0.25),
    ),
    "a2c": (A2C(), numpy_a2c),
    "a2c, normalised": (A2C(normalize_advantage=True), lambda x: numpy_a2c(x, normalize=True)),
    "imitation": (Imitation(), numpy_imitation),
    "groups": (GroupedImitation(((0, 2),)), numpy_grouped),
    "advisor": (Advisor(reinforcement=A2C()), numpy_advisor),
    "advisor, other alpha": (
        Advisor(reinforcement=A2C(), alpha=Linear(4.0, 0.0, 100.0), bound=0.2),
        lambda x: numpy_advisor(x, alpha=2.0, bound=0.2),
    ),
    "advisor, imitation": (AdvisorImitation(), numpy_advisor_imitation),
    "advisor, demonstrations": (
        AdvisorImitation(alpha=8.0),
        lambda x: numpy_advisor_imitation(x, alpha=8.0),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_value_and_gradient_are_the_formulas(case):
    loss, formula = CASES[case]
    x = draw()
    arguments = [jnp.asarray(x[name], jnp.float32) for name in ("logits", "new_value")]
    graded = jax.jit(jax.value_and_grad(loss_of(loss, batch_of(x)), (0, 1), has_aux=True))
    (value, _), gradients = graded(*arguments)
    assert float(value) == pytest.approx(formula(x), abs=1e-5)
    for name, gradient in zip(("logits", "new_value"), gradients, strict=True):
        expected = finite_differences(formula, x, name)
        np.testing.assert_allclose(gradient, expected, rtol=1e-3, atol=1e-5)


def single(ratio, advantage, loss=None):
    """PPO's gradient by the log-probability where each step has this ratio and advantage."""
    x = draw()
    logits = jnp.zeros((T, B, N), jnp.float32)
    x["log_prob"] = np.full((T, B), -np.log(N) - np.log(ratio))
    x["normalized_advantage"] = np.full((T, B), advantage)
    loss = loss or PPO(clip=0.2, entropy=0.0, value=0.0)
    output, metrics = loss_of(loss, batch_of(x))(logits, jnp.zeros((T, B), jnp.float32))
    gradient = jax.grad(lambda logits: loss_of(loss, batch_of(x))(logits, logits[..., 0])[0])
    return float(output), metrics, float(jnp.abs(gradient(logits)).max())


@pytest.mark.parametrize(
    ("ratio", "advantage", "expected", "is_clipped"),
    [
        (1.5, 2.0, -1.2 * 2.0, True),  # better, and already much more likely: no further
        (1.5, -2.0, 1.5 * 2.0, False),  # worse, yet more likely: back, at full strength
        (0.5, 2.0, -0.5 * 2.0, False),
        (0.5, -2.0, 0.8 * 2.0, True),
        (1.1, 2.0, -1.1 * 2.0, False),
    ],
)
def test_ppo_clips_only_what_would_go_too_far(ratio, advantage, expected, is_clipped):
    value, metrics, gradient = single(ratio, advantage)
    assert value == pytest.approx(expected, rel=1e-5)
    assert (gradient == 0.0) == is_clipped
    assert float(metrics["clip_fraction"]) == float(abs(ratio - 1) > 0.2)
    assert float(metrics["approximate_kl"]) == pytest.approx(ratio - 1 - np.log(ratio), rel=1e-4)


def test_ppo_clips_the_change_of_the_value():
    """V was 0, R = 1: moving V to 0.5 with clip 0.2 still counts as 0.2, with no gradient."""
    x = draw() | {"value": np.zeros((T, B)), "returns": np.ones((T, B))}
    loss = loss_of(PPO(clip=0.2, entropy=0.0, value=1.0), batch_of(x))
    logits, half = jnp.zeros((T, B, N), jnp.float32), jnp.full((T, B), 0.5, jnp.float32)
    _, metrics = loss(logits, half)
    assert float(metrics["value"]) == pytest.approx(0.5 * (1 - 0.2) ** 2)
    gradient = jax.grad(lambda values: loss(logits, values)[0])
    assert float(jnp.abs(gradient(half)).max()) == 0.0
    assert float(jnp.abs(gradient(-half)).max()) > 0.0


def test_abstaining_experts_are_not_imitated():
    x = draw()
    batch = batch_of(x)
    loss = loss_of(Imitation(), batch)
    logits, values = jnp.asarray(x["logits"], jnp.float32), jnp.zeros((T, B), jnp.float32)
    gradient, metrics = jax.grad(loss, has_aux=True)(logits, values)
    assert np.all(np.asarray(gradient)[~x["valid"]] == 0)
    assert np.all(np.abs(np.asarray(gradient)[x["valid"]]).max(-1) > 0)
    agree = x["logits"].argmax(-1) == x["expert"]
    assert float(metrics["agreement"]) == pytest.approx(agree[x["valid"]].mean())
    assert float(metrics["advised"]) == pytest.approx(x["valid"].mean())


def test_without_any_advice_imitation_is_zero_with_zero_gradient():
    x = draw()
    loss = loss_of(Imitation(), batch_of(x, valid=np.zeros((T, B), bool)))
    logits, values = jnp.asarray(x["logits"], jnp.float32), jnp.zeros((T, B), jnp.float32)
    (value, metrics), gradient = jax.value_and_grad(loss, has_aux=True)(logits, values)
    assert float(value) == 0.0
    assert np.all(np.asarray(gradient) == 0.0)
    assert all(np.isfinite(float(m)) for m in metrics.values())


def test_advisor_without_advice_is_reinforcement_and_with_alpha_zero_imitation_alone():
    x = draw()
    x["valid"] = np.zeros((T, B), bool)
    arguments = [jnp.asarray(x[name], jnp.float32) for name in ("logits", "new_value")]
    advisor, metrics = loss_of(Advisor(reinforcement=A2C()), batch_of(x))(*arguments)
    assert float(advisor) == pytest.approx(float(loss_of(A2C(), batch_of(x))(*arguments)[0]))
    assert float(metrics["imitation_weight"]) == 0.0
    x["valid"] = np.ones((T, B), bool)
    everywhere = Advisor(reinforcement=A2C(value=0.0), alpha=0.0)
    gradient = jax.grad(lambda logits: loss_of(everywhere, batch_of(x))(logits, arguments[1])[0])
    plain = jax.grad(lambda logits: loss_of(Imitation(), batch_of(x))(logits, arguments[1])[0])
    np.testing.assert_allclose(gradient(arguments[0]), plain(arguments[0]), atol=1e-6)


def test_advisors_auxiliary_actor_learns_from_imitation_alone():
    """The weight is a constant to the gradient."""
    x = draw()
    logits, values, auxiliary = (
        jnp.asarray(x[name], jnp.float32) for name in ("logits", "new_value", "auxiliary")
    )
    advisor = loss_of(Advisor(), batch_of(x))
    plain = loss_of(Imitation(), batch_of(x))
    gradient = jax.grad(lambda auxiliary: advisor(logits, values, auxiliary)[0])(auxiliary)
    expected = jax.grad(lambda logits: plain(logits, values)[0])(auxiliary)
    np.testing.assert_allclose(gradient, expected, atol=1e-6)


def test_experts_policies_are_imitated_whole():
    """The cross-entropy with a policy is that with its actions, averaged; minimal at the policy."""
    x = draw()
    policy = np.exp(log_softmax(np.random.default_rng(1).normal(size=(T, B, N))))
    batch = batch_of(x)
    soft = dataclasses.replace(batch.expert, policy=jnp.asarray(policy, jnp.float32))
    loss = loss_of(Imitation(), dataclasses.replace(batch, expert=soft))
    values = jnp.zeros((T, B), jnp.float32)
    value, _ = loss(jnp.asarray(x["logits"], jnp.float32), values)
    expected = -(policy * log_softmax(x["logits"])).sum(-1)[x["valid"]].mean()
    assert float(value) == pytest.approx(expected, rel=1e-5)
    gradient = jax.grad(lambda logits: loss(logits, values)[0])
    np.testing.assert_allclose(gradient(jnp.asarray(np.log(policy), jnp.float32)), 0.0, atol=1e-6)


@pytest.mark.parametrize("groups", [((0, 1), (1, 2)), ((-1, 0),), ((0, N),)])
def test_groups_that_are_no_groups_of_actions(groups):
    with pytest.raises(JaxactError, match=r"disjoint|so none is"):
        GroupedImitation(groups).check_model(
            ActorCriticOutput(Categorical(jnp.zeros((T, B, N))), jnp.zeros((T, B)))
        )


def test_imitation_needs_an_expert():
    batch = dataclasses.replace(batch_of(draw()), expert=None)
    with pytest.raises(JaxactError, match="without expert actions"):
        loss_of(Imitation(), batch)(jnp.zeros((T, B, N)), jnp.zeros((T, B)))


def test_mean_counts_only_where_asked_to():
    batch = batch_of(draw())
    values = jnp.arange(6, dtype=jnp.float32).reshape(T, B)
    where = jnp.array([[True, False], [False, True], [False, False]])
    assert float(batch.mean(values)) == 2.5
    assert float(batch.mean(values, where=where)) == pytest.approx(1.5)
    assert float(batch.mean(values, where=jnp.zeros_like(where))) == 0.0


def test_shares_of_a_mean_average_to_the_mean_over_all_devices():
    """Devices that hold very different numbers of entries, one of them none."""
    batch = dataclasses.replace(batch_of(draw()), axis_name="devices")
    values = jnp.arange(18, dtype=jnp.float32).reshape(3, T, B)
    where = jnp.zeros((3, T, B), bool).at[0].set(True).at[1, 0, 1].set(True)
    shares = jax.vmap(batch.mean, axis_name="devices")(values, where)
    expected = np.asarray(values)[np.asarray(where)].mean()
    assert float(jnp.mean(shares)) == pytest.approx(expected)
