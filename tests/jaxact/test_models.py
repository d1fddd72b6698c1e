"""Models: sequences are steps in a row, gates are the papers', shapes follow the leading axes."""

import chex
import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.distributions import Categorical, DiagonalNormal, Joint
from jaxact.models import (
    GRU,
    LSTM,
    ActorCritic,
    ActorHead,
    BagOfWords,
    Concatenated,
    Embedding,
    FiLM,
    GridCodes,
    Image,
    InstructedGrid,
    NoMemory,
    ProjectedGrid,
    ResNet,
    Vector,
    WordsGRU,
)
from jaxact.models.actor_critic import flatten_action
from jaxact.models.convolution import Convolution, convolve
from jaxact.models.resnet import BasicBlock
from jaxact.spaces import Box, Dict, Discrete, Tuple

T, B, F, H = 5, 3, 4, 6


def normal(seed, *shape):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), jnp.float32)


def init(module, *inputs):
    """Random parameters; initialisers take seconds to compile."""
    shapes = jax.eval_shape(module.init, jax.random.key(0), *inputs)
    leaves, structure = jax.tree.flatten(shapes)
    return structure.unflatten([0.3 * normal(i, *x.shape) for i, x in enumerate(leaves)])


def apply(module, params, *inputs):
    return jax.jit(module.apply)(params, *inputs)


@pytest.fixture(scope="module")
def sequence():
    """Inputs, and episodes that begin in the middle."""
    is_first = np.zeros((T, B), bool)
    is_first[0, 0] = is_first[2, 1] = is_first[4, 1] = is_first[3, 0] = True
    return normal(0, T, B, F), jnp.asarray(is_first)


@pytest.mark.parametrize("memory", [GRU(H), LSTM(H)], ids=["GRU", "LSTM"])
def test_a_sequence_is_its_steps_with_resets_where_episodes_begin(memory, sequence):
    inputs, is_first = sequence
    start = jax.tree.map(lambda x: x + 0.3, memory.initial(B))
    params = init(memory, inputs, start, is_first)
    outputs, last = apply(memory, params, inputs, start, is_first)
    carried = start
    for t in range(T):
        kept = jax.tree.map(lambda h, t=t: jnp.where(is_first[t][:, None], 0.0, h), carried)
        output, carried = apply(memory, params, inputs[t], kept, jnp.zeros(B, bool))
        np.testing.assert_allclose(output, outputs[t], atol=1e-6)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), carried, last)


@pytest.mark.parametrize("memory", [GRU(H), LSTM(H)], ids=["GRU", "LSTM"])
def test_nothing_passes_from_one_episode_to_the_next(memory, sequence):
    inputs, _ = sequence
    is_first = jnp.zeros((T, B), bool).at[3].set(True)
    params = init(memory, inputs, memory.initial(B), is_first)

    def late(early):
        mixed = inputs.at[:3].set(early)
        return apply(memory, params, mixed, memory.initial(B), is_first)[0][3:].sum()

    assert np.all(np.asarray(jax.grad(late)(inputs[:3])) == 0)


@pytest.mark.parametrize("memory", [GRU(H), LSTM(H)], ids=["GRU", "LSTM"])
def test_gradients_of_a_sequence_are_those_of_its_steps(memory, sequence):
    """Single steps are differentiated by JAX alone."""
    inputs, is_first = sequence
    start = jax.tree.map(lambda x: x + 0.3, memory.initial(B))
    params = init(memory, inputs, start, is_first)
    weights = normal(1, T, B, H)

    def score(outputs, last):
        return jnp.sum(weights * outputs) + sum(jnp.sum(jnp.sin(x)) for x in jax.tree.leaves(last))

    def whole(params, inputs, start):
        return score(*memory.apply(params, inputs, start, is_first))

    def by_steps(params, inputs, carried):
        outputs = []
        for t in range(T):
            output, carried = memory.apply(params, inputs[t], carried, is_first[t])
            outputs.append(output)
        return score(jnp.stack(outputs), carried)

    ours, expected = (
        jax.jit(jax.grad(function, (0, 1, 2)))(params, inputs, start)
        for function in (whole, by_steps)
    )
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), ours, expected)
    assert all(np.any(x) for x in jax.tree.leaves(expected))


