"""Task samplers that combine and steer others."""

from jaxact.samplers.fixed_seeds import FixedSeeds as FixedSeeds
from jaxact.samplers.ladder import LadderSampler as LadderSampler
from jaxact.samplers.level_replay import PrioritizedLevelReplay as PrioritizedLevelReplay
from jaxact.samplers.mixture import MixtureSampler as MixtureSampler
from jaxact.samplers.repeat_failed import RepeatFailed as RepeatFailed

__all__ = [
    "FixedSeeds",
    "LadderSampler",
    "MixtureSampler",
    "PrioritizedLevelReplay",
    "RepeatFailed",
]
