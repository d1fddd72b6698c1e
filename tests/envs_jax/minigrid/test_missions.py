from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from envs_jax.minigrid import decode_mission, encode_mission, tiles
from envs_jax.minigrid.missions import (
    COLOR_TOKENS,
    MISSION_LENGTH,
    PAD,
    VOCABULARY,
    VOCABULARY_SIZE,
    fill,
    go_to,
)
from jaxact.errors import JaxactError


@pytest.mark.parametrize(
    "text",
    [
        "reach the goal",
        "use the key to open the door and then get to the goal",
        "get the red key from the grey room, unlock the red door and go to the goal",
        "open the red door, then go to a ball",
        "",
    ],
)
def test_missions_survive_the_round_trip(text):
    tokens = encode_mission(text)
    assert tokens.shape == (MISSION_LENGTH,)
    assert tokens.dtype == np.int32
    assert decode_mission(tokens) == text
    assert decode_mission(encode_mission(text, 20)) == text


def test_the_vocabulary_is_sorted_after_the_padding():
    assert VOCABULARY_SIZE == len(set(VOCABULARY)) == 56
    assert VOCABULARY.index("<pad>") == PAD == 0
    assert list(VOCABULARY[1:]) == sorted(VOCABULARY[1:])


def test_go_to_speaks_as_the_package_does():
    tokens = go_to(jnp.int32(tiles.BOX), jnp.int32(tiles.GREY), jnp.bool_(False))
    assert decode_mission(tokens) == "go to the grey box"
    tokens = go_to(jnp.int32(tiles.KEY), jnp.int32(tiles.PURPLE), jnp.bool_(True))
    assert decode_mission(tokens) == "go to a purple key"


def test_templates_are_filled():
    red, grey = (jnp.asarray(COLOR_TOKENS)[color] for color in (tiles.RED, tiles.GREY))
    tokens = fill("get the {0} key from the {1} room, unlock the {0} door", red, grey)
    assert tokens.dtype == jnp.int32
    assert decode_mission(tokens) == "get the red key from the grey room, unlock the red door"
    with pytest.raises(JaxactError, match="unknown mission word"):
        fill("go to the {1} ball", red)


def test_bad_missions_are_refused_with_a_reason():
    with pytest.raises(JaxactError, match="unknown mission word 'blu'; the nearest is 'blue'"):
        encode_mission("go to the blu ball")
    with pytest.raises(JaxactError, match="has 19 words"):
        encode_mission("go " * 19)
    with pytest.raises(JaxactError, match="one row of tokens"):
        decode_mission(np.zeros((2, MISSION_LENGTH), np.int32))
    with pytest.raises(JaxactError, match="one row of tokens"):
        decode_mission(np.full(MISSION_LENGTH, 99))