def test_gru_is_flaxs_gru_cell():
    inputs, h = normal(0, B, F), normal(1, B, H)
    cell = nn.GRUCell(H)
    theirs = init(cell, h, inputs)
    theirs = jax.tree.map(lambda x: x + 0.1 * normal(x.size, *x.shape), theirs)
    p = theirs["params"]
    ours = {
        "input": {
            "kernel": jnp.concatenate([p[n]["kernel"] for n in ("ir", "iz", "in")], -1),
            "bias": jnp.concatenate([p[n]["bias"] for n in ("ir", "iz", "in")], -1),
        },
        "recurrent": jnp.concatenate([p[n]["kernel"] for n in ("hr", "hz", "hn")], -1),
        "recurrent_bias": p["hn"]["bias"],
    }
    expected, _ = apply(cell, theirs, h, inputs)
    output, _ = GRU(H).apply({"params": ours}, inputs, h, jnp.zeros(B, bool))
    np.testing.assert_allclose(output, expected, atol=1e-6)


def test_lstm_is_flaxs_lstm_cell_with_forget_bias_one():
    inputs, c, h = normal(0, B, F), normal(1, B, H), normal(2, B, H)
    cell = nn.LSTMCell(H)
    theirs = init(cell, (c, h), inputs)
    p = theirs["params"]
    gates = "ifgo"
    # flax keeps the bias beside the recurrent kernel; ours lies beside the input's, less the 1.
    p["hf"]["bias"] = p["hf"]["bias"] + 1.0
    bias = jnp.concatenate([p[f"h{n}"]["bias"] - (n == "f") * 1.0 for n in gates], -1)
    kernel = jnp.concatenate([p[f"i{n}"]["kernel"] for n in gates], -1)
    recurrent = jnp.concatenate([p[f"h{n}"]["kernel"] for n in gates], -1)
    ours = {"input": {"kernel": kernel, "bias": bias}, "recurrent": recurrent}
    (new_c, new_h), _ = apply(cell, theirs, (c, h), inputs)
    output, memory = LSTM(H).apply({"params": ours}, inputs, (c, h), jnp.zeros(B, bool))
    np.testing.assert_allclose(output, new_h, atol=1e-6)
    np.testing.assert_allclose(memory[0], new_c, atol=1e-6)


@pytest.mark.parametrize(
    ("stride", "size", "side"), [(1, 3, 7), (2, 3, 8), (2, 4, 9), (4, 8, 21), (3, 2, 8)]
)
def test_convolution_and_its_gradients_are_xlas(stride, size, side):
    x, kernel = normal(0, 2, side, side + 1, 3), normal(1, size, size, 3, 5)

    def reference(x, kernel):
        layout = ("NHWC", "HWIO", "NHWC")
        return jax.lax.conv_general_dilated(
            x, kernel, (stride, stride), "VALID", dimension_numbers=layout
        )

    def summed(function):
        return lambda *args: jnp.sum(jnp.sin(function(*args)))

    np.testing.assert_allclose(convolve(x, kernel, stride), reference(x, kernel), rtol=1e-6)
    ours = jax.jit(jax.grad(summed(lambda x, k: convolve(x, k, stride)), (0, 1)))(x, kernel)
    theirs = jax.jit(jax.grad(summed(reference), (0, 1)))(x, kernel)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("stride", [1, 2])
def test_gradients_of_convolutions_stay_on_the_fast_path(stride):
    x, kernel = normal(0, 2, 9, 9, 3), normal(1, 3, 3, 3, 5)
    y, pullback = jax.vjp(lambda x, kernel: convolve(x, kernel, stride), x, kernel)
    convolutions = [
        equation.params
        for equation in jax.make_jaxpr(pullback)(y).jaxpr.eqns
        if equation.primitive.name == "conv_general_dilated"
    ]
    # The gradient by the image; that by the kernel is made of products.
    assert len(convolutions) == 1
    assert convolutions[0]["lhs_dilation"] == (1, 1)
    assert convolutions[0]["padding"] == ((0, 0), (0, 0))


SPACES = {
    "discrete": (Discrete(5), Categorical),
    "box": (Box(-1, 1, (3,)), DiagonalNormal),
    "tuple": (Tuple((Discrete(5), Box(-1, 1, (2,)))), Joint),
    "dict": (Dict({"turn": Discrete(3), "arm": Tuple((Discrete(2), Discrete(4)))}), Joint),
}


