"""Task samplers that combine and steer others."""

from jaxact.samplers.mixture import MixtureSampler as MixtureSampler

__all__ = ["MixtureSampler"]
