"""How well somebody walked: SPL and its kin, with their edge cases decided.

S is success, l the geodesic metres from the start to the nearest goal, p the metres walked. Who
starts at the goal, l = 0, and ends without a step has SPL 1; with a step, 0. Without a way to a
goal, l is infinite and SPL 0: samplers draw no such episode.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp


def efficiency(shortest: jax.Array, walked: jax.Array) -> jax.Array:
    """Returns float32 l / max(l, p), with 0 / 0 = 1, and 0 for an infinite l."""
    longest = jnp.maximum(shortest, walked)
    share = jnp.where(longest > 0, shortest / jnp.maximum(longest, 1e-9), 1)
    return jnp.where(jnp.isfinite(shortest), share, 0)


def spl(success: jax.Array, shortest: jax.Array, walked: jax.Array) -> jax.Array:
    """Returns success weighted by path length, S · l / max(l, p).

    Source: Anderson et al. 2018, "On Evaluation of Embodied Navigation Agents".

    Args:
      success: bool.
      shortest: float32, l.
      walked: float32, p.
    """
    return jnp.where(success, efficiency(shortest, walked), 0)


def soft_spl(left: jax.Array, shortest: jax.Array, walked: jax.Array) -> jax.Array:
    """Returns SPL with the share of the way that was covered in place of success.

    Source: `SoftSPL` of habitat-lab's `nav.py`; there a start at the goal divides by zero, here its
    share is 1 for as long as the agent is at the goal, and else 0.

    Args:
      left: float32, geodesic metres to the nearest goal now.
      shortest: float32, l.
      walked: float32, p.
    """
    covered = 1 - left / jnp.maximum(shortest, 1e-9)
    covered = jnp.where(shortest > 0, jnp.maximum(covered, 0), (left <= 0).astype(jnp.float32))
    return jnp.where(jnp.isfinite(shortest), covered, 0) * efficiency(shortest, walked)
