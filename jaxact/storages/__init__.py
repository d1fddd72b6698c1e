"""Storages: where batches come from besides the rollout."""

from jaxact.storages.base import Storage as Storage
from jaxact.storages.demonstrations import DemonstrationStorage as DemonstrationStorage

__all__ = ["DemonstrationStorage", "Storage"]
