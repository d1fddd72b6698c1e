"""What to learn and in what order: stages of weighted losses, and the numbers they train with."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import optax

from jaxact.errors import JaxactError, unknown
from jaxact.frozen import FrozenMapping
from jaxact.losses.base import Loss, Rewarding
from jaxact.schedules import Schedule, value_at
from jaxact.storages.base import Storage


@dataclass(frozen=True)
class EarlyStopping:
    """Ends a stage once a metric of finished episodes is high enough.

    The metric is averaged over consecutive blocks of at least `episodes` finished episodes; the
    stage ends with the first block whose mean reaches `at_least`.

    Attributes:
      at_least: the threshold.
      metric: "success", "return" or "length".
      episodes: how many episodes a block needs.
    """

    at_least: float
    metric: str = "success"
    episodes: int = 1000

    def __post_init__(self) -> None:
        if self.metric not in ("success", "return", "length"):
            raise unknown("early-stopping metric", self.metric, ("success", "return", "length"))


@dataclass(frozen=True)
class Stage:
    """A part of training: some losses, for some steps.

    Attributes:
      losses: named losses, all on one forward pass of the model over the rollout; without any
        the stage learns from its storages alone, and there is a rollout only to fill them.
      steps: length in environment steps, over all lanes (without a rollout: in steps of the
        storages' batches); the last update may overshoot it.
      weights: weight of each named loss (default 1); numbers or schedules of the stage's steps.
      teacher_forcing: probability that a valid expert action is taken in place of the policy's; a
        number or a schedule of the stage's steps; None never asks the expert for it.
      stop: ends the stage early.
      overrides: values for this stage of the pipeline's fields, by name.
      storages: named storages with losses of their own, learnt from after each rollout. They take
        in the rollouts of this stage, not those of stages that do not name them.
      rewards: weight of each named component of the reward in what is learnt (default 1); numbers
        or schedules of the stage's steps. Episodes' returns are reported as the task has them.
      exploration: ε, the probability of an action at random; for models that choose greedily, such
        as `QNetwork`. A number or a schedule of the stage's steps; None leaves them greedy.
    """

    losses: Mapping[str, Loss]
    steps: int
    weights: Mapping[str, float | Schedule] = field(default_factory=dict)
    teacher_forcing: float | Schedule | None = None
    stop: EarlyStopping | None = None
    overrides: Mapping[str, Any] = field(default_factory=dict)
    storages: Mapping[str, Storage] = field(default_factory=dict)
    rewards: Mapping[str, float | Schedule] = field(default_factory=dict)
    exploration: float | Schedule | None = None

    def __post_init__(self) -> None:
        if not self.losses and not self.storages:
            raise JaxactError("a stage needs at least one loss, for example {'ppo': PPO()}")
        _check_losses("a stage", self.losses)
        for name in ("teacher_forcing", "stop", "exploration"):
            if not self.acts and getattr(self, name) is not None:
                raise JaxactError(
                    f"{name} is about rollouts, and a stage that learns from "
                    f"{', '.join(map(repr, self.storages))} alone has none: leave it out"
                )
        for name in self.weights:
            if name not in self.losses:
                raise unknown("loss in a stage's weights", name, self.losses)
        for of, storage in self.storages.items():
            _check_losses(f"storage {of!r}", storage.losses)
            for name, loss in storage.losses.items():
                rewards = isinstance(self.losses.get(name), Rewarding)
                if isinstance(loss, Rewarding) and not rewards:
                    raise JaxactError(
                        f"{type(loss).__name__} ({name!r}) rewards what is done in rollouts, but "
                        f"is among the losses of storage {of!r} alone; give the stage's losses "
                        "one of this name, too"
                    )
        for name in ("losses", "weights", "overrides", "storages", "rewards"):
            object.__setattr__(self, name, FrozenMapping(getattr(self, name)))

    @property
    def acts(self) -> bool:
        """Whether there are rollouts."""
        return bool(self.losses) or any(storage.acts for storage in self.storages.values())

    @property
    def needs_expert(self) -> bool:
        """Whether the expert must be asked at every step."""
        return self.teacher_forcing is not None or any(
            loss.needs_expert for loss in self.losses.values()
        )

    def weighed_reward(self, terms: Mapping[str, jax.Array], steps: jax.Array) -> jax.Array:
        """Returns the sum of a reward's named components [T, B], weighed as `rewards` says after so
        many steps of the stage.
        """
        weights = {name: value_at(weight, steps) for name, weight in self.rewards.items()}
        return sum((weights.get(n, 1.0) * x for n, x in terms.items()), start=jnp.float32(0))


def _check_losses(of: str, losses: Mapping[str, Any]) -> None:
    for name, loss in losses.items():
        if not isinstance(loss, Loss):
            hint = f"; write {loss.__name__}(...)" if isinstance(loss, type) else ""
            raise JaxactError(f"loss {name!r} of {of} is no loss but {loss!r}{hint}")


@dataclass(frozen=True)
class TrainingPipeline:
    """Stages, and how each is trained.

    The batch of an update is `lanes` × `rollout_length` steps, whatever the number of devices. It
    is split along lanes, whole sequences together, into `minibatches`, and gone through `epochs`
    times. A stage may override any field but `stages`, `lanes` and `optimizer`.

    Attributes:
      stages: trained one after the other, with the same parameters and optimizer state.
      lanes: worlds stepped side by side.
      rollout_length: steps of each lane between updates.
      epochs: passes over each batch.
      minibatches: gradient steps in each pass.
      discount: γ.
      gae_lambda: λ of generalized advantage estimation.
      learning_rate: a number or a schedule of the total steps (of the stage's, in an override).
      max_grad_norm: gradients are scaled down to this global norm.
      optimizer: called as optimizer(learning_rate, **optimizer_options), an optax one.
      optimizer_options: numbers for it.
    """

    stages: tuple[Stage, ...]
    lanes: int = 256
    rollout_length: int = 32
    epochs: int = 4
    minibatches: int = 4
    discount: float = 0.99
    gae_lambda: float = 0.95
    learning_rate: float | Schedule = 3e-4
    max_grad_norm: float = 0.5
    optimizer: Callable[..., optax.GradientTransformation] = optax.adam
    optimizer_options: Mapping[str, float] = field(default_factory=lambda: {"eps": 1e-5})

    def __post_init__(self) -> None:
        if not self.stages:
            raise JaxactError("a pipeline needs at least one stage")
        object.__setattr__(self, "optimizer_options", FrozenMapping(self.optimizer_options))

    def at(self, stage: Stage) -> TrainingPipeline:
        """Returns the pipeline with the stage's overrides applied.

        Raises:
          JaxactError: an override names no field, or one that stages share.
        """
        shared = {"stages", "lanes", "optimizer"}
        fields = {f.name for f in dataclasses.fields(self)} - shared
        for name in stage.overrides:
            if name in shared:
                raise JaxactError(f"all stages share {name!r}, so no stage can override it")
            if name not in fields:
                raise unknown("pipeline field in a stage's overrides", name, fields)
        return dataclasses.replace(self, **stage.overrides)

    def steps_per_update(self, stage: Stage) -> int:
        """Environment steps of one update of `stage`, over all lanes; without a rollout, steps of
        its storages.
        """
        if not stage.acts:
            return sum(storage.steps for storage in stage.storages.values())
        return self.lanes * self.at(stage).rollout_length

    def updates(self, stage: Stage) -> int:
        """Number of updates that `stage` takes."""
        return -(-stage.steps // self.steps_per_update(stage))

    @property
    def storages(self) -> dict[str, Storage]:
        """The storages of all stages by name, each as in the first stage that has it."""
        found: dict[str, Storage] = {}
        for stage in self.stages:
            found |= {name: x for name, x in stage.storages.items() if name not in found}
        return found

    @property
    def total_steps(self) -> int:
        """Environment steps of all stages together, when none stops early."""
        return sum(self.updates(stage) * self.steps_per_update(stage) for stage in self.stages)
