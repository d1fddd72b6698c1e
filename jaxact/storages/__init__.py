"""Storages: where batches come from besides the rollout."""

from jaxact.storages.base import Storage as Storage
from jaxact.storages.demonstrations import DemonstrationStorage as DemonstrationStorage
from jaxact.storages.prioritized import PrioritizedReplay as PrioritizedReplay
from jaxact.storages.replay import Replay as Replay

__all__ = ["DemonstrationStorage", "PrioritizedReplay", "Replay", "Storage"]
