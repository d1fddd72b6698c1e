"""Losses of values and continuous actions against NumPy, by the papers' formulas."""

import dataclasses

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxact.distributions import Categorical, EpsilonGreedy, SquashedNormal
from jaxact.gradients import forward
from jaxact.losses import DQN, PQN, SAC, Batch, Critic, Target, VTrace
from jaxact.losses.base import PRIORITY, BurnIn
from jaxact.losses.dqn import scale, unscale
from jaxact.losses.sac import _draw
from jaxact.models import GRU, ActorCriticOutput, Concatenated, QNetwork, Vector
from jaxact.returns import generalized_advantages
from jaxact.spaces import Discrete
from tests.jaxact.test_losses import PROGRESS, log_prob_and_entropy

T, B, N = 7, 4, 3
DISCOUNT = 0.9


def draw(seed=0):
    rng = np.random.default_rng(seed)
    terminated, truncated = rng.random((2, T, B)) < 0.2
    known = terminated | ~truncated
    known[-1] &= terminated[-1]
    return {
        "q": rng.normal(size=(T, B, N)),
        "target_q": rng.normal(size=(T, B, N)),
        "value": rng.normal(size=(T, B)),
        "action": rng.integers(0, N, (T, B)),
        "reward": rng.normal(size=(T, B)),
        "returns": rng.normal(size=(T, B)),
        "log_prob": np.log(rng.uniform(0.1, 0.6, (T, B))),
        "terminated": terminated,
        "truncated": truncated,
        "known": known,
        "weight": rng.uniform(0.2, 1.0, B),
    }


def batch_of(x, **fields):
    zeros = jnp.zeros((T, B), jnp.float32)
    given = {
        "observation": {},
        "previous_action": None,
        "is_first": jnp.zeros((T, B), bool),
        "memory": (),
        "action": jnp.asarray(x["action"], jnp.int32),
        "log_prob": jnp.asarray(x["log_prob"], jnp.float32),
        "value": zeros,
        "reward": jnp.asarray(x["reward"], jnp.float32),
        "reward_terms": {},
        "terminated": jnp.asarray(x["terminated"]),
        "truncated": jnp.asarray(x["truncated"]),
        "advantage": zeros,
        "normalized_advantage": zeros,
        "returns": jnp.asarray(x["returns"], jnp.float32),
        "expert": None,
        "key": jax.random.split(jax.random.key(0), B),
        "axis_name": None,
        "weight": jnp.asarray(x["weight"], jnp.float32),
    }
    return Batch(**given | fields)


def values_of(q, **extras):
    q = jnp.asarray(q, jnp.float32)
    value = jnp.max(q, axis=-1)
    return ActorCriticOutput(EpsilonGreedy(q, jnp.zeros_like(value)), value, {"q": q, **extras})


def take(q, action):
    return np.take_along_axis(q, action[..., None], -1)[..., 0]


def h(x):
    return np.sign(x) * (np.sqrt(np.abs(x) + 1) - 1) + 1e-3 * x


def h_inverse(x):
    root = np.sqrt(1 + 4e-3 * (np.abs(x) + 1 + 1e-3))
    return np.sign(x) * (((root - 1) / 2e-3) ** 2 - 1)


def numpy_dqn(x, n=1, double=True, rescale=False, delta=1.0):
    """Targets walked forward from each step; returns the loss and the errors."""
    best = (x["q"] if double else x["target_q"]).argmax(-1)
    value = take(x["target_q"], best)
    value = h_inverse(value) if rescale else value
    targets = np.zeros((T, B))
    for t, b in np.ndindex(T, B):
        total, weight, row = 0.0, 1.0, t
        for _ in range(n):
            if not x["known"][row, b]:
                break
            total, weight = total + weight * x["reward"][row, b], DISCOUNT * weight
            if x["terminated"][row, b]:
                weight = 0.0
                break
            row += 1
        targets[t, b] = total + weight * value[row, b]
    targets = h(targets) if rescale else targets
    error = np.where(x["known"], targets - take(x["q"], x["action"]), 0.0)
    size = np.abs(error)
    huber = np.where(size <= delta, 0.5 * error**2, delta * (size - 0.5 * delta))
    return (huber * x["weight"]).sum() / x["known"].sum(), error


