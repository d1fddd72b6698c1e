"""What a model computes on the way to its output: found by name, drawn, filmed."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import JaxactError, Policy
from jaxact.features import check_names, draw, intermediates
from jaxact.models import GRU, ActorCritic, Concatenated, Vector
from jaxact.recording import record_episode
from tests.corridor import corridor
from tests.jaxact.test_recording import Shown

POMDP = dataclasses.replace(corridor(), sensors={"vector": Shown()})


@pytest.fixture(scope="module")
def policy():
    encoder = Concatenated({"vector": Vector((5, 3))})
    model = ActorCritic(POMDP.action_space, encoder, GRU(4))
    memory = Policy(model, None, POMDP.action_space).initial_memory(1)
    _, observation = POMDP.reset(jax.random.key(0))
    batch = jax.tree.map(lambda x: x[None], observation)
    params = model.init(
        jax.random.key(1), batch, memory.model, memory.previous_action, memory.is_first
    )
    return Policy(model, params, POMDP.action_space)


def test_parts_of_the_model_are_found_by_name(policy):
    _, observation = POMDP.reset(jax.random.key(0))
    memory = policy.initial_memory()
    found = intermediates(policy, observation, memory)
    output, after = policy.output(observation, memory)
    weights = policy.params["params"]["encoder"]["encoders_vector"]["Dense_0"]
    expected = observation["vector"] @ weights["kernel"] + weights["bias"]
    np.testing.assert_allclose(found["encoder/encoders_vector/Dense_0"], expected, atol=1e-6)
    np.testing.assert_allclose(found["encoder"], output.extras["embedding"], atol=1e-6)
    np.testing.assert_allclose(found["memory/0"], output.extras["belief"], atol=1e-6)
    np.testing.assert_allclose(found["memory/1"], after, atol=1e-6)
    np.testing.assert_allclose(found["critic"], output.value[None], atol=1e-6)
    assert all(name and not name.startswith("0/") for name in found)


def test_unknown_names_are_refused_before_anything_is_played(policy):
    check_names(POMDP, policy, ("encoder", "memory/0"))
    with pytest.raises(
        JaxactError, match="unknown intermediate of the model 'encodr'; the nearest"
    ):
        record_episode(POMDP, policy, features=("encodr",))


def test_films_show_them_beside_the_world(policy):
    plain = record_episode(POMDP, policy, max_steps=2)
    shown = record_episode(POMDP, policy, max_steps=2, features=("encoder", "memory/0"))
    assert len(shown) == len(plain)
    assert shown.shape[2] > plain.shape[2]


def test_signs_are_colours_and_sizes_brightness():
    picture = draw(np.array([[2.0, -2.0], [1.0, 0.0]]))
    half = len(picture) // 2
    corner = {
        "most": picture[1, 1],
        "least": picture[1, -2],
        "half": picture[half + 1, 1],
        "zero": picture[-2, -2],
    }
    assert corner["most"][0] > corner["most"][2]
    assert corner["least"][2] > corner["least"][0]
    np.testing.assert_allclose(corner["half"], corner["most"] / 2, atol=1)
    assert not corner["zero"].any()


@pytest.mark.parametrize(
    "shape", [(), (1,), (7,), (300,), (6, 4), (3, 4, 5), (7, 7, 200), (2, 2, 2, 2)]
)
def test_any_shape_can_be_drawn(shape):
    values = np.asarray(jax.random.normal(jax.random.key(0), shape))
    picture = draw(values)
    assert picture.dtype == np.uint8
    assert picture.ndim == 3
    assert max(picture.shape) < 500
    assert picture.any()
    assert draw(jnp.full(shape, jnp.nan)).shape == picture.shape
