"""A mixture plays exactly what its parts would, in one batch, and tells them apart."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.custom_batching import custom_vmap

from jaxact import JaxactError, evaluate_expert
from jaxact.overrides import with_numbers
from jaxact.pomdp import Episode, FinishedEpisodes, TaskSampler
from jaxact.program import Program, choose_devices
from jaxact.samplers import MixtureSampler
from jaxact.testing import check_pomdp
from jaxact.train import _rates, _summarise
from jaxact.train_state import make_key
from tests.corridor import RandomStart, corridor
from tests.tiny import experiment


@dataclasses.dataclass(frozen=True)
class From(TaskSampler):
    """Starts in one cell, with the goal at the end; the horizon is random and tells the key."""

    cell: int

    def sample(self, key, sampler_state):
        del sampler_state
        horizon = jax.random.randint(key, (), 5, 1000, jnp.int32)
        return Episode(jnp.int32(self.cell), jnp.int32(5), horizon)


class Counts(From):
    """Its state counts the episodes that ended, and their successes."""

    def init(self, key):
        del key
        return jnp.zeros(2, jnp.int32)

    def update(self, sampler_state, finished):
        ended = finished.mask
        return sampler_state + jnp.stack(
            [jnp.sum(ended, dtype=jnp.int32), jnp.sum(ended & finished.success, dtype=jnp.int32)]
        )


MIXTURE = MixtureSampler(
    {"near": From(4), "far": From(1), "never": From(2)}, {"far": 3.0, "never": 0.0}
)


def drawn(sampler, keys):
    state = sampler.init(keys[0])
    return jax.jit(jax.vmap(sampler.sample, (0, None)))(keys, state)


def test_a_batch_is_what_its_episodes_are_alone():
    keys = jax.random.split(make_key(0), 100)
    together = drawn(MIXTURE, keys)
    alone = jax.jit(lambda key: MIXTURE.sample(key, MIXTURE.init(key)))
    jax.tree.map(
        lambda x, *ones: np.testing.assert_array_equal(x, np.stack(ones)),
        together,
        *[alone(key) for key in keys],
    )
    # And each is what its part draws from the same key.
    horizons = [From(0).sample(jax.random.split(key)[1], ()).horizon for key in keys]
    np.testing.assert_array_equal(together.horizon, np.stack(horizons))
    cells = np.array([4, 1, 2])[np.asarray(together.origin.part)]
    np.testing.assert_array_equal(together.environment, cells)


class Compacted(From):
    """Has a batching rule of its own, round a constant, as samplers that draw until valid have."""

    def sample(self, key, sampler_state):
        cells = jnp.arange(6, dtype=jnp.int32)

        @custom_vmap
        def start(key):
            del key
            return cells[self.cell]

        @start.def_vmap
        def starts(size, batched, key):
            del key
            return jnp.broadcast_to(cells[self.cell], (size,)), batched[0]

        episode = super().sample(key, sampler_state)
        return dataclasses.replace(episode, environment=start(key))


def test_parts_may_have_batching_rules_of_their_own():
    keys = jax.random.split(make_key(0), 40)
    plain = MixtureSampler({"a": From(1), "b": From(2)})
    ruled = MixtureSampler({"a": Compacted(1), "b": Compacted(2)})
    one, other = drawn(plain, keys), drawn(ruled, keys)
    jax.tree.map(np.testing.assert_array_equal, one, other)


def test_vmap_over_runs_changes_nothing():
    keys = jax.random.split(make_key(1), (3, 40))
    state = MIXTURE.init(keys[0, 0])
    nested = jax.jit(jax.vmap(jax.vmap(lambda key: MIXTURE.sample(key, state))))(keys)
    flat = drawn(MIXTURE, keys.reshape(-1))
    jax.tree.map(lambda x, y: np.testing.assert_array_equal(x.reshape(-1), y), nested, flat)


def test_states_may_be_batched_too():
    mixture = MixtureSampler({"a": Counts(1), "b": Counts(2)})
    keys = jax.random.split(make_key(1), 40)
    one = jax.jit(jax.vmap(lambda key: mixture.sample(key, mixture.init(key))))(keys)
    states = jnp.zeros((40, 2, 2), jnp.int32)
    other = jax.jit(jax.vmap(lambda key, s: mixture.sample(key, (s[0], s[1]))))(keys, states)
    jax.tree.map(np.testing.assert_array_equal, one, other)


def test_parts_come_by_their_weights():
    parts = np.asarray(drawn(MIXTURE, jax.random.split(make_key(2), 4000)).origin.part)
    counts = np.bincount(parts, minlength=3)
    # 1000, 3000 and none, give or take 5 standard deviations.
    assert abs(counts[0] - 1000) < 5 * np.sqrt(4000 * 0.25 * 0.75)
    assert counts[2] == 0


def test_no_part_is_sampled_for_the_others_episodes():
    """The batch is drawn in turns: what a part's loop is run on is a share of the batch."""
    mixture = MixtureSampler({"a": From(1), "b": From(2)})
    keys = jax.random.split(make_key(0), 800)
    text = str(jax.make_jaxpr(jax.vmap(lambda key: mixture.sample(key, ((), ()))))(keys))
    assert " cond[" not in text
    assert text.count("while[") >= 2
    assert "i32[100]" in text


