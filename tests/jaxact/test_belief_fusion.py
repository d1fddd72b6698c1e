"""Several beliefs: fused by the formulas, carried through sequences, seen by losses by name."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.errors import JaxactError
from jaxact.models import GRU, LSTM, ActorCritic, Concatenated, MultipleBeliefs, Vector
from jaxact.spaces import Discrete
from tests.windows import normal

T, B, F, H = 4, 3, 5, 6
INPUTS = jnp.asarray(normal(0, T, B, F))
IS_FIRST = jnp.zeros((T, B), bool).at[2, 1].set(True)


def softmax(x):
    return np.exp(x) / np.exp(x).sum(-1, keepdims=True)


def run(fusion, inputs=INPUTS, is_first=IS_FIRST, start=None):
    module = MultipleBeliefs({"left": GRU(H), "right": LSTM(H)}, fusion=fusion)
    start = module.initial(B) if start is None else start
    shapes = jax.eval_shape(module.init, jax.random.key(0), INPUTS, module.initial(B), IS_FIRST)
    leaves, structure = jax.tree.flatten(shapes)
    random = [jnp.asarray(0.5 * normal(i, *x.shape)) for i, x in enumerate(leaves)]
    params = structure.unflatten(random)
    return params["params"], jax.jit(module.apply)(params, inputs, start, is_first)


@pytest.mark.parametrize("fusion", ["attention", "softmax", "average"])
def test_weights_are_the_formulas(fusion):
    params, (beliefs, _) = run(fusion)
    left, right = (np.asarray(beliefs.named[name]) for name in ("left", "right"))
    stacked = np.stack([left, right], -2)
    if fusion == "attention":
        query = np.asarray(INPUTS) @ params["query"]["kernel"] + params["query"]["bias"]
        weights = softmax(np.einsum("tbh,tbkh->tbk", query, stacked) / np.sqrt(H))
    elif fusion == "softmax":
        weights = softmax(
            np.asarray(INPUTS) @ params["scores"]["kernel"] + params["scores"]["bias"]
        )
    else:
        weights = np.full((T, B, 2), 0.5)
    np.testing.assert_allclose(beliefs.weights["left"], weights[..., 0], rtol=1e-5)
    np.testing.assert_allclose(beliefs.weights["right"], weights[..., 1], rtol=1e-5)
    fused = weights[..., :1] * left + weights[..., 1:] * right
    np.testing.assert_allclose(beliefs.fused, fused, rtol=1e-4, atol=1e-6)


def test_a_sequence_is_its_steps():
    _, (whole, last) = run("attention")
    memory = None
    for t in range(T):
        _, (step, memory) = run("attention", INPUTS[t], IS_FIRST[t], memory)
        np.testing.assert_allclose(step.fused, whole.fused[t], atol=1e-6)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), memory, last)


def test_the_models_extras_have_every_belief_by_name():
    memory = MultipleBeliefs({"left": GRU(H), "right": GRU(H)})
    model = ActorCritic(Discrete(2), Concatenated({"x": Vector((F,))}), memory)
    inputs = ({"x": INPUTS[0]}, model.initial_memory(B), jnp.zeros(B, jnp.int32), IS_FIRST[0])
    (output, after), _ = jax.eval_shape(
        lambda key: model.init_with_output(key, *inputs), jax.random.key(0)
    )
    shapes = jax.tree.map(lambda x: x.shape, dict(output.extras))
    assert shapes == {
        "left": (B, H),
        "right": (B, H),
        "belief": (B, H),
        "embedding": (B, F),
        "fusion": {"left": (B,), "right": (B,)},
    }
    assert jax.tree.map(jnp.shape, after) == {"left": (B, H), "right": (B, H)}


@pytest.mark.parametrize(
    ("memory", "message"),
    [
        (MultipleBeliefs({"a": GRU(2), "b": GRU(3)}), "of one size"),
        (MultipleBeliefs({"a": GRU(2), "belief": GRU(2)}), "'belief' cannot name"),
        (MultipleBeliefs({"a": GRU(2)}, fusion="max"), "unknown fusion of beliefs 'max'"),
    ],
)
def test_what_cannot_be_fused(memory, message):
    with pytest.raises(JaxactError, match=message):
        jax.eval_shape(memory.init, jax.random.key(0), INPUTS, memory.initial(B), IS_FIRST)
