"""Losses with variables and rewards of their own, trained together with a policy in one program.

The policy is paid for nothing but passing as a demonstrator.
"""

import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import (
    CPCA,
    GAIL,
    PPO,
    CPCASoftmax,
    Curiosity,
    FusionEntropy,
    InverseDynamics,
    KLToReference,
    RandomNetworkDistillation,
    TemporalDistance,
)
from jaxact.losses.base import TARGET_MODEL
from jaxact.models import GRU, ActorCritic, Concatenated, MultipleBeliefs
from jaxact.program import Program, choose_devices
from jaxact.storages.base import Storage
from jaxact.train_state import make_key
from tests.corridor import corridor
from tests.tiny import Plain, assert_same
from tests.windows import batch_of

LANES, LENGTH, UPDATES = 16, 8, 40
WORLD = corridor()
ENCODER = Concatenated({"vector": Plain()})
ACTIONS = WORLD.action_space


@dataclass(frozen=True, kw_only=True)
class Walks(Storage):
    """Steps of walkers that go straight to their goals."""

    def init(self, pomdp, model, keys, data):
        return keys, model.initial_memory(self.lanes)

    def batch(self, state, data, axis_name):
        keys, memory = state
        next_keys, draws = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)

        def step(key):
            sampled = jax.vmap(lambda k: WORLD.reset(k)[0])(jax.random.split(key, self.length))
            return jax.vmap(WORLD.observe)(sampled), jax.vmap(WORLD.expert)(
                jax.random.split(key, self.length), sampled
            )

        observation, expert = jax.vmap(step, out_axes=1)(draws)
        batch = batch_of(observation, jnp.ones(expert.valid.shape, bool), expert.action, axis_name)
        return (next_keys, memory), replace(batch, memory=memory, key=draws)

    def carry_on(self, state, memory):
        return state


def experiment(everything=False):
    """With the losses that the fixture `trained` is about, or with all."""
    memory = MultipleBeliefs({name: GRU(8) for name in ("inverse", "cpca")})
    model = ActorCritic(ACTIONS, ENCODER, memory)
    gail = GAIL(action_space=ACTIONS, encoder=ENCODER, hidden=16, logit_reward=True)
    losses = {
        "ppo": PPO(clip=0.2),
        "inverse_dynamics": InverseDynamics(action_space=ACTIONS, belief="inverse"),
        "fusion": FusionEntropy(),
        "novelty": RandomNetworkDistillation(encoder=ENCODER, features=8, hidden=16),
        "kl": KLToReference(),
        "gail": gail,
    }
    if everything:
        losses |= {
            "temporal_distance": TemporalDistance(longer_than=1, belief="inverse"),
            "cpca": CPCA(action_space=ACTIONS, steps=2, belief="cpca"),
            "softmax": CPCASoftmax(action_space=ACTIONS, steps=2, features=8, belief="cpca"),
            "curiosity": Curiosity(action_space=ACTIONS, encoder=ENCODER, hidden=16),
        }
    own = ("success", "step", "novelty", "curiosity")[: 4 if everything else 3]
    stage = Stage(
        losses=losses,
        weights={"kl": 0.01, "fusion": 0.01},
        rewards={name: 0.0 for name in own},
        storages={
            "walks": Walks(
                losses={"gail": replace(gail, demonstrations=True)}, updates=4, lanes=8, length=8
            )
        },
        steps=UPDATES * LANES * LENGTH,
    )
    pipeline = TrainingPipeline(
        (stage,), lanes=LANES, rollout_length=LENGTH, minibatches=2, epochs=2, learning_rate=1e-2,
        max_grad_norm=5.0,
    )  # fmt: skip
    return Experiment("auxiliary", WORLD, model, pipeline)


def run(experiment):
    """The state before training, with parameters of another seed, and after; metrics [UPDATES]."""
    program = Program(experiment, choose_devices(1))
    state = replace(program.start(make_key(0)), params=program.start(make_key(1)).params)
    before = jax.tree.map(np.asarray, replace(state, lanes=(), storages=(), sampler=()))
    state, metrics = program.stage(0, UPDATES)(state, program.numbers(), np.int32(UPDATES))
    return before, state, {name: np.asarray(x) for name, x in metrics.items()}


@pytest.fixture(scope="module")
def trained():
    return run(experiment())


