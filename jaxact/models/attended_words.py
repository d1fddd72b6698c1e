"""Instructions of which a policy reads, at each step, the words that matter there."""

from __future__ import annotations

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.models.memory import GRU

_UNIT = nn.initializers.normal(0.5)


class BidirectionalWords(nn.Module):
    """Reads a sequence of tokens forth and back with gated recurrent units; 0 is padding.

    Attributes:
      features: size of what is said of a word, half of it from each direction.
      vocabulary: number of tokens, padding included.
    """

    features: int
    vocabulary: int = 64

    @nn.compact
    def __call__(self, tokens: jax.Array) -> jax.Array:
        """Maps integer tokens [..., L], padded behind, to float32 [..., L, features]; where there
        is padding it means nothing.
        """
        flat = tokens.reshape((-1, tokens.shape[-1])).T
        words = nn.Embed(self.vocabulary, self.features, embedding_init=_UNIT)(flat)
        start = jnp.zeros_like(flat, bool)
        forth = self._read(words, start, "forth")
        # Backwards the instruction begins behind the padding.
        start = jnp.concatenate([start[:1], (flat == 0)[:0:-1]])
        back = self._read(words[::-1], start, "back")[::-1]
        outputs = jnp.concatenate([forth, back], axis=-1)
        return jnp.swapaxes(outputs, 0, 1).reshape((*tokens.shape, -1))

    def _read(self, words: jax.Array, is_first: jax.Array, name: str) -> jax.Array:
        unit = GRU(self.features // 2, name=name)
        return unit(words, unit.initial(words.shape[1]), is_first)[0]


def attend(query: jax.Array, words: jax.Array, tokens: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Averages words by how well they answer a query (dot-product attention, Luong et al. 2015).

    Args:
      query: [B, F].
      words: [B, L, F].
      tokens: integers [B, L]; 0 is padding.

    Returns:
      The average [B, F], and the weights [B, L]: zero on padding, zero everywhere in an instruction
      without words.
    """
    scores = jnp.einsum("bf,blf->bl", query, words)
    weights = jax.nn.softmax(scores, axis=-1, where=tokens != 0)
    return jnp.einsum("bl,blf->bf", weights, words), weights
