"""AllenAct's reading of a grid: embeddings of every cell's codes, straight into the memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np


class ProjectedGrid(nn.Module):
    """Embeds each code of each cell, lays all embeddings out as one vector and projects it.

    Before `LSTM(H, projects=False)` and with 4 · H features it is what AllenAct's
    `MiniGridSimpleConvRNN` does. The vector is never laid out: projected, it is the sum of one row
    for each cell, out of a table with a row for each place and each kind of cell, and the product
    with who-is-where has as many columns as there are kinds, where embeddings have three times
    `embedding`.

    Attributes:
      features: size of the result.
      kinds: the codes of each kind of cell that the world has; cells of others count as nothing.
      embedding: size of a code's embedding.
      sizes: number of values of each code; MiniGrid's type, colour and state by default.
      image: name of the grid observation.
    """

    features: int
    kinds: Sequence[Sequence[int]]
    embedding: int = 8
    sizes: Sequence[int] = (11, 6, 3)
    image: str = "image"

    @nn.compact
    def __call__(self, observation: Mapping[str, jax.Array]) -> jax.Array:
        """Returns float32 [..., features]."""
        codes = observation[self.image].astype(jnp.int32)
        kinds = np.asarray(self.kinds, np.int32)
        cells = codes.shape[-3] * codes.shape[-2]
        embeddings = [
            self.param(
                f"code_{i}", nn.initializers.normal(1.0), (size, self.embedding), jnp.float32
            )[kinds[:, i]]
            for i, size in enumerate(self.sizes)
        ]
        each = self.embedding * len(self.sizes)
        shape = (cells * each, self.features)
        kernel = self.param("kernel", nn.initializers.lecun_normal(), shape, jnp.float32)
        bias = self.param("bias", nn.initializers.zeros, (self.features,), jnp.float32)
        rows = jnp.einsum(
            "ke,cef->ckf",
            jnp.concatenate(embeddings, axis=-1),
            kernel.reshape(cells, each, self.features),
        )
        is_kind = jnp.all(codes[..., None, :] == kinds, axis=-1).astype(jnp.float32)
        where = is_kind.reshape(*codes.shape[:-3], -1)
        return where @ rows.reshape(-1, self.features) + bias
