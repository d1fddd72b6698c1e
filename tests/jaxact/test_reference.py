"""Staying near a reference: the divergence of either direction, and references from runs."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxact.checkpoints import Checkpoints
from jaxact.errors import JaxactError
from jaxact.losses import KLToReference
from jaxact.models import GRU, ActorCritic, Concatenated, Vector
from jaxact.runs import create_run
from tests.tiny import assert_same
from tests.windows import ACTIONS, PROGRESS, B, T, batch_of, normal

MODEL = ActorCritic(ACTIONS, Concatenated({"x": Vector((5,))}), GRU(4))
OBSERVATION = {"x": jnp.asarray(normal(0, T, B, 4))}
BATCH = dataclasses.replace(batch_of(OBSERVATION), memory=jnp.asarray(normal(1, B, 4)))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Saved:
    """The part of a train state that is looked for."""

    params: object


def params_of(seed):
    inputs = (
        {"x": OBSERVATION["x"][0]},
        MODEL.initial_memory(B),
        BATCH.action[0],
        BATCH.is_first[0],
    )
    leaves, structure = jax.tree.flatten(jax.eval_shape(MODEL.init, jax.random.key(0), *inputs))
    random = [jnp.asarray(normal(seed + i, *x.shape)) for i, x in enumerate(leaves)]
    return structure.unflatten(random)


def apply(params):
    inputs = (OBSERVATION, BATCH.memory, BATCH.previous_action, BATCH.is_first)
    return MODEL.apply(params, *inputs)[0]


def test_divergence_is_that_of_the_policies_over_the_window():
    """In either direction; the reference goes on from the policy's memory."""

    def kl(params):
        variables = {"reference": params_of(50)}
        directions = [KLToReference(model=MODEL, forward=x) for x in (True, False)]
        return jnp.stack(
            [loss(apply(params), BATCH, PROGRESS, variables)[0] for loss in directions]
        )

    @jax.jit
    def everything(params):
        policies = [apply(x).distribution.probabilities for x in (params, params_of(50))]
        return kl(params), policies, jax.jacrev(kl)(params)

    (forward, backward), (ours, theirs), gradient = everything(params_of(0))
    assert float(forward) == pytest.approx(stats.entropy(theirs, ours, axis=-1).mean(), rel=1e-3)
    assert float(backward) == pytest.approx(stats.entropy(ours, theirs, axis=-1).mean(), rel=1e-3)
    assert all(np.abs(x).max() > 0 for x in jax.tree.leaves(gradient["params"]["actor"]))


def init(loss):
    one = {"x": OBSERVATION["x"][0, :1]}
    return jax.jit(lambda key: loss.init(key, None, one, jnp.zeros(1, jnp.int32)))(
        jax.random.key(0)
    )


def test_it_begins_as_the_policy_is_unless_a_run_is_named(tmp_path):
    anchored = KLToReference(model=MODEL)
    params = params_of(0)
    assert_same(anchored.anchor(init(anchored), params), {"reference": params})

    saved = params_of(50)
    run = create_run(tmp_path, "teacher", {})
    Checkpoints(run / "checkpoints").save(7, Saved(saved), metadata={})
    loaded = KLToReference(model=MODEL, run=str(run))
    variables = init(loaded)
    assert_same(variables, {"reference": saved})
    assert_same(loaded.anchor(variables, params), variables)


def test_the_run_has_to_be_there():
    with pytest.raises(JaxactError, match="nowhere"):
        init(KLToReference(model=MODEL, run="nowhere"))
