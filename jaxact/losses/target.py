"""Target networks: copies of parameters that follow them slowly."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.errors import check_at_least
from jaxact.pomdp import PyTree


@dataclass(frozen=True)
class Target:
    """How a copy follows: every so many gradient steps, copy ← rate · new + (1 − rate) · copy.

    With a rate of 1 it is a copy anew each time (Mnih et al. 2015), with a small rate at every step
    an average over the past (Polyak averaging, Lillicrap et al. 2016).

    Attributes:
      rate: in (0, 1].
      every: gradient steps between.
    """

    rate: float = 1.0
    every: int = 1

    def __post_init__(self) -> None:
        check_at_least(1, "Target", every=self.every)

    def follow(self, copy: PyTree, new: PyTree, steps: jax.Array) -> PyTree:
        """Returns the copy after gradient step number `steps`, int32 from 1."""
        rate = jnp.where(steps % self.every == 0, jnp.float32(self.rate), 0.0)
        return jax.tree.map(lambda old, x: old + rate.astype(x.dtype) * (x - old), copy, new)
