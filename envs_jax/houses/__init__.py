"""Furnished houses seen in the first person: navigation with cameras, in pure JAX."""

from envs_jax.houses.catalogue import navigation as navigation

__all__ = ["navigation"]