@pytest.mark.parametrize(
    "fields", [{}, {"n_step": 3}, {"double": False}, {"n_step": 5, "rescale": True, "huber": 0.3}]
)
def test_dqn_is_the_formula(fields):
    x = draw()
    loss = DQN(discount=DISCOUNT, priority_mix=0.7, **fields)

    def value(q):
        return loss(values_of(q, target=values_of(x["target_q"])), batch_of(x), PROGRESS)

    graded = jax.jit(jax.value_and_grad(value, has_aux=True))
    (got, parts), gradient = graded(jnp.asarray(x["q"], jnp.float32))
    names = {"n_step": "n", "double": "double", "rescale": "rescale", "huber": "delta"}
    expected, error = numpy_dqn(x, **{names[name]: v for name, v in fields.items()})
    assert float(got) == pytest.approx(expected, rel=1e-4)
    size, count = np.abs(error), x["known"].sum(0)
    priority = 0.7 * size.max(0) + 0.3 * size.sum(0) / count
    np.testing.assert_allclose(parts[PRIORITY], priority, rtol=1e-3)
    # Of the network itself only Q(s, a) is learnt: the target is a constant.
    slope = np.clip(error, -loss.huber, loss.huber) * x["weight"] / x["known"].sum()
    expected_gradient = -slope[..., None] * np.eye(N)[x["action"]]
    np.testing.assert_allclose(gradient, expected_gradient, rtol=1e-3, atol=1e-6)


