"""Spaces and their values as Gymnasium has them: NumPy arrays, and int64 for what is discrete."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np

from jaxact import spaces
from jaxact.errors import JaxactError
from jaxact.pomdp import PyTree


def to_space(space: spaces.Space, flatten: bool = False) -> gymnasium.Space[Any]:
    """Returns Gymnasium's space of the same values; with `flatten` all its boxes are vectors.

    Raises:
      JaxactError: Gymnasium has none.
    """
    match space:
        case spaces.Discrete(n):
            return gymnasium.spaces.Discrete(n)
        case spaces.Box(low, high, shape, name):
            dtype: Any = np.dtype(name)
            if np.issubdtype(dtype, np.integer):
                low, high = int(low), int(high)
            shape = (math.prod(shape),) if flatten else shape
            return gymnasium.spaces.Box(low, high, shape, dtype.type)
        case spaces.Tuple(parts):
            return gymnasium.spaces.Tuple([to_space(part, flatten) for part in parts])
        case spaces.Dict(named):
            return gymnasium.spaces.Dict({n: to_space(part, flatten) for n, part in named.items()})
    raise JaxactError(f"Gymnasium has no space like {space}")


def from_space(space: gymnasium.Space[Any]) -> spaces.Space:
    """Returns the space of the same values; wider numbers become float32, int32 and uint32.

    Raises:
      JaxactError: there is none.
    """
    match space:
        case gymnasium.spaces.Discrete() if space.start == 0:
            return spaces.Discrete(int(space.n))
        case gymnasium.spaces.Box() if space.low.size:
            narrow = {"f8": "f4", "i8": "i4", "u8": "u4"}
            dtype = np.dtype(narrow.get(space.dtype.str[1:], space.dtype))
            low, high = float(space.low.min()), float(space.high.max())
            if np.issubdtype(dtype, np.integer):
                limits = np.iinfo(dtype)
                low, high = max(low, limits.min), min(high, limits.max)
            return spaces.Box(low, high, space.shape, str(dtype))
        case gymnasium.spaces.Tuple():
            return spaces.Tuple(tuple(from_space(part) for part in space.spaces))
        case gymnasium.spaces.Dict():
            return spaces.Dict({name: from_space(part) for name, part in space.spaces.items()})
    raise JaxactError(f"jaxact has no space like Gymnasium's {space}")


def to_numpy(space: spaces.Space, value: PyTree, flatten: bool) -> Any:
    """Returns a value of `space`, or a batch of them, as Gymnasium has it."""
    match space:
        case spaces.Discrete():
            return np.array(value, np.int64)[()]
        case spaces.Box(shape=shape):
            array = np.array(value)
            lead = array.shape[: array.ndim - len(shape)]
            return array.reshape(*lead, math.prod(shape)) if flatten else array
        case spaces.Tuple(parts):
            return tuple(to_numpy(part, x, flatten) for part, x in zip(parts, value, strict=True))
        case spaces.Dict(named):
            return {name: to_numpy(part, value[name], flatten) for name, part in named.items()}
    raise JaxactError(f"Gymnasium has no space like {space}")


def to_jax(space: spaces.Space, value: Any, lead: tuple[int, ...]) -> PyTree:
    """Returns an action, or a batch of shape `lead`, as the world takes it.

    Raises:
      JaxactError: it is none.
    """
    match space:
        case spaces.Discrete(n):
            array = np.asarray(value)
            whole = np.issubdtype(array.dtype, np.integer) and array.shape == lead
            if not whole or np.any((array < 0) | (array >= n)):
                raise JaxactError(f"expected an action of 0 to {n - 1} with shape {lead}: {value}")
            return array.astype(np.int32)
        case spaces.Box(shape=shape, dtype=dtype):
            array = np.asarray(value, dtype)
            if array.shape != lead + shape:
                raise JaxactError(
                    f"expected an action of shape {lead + shape}, but got {array.shape}"
                )
            return array
        case spaces.Tuple(parts):
            return tuple(to_jax(part, x, lead) for part, x in zip(parts, value, strict=True))
        case spaces.Dict(named):
            return {name: to_jax(part, value[name], lead) for name, part in named.items()}
    raise JaxactError(f"Gymnasium has no space like {space}")
