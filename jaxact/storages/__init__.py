"""Storages: where batches come from besides the rollout."""

from jaxact.storages.base import Storage as Storage

__all__ = ["Storage"]