def test_rescaling_is_inverted():
    x = np.concatenate([-np.logspace(-3, 3, 20), [0.0], np.logspace(-3, 3, 20)])
    np.testing.assert_allclose(scale(jnp.asarray(x, jnp.float32)), h(x), rtol=1e-4)
    back = unscale(scale(jnp.asarray(x, jnp.float32)))
    np.testing.assert_allclose(back, x, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize(
    ("target", "expected"),
    [(Target(every=3), [0, 0, 3, 3, 3, 6]), (Target(rate=0.5), [0.5, 1.25, 2.125])],
)
def test_targets_follow(target, expected):
    loss = DQN(target=target)
    variables = loss.follow({"steps": jnp.int32(0)}, {"w": jnp.float32(0.0)})
    for step, value in enumerate(expected, start=1):
        variables = loss.follow(variables, {"w": jnp.float32(step)})
        assert float(variables["target_model"]["w"]) == value


def test_pqn_learns_the_lambda_returns():
    """The batch's returns are Rₜ = rₜ + γ ((1 − λ) max Q(sₜ₊₁) + λ Rₜ₊₁) if the value is max Q."""
    x, lambda_ = draw(), 0.7
    finished = x["terminated"] | x["truncated"]
    best, after = x["q"].max(-1), np.random.default_rng(1).normal(size=(T, B))
    going_on = ~finished
    going_on[-1] = False
    after[:-1] = np.where(finished[:-1], after[:-1], best[1:])
    expected = np.zeros((T, B))
    for t in reversed(range(T)):
        later = np.where(going_on[t], expected[min(t + 1, T - 1)], after[t])
        blend = (1 - lambda_) * after[t] + lambda_ * later
        expected[t] = x["reward"][t] + DISCOUNT * np.where(x["terminated"][t], 0.0, blend)
    arrays = [jnp.asarray(a, jnp.float32) for a in (x["reward"], best, after)]
    advantage = generalized_advantages(*arrays, x["terminated"], finished, DISCOUNT, lambda_)
    np.testing.assert_allclose(advantage + best, expected, rtol=1e-4, atol=1e-5)

    batch = batch_of(x | {"returns": expected}, weight=None)
    loss, parts = jax.jit(lambda q: PQN()(values_of(q), batch, PROGRESS))(x["q"])
    error = expected - take(x["q"], x["action"])
    assert float(loss) == pytest.approx(0.5 * (error**2).mean(), rel=1e-4)
    assert float(parts["error"]) == pytest.approx(np.abs(error).mean(), rel=1e-4)


def test_vtrace_loss_is_the_formula():
    x = draw()
    log_prob, entropy = log_prob_and_entropy(x["q"], x["action"])
    ratio = np.minimum(np.exp(log_prob - x["log_prob"]), 1.0)
    value, known = x["value"], x["known"]
    targets = value.copy()
    for t in reversed(range(T)):
        if t == T - 1:
            after, change = np.zeros(B), np.zeros(B)
        else:
            after, change = value[t + 1], targets[t + 1] - value[t + 1]
        discount = DISCOUNT * ~x["terminated"][t]
        delta = ratio[t] * (x["reward"][t] + discount * after - value[t])
        targets[t] = np.where(known[t], value[t] + delta + discount * ratio[t] * change, value[t])
    later = DISCOUNT * ~x["terminated"] * np.concatenate([targets[1:], targets[-1:]])
    advantage = ratio * (x["reward"] + later - value)

    def mean(z):
        return z[known].sum() / known.sum()

    expected = -mean(advantage * log_prob) + 0.25 * mean((value - targets) ** 2)
    expected -= 0.01 * mean(entropy)

    def loss(logits, values):
        output = ActorCriticOutput(Categorical(logits), values)
        return VTrace(discount=DISCOUNT)(output, batch_of(x, weight=None), PROGRESS)[0]

    arguments = [jnp.asarray(z, jnp.float32) for z in (x["q"], value)]
    got, gradient = jax.jit(jax.value_and_grad(loss, 1))(*arguments)
    assert float(got) == pytest.approx(expected, rel=1e-4)
    # Targets are constants: the value's gradient is that of its own square.
    slope = np.where(known, 0.5 * (value - targets), 0.0) / known.sum()
    np.testing.assert_allclose(gradient, slope, rtol=1e-3, atol=1e-6)


def test_squashed_normal_is_a_density_on_its_box():
    mean, log_std = jnp.array([[0.3], [-0.8]]), jnp.array([[-0.5], [0.4]])
    policy = SquashedNormal(mean, log_std, jnp.full((2, 1), 1.0), jnp.full((2, 1), 2.0))
    u = np.linspace(-8, 8, 20_001)
    a = 1.0 + 2.0 * np.tanh(u)
    inside = np.abs(u) < 3

    @jax.jit
    def run(actions):
        far = dataclasses.replace(policy, mean=jnp.full((2, 1), 40.0))
        return (
            jax.vmap(policy.log_prob)(actions),
            policy.entropy(),
            policy.sample_with_log_prob(jax.random.key(0)),
            jax.vmap(policy.sample)(jax.random.split(jax.random.key(1), 4000)),
            far.sample_with_log_prob(jax.random.key(0))[1],
        )

    both = np.broadcast_to(a[inside, None, None], (inside.sum(), 2, 1))
    log_probs, entropies, (action, log_prob), many, saturated = run(both.astype(np.float32))
    for row in range(2):
        normal = stats.norm(float(mean[row, 0]), np.exp(float(log_std[row, 0])))
        density = np.exp(normal.logpdf(u)) / (2.0 * (1 - np.tanh(u) ** 2))
        np.testing.assert_allclose(log_probs[:, row], np.log(density[inside]), atol=5e-3)
        weight = normal.pdf(u) * (u[1] - u[0])
        entropy = -(weight * (normal.logpdf(u) - np.log(2.0) - np.log1p(-(np.tanh(u) ** 2)))).sum()
        assert float(entropies[row]) == pytest.approx(entropy, abs=2e-2)
    np.testing.assert_allclose(log_prob, policy.log_prob(action), rtol=1e-3)
    np.testing.assert_allclose(policy.mode(), 1.0 + 2.0 * np.tanh(mean), rtol=1e-6)
    assert float(jnp.abs(many - 1.0).max()) <= 2.0
    samples = 1.0 + 2.0 * np.tanh(np.random.default_rng(0).normal(0.3, np.exp(-0.5), 4000))
    assert stats.ks_2samp(np.asarray(many[:, 0, 0]), samples).pvalue > 1e-3
    assert np.isfinite(saturated).all()  # where tanh is one to the last bit


def test_epsilon_greedy():
    values = jnp.broadcast_to(jnp.array([0.0, 2.0, 1.0, -1.0]), (20_000, 4))
    policy = EpsilonGreedy(values, jnp.full(20_000, 0.2))
    draws = np.asarray(policy.sample(jax.random.key(0)))
    expected = np.array([0.05, 0.85, 0.05, 0.05])
    np.testing.assert_allclose(np.bincount(draws, minlength=4) / 20_000, expected, atol=0.015)
    np.testing.assert_allclose(policy.probabilities[0], expected, rtol=1e-6)
    log_prob = policy.log_prob(jnp.ones(20_000, jnp.int32))
    np.testing.assert_allclose(log_prob[0], np.log(0.85), rtol=1e-5)
    entropy = -(expected * np.log(expected)).sum()
    np.testing.assert_allclose(policy.entropy()[0], entropy, rtol=1e-5)
    greedy = EpsilonGreedy(values, jnp.zeros(20_000))
    assert np.all(greedy.sample(jax.random.key(0)) == 1)
    assert np.all(greedy.entropy() == 0.0)


def sac_inputs():
    rng = np.random.default_rng(0)
    x = draw() | {"action": rng.uniform(-1, 1, (T, B, 2))}
    observation = {"vector": jnp.asarray(rng.normal(size=(T, B, 3)), jnp.float32)}
    action = jnp.asarray(x["action"], jnp.float32)
    batch = batch_of(x | {"action": np.zeros(())}, observation=observation, action=action)
    mean, log_std = (jnp.asarray(0.4 * rng.normal(size=(T, B, 2)), jnp.float32) for _ in range(2))
    loss = SAC(
        critic=Critic(Concatenated({"vector": Vector((4,))}), (5,)),
        discount=DISCOUNT,
        temperature=0.3,
    )
    output = ActorCriticOutput(squashed(mean, log_std), jnp.zeros((T, B)))
    init = jax.jit(lambda key: loss.follow(loss.init(key, output, observation, action), ()))
    variables, other = init(jax.random.key(1)), init(jax.random.key(2))
    return x, loss, batch, (mean, log_std), {**variables, "target": other["target"]}


def squashed(mean, log_std):
    return SquashedNormal(mean, log_std, jnp.zeros_like(mean), jnp.ones_like(mean))


def test_sac_is_the_formulas():
    x, loss, batch, (mean, log_std), variables = sac_inputs()
    draw_all = jax.jit(lambda: _draw(squashed(mean, log_std), batch.key))
    action, log_prob = (np.asarray(a) for a in draw_all())
    u = np.arctanh(action.astype(np.float64))
    normal = stats.norm(np.asarray(mean), np.exp(np.asarray(log_std)))
    exact = (normal.logpdf(u) - np.log1p(-(np.tanh(u) ** 2))).sum(-1)
    np.testing.assert_allclose(log_prob, exact, atol=0.02)

    apply = jax.jit(loss.critic.apply)

    def q(critics, name, a):
        return np.asarray(apply(critics[name], batch.observation, jnp.asarray(a)))

    names, own, known = ("critic_0", "critic_1"), variables["params"], x["known"]
    soft = np.minimum(*(q(variables["target"], n, action) for n in names)) - 0.3 * log_prob
    target = np.zeros((T, B))
    for t, b in np.ndindex(T, B):
        after = 0.0 if x["terminated"][t, b] else soft[min(t + 1, T - 1), b]
        target[t, b] = x["reward"][t, b] + DISCOUNT * after

    def mean_of(z):
        return (z * x["weight"])[known].sum() / known.sum()

    critic = sum(mean_of(0.5 * (q(own, n, batch.action) - target) ** 2) for n in names)
    actor = mean_of(0.3 * log_prob - np.minimum(*(q(own, n, action) for n in names)))
    temperature = -np.log(0.3) * mean_of(log_prob - 2.0)
    output = ActorCriticOutput(squashed(mean, log_std), jnp.zeros((T, B)))
    total, parts = jax.jit(lambda v: loss(output, batch, PROGRESS, v))(variables)
    assert float(parts["critic"]) == pytest.approx(critic, rel=1e-3)
    assert float(parts["actor"]) == pytest.approx(actor, rel=1e-3)
    assert float(total) == pytest.approx(critic + actor + temperature, rel=1e-3)


@pytest.mark.parametrize(("centre", "half"), [(0.0, 0.1), (3.0, 20.0)])
def test_to_sac_the_unit_of_actions_means_nothing(centre, half):
    _, loss, batch, (mean, log_std), variables = sac_inputs()

    def total(mean, centre, half):
        box = SquashedNormal(mean, log_std, jnp.full_like(mean, centre), jnp.full_like(mean, half))
        moved = dataclasses.replace(batch, action=centre + half * batch.action)
        return loss(ActorCriticOutput(box, jnp.zeros((T, B))), moved, PROGRESS, variables)[0]

    value = jax.jit(jax.value_and_grad(total))
    chex.assert_trees_all_close(value(mean, 0.0, 1.0), value(mean, centre, half), rtol=2e-3)


def test_sac_teaches_each_part_by_its_own_term():
    _, loss, batch, policy, variables = sac_inputs()

    def part(name):
        def value(policy, own):
            output = ActorCriticOutput(squashed(*policy), jnp.zeros((T, B)))
            total, parts = loss(output, batch, PROGRESS, {**variables, "params": own})
            return parts[name] if name else total

        return jax.grad(value, (0, 1))(policy, variables["params"])

    def size(tree):
        return sum(float(np.abs(x).sum()) for x in jax.tree.leaves(tree))

    total, critic, actor = jax.jit(lambda: (part(""), part("critic"), part("actor")))()
    assert size(critic[0]) == 0.0  # the critics' error is not the policy's business
    assert size(actor[1]) == 0.0  # nor is the policy's gain the critics', or the temperature's
    np.testing.assert_allclose(total[0][0], actor[0][0], rtol=1e-4, atol=1e-7)
    assert size(critic[1]["critic_0"]) > 0.0
    assert size(critic[1]["critic_1"]) > 0.0
    assert float(total[1]["log_temperature"]) != 0.0


def test_burn_in_warms_the_memory_and_is_not_learnt_from():
    model = QNetwork(Discrete(N), Concatenated({"vector": Vector((4,))}), GRU(3), hidden=4)
    rng = np.random.default_rng(0)
    vector = jnp.asarray(rng.normal(size=(T, B, 5)), jnp.float32)
    inputs = ({"vector": vector}, jnp.zeros((T, B), jnp.int32), jnp.zeros((T, B), bool))
    memory = jnp.asarray(rng.normal(size=(B, 3)), jnp.float32)
    params = jax.jit(model.init)(jax.random.key(0), inputs[0], memory, inputs[1], inputs[2])
    early, late = (jax.tree.map(lambda x, s=s: x[s], inputs) for s in (slice(2), slice(2, None)))
    batch = batch_of(
        draw(),
        observation=late[0],
        previous_action=late[1],
        is_first=late[2],
        memory=memory,
        burn_in=BurnIn(*early),
    )

    def value(vector):
        burn_in = dataclasses.replace(batch.burn_in, observation={"vector": vector})
        warmed = dataclasses.replace(batch, burn_in=burn_in)
        output = forward(model, params, warmed)[0].value
        return jnp.sum(output), output

    @jax.jit
    def run(vector):
        whole, _ = model.apply(params, inputs[0], memory, inputs[1], inputs[2])
        gradient, output = jax.grad(value, has_aux=True)(vector)
        return whole.value[2:], output, value(vector + 1.0)[1], gradient

    whole, output, other, gradient = run(early[0]["vector"])
    np.testing.assert_allclose(output, whole, rtol=1e-5, atol=1e-7)
    assert np.all(other[0] != output[0])
    assert not np.any(gradient)
