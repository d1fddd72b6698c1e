"""Recurrent memory that forgets at the start of an episode.

The inputs of all time steps are projected in one matrix product, and so is the gradient of the
recurrent weights: only the recurrence itself is scanned.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

# Arrays [B, H], the last of which is what the cell puts out.
Carry = tuple[jax.Array, ...]
# From carry, input [B, F] and recurrent product [B, G] to the next carry.
Cell = Callable[[Carry, jax.Array, jax.Array], Carry]


def recur(
    cell: Cell,
    weights: jax.Array,
    bias: jax.Array,
    carry: Carry,
    inputs: jax.Array,
    is_first: jax.Array,
) -> tuple[Carry, jax.Array]:
    """Runs a cell over time, from zero memory wherever an episode begins.

    Args:
      cell: a function of its arguments alone: what is to be learnt must not be bound to it.
      weights: float32 [H, G]; what the cell put out last times these is its recurrent product.
      bias: float32 [G], added to it.
      carry: before the first step.
      inputs: [T, B, F], or [B, F] for a single step.
      is_first: bool [T, B] or [B].

    Returns:
      The last carry and the outputs, [T, B, H] or [B, H].
    """
    if is_first.ndim > 1:
        return _scan(cell, weights, bias, carry, inputs, is_first)
    kept = _forget(carry, is_first)
    carry = cell(kept, inputs, kept[-1] @ weights + bias)
    return carry, carry[-1]


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _scan(cell: Cell, *arguments: Any) -> Any:
    """Returns the last carry and the outputs, of the arguments that `_forward` takes."""
    return _forward(cell, *arguments)[0]


def _forward(
    cell: Cell,
    weights: jax.Array,
    bias: jax.Array,
    carry: Carry,
    inputs: jax.Array,
    is_first: jax.Array,
) -> tuple[Any, Any]:
    """Returns the last carry and the outputs, and what `_backward` needs."""

    def step(carry: Carry, now: tuple[jax.Array, jax.Array]) -> tuple[Carry, Any]:
        x, first = now
        kept = _forget(carry, first)
        carry, pull = jax.vjp(cell, kept, x, kept[-1] @ weights + bias)
        return carry, (carry[-1], kept[-1], pull)

    last, (outputs, hidden, pulls) = jax.lax.scan(step, carry, (inputs, is_first))
    return (last, outputs), (weights, is_first, hidden, pulls)


def _backward(cell: Cell, residuals: Any, cotangents: tuple[Carry, jax.Array]) -> tuple[Any, ...]:
    """Scans back over time; a step's share of the weights' gradient would be an outer product of
    few lanes, so that of all steps is taken at once, from the products' cotangents.
    """
    weights, is_first, hidden, pulls = residuals
    transposed = weights.T

    def step(d_carry: Carry, now: Any) -> tuple[Carry, tuple[jax.Array, jax.Array]]:
        d_output, first, pull = now
        d_kept, d_x, d_product = pull((*d_carry[:-1], d_carry[-1] + d_output))
        d_kept = (*d_kept[:-1], d_kept[-1] + d_product @ transposed)
        return _forget(d_kept, first), (d_x, d_product)

    d_last, d_outputs = cotangents
    d_carry, (d_inputs, d_products) = jax.lax.scan(
        step, d_last, (d_outputs, is_first, pulls), reverse=True
    )
    d_weights = jnp.einsum("tbh,tbg->hg", hidden, d_products)
    return d_weights, jnp.sum(d_products, (0, 1)), d_carry, d_inputs, None


_scan.defvjp(_forward, _backward)


def _forget(carry: Carry, where: jax.Array) -> Carry:
    return jax.tree.map(lambda h: jnp.where(where[:, None], jnp.zeros_like(h), h), carry)


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
        # That of the other two gates is the projection's.
        padded = jnp.pad(bias, (2 * self.size, 0))
        (memory,), outputs = recur(_gru_cell, recurrent, padded, (memory,), projected, is_first)
        return outputs, memory

    @nn.nowrap
    def initial(self, lanes: int) -> jax.Array:
        """Returns the empty memory, float32 [lanes, size]."""
        return jnp.zeros((lanes, self.size), jnp.float32)


def _gru_cell(carry: Carry, x: jax.Array, product: jax.Array) -> Carry:
    (h,) = carry
    x_r, x_z, x_n = jnp.split(x, 3, axis=-1)
    h_r, h_z, h_n = jnp.split(product, 3, axis=-1)
    reset = nn.sigmoid(x_r + h_r)
    update = nn.sigmoid(x_z + h_z)
    new = jnp.tanh(x_n + reset * h_n)
    return ((1.0 - update) * new + update * h,)


class LSTM(nn.Module):
    """Long short-term memory (Hochreiter & Schmidhuber 1997), forget-gate bias 1.

    Attributes:
      size: number of units.
      projects: whether inputs are projected to the four gates; if not, the inputs are already
        what the gates add up, [..., 4 · size].
    """

    size: int
    projects: bool = True

    @nn.compact
    def __call__(
        self, inputs: jax.Array, memory: tuple[jax.Array, jax.Array], is_first: jax.Array
    ) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        """Returns outputs [T, B, size] (or [B, size]) and the memory after them."""
        projected = nn.Dense(4 * self.size, name="input")(inputs) if self.projects else inputs
        recurrent = self.param(
            "recurrent", nn.initializers.orthogonal(), (self.size, 4 * self.size), jnp.float32
        )

        bias = jnp.zeros(4 * self.size, jnp.float32)  # the inputs have one
        (c, h), outputs = recur(_lstm_cell, recurrent, bias, memory, projected, is_first)
        return outputs, (c, h)

    @nn.nowrap
    def initial(self, lanes: int) -> tuple[jax.Array, jax.Array]:
        """Returns the empty memory, (cell, hidden) float32 [lanes, size] each."""
        zeros = jnp.zeros((lanes, self.size), jnp.float32)
        return zeros, zeros


def _lstm_cell(carry: Carry, x: jax.Array, product: jax.Array) -> Carry:
    c, _ = carry
    i, f, g, o = jnp.split(x + product, 4, axis=-1)
    c = nn.sigmoid(f + 1.0) * c + nn.sigmoid(i) * jnp.tanh(g)
    return c, nn.sigmoid(o) * jnp.tanh(c)


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
