"""Recurrent memory that forgets at the start of an episode.

The inputs of all time steps are projected in one matrix product; only the recurrence is scanned.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import flax.linen as nn
import jax
import jax.numpy as jnp

Carry = TypeVar("Carry")


def scan_episodes(
    cell: Callable[[Carry, jax.Array], tuple[Carry, jax.Array]],
    carry: Carry,
    inputs: jax.Array,
    is_first: jax.Array,
) -> tuple[Carry, jax.Array]:
    """Runs a cell over time, from zero memory wherever an episode begins.

    Args:
      cell: (carry, input [B, F]) -> (carry, output [B, H]).
      carry: tree of [B, H].
      inputs: [T, B, F], or [B, F] for a single step.
      is_first: bool [T, B] or [B].

    Returns:
      The last carry and the outputs, [T, B, H] or [B, H].
    """

    def step(carry: Carry, x: tuple[jax.Array, jax.Array]) -> tuple[Carry, jax.Array]:
        x_t, first_t = x
        kept = jax.tree.map(lambda h: jnp.where(first_t[:, None], jnp.zeros_like(h), h), carry)
        return cell(kept, x_t)

    if is_first.ndim == 1:
        return step(carry, (inputs, is_first))
    return jax.lax.scan(step, carry, (inputs, is_first))


class GRU(nn.Module):
    """Gated recurrent unit (Cho et al. 2014), with the reset gate on the recurrent product.

    Attributes:
      size: number of units.
    """

    size: int

    @nn.compact
    def __call__(
        self, inputs: jax.Array, memory: jax.Array, is_first: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Returns outputs [T, B, size] (or [B, size]) and the memory [B, size] after them."""
        projected = nn.Dense(3 * self.size, name="input")(inputs)
        recurrent = self.param(
            "recurrent", nn.initializers.orthogonal(), (self.size, 3 * self.size), jnp.float32
        )
        bias = self.param("recurrent_bias", nn.initializers.zeros, (self.size,), jnp.float32)

        def cell(h: jax.Array, x: jax.Array) -> tuple[jax.Array, jax.Array]:
            x_r, x_z, x_n = jnp.split(x, 3, axis=-1)
            h_r, h_z, h_n = jnp.split(h @ recurrent, 3, axis=-1)
            reset = nn.sigmoid(x_r + h_r)
            update = nn.sigmoid(x_z + h_z)
            new = jnp.tanh(x_n + reset * (h_n + bias))
            h = (1.0 - update) * new + update * h
            return h, h

        memory, outputs = scan_episodes(cell, memory, projected, is_first)
        return outputs, memory

    @nn.nowrap
    def initial(self, lanes: int) -> jax.Array:
        """Returns the empty memory, float32 [lanes, size]."""
        return jnp.zeros((lanes, self.size), jnp.float32)


class LSTM(nn.Module):
    """Long short-term memory (Hochreiter & Schmidhuber 1997), forget-gate bias 1.

    Attributes:
      size: number of units.
    """

    size: int

    @nn.compact
    def __call__(
        self, inputs: jax.Array, memory: tuple[jax.Array, jax.Array], is_first: jax.Array
    ) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        """Returns outputs [T, B, size] (or [B, size]) and the memory after them."""
        projected = nn.Dense(4 * self.size, name="input")(inputs)
        recurrent = self.param(
            "recurrent", nn.initializers.orthogonal(), (self.size, 4 * self.size), jnp.float32
        )

        def cell(
            carry: tuple[jax.Array, jax.Array], x: jax.Array
        ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
            c, h = carry
            i, f, g, o = jnp.split(x + h @ recurrent, 4, axis=-1)
            c = nn.sigmoid(f + 1.0) * c + nn.sigmoid(i) * jnp.tanh(g)
            h = nn.sigmoid(o) * jnp.tanh(c)
            return (c, h), h

        memory, outputs = scan_episodes(cell, memory, projected, is_first)
        return outputs, memory

    @nn.nowrap
    def initial(self, lanes: int) -> tuple[jax.Array, jax.Array]:
        """Returns the empty memory, (cell, hidden) float32 [lanes, size] each."""
        zeros = jnp.zeros((lanes, self.size), jnp.float32)
        return zeros, zeros


class NoMemory(nn.Module):
    """For policies that react to the present observation alone."""

    def __call__(
        self, inputs: jax.Array, memory: Any, is_first: jax.Array
    ) -> tuple[jax.Array, Any]:
        """Returns the inputs as they are."""
        del is_first
        return inputs, memory

    @nn.nowrap
    def initial(self, lanes: int) -> tuple[()]:
        """Returns the empty tuple."""
        del lanes
        return ()
