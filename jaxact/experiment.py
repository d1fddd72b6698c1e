"""An experiment: everything that decides a training run but its seed, in one frozen dataclass."""

from __future__ import annotations

from dataclasses import dataclass

import flax.linen as nn

from jaxact.errors import JaxactError
from jaxact.pipeline import TrainingPipeline
from jaxact.pomdp import POMDP


@dataclass(frozen=True)
class Experiment:
    """A world, a model and how to train it.

    Attributes:
      name: of its runs.
      pomdp: the world to train and evaluate in.
      model: a linen module as `jaxact.models.ActorCritic`.
      pipeline: what to learn and in what order.
    """

    name: str
    pomdp: POMDP
    model: nn.Module
    pipeline: TrainingPipeline

    def check(self, devices: int = 1) -> None:
        """Finds what cannot work before anything compiles.

        Raises:
          JaxactError: sizes that do not divide, losses that need an expert where there is none,
            overrides that name nothing.
        """
        pipeline = self.pipeline
        for index, stage in enumerate(pipeline.stages):
            settings = pipeline.at(stage)
            where = f"stage {index}"
            for name in ("rollout_length", "epochs", "minibatches", "lanes"):
                if getattr(settings, name) < 1:
                    raise JaxactError(
                        f"{where}: {name} must be at least 1, got {getattr(settings, name)}"
                    )
            if stage.steps < 1:
                raise JaxactError(f"{where}: steps must be at least 1, got {stage.steps}")
            parts = settings.minibatches * devices
            if settings.lanes % parts:
                nearest = max(parts, round(settings.lanes / parts) * parts)
                raise JaxactError(
                    f"{where}: {settings.lanes} lanes do not divide into {settings.minibatches} "
                    f"minibatches on {devices} device(s); the nearest number of lanes that does "
                    f"is {nearest}"
                )
            if stage.needs_expert and not self.pomdp.has_expert:
                raise JaxactError(
                    f"{where} imitates or forces an expert, but "
                    f"{type(self.pomdp.task).__name__} has no method expert(key, task_state, state)"
                )