@pytest.mark.parametrize("name", SPACES)
def test_heads_give_distributions_over_their_space(name):
    space, kind = SPACES[name]
    features = normal(0, T, B, F)
    head = ActorHead(space)
    distribution = apply(head, init(head, features), features)
    assert isinstance(distribution, kind)
    action = distribution.sample(jax.random.key(1))
    expected = jax.tree.map(lambda x: ((T, B, *x.shape), x.dtype), space.structure)
    assert jax.tree.map(lambda x: (x.shape, x.dtype), action) == expected
    assert distribution.log_prob(action).shape == (T, B)
    assert distribution.entropy().shape == (T, B)
    assert jax.tree.structure(distribution.mode()) == jax.tree.structure(action)


def test_first_policies_are_nearly_uniform():
    features = normal(0, 100, F)
    head = ActorHead(Discrete(4))
    distribution = head.apply(head.init(jax.random.key(0), features), features)
    np.testing.assert_allclose(distribution.probabilities, 0.25, atol=0.02)


def test_spaces_without_a_head_are_named():
    with pytest.raises(TypeError, match=r"no actor head .*\(2, 2\)"):
        ActorHead(Box(0, 1, (2, 2))).init(jax.random.key(0), normal(0, B, F))


def test_film_modulates_by_one_plus_scale_and_shift():
    x, condition = normal(0, B, 2, 2, F), normal(1, B, 7)
    film = FiLM()
    params = init(film, x, condition)
    zeros = jax.tree.map(jnp.zeros_like, params)
    np.testing.assert_array_equal(apply(film, zeros, x, condition), x)
    dense = params["params"]["Dense_0"]
    scale, shift = np.split(np.asarray(condition @ dense["kernel"] + dense["bias"]), 2, -1)
    expected = np.asarray(x) * (1 + scale[:, None, None]) + shift[:, None, None]
    np.testing.assert_allclose(apply(film, params, x, condition), expected, rtol=1e-4, atol=1e-5)


CODES = jnp.asarray(np.random.default_rng(0).integers(0, [11, 6, 3], (T, B, 7, 7, 3)), jnp.uint8)
TOKENS = jnp.asarray(np.random.default_rng(1).integers(1, 20, (T, B, 6)), jnp.int32)
PIXELS = jnp.asarray(np.random.default_rng(2).integers(0, 256, (T, B, 36, 36, 3)), jnp.uint8)

ENCODERS = {
    "GridCodes": (GridCodes(8), CODES, (7, 7, 8)),
    "BagOfWords": (BagOfWords(8), TOKENS, (8,)),
    "WordsGRU": (WordsGRU(8), TOKENS, (8,)),
    "Image": (Image(16, channels=(4, 4, 4)), PIXELS, (16,)),
    "ResNet": (ResNet(16, channels=4, blocks=(1, 1), groups=2, compressed=4), PIXELS, (16,)),
    "Embedding": (Embedding(8, 20), TOKENS[..., 0], (8,)),
    "Vector": (Vector((9, 8)), normal(3, T, B, F), (8,)),
    "InstructedGrid": (InstructedGrid(10, 4), {"image": CODES, "mission": TOKENS}, (10,)),
    "Concatenated": (
        Concatenated({"a": Vector((3,)), "b": BagOfWords(5)}),
        {"a": normal(3, T, B, F), "b": TOKENS, "unread": TOKENS},
        (8,),
    ),
}


@pytest.mark.parametrize("name", ENCODERS)
def test_encoders_treat_leading_axes_alike(name):
    encoder, reading, shape = ENCODERS[name]
    one = jax.tree.map(lambda x: x[2, 1], reading)
    params = init(encoder, one)
    all_of_them = apply(encoder, params, reading)
    assert all_of_them.shape == (T, B, *shape)
    assert all_of_them.dtype == jnp.float32
    # The single case goes through other kernels, so sums differ in their order.
    np.testing.assert_allclose(apply(encoder, params, one), all_of_them[2, 1], atol=1e-4)
    assert float(jnp.std(all_of_them)) > 1e-3


