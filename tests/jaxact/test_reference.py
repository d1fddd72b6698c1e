"""Staying near a reference: the divergence of either direction, and which policy is meant."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest
from scipy import stats

from jaxact.checkpoints import Checkpoints
from jaxact.distributions import Categorical
from jaxact.errors import JaxactError
from jaxact.losses import Anchored, Following, KLToReference
from jaxact.losses.base import TARGET_MODEL
from jaxact.runs import create_run
from tests.tiny import assert_same
from tests.windows import PROGRESS, B, N, T, batch_of, normal, output_of


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Saved:
    """The part of a train state that is looked for."""

    params: object


PARAMS = {"kernel": jnp.asarray(normal(0, 2, 3))}


def test_divergence_is_the_mean_over_the_window():
    policy, reference = (Categorical(jnp.asarray(normal(i, T, B, N))) for i in range(2))
    target = dataclasses.replace(output_of(), distribution=reference)
    output = dataclasses.replace(output_of(), distribution=policy, extras={"target": target})
    p, q = policy.probabilities, reference.probabilities
    for forward, expected in (
        (True, stats.entropy(q, p, axis=-1)),
        (False, stats.entropy(p, q, axis=-1)),
    ):
        kl, _ = KLToReference(forward=forward)(output, batch_of(), PROGRESS, {})
        assert float(kl) == pytest.approx(expected.mean(), rel=1e-4)


def begin(loss, params=PARAMS):
    return jax.jit(lambda params: loss.follow(loss.init(None, None, None, None), params))(params)


def test_it_is_the_policy_as_the_stage_begins_unless_a_run_is_named(tmp_path):
    own = KLToReference()
    assert isinstance(own, Anchored)
    assert isinstance(own, Following)
    later = jax.tree.map(lambda x: x + 1.0, PARAMS)
    assert_same(begin(own), {TARGET_MODEL: PARAMS})
    assert_same(own.follow(begin(own), later), {TARGET_MODEL: PARAMS})
    assert_same(own.anchor(begin(own), later), {TARGET_MODEL: later})

    run = create_run(tmp_path, "teacher", {})
    Checkpoints(run / "checkpoints").save(7, Saved(later), metadata={})
    loaded = KLToReference(run=str(run))
    assert_same(begin(loaded), {TARGET_MODEL: later})
    assert_same(loaded.anchor(begin(loaded), PARAMS), {TARGET_MODEL: later})


def test_the_run_has_to_be_there():
    with pytest.raises(JaxactError, match="nowhere"):
        begin(KLToReference(run="nowhere"))
