"""Numbers that change during training, as functions of the environment steps taken.

Anywhere a schedule is accepted, a plain number is one too, and so is any jittable function from
steps (float32 scalar) to a float32 scalar. The end points are data: changing one never recompiles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp

Schedule = Callable[[jax.Array], jax.Array]


@dataclass(frozen=True)
class Linear:
    """From `start` to `end` over `steps` steps, then constant."""

    start: float
    end: float
    steps: float

    def __call__(self, steps: jax.Array) -> jax.Array:
        """Returns the value after `steps` steps."""
        fraction = jnp.clip(steps / self.steps, 0.0, 1.0)
        return jnp.asarray(self.start + (self.end - self.start) * fraction, jnp.float32)


@dataclass(frozen=True)
class Cosine:
    """From `start` to `end` along half a cosine wave over `steps` steps, then constant."""

    start: float
    end: float
    steps: float

    def __call__(self, steps: jax.Array) -> jax.Array:
        """Returns the value after `steps` steps."""
        fraction = jnp.clip(steps / self.steps, 0.0, 1.0)
        blend = 0.5 * (1.0 + jnp.cos(jnp.pi * fraction))
        return jnp.asarray(self.end + (self.start - self.end) * blend, jnp.float32)


@dataclass(frozen=True)
class Piecewise:
    """`values[i]` before `boundaries[i]` steps; the last value from the last boundary on.

    `values` has one entry more than `boundaries`, which ascend.
    """

    boundaries: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.values) != len(self.boundaries) + 1:
            raise ValueError(
                f"Piecewise needs one value more than boundaries, got {len(self.values)} values "
                f"and {len(self.boundaries)} boundaries"
            )

    def __call__(self, steps: jax.Array) -> jax.Array:
        """Returns the value after `steps` steps."""
        index = jnp.sum(steps >= jnp.asarray(self.boundaries, jnp.float32), dtype=jnp.int32)
        return jnp.asarray(self.values, jnp.float32)[index]


def value_at(number: float | Schedule, steps: jax.Array) -> jax.Array:
    """Returns a schedule's value after `steps` steps, or the plain number, as float32."""
    return jnp.asarray(number(steps) if callable(number) else number, jnp.float32)
