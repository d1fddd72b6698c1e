"""One update: a rollout, its advantages, and epochs of minibatch gradient steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree

from jaxact.experiment import Experiment
from jaxact.losses.base import Batch, Progress
from jaxact.pipeline import Stage, TrainingPipeline
from jaxact.pomdp import PyTree
from jaxact.returns import episode_means, generalized_advantages
from jaxact.rollout import Lanes, Trajectory, next_values, rollout
from jaxact.schedules import value_at
from jaxact.train_state import TrainState, optimizer_for

Metrics = dict[str, jax.Array]


def update(
    experiment: Experiment, stage_index: int, state: TrainState, axis_name: str | None = None
) -> tuple[TrainState, Metrics]:
    """Does one update of a stage.

    Args:
      experiment: what is trained; its numbers may be tracers.
      stage_index: which stage (static).
      state: where training stands; under `shard_map`, with this device's lanes.
      axis_name: the device axis, None on a single device.

    Returns:
      The state after it and scalar metrics. Those under "episodes/" are sums over the episodes that
      finished, to be divided by "episodes/count", and "episodes/kinds/{kind}/success" by the
      "count" beside it; the rest are means over the update.
    """
    pomdp, pipeline = experiment.pomdp, experiment.pipeline
    stage = pipeline.stages[stage_index]
    settings = pipeline.at(stage)
    progress = _progress(pipeline, stage_index, state.updates)

    def policy(*inputs: Any) -> Any:
        return experiment.model.apply(state.params, *inputs)

    teacher_forcing = value_at(
        0.0 if stage.teacher_forcing is None else stage.teacher_forcing, progress.stage_steps
    )
    lanes, trajectory = rollout(
        pomdp,
        policy,
        state.sampler,
        state.lanes,
        settings.rollout_length,
        query_expert=stage.needs_expert,
        teacher_forcing=teacher_forcing,
        keep_tasks=pomdp.sampler.learns,
    )
    batch = make_batch(
        trajectory, next_values(policy, trajectory), state.lanes.memory, settings, axis_name
    )

    own_rate = "learning_rate" in stage.overrides
    rate_steps = progress.stage_steps if own_rate else progress.total_steps
    learning_rate = value_at(settings.learning_rate, rate_steps)
    params, optimizer, lanes, losses = _optimize(
        experiment, stage, settings, state, lanes, batch, progress, learning_rate
    )

    sampler = state.sampler
    if pomdp.sampler.learns:
        error = episode_means(jnp.abs(batch.advantage), trajectory.step.finished)
        finished = replace(trajectory.finished, mean_error=error)
        sampler = pomdp.sampler.update(sampler, _gather_lanes(finished, axis_name))
    kinds = pomdp.sampler.kinds(trajectory.finished.origin)
    episodes = _episode_sums(trajectory, kinds, axis_name)
    block, stopped = _early_stopping(stage, state.block[stage_index], episodes)
    metrics = {
        **losses,
        **{f"episodes/{name}": value for name, value in episodes.items()},
        **{f"train/sampler/{n}": x for n, x in pomdp.sampler.metrics(sampler).items()},
        "train/learning_rate": learning_rate,
        "train/teacher_forcing": teacher_forcing,
        "train/forced": _global_mean(trajectory.forced.astype(jnp.float32), axis_name),
    }
    return TrainState(
        params=params,
        optimizer=optimizer,
        lanes=lanes,
        sampler=sampler,
        updates=state.updates.at[stage_index].add(1),
        stopped=state.stopped.at[stage_index].set(stopped),
        block=state.block.at[stage_index].set(block),
    ), metrics


def make_batch(
    trajectory: Trajectory,
    next_value: jax.Array,
    memory: PyTree,
    settings: TrainingPipeline,
    axis_name: str | None,
) -> Batch:
    """Computes advantages and puts together what losses see.

    Args:
      trajectory: of the rollout.
      next_value: see `rollout.next_values`.
      memory: the policy's memory before the rollout.
      settings: discount and λ.
      axis_name: the device axis over which advantages are normalised.
    """
    step = trajectory.step
    advantage = generalized_advantages(
        step.reward,
        trajectory.value,
        next_value,
        step.terminated,
        step.finished,
        settings.discount,
        settings.gae_lambda,
    )
    mean = _global_mean(advantage, axis_name)
    deviation = jnp.sqrt(_global_mean(jnp.square(advantage - mean), axis_name))
    return Batch(
        observation=trajectory.observation,
        previous_action=trajectory.previous_action,
        is_first=trajectory.is_first,
        memory=memory,
        action=trajectory.action,
        log_prob=trajectory.log_prob,
        value=trajectory.value,
        reward=step.reward,
        reward_terms=dict(step.reward_terms),
        terminated=step.terminated,
        truncated=step.truncated,
        advantage=advantage,
        normalized_advantage=(advantage - mean) / (deviation + 1e-5),
        returns=advantage + trajectory.value,
        expert=trajectory.expert,
        axis_name=axis_name,
    )


def _optimize(
    experiment: Experiment,
    stage: Stage,
    settings: TrainingPipeline,
    state: TrainState,
    lanes: Lanes,
    batch: Batch,
    progress: Progress,
    learning_rate: jax.Array,
) -> tuple[PyTree, PyTree, Lanes, Metrics]:
    """Epochs of minibatch gradient steps; returns params, optimizer state, lanes and metrics."""
    optimizer = optimizer_for(settings, learning_rate)
    axis_name = batch.axis_name
    weights = {
        name: value_at(stage.weights.get(name, 1.0), progress.stage_steps) for name in stage.losses
    }

    def objective(params: PyTree, batch: Batch) -> tuple[jax.Array, Metrics]:
        output, _ = experiment.model.apply(
            params, batch.observation, batch.memory, batch.previous_action, batch.is_first
        )
        total = jnp.float32(0)
        metrics: Metrics = {}
        for name, loss in stage.losses.items():
            value, parts = loss(output, batch, progress)
            total = total + weights[name] * value
            metrics |= {f"losses/{name}/{part}": x for part, x in parts.items()}
            metrics[f"losses/{name}/weight"] = weights[name]
        metrics["losses/total"] = total
        return total, metrics

    names: tuple[str, ...] = ()

    def minibatch_step(
        carry: tuple[PyTree, PyTree], chosen: jax.Array
    ) -> tuple[tuple[PyTree, PyTree], jax.Array]:
        nonlocal names
        params, optimizer_state = carry
        grads, metrics = jax.grad(objective, has_aux=True)(params, _take_lanes(batch, chosen))
        names, values = (*metrics, "train/gradient_norm"), stack_metrics(metrics)
        flat, unflatten = ravel_pytree(grads)
        if axis_name is not None:
            flat, values = jax.lax.pmean((flat, values), axis_name)
        values = jnp.append(values, jnp.linalg.norm(flat))
        # Optimizers are others' code, which may rely on JAX's default promotion of dtypes.
        with jax.numpy_dtype_promotion("standard"):
            updates, optimizer_state = optimizer.update(unflatten(flat), optimizer_state, params)
        return (optax.apply_updates(params, updates), optimizer_state), values

    def epoch(
        carry: tuple[PyTree, PyTree, jax.Array], _: None
    ) -> tuple[tuple[PyTree, PyTree, jax.Array], jax.Array]:
        params, optimizer_state, keys = carry
        keys, order = _minibatch_lanes(keys, settings.minibatches)
        (params, optimizer_state), values = jax.lax.scan(
            minibatch_step, (params, optimizer_state), order
        )
        return (params, optimizer_state, keys), values

    (params, optimizer_state, keys), values = jax.lax.scan(
        epoch, (state.params, state.optimizer, lanes.key), None, settings.epochs
    )
    means = dict(zip(names, jnp.mean(values, axis=(0, 1)), strict=True))
    return params, optimizer_state, replace(lanes, key=keys), means


def stack_metrics(metrics: Metrics) -> jax.Array:
    """Returns metrics of one shape stacked in order, float32 [M, ...]; one array is one kernel."""
    return jnp.stack([jnp.asarray(x).astype(jnp.float32) for x in metrics.values()])


def _minibatch_lanes(keys: jax.Array, minibatches: int) -> tuple[jax.Array, jax.Array]:
    """Deals the lanes to minibatches at random, from the lanes' own keys.

    Of each run of `minibatches` neighbouring lanes one goes to each minibatch, so that the deal
    is the same on any number of devices and every device has a share of every minibatch.

    Returns:
      New keys [B] and lane indices int32 [minibatches, B / minibatches].
    """
    keys, draw_keys = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
    draws = jax.vmap(lambda key: jax.random.uniform(key, (), jnp.float32))(draw_keys)
    order = jnp.argsort(draws.reshape(-1, minibatches), axis=1).astype(jnp.int32)
    first = jnp.arange(order.shape[0], dtype=jnp.int32)[:, None] * minibatches
    return keys, (first + order).T


def _take_lanes(batch: Batch, chosen: jax.Array) -> Batch:
    taken = jax.tree.map(lambda x: x[:, chosen], replace(batch, memory=None))
    return replace(taken, memory=jax.tree.map(lambda x: x[chosen], batch.memory))


def _progress(pipeline: TrainingPipeline, stage_index: int, updates: jax.Array) -> Progress:
    sizes = [float(pipeline.steps_per_update(stage)) for stage in pipeline.stages]
    steps = updates.astype(jnp.float32) * jnp.asarray(sizes, jnp.float32)
    return Progress(stage_steps=steps[stage_index], total_steps=jnp.sum(steps))


def _episode_sums(
    trajectory: Trajectory, kinds: Mapping[str, jax.Array], axis_name: str | None
) -> Metrics:
    """Sums over finished episodes: count, success, return, its terms, length, task metrics.

    Count and success also for each kind, bool [T, B].
    """
    finished = trajectory.finished
    values = {
        "success": finished.success,
        "return": finished.episode_return,
        "length": finished.length,
        **{f"reward/{name}": total for name, total in trajectory.episode_terms.items()},
        **{f"task/{name}": value for name, value in trajectory.step.metrics.items()},
    }
    mask = finished.mask
    values["count"] = jnp.ones_like(mask)
    for name, of_kind in kinds.items():
        values[f"kinds/{name}/count"] = of_kind
        values[f"kinds/{name}/success"] = of_kind & finished.success
    totals = jnp.sum(jnp.where(mask, stack_metrics(values), 0.0), axis=(1, 2))
    totals = totals if axis_name is None else jax.lax.psum(totals, axis_name)
    return dict(zip(values, totals, strict=True))


def _early_stopping(
    stage: Stage, block: jax.Array, episodes: Metrics
) -> tuple[jax.Array, jax.Array]:
    """Returns the block's sum and count after the update, and whether the stage should end."""
    if stage.stop is None:
        return jnp.zeros_like(block), jnp.bool_(False)
    block = block + jnp.stack([episodes[stage.stop.metric], episodes["count"]])
    full = block[1] >= stage.stop.episodes
    stop = full & (block[0] >= stage.stop.at_least * block[1])
    return jnp.where(full, jnp.zeros_like(block), block), stop


def _global_mean(x: jax.Array, axis_name: str | None) -> jax.Array:
    mean = jnp.mean(x)
    return mean if axis_name is None else jax.lax.pmean(mean, axis_name)


def _gather_lanes(tree: PyTree, axis_name: str | None) -> PyTree:
    """Brings the lanes of all devices together, [T, B, ...]."""
    if axis_name is None:
        return tree
    return jax.tree.map(lambda x: jax.lax.all_gather(x, axis_name, axis=1, tiled=True), tree)
