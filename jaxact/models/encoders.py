"""Encoders: from sensor readings to feature vectors, over any leading axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from jaxact.errors import JaxactError
from jaxact.models.convolution import Convolution

# Kaiming-style gain for layers that a rectifier follows.
RELU = nn.initializers.orthogonal(2.0**0.5)
_UNIT = nn.initializers.normal(0.5)


class GridCodes(nn.Module):
    """Embeds each cell of a grid observation by its codes.

    The codes' embeddings are summed, so that what is learnt of a colour holds for every kind of
    thing that has it, and a hidden layer on the sums makes "red ball" more than red and ball. All
    combinations are embedded first, so that a cell costs one look-up, however deep this is.

    Attributes:
      features: size of a cell's embedding.
      hidden: size of the hidden layer.
      sizes: number of values of each code; MiniGrid's type, colour and state by default.
    """

    features: int
    hidden: int = 64
    sizes: Sequence[int] = (11, 6, 3)

    @nn.compact
    def __call__(self, codes: jax.Array) -> jax.Array:
        """Maps integer codes [..., W, H, len(sizes)] to float32 [..., W, H, features]."""
        index = jnp.zeros(codes.shape[:-1], jnp.int32)
        embeddings = []
        for i, size in enumerate(self.sizes):
            index = index * size + codes[..., i].astype(jnp.int32)
            embeddings.append(self.param(f"code_{i}", _UNIT, (size, self.hidden), jnp.float32))
        sums = jnp.asarray(_combinations(tuple(self.sizes))) @ jnp.concatenate(embeddings)
        table = nn.Dense(self.features, use_bias=False, kernel_init=RELU)(nn.relu(sums))
        return table.at[index].get(mode="clip")


def _combinations(sizes: tuple[int, ...]) -> np.ndarray:
    """Returns which codes each combination has, float32 [product of sizes, sum of sizes]."""
    codes = np.indices(sizes).reshape(len(sizes), -1)
    pairs = zip(sizes, codes, strict=True)
    return np.concatenate([np.eye(size, dtype=np.float32)[code] for size, code in pairs], axis=1)


class BagOfWords(nn.Module):
    """Embeds a sequence of tokens by the words it holds, whatever their order; 0 is padding.

    Enough for instructions such as "go to the red ball"; where word order matters, use `WordsGRU`.

    Attributes:
      features: size of the embedding.
      vocabulary: number of tokens, padding included.
    """

    features: int
    vocabulary: int = 64

    @nn.compact
    def __call__(self, tokens: jax.Array) -> jax.Array:
        """Maps integer tokens [..., length] to float32 [..., features]."""
        shape = (self.vocabulary, self.features)
        words = self.param("table", _UNIT, shape, jnp.float32).at[tokens].get(mode="clip")
        return jnp.sum(jnp.where(tokens[..., None] == 0, 0.0, words), axis=-2)


class WordsGRU(nn.Module):
    """Reads a sequence of tokens in order with a gated recurrent unit; 0 is padding.

    Attributes:
      features: size of the embedding.
      vocabulary: number of tokens, padding included.
    """

    features: int
    vocabulary: int = 64

    @nn.compact
    def __call__(self, tokens: jax.Array) -> jax.Array:
        """Maps integer tokens [..., length] to float32 [..., features]."""
        flat = tokens.reshape((-1, tokens.shape[-1]))
        words = nn.Embed(self.vocabulary, self.features, embedding_init=_UNIT)(flat)
        cell = nn.GRUCell(self.features, parent=None)
        parameters = self.param(
            "cell", lambda key: cell.init(key, jnp.zeros((1, self.features)), words[:1, 0])
        )

        def step(h: jax.Array, x: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
            word, token = x
            new, _ = cell.apply(parameters, h, word)
            return jnp.where(token[:, None] == 0, h, new), None

        start = jnp.zeros((flat.shape[0], self.features), jnp.float32)
        h, _ = jax.lax.scan(step, start, (jnp.swapaxes(words, 0, 1), flat.T))
        return h.reshape((*tokens.shape[:-1], self.features))


class FiLM(nn.Module):
    """Feature-wise linear modulation (Perez et al. 2018): x (1 + γ(c)) + β(c)."""

    @nn.compact
    def __call__(self, x: jax.Array, condition: jax.Array) -> jax.Array:
        """Modulates x [..., W, H, F] or [..., F] by a condition [..., C]."""
        scale, shift = jnp.split(nn.Dense(2 * x.shape[-1])(condition), 2, axis=-1)
        extra = (1,) * (x.ndim - condition.ndim)
        scale = scale.reshape(scale.shape[:-1] + extra + scale.shape[-1:])
        shift = shift.reshape(shift.shape[:-1] + extra + shift.shape[-1:])
        return x * (1.0 + scale) + shift


class InstructedGrid(nn.Module):
    """A grid view read in the light of an instruction.

    Cells are embedded, modulated by the instruction (so that a cell can tell that it holds what is
    asked for) and laid out as one vector that keeps where each cell was.

    Attributes:
      features: size of the result.
      cell_features: size of a cell's embedding.
      words: the instruction's encoder, `BagOfWords` or `WordsGRU`.
      image: name of the grid observation.
      mission: name of the instruction's tokens.
    """

    features: int = 128
    cell_features: int = 16
    words: nn.Module = BagOfWords(32)
    image: str = "image"
    mission: str = "mission"

    @nn.compact
    def __call__(self, observation: Mapping[str, jax.Array]) -> jax.Array:
        """Returns float32 [..., features]."""
        instruction = self.words(observation[self.mission])
        cells = GridCodes(self.cell_features)(observation[self.image])
        cells = nn.relu(FiLM()(cells, instruction))
        flat = cells.reshape((*cells.shape[:-3], -1))
        # The sum of two products is the product with both side by side, without the copy.
        hidden = nn.Dense(self.features, kernel_init=RELU)(flat)
        return nn.relu(hidden + nn.Dense(self.features, use_bias=False)(instruction))


class Image(nn.Module):
    """Three convolutions and a dense layer (Mnih et al. 2015) for uint8 or float images.

    Attributes:
      features: size of the result.
      channels: output channels of each convolution.
      sizes: kernel sides.
      strides: kernel strides.
    """

    features: int = 512
    channels: Sequence[int] = (32, 64, 64)
    sizes: Sequence[int] = (8, 4, 3)
    strides: Sequence[int] = (4, 2, 1)

    @nn.compact
    def __call__(self, image: jax.Array) -> jax.Array:
        """Maps [..., H, W, C] to float32 [..., features]; uint8 is scaled to [0, 1]."""
        x = scaled(image)
        for channels, size, stride in zip(self.channels, self.sizes, self.strides, strict=True):
            x = nn.relu(Convolution(channels, size, stride)(x))
        x = x.reshape((*x.shape[:-3], -1))
        return nn.relu(nn.Dense(self.features, kernel_init=RELU)(x))


def scaled(image: jax.Array) -> jax.Array:
    """Returns an image as float32, uint8 scaled to [0, 1]."""
    x = image.astype(jnp.float32)
    return x / 255.0 if image.dtype == jnp.uint8 else x


class Embedding(nn.Module):
    """Looks up what a number stands for, such as the category of an object to find.

    Attributes:
      features: size of the embedding.
      size: numbers run from 0 to size − 1.
    """

    features: int
    size: int

    @nn.compact
    def __call__(self, number: jax.Array) -> jax.Array:
        """Maps integers [...] to float32 [..., features]."""
        table = self.param("table", _UNIT, (self.size, self.features), jnp.float32)
        return table.at[number].get(mode="clip")


class Vector(nn.Module):
    """Dense layers for vectors, and for maps small enough to be read cell by cell.

    Attributes:
      features: size of each layer.
      axes: of a reading; those of a map [H, W, C] are three, which are laid end to end.
    """

    features: Sequence[int] = (64, 64)
    axes: int = 1

    @nn.compact
    def __call__(self, vector: jax.Array) -> jax.Array:
        """Maps [..., D], or other `axes`, to float32 [..., features[-1]]."""
        x = vector.astype(jnp.float32)
        x = x.reshape(*x.shape[: x.ndim - self.axes], -1)
        for size in self.features:
            x = nn.tanh(nn.Dense(size, kernel_init=RELU)(x))
        return x


class Concatenated(nn.Module):
    """Several sensors, each through its own encoder, side by side.

    Attributes:
      encoders: an encoder for each named sensor that is to be read.
    """

    encoders: Mapping[str, nn.Module]

    @nn.compact
    def __call__(self, observation: Mapping[str, jax.Array]) -> jax.Array:
        """Returns float32 [..., sum of the encoders' features]."""
        return jnp.concatenate(
            [encoder(observation[name]) for name, encoder in sorted(self.encoders.items())],
            axis=-1,
        )


def check_features(features: jax.Array, leading: tuple[int, ...]) -> None:
    """Refuses what is not one vector for each of the leading axes' elements.

    Raises:
      JaxactError: the encoder kept axes of a reading, or took one too many.
    """
    if features.shape[:-1] != leading:
        raise JaxactError(
            f"the encoder makes features of shape {features.shape} of observations with the "
            f"leading axes {leading}, but a model needs [{', '.join(map(str, leading))}, F]: "
            "encode pictures by Image and maps by Vector(..., axes=3)"
        )