def assert_fall(metrics, ratios):
    """These metrics have fallen to such a share of what they were."""
    for name, ratio in ratios.items():
        values = metrics[name]
        assert np.isfinite(values).all(), name
        assert values[-5:].mean() < ratio * values[:2].mean(), name


def test_what_is_learnt_falls(trained):
    ratios = {"losses/inverse_dynamics/cross_entropy": 0.5, "losses/novelty/error": 0.5}
    assert_fall(trained[2], ratios | {"train/step_reward/novelty": 0.5})


@pytest.mark.slow
def test_what_is_learnt_falls_beside_all_others():
    falls = {
        "losses/inverse_dynamics/cross_entropy": 0.5,
        "losses/cpca/positive": 0.8,
        "losses/softmax/cross_entropy": 0.8,
        "losses/curiosity/inverse": 0.5,
        "losses/curiosity/forward": 0.5,
        "losses/novelty/error": 0.5,
        "train/step_reward/curiosity": 0.5,
        "train/step_reward/novelty": 0.5,
    }
    assert_fall(run(experiment(everything=True))[2], falls)


def test_what_was_never_seen_stays_novel(trained):
    _, after, _ = trained
    states = jax.vmap(lambda key: WORLD.reset(key)[0])(jax.random.split(jax.random.key(0), 8))
    seen = jax.vmap(WORLD.observe)(states)["vector"]
    never = jnp.roll(jnp.repeat(seen[:, :6], 2, axis=1), 3, axis=1)
    distillation = experiment().pipeline.stages[0].losses["novelty"]

    @jax.jit
    def error(vectors):
        batch = batch_of({"vector": vectors[None]}, jnp.ones((1, 8), bool))
        return distillation(None, batch, None, after.losses["novelty"])[0]

    assert float(error(never)) > 5.0 * float(error(seen))


def test_demonstrations_alone_teach_the_task(trained):
    _, _, metrics = trained
    rates = [
        metrics["episodes/success"][part].sum() / metrics["episodes/count"][part].sum()
        for part in (slice(0, 8), slice(-8, None))
    ]
    assert rates[1] > 0.95 > 0.8 > rates[0]


def test_the_reference_is_the_policy_as_the_stage_began(trained):
    before, after, metrics = trained
    assert_same(after.losses["kl"][TARGET_MODEL], before.params)
    assert metrics["losses/kl/kl"][0] < metrics["losses/kl/kl"][-1]


def test_only_what_is_to_learn_has_changed(trained):
    before, after, _ = trained
    assert_same(after.losses["novelty"]["target"], before.losses["novelty"]["target"])
    statistics = after.losses["novelty"]["statistics"]
    assert float(statistics["return"].count) == UPDATES * LANES * LENGTH
    mean = np.asarray(statistics["observation"]["vector"].mean)
    np.testing.assert_allclose(mean.reshape(2, 6).sum(1), 1.0, rtol=1e-4)
    for name, own in before.losses.items():
        pairs = zip(
            jax.tree.leaves(own.get("params", {})),
            jax.tree.leaves(after.losses[name].get("params", {})),
            strict=True,
        )
        assert all(not np.array_equal(a, b) for a, b in pairs), name


SCRIPT = """
import jax
import numpy as np
from jaxact.program import Program, choose_devices
from jaxact.train_state import make_key
from tests.jaxact.test_auxiliary_training import experiment

ends = []
for devices in (1, 2):
    program = Program(experiment(everything=True), choose_devices(devices))
    state, metrics = program.start(make_key(0)), {}
    state, metrics = program.stage(0, 2)(state, program.numbers(), np.int32(2))
    ends.append(jax.tree.map(np.asarray, (state.params, state.losses, metrics)))
for (path, one), two in zip(jax.tree_util.tree_leaves_with_path(ends[0]), jax.tree.leaves(ends[1])):
    np.testing.assert_allclose(one, two, rtol=1e-3, atol=1e-4, err_msg=jax.tree_util.keystr(path))
print("done")
"""


@pytest.mark.slow
def test_the_same_is_learnt_on_two_devices():
    root = str(Path(__file__).parents[2])
    names = {"JAX_NUM_CPU_DEVICES": "2", "PYTHONPATH": root}
    ended = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env=os.environ | names,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.stdout == "done\n", ended.stderr
