"""Contacts of capsules with planes as MuJoCo in C has them.

A contact's friction is a pyramid, and which way its edges point decides what force a foot gets that
is about to slide. In C they point along the capsule, seen from above. MJX does the same only where
the capsule lies rather flat, and turns them to an axis of the world where it is steeper than 60°;
feet mostly are. Nothing else of MJX is changed, and that only while a step is traced.

Source: `mjc_PlaneCapsule` and `mju_makeFrame` of MuJoCo; `plane_capsule` of MJX.
"""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp

from envs_jax.physics.models import mjx

# Where a capsule stands so nearly upright, no way along the plane is along it.
_UPRIGHT = 1e-6
# The table is one for all threads.
_LOCK = threading.RLock()


@contextlib.contextmanager
def capsules_as_in_c() -> Iterator[None]:
    """Has MJX take contacts of capsules with planes from here for as long as it is entered."""
    mjx()
    from mujoco.mjx._src import collision_driver
    from mujoco.mjx._src.types import GeomType

    table, pair = collision_driver._COLLISION_FUNC, (GeomType.PLANE, GeomType.CAPSULE)
    with _LOCK:
        own = table[pair]
        table[pair] = _collider()
        try:
            yield
        finally:
            table[pair] = own


@functools.cache
def _collider() -> Callable[..., Any]:
    from mujoco.mjx._src.collision_primitive import collider

    return collider(ncon=2)(_meet)


def _meet(plane: Any, capsule: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Returns distances [2], places [2, 3] and frames [2, 3, 3] of both ends' contacts."""
    normal, axis = plane.mat[:, 2], capsule.mat[:, 2]
    along = axis - normal * jnp.dot(normal, axis)
    length = jnp.sqrt(jnp.sum(along**2))
    # Instead, the world's y along the plane, or z if y is nearly the normal. What C takes there
    # comes from rounding.
    y, z = jnp.array([0.0, 1.0, 0.0]), jnp.array([0.0, 0.0, 1.0])
    other = jnp.where(jnp.abs(normal[1]) < 0.5, y, z)
    other -= normal * jnp.dot(normal, other)
    other /= jnp.sqrt(jnp.sum(other**2))
    first = jnp.where(length > _UPRIGHT, along / jnp.maximum(length, _UPRIGHT), other)
    frame = jnp.stack([normal, first, jnp.cross(normal, first)])
    ends = capsule.pos + capsule.size[1] * jnp.stack([axis, -axis])
    distance = (ends - plane.pos) @ normal - capsule.size[0]
    # Halfway between the two surfaces.
    place = ends - normal * (capsule.size[0] + 0.5 * distance)[:, None]
    return distance, place, jnp.broadcast_to(frame, (2, 3, 3))
