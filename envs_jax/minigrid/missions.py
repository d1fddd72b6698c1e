"""Missions as tokens: the words of every MiniGrid and BabyAI mission, numbered.

Inside compiled code a mission is made from data (`go_to`, `fill`, and `sentences`), never from
text; text is for people.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import tiles
from jaxact.errors import JaxactError, unknown

PAD = 0
# Source: the missions of all ids registered by minigrid 3.2.0.
_WORDS = """
, a after and at avoid ball behind blue box door end fetch find from front get go goal green grey
hallway in key lava left matching maze must near next object of on open opening pick purple put
reach red right room rooms square the then to traverse unlock up use yellow you your
"""
VOCABULARY = ("<pad>", *sorted(_WORDS.split()))
VOCABULARY_SIZE = len(VOCABULARY)
# The longest mission of the registered MiniGrid worlds, LockedRoom's. All of them share it, so that
# their observations stack. BabyAI's levels have their own, the length of the longest mission that a
# level can make: 3 to 72 words.
MISSION_LENGTH = 18

# Words of a mission that `go_to` makes.
GO_TO_LENGTH = 5

_TOKENS = {word: token for token, word in enumerate(VOCABULARY)}
_KIND_WORDS = {tiles.KEY: "key", tiles.BALL: "ball", tiles.BOX: "box", tiles.OPEN_DOOR: "door"}
COLOR_WORDS = ("red", "green", "blue", "purple", "yellow", "grey")

# Tokens of the words for a tile type (indexed by type) and for a colour (indexed by colour).
KIND_TOKENS = np.array(
    [_TOKENS.get(_KIND_WORDS.get(kind, ""), PAD) for kind in range(tiles.NUM_TYPES)], np.int32
)
COLOR_TOKENS = np.array([_TOKENS[word] for word in COLOR_WORDS], np.int32)


def word_tokens(text: str) -> list[int]:
    """Returns the tokens of a text's words and commas.

    Raises:
      JaxactError: a word is not in the vocabulary.
    """
    words = _split(text)
    for word in words:
        if word not in _TOKENS:
            raise unknown("mission word", word, VOCABULARY[1:])
    return [_TOKENS[word] for word in words]


def _split(text: str) -> list[str]:
    """Returns a text's words and commas."""
    return text.replace(",", " ,").split()


def encode_mission(text: str, length: int = MISSION_LENGTH) -> np.ndarray:
    """Turns a mission into tokens int32[length], padded with `PAD` at the end.

    Raises:
      JaxactError: a word is not in the vocabulary, or the mission is too long.
    """
    words = word_tokens(text)
    if len(words) > length:
        raise JaxactError(
            f"the mission {text!r} has {len(words)} words; missions of its world have at most "
            f"{length}"
        )
    tokens = np.full(length, PAD, np.int32)
    tokens[: len(words)] = words
    return tokens


def decode_mission(tokens: Sequence[int] | np.ndarray | jax.Array | Any) -> str:
    """Turns tokens int[length] back into MiniGrid's mission text.

    >>> decode_mission(encode_mission("go to the red ball"))
    'go to the red ball'

    Raises:
      JaxactError: `tokens` is not one row of tokens of the vocabulary.
    """
    row = np.asarray(tokens)
    if row.ndim != 1 or (row.size and not 0 <= row.min() <= row.max() < VOCABULARY_SIZE):
        raise JaxactError(
            f"a mission is one row of tokens in 0 … {VOCABULARY_SIZE - 1}; got shape {row.shape}"
            + (f" with values {row.min()} … {row.max()}" if row.size else "")
        )
    return " ".join(VOCABULARY[token] for token in row if token != PAD).replace(" ,", ",")


def go_to(kind: jax.Array, color: jax.Array, several: jax.Array) -> jax.Array:
    """Returns the tokens int32[GO_TO_LENGTH] of "go to the/a {color} {kind}".

    Args:
      kind: integer scalar, tile type of what to go to.
      color: integer scalar.
      several: bool, more than one object matches ("a" instead of "the").
    """
    words = [
        jnp.int32(_TOKENS["go"]),
        jnp.int32(_TOKENS["to"]),
        jnp.where(several, jnp.int32(_TOKENS["a"]), jnp.int32(_TOKENS["the"])),
        jnp.asarray(COLOR_TOKENS)[color],
        jnp.asarray(KIND_TOKENS)[kind],
    ]
    return jnp.stack(words)


def fill(template: str, *words: jax.Array) -> jax.Array:
    """Returns the tokens int32[MISSION_LENGTH] of a sentence whose words are partly computed.

    Args:
      template: the sentence; "{0}", "{1}" … are words of their own and stand for `words`.
      *words: their tokens, int32 scalars.

    Raises:
      JaxactError: a word is not in the vocabulary, or the sentence is too long.
    """
    places = [f"{{{number}}}" for number in range(len(words))]
    text = _split(template)
    known = encode_mission(" ".join("a" if word in places else word for word in text))
    tokens = jnp.asarray(known)
    for place, word in zip(places, words, strict=True):
        spots = np.array([spot == place for spot in text] + [False] * (len(known) - len(text)))
        tokens = jnp.where(spots, word, tokens)
    return tokens
