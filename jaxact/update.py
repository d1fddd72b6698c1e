"""One update: a rollout, its advantages, and epochs of minibatch gradient steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.distributions import explore
from jaxact.experiment import Experiment
from jaxact.gradients import GradientStep, Learnt, Metrics, stack_metrics
from jaxact.losses.base import Anchored, Batch, Loss, Progress, Rewarding
from jaxact.models.normalized import observed
from jaxact.models.output import ActorCriticOutput
from jaxact.pipeline import Stage, TrainingPipeline
from jaxact.pomdp import FollowsPolicy, PyTree
from jaxact.returns import episode_means, generalized_advantages
from jaxact.rollout import Trajectory, for_each_agent, mean_of_agents, next_values, rollout
from jaxact.schedules import Schedule, value_at
from jaxact.storage_update import learn_from_storage, resumed
from jaxact.train_state import TrainState, optimizer_for


def update(
    experiment: Experiment,
    stage_index: int,
    state: TrainState,
    data: Mapping[str, PyTree],
    axis_name: str | None = None,
) -> tuple[TrainState, Metrics]:
    """Does one update of a stage: a rollout and what is learnt of it, then the stage's storages.

    Args:
      experiment: what is trained; its numbers may be tracers.
      stage_index: which stage (static).
      state: where training stands; under `shard_map`, with this device's lanes.
      data: arrays of the experiment's storages, by name, see `load_data`.
      axis_name: the device axis, None on a single device.

    Returns:
      The state after it and scalar metrics. Those under "episodes/" are sums over the episodes that
      finished, to be divided by "episodes/count", and "episodes/kinds/{kind}/success" by the
      "count" beside it; the rest are means over the update.
    """
    pipeline = experiment.pipeline
    stage = pipeline.stages[stage_index]
    settings = pipeline.at(stage)
    progress = _progress(pipeline, stage_index, state.updates)
    state = replace(state, losses=_anchored(stage, state, state.updates[stage_index] == 0))
    own_rate = "learning_rate" in stage.overrides
    rate_steps = progress.stage_steps if own_rate else progress.total_steps
    learning_rate = value_at(settings.learning_rate, rate_steps)
    optimizer = optimizer_for(settings, learning_rate)

    def gradient_step(
        losses: Mapping[str, Loss], weights: Mapping[str, float | Schedule], prefix: str
    ) -> GradientStep:
        return GradientStep(experiment.model, losses, weights, progress, optimizer, prefix)

    metrics: Metrics = {}
    stopped, block = state.stopped[stage_index], state.block[stage_index]
    if stage.acts:
        state = replace(state, storages=resumed(pipeline, stage_index, state))
        on_policy = gradient_step(stage.losses, stage.weights, "losses")
        state, metrics, episodes = _rollout_update(
            experiment, stage, on_policy, state, progress, axis_name
        )
        block, stopped = _early_stopping(stage, block, episodes)
    learnt, storages = state.learnt, dict(state.storages)
    for name, storage in stage.storages.items():
        step = gradient_step(storage.losses, storage.weights, f"losses/{name}")
        learnt, storages[name], of_storage = learn_from_storage(
            step, stage, storage, learnt, storages[name], data.get(name, ()), axis_name
        )
        metrics = {**of_storage, **metrics}
    metrics["train/learning_rate"] = learning_rate
    return replace(
        state.with_learnt(learnt),
        storages=storages,
        updates=state.updates.at[stage_index].add(1),
        stopped=state.stopped.at[stage_index].set(stopped),
        block=state.block.at[stage_index].set(block),
    ), metrics


def _rollout_update(
    experiment: Experiment,
    stage: Stage,
    gradient_step: GradientStep,
    state: TrainState,
    progress: Progress,
    axis_name: str | None,
) -> tuple[TrainState, Metrics, Metrics]:
    """Acts, and learns from it; returns the state, metrics, and sums over finished episodes."""
    pomdp, settings = experiment.pomdp, experiment.pipeline.at(stage)
    sampler = state.sampler
    if isinstance(pomdp.sampler, FollowsPolicy):
        sampler = pomdp.sampler.follow(sampler, state.params)

    metrics: Metrics = {}
    if stage.exploration is not None:
        metrics["train/exploration"] = value_at(stage.exploration, progress.stage_steps)

    def policy(*inputs: Any) -> tuple[ActorCriticOutput, PyTree]:
        output, memory = experiment.model.apply(state.params, *inputs)
        if stage.exploration is not None:
            distribution = explore(output.distribution, metrics["train/exploration"])
            output = replace(output, distribution=distribution)
        return output, memory

    teacher_forcing = value_at(
        0.0 if stage.teacher_forcing is None else stage.teacher_forcing, progress.stage_steps
    )
    lanes, trajectory = rollout(
        pomdp,
        policy,
        sampler,
        state.lanes,
        settings.rollout_length,
        query_expert=stage.needs_expert,
        teacher_forcing=teacher_forcing,
        keep_tasks=pomdp.sampler.learns,
    )
    learnt, trajectory, own = _add_rewards(stage, state.learnt, trajectory, progress, axis_name)
    metrics |= own
    storages = {
        name: stage.storages[name].add(held, trajectory, state.lanes.memory)
        if name in stage.storages
        else held
        for name, held in state.storages.items()
    }
    batch = make_batch(
        trajectory,
        next_values(policy, trajectory),
        state.lanes.memory,
        lanes.key,
        settings,
        axis_name,
    )
    keys = lanes.key
    losses: Metrics = {}
    if stage.losses:
        learnt, keys, losses = _learn_from_rollout(gradient_step, settings, learnt, batch)
    learnt = learnt.with_trained(observed(learnt.trained, trajectory.observation, axis_name))

    if pomdp.sampler.learns:
        error = mean_of_agents(jnp.abs(batch.advantage), 2)
        error = episode_means(error, trajectory.step.finished)
        finished = replace(trajectory.finished, mean_error=error)
        sampler = pomdp.sampler.update(sampler, _gather_lanes(finished, axis_name))
    kinds = pomdp.sampler.kinds(trajectory.finished.origin)
    episodes = _episode_sums(trajectory, kinds, axis_name)
    metrics = {
        **losses,
        **{f"episodes/{name}": value for name, value in episodes.items()},
        **{f"train/sampler/{n}": x for n, x in pomdp.sampler.metrics(sampler).items()},
        "train/teacher_forcing": teacher_forcing,
        "train/forced": _global_mean(trajectory.forced.astype(jnp.float32), axis_name),
        **metrics,
    }
    state = replace(state.with_learnt(learnt), storages=storages, sampler=sampler)
    return replace(state, lanes=replace(lanes, key=keys)), metrics, episodes


def _anchored(stage: Stage, state: TrainState, begins: jax.Array) -> dict[str, dict[str, PyTree]]:
    """Returns the losses' variables; where the stage begins, as the losses that look back say."""
    variables = dict(state.losses)
    for group in (stage.losses, *(storage.losses for storage in stage.storages.values())):
        for name, loss in group.items():
            if isinstance(loss, Anchored):
                anchored = loss.anchor(state.losses[name], state.params)
                variables[name] = jax.tree.map(
                    lambda new, old: jnp.where(begins, new, old), anchored, state.losses[name]
                )
    return variables


