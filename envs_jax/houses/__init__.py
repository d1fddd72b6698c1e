"""Furnished houses seen in the first person: navigation with cameras, in pure JAX."""
