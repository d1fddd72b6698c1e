"""Distributions of levels, one module a family."""
