"""BabyAI's large model: sequences are steps, and its memory chooses the words that are read."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.models import BidirectionalWords, FiLMActorCritic
from jaxact.models.attended_words import attend
from jaxact.spaces import Discrete

T, B, L, H = 5, 3, 4, 6
MODEL = FiLMActorCritic(
    Discrete(3),
    channels=8,
    groups=2,
    instruction_size=10,
    memory_size=H,
    hidden=5,
    vocabulary=12,
    auxiliary_actor=True,
)
IS_FIRST = np.zeros((T, B), bool)
IS_FIRST[[0, 2, 4, 3], [0, 1, 1, 0]] = True


def normal(seed, *shape):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), jnp.float32)


def random_params(module, *inputs):
    """Random parameters; initialisers take seconds to compile."""
    shapes = jax.eval_shape(module.init, jax.random.key(0), *inputs)
    leaves, structure = jax.tree.flatten(shapes)
    return structure.unflatten([0.3 * normal(i, *x.shape) for i, x in enumerate(leaves)])


@pytest.fixture(scope="module")
def given():
    """Observations of a window, memories before it, and parameters."""
    rng = np.random.default_rng(0)
    tokens = rng.integers(1, 12, (T, B, L))
    tokens[..., 3] = 0
    observation = {
        "image": jnp.asarray(rng.integers(0, [11, 6, 3], (T, B, 7, 7, 3)), jnp.uint8),
        "mission": jnp.asarray(tokens, jnp.int32),
    }
    memory = normal(1, B, H), normal(2, B, H)
    actions = jnp.zeros((T, B), jnp.int32)
    now = jax.tree.map(lambda x: x[0], observation)
    params = random_params(MODEL, now, memory, actions[0], jnp.asarray(IS_FIRST[0]))
    return params, observation, memory, actions


def apply(params, observation, memory, actions, is_first):
    return _apply(params, observation, memory, actions, jnp.asarray(is_first))


_apply = jax.jit(MODEL.apply)


def test_a_sequence_is_its_steps_with_resets_where_episodes_begin(given):
    params, observation, start, actions = given
    together, last = apply(params, observation, start, actions, IS_FIRST)
    carried = start
    for t in range(T):
        kept = jax.tree.map(lambda h, t=t: jnp.where(IS_FIRST[t][:, None], 0.0, h), carried)
        now = jax.tree.map(lambda x, t=t: x[t], observation)
        output, carried = apply(params, now, kept, actions[t], np.zeros(B, bool))
        of_step = jax.tree.map(lambda x, t=t: x[t], together)
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), output, of_step)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), carried, last)
    shapes = {name: x.shape for name, x in together.extras.items() if name[:4] != "auxi"}
    assert shapes == {"embedding": (T, B, 8), "belief": (T, B, H), "attention": (T, B, L)}
    assert together.value.shape == (T, B)
    assert together.distribution.logits.shape == (T, B, 3)


def test_nothing_passes_from_one_episode_to_the_next(given):
    params, observation, start, actions = given
    one, _ = apply(params, observation, start, actions, IS_FIRST)
    changed = {**observation, "image": observation["image"].at[:2].set(1)}
    other, _ = apply(params, changed, jax.tree.map(jnp.zeros_like, start), actions, IS_FIRST)
    differs = np.asarray(jnp.any(one.distribution.logits != other.distribution.logits, axis=-1))
    # Lane 0 begins anew at 0, where its images differ, and at 3; lane 1 at 2; lane 2 never does.
    np.testing.assert_array_equal(
        differs, np.array([[1, 1, 1, 0, 0], [1, 1, 0, 0, 0], [1, 1, 1, 1, 1]], bool).T
    )


def test_attention_is_paid_to_what_the_memory_asks_for(given):
    params, observation, start, actions = given
    now = jax.tree.map(lambda x: x[0], observation)

    def attention(memory, is_first):
        output, _ = apply(params, now, memory, actions[0], np.full(B, is_first))
        return np.asarray(output.extras["attention"])

    one, other = attention(start, False), attention(jax.tree.map(jnp.negative, start), False)
    assert (np.abs(one - other).max(axis=-1) > 0.01).all()
    # The output half matters, and so does the cell half.
    assert not np.allclose(one, attention((start[0], -start[1]), False), atol=1e-3)
    assert not np.allclose(one, attention((-start[0], start[1]), False), atol=1e-3)
    np.testing.assert_allclose(one.sum(axis=-1), 1.0, rtol=1e-5)
    np.testing.assert_array_equal(one[:, 3], 0.0)
    # Where an episode begins there is nothing to remember.
    np.testing.assert_array_equal(
        attention(start, True), attention(jax.tree.map(jnp.negative, start), True)
    )


def test_the_view_is_read_in_the_light_of_the_instruction(given):
    params, observation, start, actions = given
    one, _ = apply(params, observation, start, actions, IS_FIRST)
    asked = {**observation, "mission": observation["mission"].at[..., 0].set(11)}
    other, _ = apply(params, asked, start, actions, IS_FIRST)
    difference = np.abs(one.extras["embedding"] - other.extras["embedding"]).max(axis=-1)
    assert (difference > 1e-3)[np.asarray(observation["mission"][..., 0]) != 11].all()


def test_gradients_reach_every_parameter(given):
    params, observation, start, actions = given

    @jax.jit
    def gradient(params):
        def loss(params):
            output, _ = MODEL.apply(params, observation, start, actions, jnp.asarray(IS_FIRST))
            second = output.extras["auxiliary_distribution"]
            outputs = (output.distribution.logits, second.logits, output.value)
            return sum(jnp.sum(jnp.sin(x + i)) for i, x in enumerate(outputs))

        return jax.grad(loss)(params)

    for path, leaf in jax.tree_util.tree_leaves_with_path(gradient(params)):
        assert np.isfinite(leaf).all(), jax.tree_util.keystr(path)
        assert np.abs(leaf).max() > 0, jax.tree_util.keystr(path)


def test_words_are_read_forth_and_back_alike():
    """Backwards, with both directions' parameters exchanged, what is read is the same."""
    words = BidirectionalWords(6, 12)
    tokens = jnp.array([[[1, 2, 3, 4], [5, 6, 0, 0]]], jnp.int32)
    params = random_params(words, tokens)
    read = jax.jit(words.apply)
    outputs = read(params, tokens)
    assert outputs.shape == (1, 2, 4, 6)
    own = params["params"]
    exchanged = {"params": {**own, "forth": own["back"], "back": own["forth"]}}
    mirrored = read(exchanged, tokens[:, :1, ::-1])[0, 0, ::-1]
    mirrored = jnp.concatenate([mirrored[:, 3:], mirrored[:, :3]], axis=-1)
    np.testing.assert_allclose(outputs[0, 0], mirrored, atol=1e-6)
    # Padding is not read, from neither side.
    short = read(params, tokens[:, 1:, :2])
    np.testing.assert_allclose(outputs[:, 1:, :2], short, atol=1e-6)


def test_an_instruction_without_words_says_nothing():
    words = normal(0, 2, L, H)
    tokens = jnp.array([[3, 0, 0, 0], [0, 0, 0, 0]], jnp.int32)
    average, weights = attend(normal(1, 2, H), words, tokens)
    np.testing.assert_allclose(average[0], words[0, 0], rtol=1e-6)
    np.testing.assert_array_equal(weights, [[1, 0, 0, 0], [0, 0, 0, 0]])
    np.testing.assert_array_equal(average[1], np.zeros(H))
