"""An experiment: everything that decides a training run but its seed, in one frozen dataclass."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError, unknown
from jaxact.loss_checks import check_losses
from jaxact.losses.base import Rewarding
from jaxact.pipeline import Stage, TrainingPipeline
from jaxact.pomdp import POMDP, FollowsPolicy
from jaxact.spaces import Agents
from jaxact.storages.base import Storage


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
          JaxactError: sizes that do not divide, losses that need an expert where there is none or
            cannot work where they stand, overrides that name nothing.
        """
        pipeline = self.pipeline
        self._check_agents()
        if isinstance(self.pomdp.sampler, FollowsPolicy):
            self.pomdp.sampler.check_model(self.model)
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
            limit = self.pomdp.lanes_at_once(settings.lanes)
            if settings.lanes > limit:
                raise JaxactError(
                    f"{where}: there are {settings.lanes} lanes, but the world can be simulated "
                    f"{limit} times at once; give it more simulators, or the pipeline {limit} lanes"
                )
            parts = settings.minibatches * devices
            if settings.lanes % parts:
                nearest = max(parts, round(settings.lanes / parts) * parts)
                raise JaxactError(
                    f"{where}: {settings.lanes} lanes do not divide into {settings.minibatches} "
                    f"minibatches on {devices} device(s); the nearest number of lanes that does "
                    f"is {nearest}"
                )
            for name, storage in stage.storages.items():
                self._check_storage(f"{where}: storage {name!r}", name, storage, devices)
            self._check_rewards(where, stage)
            if stage.needs_expert and not self.pomdp.has_expert:
                raise JaxactError(
                    f"{where} imitates or forces an expert, but "
                    f"{type(self.pomdp.task).__name__} has no method expert(key, task_state, state)"
                )
        inputs = jax.eval_shape(self.zero_inputs)
        (output, _), _ = jax.eval_shape(self.model.init_with_output, jax.random.key(0), *inputs)
        check_losses(pipeline, self.pomdp.action_space, output, inputs[0], inputs[2])

    def zero_inputs(self) -> tuple[Any, ...]:
        """Returns what the model is called with, of zeros, for one lane."""
        zeros = jax.tree.map(lambda x: x[None], self.pomdp.observation_space.zeros())
        action = jax.tree.map(lambda x: x[None], self.pomdp.action_space.zeros())
        return zeros, self.model.initial_memory(1), action, jnp.ones(1, bool)

    def _check_agents(self) -> None:
        space = self.pomdp.action_space
        of_model = getattr(self.model, "action_space", space)
        if isinstance(of_model, Agents) and not isinstance(space, Agents):
            raise JaxactError(
                f"the world is one of a single agent with the action space {space}, but the model "
                f"{type(self.model).__name__} is for {of_model}: use ActorCritic"
            )
        if isinstance(space, Agents) and of_model != space:
            raise JaxactError(
                f"the world is one of {space.count} agents with the action space {space}, but the "
                f"model {type(self.model).__name__} is for {of_model}: use AgentsActorCritic, or a "
                "model that sees the axis of agents as it does, with the world's action space"
            )
        if self.pipeline.storages:
            self.pomdp.check_single_agent("storages are")
        for stage in self.pipeline.stages:
            for name, loss in stage.losses.items():
                if isinstance(loss, Rewarding):
                    self.pomdp.check_single_agent(f"rewards of losses ({name!r}) are")

    def _check_storage(self, where: str, name: str, storage: Storage, devices: int) -> None:
        for number in ("updates", "lanes", "length"):
            if getattr(storage, number) < 1:
                raise JaxactError(
                    f"{where}: {number} must be at least 1, got {getattr(storage, number)}"
                )
        if storage.lanes % devices:
            raise JaxactError(
                f"{where}: its {storage.lanes} lanes do not divide among {devices} devices"
            )
        try:
            storage.width(self.pipeline.lanes)
        except JaxactError as error:
            raise JaxactError(f"{where}: {error}") from None
        first = self.pipeline.storages[name]
        alike = replace(storage, losses=first.losses, weights=first.weights, updates=first.updates)
        if alike != first:
            raise JaxactError(
                f"{where} is another than that of this name in an earlier stage; only losses, "
                "weights and updates can differ"
            )

    def _check_rewards(self, where: str, stage: Stage) -> None:
        own = [name for name, loss in stage.losses.items() if isinstance(loss, Rewarding)]
        if not own and not stage.rewards:
            return
        state, _ = jax.eval_shape(self.pomdp.reset, jax.random.key(0))
        action = self.pomdp.action_space.structure
        _, step = jax.eval_shape(self.pomdp.step, jax.random.key(0), state, action)
        for name in own:
            if name in step.reward_terms:
                raise JaxactError(
                    f"{where}: the loss {name!r} rewards under its own name, which is that of one "
                    "of the task's components; give it another"
                )
        for name in stage.rewards:
            if name not in {*step.reward_terms, *own}:
                raise unknown(f"reward component in {where}", name, [*step.reward_terms, *own])
