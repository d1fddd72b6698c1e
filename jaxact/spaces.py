"""Observation and action spaces: what an array (or tree of arrays) may hold.

A space is static structure: frozen and hashable, never an array. `sample` and `contains` are pure
functions that can be jitted and vmapped.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.frozen import FrozenMapping


class Space(ABC):
    """A set of values, all with one tree structure, shape and dtype."""

    @abstractmethod
    def sample(self, key: jax.Array) -> Any:
        """Draws one value uniformly (bounded) or from a unit normal (unbounded)."""

    @abstractmethod
    def contains(self, value: Any) -> jax.Array:
        """Returns a scalar bool: whether `value` lies within the bounds."""

    @property
    @abstractmethod
    def structure(self) -> Any:
        """The tree of `jax.ShapeDtypeStruct` that every value has."""

    def zeros(self) -> Any:
        """Returns the all-zero value of this structure (it need not lie within the bounds)."""
        return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), self.structure)


@dataclass(frozen=True)
class Discrete(Space):
    """Integers 0 … n − 1, as an int32 scalar."""

    n: int

    def sample(self, key: jax.Array) -> jax.Array:  # noqa: D102
        return jax.random.randint(key, (), 0, self.n, jnp.int32)

    def contains(self, value: Any) -> jax.Array:  # noqa: D102
        return (jnp.asarray(value) >= 0) & (jnp.asarray(value) < self.n)

    @property
    def structure(self) -> jax.ShapeDtypeStruct:  # noqa: D102
        return jax.ShapeDtypeStruct((), jnp.int32)


@dataclass(frozen=True)
class Box(Space):
    """Arrays of `shape` and `dtype` with `low` ≤ every element ≤ `high` (both inclusive)."""

    low: float
    high: float
    shape: tuple[int, ...]
    dtype: str = "float32"

    def sample(self, key: jax.Array) -> jax.Array:  # noqa: D102
        dtype = jnp.dtype(self.dtype)
        if jnp.issubdtype(dtype, jnp.integer):
            # Drawn in int32: `high` + 1 would wrap round in the narrow types.
            draw = jax.random.randint(key, self.shape, int(self.low), int(self.high) + 1, jnp.int32)
            return draw.astype(dtype)
        if np.isinf(self.low) or np.isinf(self.high):
            return jnp.clip(jax.random.normal(key, self.shape, dtype), self.low, self.high)
        return jax.random.uniform(key, self.shape, dtype, self.low, self.high)

    def contains(self, value: Any) -> jax.Array:  # noqa: D102
        return jnp.all((jnp.asarray(value) >= self.low) & (jnp.asarray(value) <= self.high))

    @property
    def structure(self) -> jax.ShapeDtypeStruct:  # noqa: D102
        return jax.ShapeDtypeStruct(self.shape, jnp.dtype(self.dtype))


@dataclass(frozen=True)
class Tuple(Space):
    """Tuples with one value from each of `spaces`."""

    spaces: tuple[Space, ...]

    def sample(self, key: jax.Array) -> tuple[Any, ...]:  # noqa: D102
        keys = jax.random.split(key, len(self.spaces))
        return tuple(space.sample(k) for space, k in zip(self.spaces, keys, strict=True))

    def contains(self, value: Any) -> jax.Array:  # noqa: D102
        return jnp.all(jnp.stack([s.contains(v) for s, v in zip(self.spaces, value, strict=True)]))

    @property
    def structure(self) -> tuple[Any, ...]:  # noqa: D102
        return tuple(space.structure for space in self.spaces)


@dataclass(frozen=True)
class Dict(Space):
    """Mappings with one value from each named space; keys are ordered by name."""

    spaces: Mapping[str, Space]

    def __post_init__(self) -> None:
        object.__setattr__(self, "spaces", FrozenMapping(sorted(self.spaces.items())))

    def sample(self, key: jax.Array) -> dict[str, Any]:  # noqa: D102
        keys = jax.random.split(key, len(self.spaces))
        return {n: s.sample(k) for (n, s), k in zip(self.spaces.items(), keys, strict=True)}

    def contains(self, value: Mapping[str, Any]) -> jax.Array:  # noqa: D102
        return jnp.all(jnp.stack([s.contains(value[n]) for n, s in self.spaces.items()]))

    @property
    def structure(self) -> dict[str, Any]:  # noqa: D102
        return {name: space.structure for name, space in self.spaces.items()}


@dataclass(frozen=True)
class Agents(Space):
    """A value of `space` for each of `count` agents: every array has a leading axis [A]."""

    space: Space
    count: int

    def sample(self, key: jax.Array) -> Any:  # noqa: D102
        return jax.vmap(self.space.sample)(jax.random.split(key, self.count))

    def contains(self, value: Any) -> jax.Array:  # noqa: D102
        return jnp.all(jax.vmap(self.space.contains)(value))

    @property
    def structure(self) -> Any:  # noqa: D102
        return jax.tree.map(
            lambda leaf: jax.ShapeDtypeStruct((self.count, *leaf.shape), leaf.dtype),
            self.space.structure,
        )