def test_each_part_is_told_of_its_own():
    mixture = MixtureSampler({"a": Counts(1), "b": Counts(2)})
    origin = drawn(mixture, jax.random.split(make_key(4), 12)).origin
    part = np.asarray(origin.part)
    mask, success = np.arange(12) % 3 > 0, np.arange(12) % 2 == 0
    finished = FinishedEpisodes(
        mask=jnp.asarray(mask),
        success=jnp.asarray(success),
        episode_return=jnp.zeros(12),
        length=jnp.ones(12, jnp.int32),
        task=None,
        origin=origin,
        mean_error=None,
    )
    states = mixture.update(mixture.init(make_key(0)), finished)
    for index, state in enumerate(states):
        own = mask & (part == index)
        assert np.asarray(state).tolist() == [own.sum(), (own & success).sum()]
    assert mixture.learns
    assert not MIXTURE.learns


def test_training_reports_success_by_name():
    parts = {"start": RandomStart(horizon=3), "inner": MixtureSampler({"a": From(4), "b": From(3)})}
    wrong = dataclasses.replace(corridor(), sampler=MixtureSampler(parts))
    with pytest.raises(JaxactError, match=r"of 'inner' cannot be mixed .* they have .*part in add"):
        wrong.reset(make_key(0))

    nested = MixtureSampler(
        {"x": parts["inner"], "y": MixtureSampler({"c": From(4), "d": From(2)})}
    )
    pomdp = dataclasses.replace(corridor(), sampler=nested)
    program = Program(experiment(pomdp), choose_devices(1))
    _, metrics = program.stage(0, 1)(program.start(make_key(0)), program.numbers(), 1)
    rows = {name: np.asarray(x) for name, x in metrics.items()}
    count, success = rows["episodes/count"], rows["episodes/success"]
    for total, name in ((count, "count"), (success, "success")):
        np.testing.assert_array_equal(
            total, rows[f"episodes/kinds/x/{name}"] + rows[f"episodes/kinds/y/{name}"]
        )
        np.testing.assert_array_equal(
            rows[f"episodes/kinds/x/{name}"],
            rows[f"episodes/kinds/x/a/{name}"] + rows[f"episodes/kinds/x/b/{name}"],
        )
    assert count.min() > 0
    means = _summarise(rows)
    of_x = rows["episodes/kinds/x/count"].sum()
    assert means["train/episodes"] == count.sum()
    assert means["train/kinds/x/episodes"] == of_x
    assert means["train/kinds/x/success"] == pytest.approx(
        rows["episodes/kinds/x/success"].sum() / of_x
    )
    assert means["train/success"] == pytest.approx(success.sum() / count.sum())
    rates = _rates(rows)
    np.testing.assert_allclose(
        rates["train/kinds/y/success"],
        rows["episodes/kinds/y/success"] / rows["episodes/kinds/y/count"],
    )


def test_evaluation_reports_success_by_name():
    """The expert walks four cells at most; of those who start far off only the patient arrive."""
    mixture = MixtureSampler({"near": From(4), "hopeless": RandomStart(horizon=0)})
    pomdp = dataclasses.replace(corridor(), sampler=mixture)
    check_pomdp(pomdp)
    outcome = evaluate_expert(pomdp, 40)
    near = outcome.kinds["near"]
    np.testing.assert_array_equal(near, ~outcome.kinds["hopeless"])
    assert 5 < near.sum() < 35
    assert outcome.success[near].all()
    summary = outcome.summary()
    assert summary["kinds/near/success"]["mean"] == 1.0
    assert summary["kinds/hopeless/success"]["mean"] == outcome.success[~near].mean()


def test_weights_can_be_swept():
    keys = jax.random.split(make_key(5), 40)

    def parts_drawn(weight):
        mixture = with_numbers(MIXTURE, {"weights.far": weight})
        return jax.vmap(lambda key: mixture.sample(key, ((), (), ())).origin.part)(keys)

    never, always = np.asarray(jax.jit(jax.vmap(parts_drawn))(jnp.array([0.0, 1e9])))
    assert set(never.tolist()) == {0}
    assert set(always.tolist()) == {1}


@pytest.mark.parametrize(
    ("parts", "weights", "message"),
    [
        ({"a": From(1)}, {"b": 1.0}, "unknown part of the mixture 'b'; the nearest is 'a'"),
        ({"a": From(1)}, {"a": -1.0}, "the weight of 'a' must not be negative, got -1.0"),
        ({"a": From(1)}, {"a": 0.0}, "needs at least one part whose weight is positive"),
        ({}, {}, "needs at least one part"),
    ],
)
def test_bad_weights_are_answered_with_a_sentence(parts, weights, message):
    with pytest.raises(JaxactError, match=message):
        MixtureSampler(parts, weights)


class Wide(From):
    def sample(self, key, sampler_state):
        return dataclasses.replace(super().sample(key, sampler_state), task=jnp.zeros(3, jnp.int32))


def test_parts_of_other_shapes_are_named():
    mixture = MixtureSampler({"narrow": From(1), "wide": Wide(1)})
    message = (
        r"episodes of 'wide' cannot be mixed with those of 'narrow': their .task is int32\[3\]"
    )
    with pytest.raises(JaxactError, match=message):
        mixture.init(make_key(0))
