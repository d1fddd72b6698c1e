"""A way round a gap in XLA, for programs on several devices.

Philox keys multiply words and take the product's upper half. XLA has an instruction for that, but
its partitioner cannot yet pass it on: with more than one device compiling ends in "Unable to
convert MHLO to StableHLO". There the product is spelled out in halves of words instead, with the
same bits as the result.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.interpreters import mlir


def multiply_high(x: jax.Array, y: jax.Array) -> jax.Array:
    """Returns the upper half of the full product of integers of one dtype, element by element."""
    bits = jnp.iinfo(x.dtype).bits
    if jnp.issubdtype(x.dtype, jnp.signedinteger):
        unsigned = jnp.dtype(f"uint{bits}")
        zero = jnp.zeros((), x.dtype)
        high = multiply_high(x.astype(unsigned), y.astype(unsigned)).astype(x.dtype)
        return high - jnp.where(x < zero, y, zero) - jnp.where(y < zero, x, zero)
    half = jnp.asarray(bits // 2, x.dtype)
    mask = jnp.asarray(2 ** (bits // 2) - 1, x.dtype)
    x_low, x_high, y_low, y_high = x & mask, x >> half, y & mask, y >> half
    # No sum overflows: (2ⁿ − 1)² + 2 (2ⁿ − 1) = 2²ⁿ − 1.
    first = x_high * y_low + ((x_low * y_low) >> half)
    second = x_low * y_high + (first & mask)
    return x_high * y_high + (first >> half) + (second >> half)


def spell_out_multiply_high() -> None:
    """Makes what this process compiles from now on do without XLA's instruction."""
    lowering = mlir.lower_fun(multiply_high, multiple_results=False)
    mlir.register_lowering(jax.lax.mulhi_p, lowering)
