"""Learning from a stage's storages, after its rollout."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError
from jaxact.gradients import GradientStep, Learnt, Metrics, stack_metrics
from jaxact.losses.base import Batch, Unknown
from jaxact.pipeline import Stage, TrainingPipeline
from jaxact.pomdp import PyTree
from jaxact.storages.base import Storage
from jaxact.train_state import TrainState


def resumed(pipeline: TrainingPipeline, stage_index: int, state: TrainState) -> dict[str, PyTree]:
    """Returns what storages hold; those that earlier stages filled, but not the last one that
    acted, hear of it where the stage begins.
    """
    begins = state.updates[stage_index] == 0
    earlier = [stage for stage in pipeline.stages[:stage_index] if stage.acts]
    storages = dict(state.storages)
    for name, storage in pipeline.stages[stage_index].storages.items():
        had = [name in stage.storages for stage in earlier]
        if any(had) and not had[-1]:
            storages[name] = storage.interrupt(storages[name], begins)
    return storages


def learn_from_storage(
    gradient_step: GradientStep,
    stage: Stage,
    storage: Storage,
    learnt: Learnt,
    held: PyTree,
    data: PyTree,
    axis_name: str | None,
) -> tuple[Learnt, PyTree, Metrics]:
    """Gradient steps on a storage's batches; returns what is learnt, its state, mean metrics.

    The reward's components are weighed, but for what was in a rollout and weighed there. Until the
    storage is ready, nothing is learnt and all metrics are zero.
    """
    names: tuple[str, ...] = ()
    ready = storage.ready(held, axis_name)

    def step(carry: tuple[Learnt, PyTree], _: None) -> tuple[tuple[Learnt, PyTree], jax.Array]:
        nonlocal names
        learnt, held = carry
        held, batch = storage.batch(held, data, axis_name)
        if stage.rewards and not storage.acts:
            steps = gradient_step.progress.stage_steps
            batch = replace(batch, reward=_weighed_reward(stage, storage, batch, steps))
        after, metrics, memory, priority = gradient_step(learnt, batch)
        names = tuple(metrics)
        held = storage.carry_on(held, memory)
        if priority is not None:
            held = storage.reprioritize(held, priority)
        learnt = jax.tree.map(lambda new, old: jnp.where(ready, new, old), after, learnt)
        return (learnt, held), jnp.where(ready, stack_metrics(metrics), 0.0)

    (learnt, held), values = jax.lax.scan(step, (learnt, held), None, storage.updates)
    return learnt, held, dict(zip(names, jnp.mean(values, axis=0), strict=True))


def _weighed_reward(stage: Stage, storage: Storage, batch: Batch, steps: jax.Array) -> Any:
    """Returns the reward as the stage weighs it.

    Raises:
      JaxactError: its components are not known, and a loss needs it.
    """
    if batch.reward_terms:
        return stage.weighed_reward(batch.reward_terms, steps)
    why = (
        f"a {type(storage).__name__} has the reward without its components, and the stage weighs "
        f"these ({', '.join(stage.rewards)}); record the demonstrations anew, or leave the weights "
        "out"
    )
    for name, loss in storage.losses.items():
        if "reward" in loss.needs:
            raise JaxactError(f"{type(loss).__name__} ({name!r}) needs the reward, but {why}")
    return Unknown(f"a loss asks for the reward, but {why}")