@pytest.mark.parametrize("encoder", [BagOfWords(8), WordsGRU(8)], ids=["BagOfWords", "WordsGRU"])
def test_padding_tokens_do_not_matter(encoder):
    tokens = jnp.array([[3, 1, 2]], jnp.int32)
    padded = jnp.array([[3, 1, 2, 0, 0, 0]], jnp.int32)
    params = init(encoder, padded)
    short, long = apply(encoder, params, tokens), apply(encoder, params, padded)
    np.testing.assert_allclose(short, long, atol=1e-6)
    none = apply(encoder, params, jnp.zeros((1, 3), jnp.int32))
    np.testing.assert_array_equal(none, np.zeros((1, 8)))


def test_word_order_matters_only_to_the_gru():
    there, back = jnp.array([[1, 2, 3]], jnp.int32), jnp.array([[3, 2, 1]], jnp.int32)
    for encoder, matters in ((BagOfWords(8), False), (WordsGRU(8), True)):
        params = init(encoder, there)
        one, other = apply(encoder, params, there), apply(encoder, params, back)
        assert np.allclose(one, other, atol=1e-5) != matters


def test_every_combination_of_codes_has_a_row_of_its_own():
    codes = np.stack(np.meshgrid(range(11), range(6), range(3), indexing="ij"), -1)
    codes = jnp.asarray(codes.reshape(1, -1, 3), jnp.uint8)
    grid = GridCodes(5)
    rows = np.asarray(apply(grid, init(grid, codes), codes))[0]
    assert len(np.unique(rows, axis=0)) == 11 * 6 * 3


def test_bytes_are_scaled_to_one():
    image = Image(16, channels=(4, 4, 4))
    params = init(image, PIXELS[0])
    as_floats = PIXELS[0].astype(jnp.float32) / 255.0
    np.testing.assert_allclose(
        apply(image, params, PIXELS[0]), apply(image, params, as_floats), atol=1e-5
    )


def test_a_block_without_residue_passes_the_image_on_and_a_lane_is_its_own():
    """With the last scale of a basic block at zero, what is left of it is its shortcut."""
    block = BasicBlock(4, 1, 2)
    x = jnp.abs(normal(0, B, 6, 6, 4))
    params = init(block, x)
    last = params["params"]["GroupNorm_1"]
    silent = {"params": {**params["params"], "GroupNorm_1": jax.tree.map(jnp.zeros_like, last)}}
    np.testing.assert_array_equal(apply(block, silent, x), x)
    np.testing.assert_allclose(apply(block, params, x)[:1], apply(block, params, x[:1]), atol=1e-5)


def test_padded_convolutions_see_zeros_beyond_the_border():
    layer = Convolution(2, 3, padding=1, use_bias=False)
    x = normal(0, B, 5, 5, 1)
    params = init(layer, x)
    bordered = jnp.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)))
    valid = apply(Convolution(2, 3, use_bias=False), params, bordered)
    np.testing.assert_allclose(apply(layer, params, x), valid, atol=1e-6)
    assert valid.shape == (B, 5, 5, 2)


@pytest.mark.parametrize(
    ("shape", "size", "stride", "padding"),
    [((2, 2), 3, 1, 1), ((3, 2), 3, 2, 1), ((1, 1), 2, 1, 1), ((3, 3), 3, 1, 0)],
)
def test_convolutions_of_few_cells_are_one_matrix(shape, size, stride, padding):
    x, kernel = normal(0, B, *shape, F), normal(1, size, size, F, 5)
    sides = (padding, padding)
    expected = convolve(jnp.pad(x, ((0, 0), sides, sides, (0, 0))), kernel, stride)
    layer = Convolution(5, size, stride, padding, use_bias=False)
    assert "conv_general" not in str(jax.make_jaxpr(layer.apply)({"params": {"kernel": kernel}}, x))
    result = apply(layer, {"params": {"kernel": kernel}}, x)
    assert result.shape == expected.shape
    np.testing.assert_allclose(result, expected, rtol=1e-4, atol=1e-5)


