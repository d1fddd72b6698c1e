"""Normalised observations: NumPy's means and variances, and part of all that a run is."""

import shutil

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jaxact import Experiment, JaxactError, Stage, TrainingPipeline, make_key, train, train_state
from jaxact.checkpoints import Checkpoints
from jaxact.evaluation import evaluate_policy
from jaxact.losses import PPO, SAC, Critic
from jaxact.models import ActorCritic, Concatenated, NoMemory, Normalized
from jaxact.models.normalized import observed
from jaxact.moments import Moments
from jaxact.program import Program, choose_devices
from jaxact.storages import Replay
from jaxact.update import update
from tests.point import point
from tests.tiny import Plain, assert_same

UPDATE = 64
OPTIONS = {
    "log_every": UPDATE,
    "checkpoint_every": UPDATE,
    "evaluation_episodes": 8,
    "keep_last": 10,
    "progress": False,
}


def encoder():
    return Normalized(Concatenated({"vector": Plain()}))


def experiment(**settings):
    pomdp = point()
    model = ActorCritic(pomdp.action_space, encoder(), NoMemory(), squashed=True)
    defaults = {
        "stages": (Stage({"ppo": PPO()}, steps=4 * UPDATE),),
        "lanes": 8,
        "rollout_length": 8,
        "minibatches": 2,
        "epochs": 1,
        "learning_rate": 1e-2,
        "optimizer": optax.adamw,
        "optimizer_options": {"weight_decay": 0.5},
    }
    return Experiment("normalized", pomdp, model, TrainingPipeline(**defaults | settings))


def moments_of(params):
    return params["moments"]["encoder"]["vector"]


def assert_moments(moments, values):
    """Those of values [N, D]."""
    np.testing.assert_allclose(moments.count, len(values))
    np.testing.assert_allclose(moments.mean, values.mean(0), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(moments.variance, values.var(0), rtol=1e-4)


def test_statistics_are_those_of_all_that_was_seen():
    """Of four rollouts [8, 6], on one device and dealt out to two."""
    seen = 5.0 + 3.0 * np.random.default_rng(0).normal(size=(4, 8, 6, 3)).astype(np.float32)
    variables = both = {"vector": Moments.of_none(3)}
    alone = jax.jit(lambda x, y: observed(x, {"vector": y, "code": None}, None))
    devices = jax.vmap(
        lambda x, y: observed(x, {"vector": y}, "devices"), (None, 1), axis_name="devices"
    )
    apart = jax.jit(lambda x, y: jax.tree.map(lambda z: z[0], devices(x, y.reshape(8, 2, 3, 3))))
    for rollouts in range(1, 5):
        variables, both = alone(variables, seen[rollouts - 1]), apart(both, seen[rollouts - 1])
        for moments in (variables["vector"], both["vector"]):
            assert_moments(moments, seen[:rollouts].reshape(-1, 3))


def test_what_the_encoder_sees_is_normalised_and_clipped():
    model = Normalized(Concatenated({"vector": lambda x: x}), clip=2.0)
    values = np.random.default_rng(1).normal(3.0, 2.0, (16, 4, 3)).astype(np.float32)
    observation = {"vector": jnp.asarray(values)}
    variables = model.init(jax.random.key(0), {"vector": observation["vector"][0]})
    variables = observed(variables, observation, None)
    normal = (values - values.mean((0, 1))) / values.std((0, 1))
    assert np.abs(normal).max() > 2.0
    expected = np.clip(normal, -2.0, 2.0)
    np.testing.assert_allclose(model.apply(variables, observation), expected, rtol=1e-4, atol=1e-5)


def test_sensors_are_named():
    model = Normalized(Concatenated({"a": Plain()}), sensors=("a",))
    observation = {"a": jnp.ones((1, 2), jnp.float32), "b": jnp.ones((1, 2), jnp.float32)}
    assert set(model.init(jax.random.key(0), observation)["moments"]) == {"a"}
    with pytest.raises(JaxactError, match="unknown sensor to normalise 'c'; the nearest is"):
        model.clone(sensors=("c",)).init(jax.random.key(0), observation)


def test_a_rollout_is_taken_in_after_it_was_learnt_from(monkeypatch):
    """Nor do gradient steps and weight decay change the statistics."""
    small, seen = experiment(epochs=1, minibatches=1), []

    def recorded(variables, observation, axis_name):
        jax.debug.callback(lambda x: seen.append(np.asarray(x)), observation["vector"])
        return observed(variables, observation, axis_name)

    monkeypatch.setattr("jaxact.update.observed", recorded)
    advance = jax.jit(lambda state: update(small, 0, state, {}))
    state = jax.jit(lambda key: train_state.start(small, key, {}))(make_key(0))
    before = state.params
    assert float(moments_of(before).count) == 0.0
    for rollouts in range(1, 4):
        state, metrics = jax.block_until_ready(advance(state))
        jax.effects_barrier()
        assert len(seen) == rollouts
        assert_moments(moments_of(state.params), np.concatenate(seen).reshape(-1, 4))
    # What acted is what was learnt from: in a rollout's one gradient step no ratio is clipped.
    assert float(metrics["losses/ppo/clip_fraction"]) == 0.0
    weights = [jax.tree.leaves(params["params"]) for params in (before, state.params)]
    assert all(bool(jnp.any(a != b)) for a, b in zip(*weights, strict=True))


@pytest.mark.slow
def test_a_run_is_resumed_with_its_statistics(tmp_path):
    """To which evaluations add nothing."""
    small = experiment()
    whole = train(small, seed=1, output=tmp_path, evaluate_every=UPDATE, **OPTIONS)
    assert len(list((whole.run / "evaluation").iterdir())) == 4
    assert float(moments_of(whole.state.params).count) == 4 * UPDATE
    for path in (whole.run / "checkpoints").iterdir():
        if int(path.name) > 2 * UPDATE:
            shutil.rmtree(path)
    like = Program(small, choose_devices(1)).like()
    saved = Checkpoints(whole.run / "checkpoints").restore(None, like).state
    assert float(moments_of(saved.params).count) == 2 * UPDATE
    resumed = train(small, seed=1, resume=whole.run, evaluate_every=0, **OPTIONS)
    assert_same(resumed.state, whole.state)
    again = evaluate_policy(small.pomdp, whole.policy, OPTIONS["evaluation_episodes"], seed=1)
    assert_same(again.episode_return, whole.evaluation.episode_return)


@pytest.mark.slow
def test_critics_have_statistics_of_their_own():
    critic = Critic(encoder(), (16,))
    replay = Replay(
        losses={"sac": SAC(critic=critic)}, capacity=64, lanes=8, length=2, start_after=0
    )
    stage = Stage({}, steps=4 * UPDATE, storages={"replay": replay})
    small = experiment(stages=(stage,))
    program = Program(small, choose_devices(1))
    state, _ = program.stage(0, 4)(program.start(make_key(0)), program.numbers(), np.int32(4))
    own = state.losses["sac"]["params"]
    for name in ("critic_0", "critic_1"):
        assert_same(moments_of(own[name]), moments_of(state.params))
    target = moments_of(state.losses["sac"]["target"]["critic_0"])
    assert 0.0 < float(target.count) < 4 * UPDATE
