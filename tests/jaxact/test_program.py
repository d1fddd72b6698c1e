"""Compiled training: numbers are data, batches of runs are runs, and every loss learns.

One stage holds all losses. Their weights, like all numbers, are data, so that one program trains
with any of them.
"""

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import EarlyStopping, Experiment, JaxactError, Stage, TrainingPipeline, make_train
from jaxact.distributions import Categorical
from jaxact.losses import A2C, PPO, Imitation
from jaxact.models import ActorCriticOutput
from jaxact.program import Program, choose_devices
from jaxact.schedules import Linear
from jaxact.train_state import make_key, start
from tests.corridor import corridor
from tests.tiny import assert_same

LANES, LENGTH, UPDATES = 16, 8, 60
STAGE = "pipeline.stages.0"


class Mine(nn.Module):
    """A user's own model: any linen module with these two methods will do."""

    @nn.compact
    def __call__(self, observation, memory, previous_action, is_first):
        del previous_action, is_first
        x = nn.tanh(nn.Dense(16, kernel_init=nn.initializers.he_normal())(observation["vector"]))
        value = nn.Dense(1)(x)[..., 0]
        return ActorCriticOutput(Categorical(nn.Dense(2)(x)), value), memory

    @nn.nowrap
    def initial_memory(self, lanes):
        del lanes
        return ()


def every_loss():
    stage = Stage(
        losses={"ppo": PPO(clip=0.2), "a2c": A2C(), "imitation": Imitation()},
        weights={"ppo": 1.0, "a2c": 0.0, "imitation": 0.0},
        steps=UPDATES * LANES * LENGTH,
        teacher_forcing=Linear(0.0, 0.0, UPDATES * LANES * LENGTH / 2.0),
        stop=EarlyStopping(at_least=2.0, episodes=50),
    )
    pipeline = TrainingPipeline(
        (stage,), lanes=LANES, rollout_length=LENGTH, minibatches=2, epochs=2, learning_rate=2e-2
    )
    return Experiment("every_loss", corridor(), Mine(), pipeline)


def setting(ppo=0.0, a2c=0.0, imitation=0.0, forcing=(0.0, 0.0), stop=2.0, rate=2e-2):
    values = {
        f"{STAGE}.weights.ppo": ppo,
        f"{STAGE}.weights.a2c": a2c,
        f"{STAGE}.weights.imitation": imitation,
        f"{STAGE}.teacher_forcing.start": forcing[0],
        f"{STAGE}.teacher_forcing.end": forcing[1],
        f"{STAGE}.stop.at_least": stop,
        "pipeline.learning_rate": rate,
    }
    return {name: np.float32(value) for name, value in values.items()}


SETTINGS = {
    "PPO": setting(ppo=1.0),
    "A2C": setting(a2c=1.0, rate=1e-2),
    "cloning on the agent's states": setting(imitation=1.0),
    "cloning on the expert's states": setting(imitation=1.0, forcing=(1.0, 1.0)),
    "DAgger": setting(imitation=1.0, forcing=(1.0, 0.0)),
    "DAgger until it succeeds": setting(imitation=1.0, forcing=(1.0, 0.0), stop=0.95),
    "no learning": setting(ppo=1.0, rate=0.0),
}


@pytest.fixture(scope="module")
def sweep():
    """All settings, with different seeds, in one vmapped program."""
    numbers = jax.tree.map(lambda *xs: jnp.stack(xs), *SETTINGS.values())
    keys = jnp.stack([make_key(seed) for seed in range(len(SETTINGS))])
    state, metrics = jax.jit(jax.vmap(make_train(every_loss())))(keys, numbers)
    return state, jax.tree.map(np.asarray, metrics)


def rows_of(sweep, name):
    index = list(SETTINGS).index(name)
    return {tag: x[index] for tag, x in sweep[1].items()}


def success(rows, last=15):
    return rows["episodes/success"][-last:].sum() / rows["episodes/count"][-last:].sum()


@pytest.mark.parametrize("name", list(SETTINGS)[:5])
def test_every_loss_solves_the_corridor(sweep, name):
    assert success(rows_of(sweep, name)) > 0.95


def test_without_learning_the_corridor_is_not_solved(sweep):
    assert success(rows_of(sweep, "no learning")) < 0.8


def test_a_stage_ends_early_once_it_succeeds(sweep):
    rows, state = rows_of(sweep, "DAgger until it succeeds"), sweep[0]
    index = list(SETTINGS).index("DAgger until it succeeds")
    done = int(state.updates[index, 0])
    assert 0 < done < UPDATES
    assert rows["active"].tolist() == [True] * done + [False] * (UPDATES - done)
    assert bool(state.stopped[index, 0])
    # The blocks of at least 50 episodes, by hand: all but the last stay below the threshold.
    blocks, total, count = [], 0.0, 0.0
    for n, c in zip(rows["episodes/success"][:done], rows["episodes/count"][:done], strict=True):
        total, count = total + n, count + c
        if count >= 50:
            blocks.append(total / count)
            total = count = 0.0
    assert blocks[-1] >= 0.95
    assert all(block < 0.95 for block in blocks[:-1])
    assert rows["losses/total"][done:].tolist() == [0.0] * (UPDATES - done)