def test_convolution_adds_its_bias():
    layer = Convolution(2, 3, stride=2)
    x = normal(0, B, 9, 9, 1)
    params = init(layer, x)
    params = {"params": {**params["params"], "bias": jnp.zeros(2, jnp.float32)}}
    moved = {"params": {**params["params"], "bias": jnp.array([1.0, -2.0])}}
    difference = apply(layer, moved, x) - apply(layer, params, x)
    np.testing.assert_allclose(difference, np.broadcast_to([1.0, -2.0], (B, 4, 4, 2)), atol=1e-5)


def test_actions_are_laid_out_as_vectors():
    space = Dict({"b": Tuple((Discrete(3), Box(-1, 1, (2,)))), "a": Discrete(2)})
    action = {
        "a": jnp.array([1, 0], jnp.int32),
        "b": (jnp.array([2, 0], jnp.int32), jnp.array([[0.5, -0.5], [1.0, 0.0]])),
    }
    expected = [[0, 1, 0, 0, 1, 0.5, -0.5], [1, 0, 1, 0, 0, 1, 0]]
    np.testing.assert_allclose(flatten_action(space, action), expected)


def test_previous_actions_are_read_except_at_the_start():
    model = ActorCritic(Discrete(3), Vector((8,)), NoMemory(), previous_action=True)
    observation = jnp.ones((2, F), jnp.float32)
    is_first = jnp.array([True, False])
    zero, one = jnp.zeros(2, jnp.int32), jnp.ones(2, jnp.int32)
    params = init(model, observation, (), zero, is_first)
    after_zero, _ = apply(model, params, observation, (), zero, is_first)
    after_one, _ = apply(model, params, observation, (), one, is_first)
    changed = np.asarray(after_zero.value != after_one.value)
    assert changed.tolist() == [False, True]


@pytest.mark.parametrize("memory", [GRU(H), LSTM(H), NoMemory()], ids=["GRU", "LSTM", "none"])
def test_the_actor_critic_acts_and_learns_on_the_same_numbers(memory, sequence):
    """What was computed step by step while acting comes out of the sequence pass again."""
    inputs, is_first = sequence
    model = ActorCritic(Discrete(3), Vector((8,)), memory, previous_action=True)
    actions = jnp.asarray(np.random.default_rng(0).integers(0, 3, (T, B)), jnp.int32)
    start = model.initial_memory(B)
    params = init(model, inputs[0], start, actions[0], is_first[0])
    together, last = apply(model, params, inputs, start, actions, is_first)
    carried = start
    for t in range(T):
        output, carried = apply(model, params, inputs[t], carried, actions[t], is_first[t])
        np.testing.assert_allclose(output.value, together.value[t], atol=1e-5)
        logits = together.distribution.logits[t]
        np.testing.assert_allclose(output.distribution.logits, logits, atol=1e-5)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), carried, last)


def test_a_projected_grid_is_the_projection_of_its_embeddings():
    kinds = ((0, 0, 0), (1, 0, 0), (2, 5, 0), (9, 0, 0), (8, 1, 0))
    model = ProjectedGrid(12, kinds)
    which = jax.random.randint(jax.random.key(0), (3, 4, 7, 7), 0, len(kinds))
    image = jnp.asarray(kinds, jnp.uint8)[which]
    params = model.init(jax.random.key(1), {"image": image})
    own = params["params"]
    parts = [np.asarray(own[f"code_{i}"])[np.asarray(image[..., i])] for i in range(3)]
    flat = np.concatenate(parts, axis=-1).reshape(3, 4, -1)
    expected = flat @ np.asarray(own["kernel"]) + np.asarray(own["bias"])
    np.testing.assert_allclose(model.apply(params, {"image": image}), expected, atol=1e-4)


def test_an_lstm_may_be_given_what_its_gates_add_up():
    """With the projection outside it is the same function."""
    inputs = jax.random.normal(jax.random.key(0), (5, 3, 6))
    first = jnp.zeros((5, 3), bool).at[2, 1].set(True)
    whole, bare = LSTM(4), LSTM(4, projects=False)
    params = whole.init(jax.random.key(1), inputs, whole.initial(3), first)["params"]
    outputs, memory = whole.apply({"params": params}, inputs, whole.initial(3), first)
    projection = params["input"]
    gates = inputs @ projection["kernel"] + projection["bias"]
    rest = {"params": {"recurrent": params["recurrent"]}}
    chex.assert_trees_all_close((outputs, memory), bare.apply(rest, gates, bare.initial(3), first))