def _add_rewards(
    stage: Stage,
    learnt: Learnt,
    trajectory: Trajectory,
    progress: Progress,
    axis_name: str | None,
) -> tuple[Learnt, Trajectory, Metrics]:
    """Adds the losses' own rewards, and weighs all components as the stage says."""
    own: dict[str, jax.Array] = {}
    variables = dict(learnt.losses)
    for name, loss in stage.losses.items():
        if isinstance(loss, Rewarding):
            own[name], variables[name] = loss.reward(variables[name], trajectory, axis_name)
    metrics = {f"train/step_reward/{name}": _global_mean(x, axis_name) for name, x in own.items()}
    if not own and not stage.rewards:
        return learnt, trajectory, metrics
    terms = {**trajectory.step.reward_terms, **own}
    reward = stage.weighed_reward(terms, progress.stage_steps)
    step = replace(trajectory.step, reward=reward, reward_terms=terms)
    return replace(learnt, losses=variables), replace(trajectory, step=step), metrics


def make_batch(
    trajectory: Trajectory,
    next_value: jax.Array,
    memory: PyTree,
    key: jax.Array,
    settings: TrainingPipeline,
    axis_name: str | None,
) -> Batch:
    """Computes advantages and puts together what losses see.

    Args:
      trajectory: of the rollout.
      next_value: see `rollout.next_values`.
      memory: the policy's memory before the rollout.
      key: of each lane.
      settings: discount and λ.
      axis_name: the device axis over which advantages are normalised.
    """
    step = trajectory.step
    terminated = for_each_agent(step.terminated, step.reward)
    truncated = for_each_agent(step.truncated, step.reward)
    advantage = generalized_advantages(
        step.reward,
        trajectory.value,
        next_value,
        terminated,
        terminated | truncated,
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
        terminated=terminated,
        truncated=truncated,
        advantage=advantage,
        normalized_advantage=(advantage - mean) / (deviation + 1e-5),
        returns=advantage + trajectory.value,
        expert=trajectory.expert,
        key=key,
        axis_name=axis_name,
    )