def test_runs_that_never_succeed_enough_go_on_to_the_end(sweep):
    state, metrics = sweep
    for index, name in enumerate(SETTINGS):
        if name != "DAgger until it succeeds":
            assert metrics["active"][index].all()
            assert not bool(state.stopped[index, 0])


def test_a_run_in_a_batch_is_the_run_by_itself(sweep):
    """The first rollout exactly; later, batched sums round differently and runs drift apart."""
    index = list(SETTINGS).index("DAgger")
    _, alone = jax.jit(make_train(every_loss()))(make_key(index), SETTINGS["DAgger"])
    together = rows_of(sweep, "DAgger")
    for name in ("episodes/count", "episodes/success", "episodes/length", "train/forced"):
        assert together[name][0] == alone[name][0]
    for name in ("losses/total", "train/gradient_norm", "losses/imitation/cross_entropy"):
        np.testing.assert_allclose(together[name][:3], alone[name][:3], rtol=1e-3)
    assert success(alone) > 0.95


def test_teacher_forcing_of_one_always_takes_the_advice(sweep):
    rows = rows_of(sweep, "cloning on the expert's states")
    np.testing.assert_array_equal(rows["train/teacher_forcing"], np.ones(UPDATES))
    np.testing.assert_allclose(rows["train/forced"], rows["losses/imitation/advised"], rtol=1e-6)


def test_unknown_numbers_are_told():
    with pytest.raises(JaxactError, match=r"learning_rat'.*nearest is 'learning_rate'"):
        jax.eval_shape(make_train(every_loss()), make_key(0), {"pipeline.learning_rat": 1.0})


@pytest.fixture(scope="module")
def program():
    return Program(every_loss(), choose_devices(1))


@pytest.fixture(scope="module")
def advance(program):
    """(numbers that differ) -> (state, metrics) after two updates or fewer, in one program."""
    run = program.stage(0, 2)
    start = program._start.lower().compile()

    def call(limit=2, **changes):
        changed = {name.replace("__", "."): np.float32(x) for name, x in changes.items()}
        numbers = program.numbers()
        assert changed.keys() <= numbers.keys()
        state = start(make_key(0), numbers, program.data)
        state, metrics = run(state, numbers | jax.tree.map(jnp.asarray, changed), np.int32(limit))
        return state, jax.tree.map(np.asarray, metrics)

    call.compiled = run
    return call


def losses(name):
    return f"pipeline__stages__0__losses__{name}"


WEIGHTS = "pipeline__stages__0__weights__"
NUMBERS = {
    "learning rate": {"pipeline__learning_rate": 1e-3},
    "discount": {"pipeline__discount": 0.5},
    "lambda": {"pipeline__gae_lambda": 0.1},
    "gradient norm": {"pipeline__max_grad_norm": 1e-3},
    "optimizer's epsilon": {"pipeline__optimizer_options__eps": 1.0},
    "clip": {losses("ppo__clip"): 1e-3},
    "value's weight": {losses("ppo__value"): 5.0},
    "entropy": {losses("ppo__entropy"): 1.0},
    "weight of a loss": {f"{WEIGHTS}imitation": 1.0},
    "teacher forcing": {"pipeline__stages__0__teacher_forcing__start": 1.0},
    "reward": {"pomdp__task__step_penalty": -1.0},
}


@pytest.mark.parametrize("name", NUMBERS)
def test_changing_a_number_changes_training_but_compiles_nothing(advance, name):
    plain, _ = advance()
    changed, _ = advance(**NUMBERS[name])
    leaves = zip(jax.tree.leaves(plain.params), jax.tree.leaves(changed.params), strict=True)
    assert any(not np.array_equal(a, b) for a, b in leaves)
    assert advance.compiled._cache_size() == 1


def test_a_loss_of_weight_zero_has_no_influence(advance):
    plain, _ = advance()
    changed, metrics = advance(**{losses("a2c__value"): 9.0, losses("a2c__entropy"): 9.0})
    assert_same(changed.params, plain.params)
    assert np.all(metrics["losses/a2c/weight"] == 0)
    assert np.all(metrics["losses/a2c/value"] > 0)


def test_the_total_is_the_weighted_sum(advance):
    _, metrics = advance(**{f"{WEIGHTS}ppo": 0.0, f"{WEIGHTS}imitation": 3.0})
    expected = 3.0 * metrics["losses/imitation/cross_entropy"]
    np.testing.assert_allclose(metrics["losses/total"], expected, rtol=1e-5)


def test_the_limit_ends_a_chunk_before_its_length(advance):
    state, metrics = advance(limit=1)
    assert metrics["active"].tolist() == [True, False]
    assert np.asarray(state.updates).tolist() == [1]


def test_the_described_state_is_the_state(program):
    like = program.like()
    state = jax.eval_shape(lambda key: start(every_loss(), key, {}), make_key(0))
    describe = lambda tree: jax.tree.map(lambda x: (x.shape, x.dtype), tree)  # noqa: E731
    assert describe(like) == describe(state)
    # No weak types: the second call of a stage would be traced anew.
    assert not any(x.weak_type for x in jax.tree.leaves(state) if hasattr(x, "weak_type"))
