"""Worlds and tasks in pure JAX, built by `make(id)`."""

from envs_jax import brax_worlds as brax_worlds
from envs_jax import furniture as furniture
from envs_jax import houses as houses
from envs_jax import lighthouse as lighthouse
from envs_jax import minigrid as minigrid
from envs_jax import multigrid as multigrid
from envs_jax import physics as physics
from envs_jax import poisoned_doors as poisoned_doors
from envs_jax import social as social
from envs_jax.registry import ids as ids
from envs_jax.registry import make as make
from envs_jax.registry import register as register

__all__ = [
    "brax_worlds",
    "furniture",
    "houses",
    "ids",
    "lighthouse",
    "make",
    "minigrid",
    "multigrid",
    "physics",
    "poisoned_doors",
    "register",
    "social",
]