def _learn_from_rollout(
    gradient_step: GradientStep, settings: TrainingPipeline, learnt: Learnt, batch: Batch
) -> tuple[Learnt, jax.Array, Metrics]:
    """Epochs of minibatch gradient steps; returns what is learnt, lanes' keys and mean metrics."""
    names: tuple[str, ...] = ()

    def minibatch_step(learnt: Learnt, minibatch: tuple[Any, Any]) -> tuple[Learnt, jax.Array]:
        nonlocal names
        chosen, draws = minibatch
        learnt, metrics, *_ = gradient_step(learnt, _take_lanes(batch, chosen, draws))
        names = tuple(metrics)
        return learnt, stack_metrics(metrics)

    def epoch(
        carry: tuple[Learnt, jax.Array], _: None
    ) -> tuple[tuple[Learnt, jax.Array], jax.Array]:
        learnt, keys = carry
        keys, draws = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
        order = _minibatch_lanes(draws, settings.minibatches)
        learnt, values = jax.lax.scan(minibatch_step, learnt, (order, draws[order]))
        return (learnt, keys), values

    (learnt, keys), values = jax.lax.scan(epoch, (learnt, batch.key), None, settings.epochs)
    return learnt, keys, dict(zip(names, jnp.mean(values, axis=(0, 1)), strict=True))


def _minibatch_lanes(keys: jax.Array, minibatches: int) -> jax.Array:
    """Deals the lanes to minibatches at random, by a key of each lane's own.

    Of each run of `minibatches` neighbouring lanes one goes to each minibatch, so that the deal
    is the same on any number of devices and every device has a share of every minibatch.

    Returns:
      Lane indices int32 [minibatches, B / minibatches].
    """
    draws = jax.vmap(lambda key: jax.random.uniform(key, (), jnp.float32))(keys)
    order = jnp.argsort(draws.reshape(-1, minibatches), axis=1).astype(jnp.int32)
    first = jnp.arange(order.shape[0], dtype=jnp.int32)[:, None] * minibatches
    return (first + order).T


def _take_lanes(batch: Batch, chosen: jax.Array, keys: jax.Array) -> Batch:
    by_time = replace(batch, memory=(), key=jnp.zeros((1, batch.key.shape[0]), jnp.uint32))
    taken = jax.tree.map(lambda x: x[:, chosen], by_time)
    return replace(taken, memory=jax.tree.map(lambda x: x[chosen], batch.memory), key=keys)


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
