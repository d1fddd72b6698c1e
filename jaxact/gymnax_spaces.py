"""Spaces as gymnax and JaxMARL have them, and values of ours as flat vectors."""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact import spaces
from jaxact.errors import JaxactError
from jaxact.pomdp import PyTree


def to_space(space: spaces.Space, theirs: ModuleType) -> Any:
    """Returns the space of the same values.

    Args:
      space: ours.
      theirs: the module with gymnax's classes of spaces, or with JaxMARL's, which are like them.

    Raises:
      JaxactError: they have none.
    """
    match space:
        case spaces.Discrete(n):
            return theirs.Discrete(n)
        case spaces.Box(low, high, shape, dtype):
            return theirs.Box(low, high, shape, jnp.dtype(dtype))
        case spaces.Tuple(parts):
            return theirs.Tuple([to_space(part, theirs) for part in parts])
    return theirs.Dict({name: to_space(part, theirs) for name, part in _parts(space).items()})


def to_flat_space(space: spaces.Space, theirs: ModuleType) -> Any:
    """Returns the box of what `flattened` makes of the space's values."""
    low, high = (np.concatenate(bounds) for bounds in zip(*_bounds(space), strict=True))
    return theirs.Box(low, high, low.shape, jnp.float32)


def flattened(space: spaces.Space, value: PyTree) -> jax.Array:
    """Returns a value as one vector, float32 [n]; what is discrete in it is one-hot.

    Values in a dict follow one another in the order of their names.
    """
    return jnp.concatenate(_vectors(space, value))


def _parts(space: spaces.Space) -> dict[Any, spaces.Space]:
    """Returns the spaces that a composite one is made of, by how to get at their values."""
    match space:
        case spaces.Dict(named):
            return dict(named)
        case spaces.Tuple(parts):
            return dict(enumerate(parts))
    raise JaxactError(f"neither gymnax nor JaxMARL has a space like {space}")


def _vectors(space: spaces.Space, value: PyTree) -> list[jax.Array]:
    match space:
        case spaces.Discrete(n):
            return [jax.nn.one_hot(value, n, dtype=jnp.float32)]
        case spaces.Box():
            return [jnp.ravel(value).astype(jnp.float32)]
    return [x for name, part in _parts(space).items() for x in _vectors(part, value[name])]


def _bounds(space: spaces.Space) -> list[tuple[np.ndarray, np.ndarray]]:
    """Returns the lowest and the highest values of each of `_vectors`."""
    match space:
        case spaces.Discrete(n):
            return [(np.zeros(n, np.float32), np.ones(n, np.float32))]
        case spaces.Box(low, high, shape):
            size = math.prod(shape)
            return [(np.full(size, low, np.float32), np.full(size, high, np.float32))]
    return [pair for part in _parts(space).values() for pair in _bounds(part)]
