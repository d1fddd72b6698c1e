"""The whole state of a training run, as one pytree: saving it is saving the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import optax

from jaxact.experiment import Experiment
from jaxact.gradients import Learnt
from jaxact.losses.base import Following, Loss
from jaxact.pomdp import PyTree
from jaxact.rollout import QUEUE_LENGTH, SHORTEST_QUEUE_LENGTH, Lanes, start_lanes

# Exact under vmap, the same on every backend, and several times faster on CPUs than the default.
PRNG_IMPLEMENTATION = "philox2x32"


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TrainState:
    """A training run, as it stands.

    Attributes:
      params: of the model.
      losses: variables of the losses that have some, by the loss's name.
      optimizer: the optimizer's state.
      lanes: worlds in progress; this and the storages have a lane axis (sharded over devices).
      storages: what storages hold, by name.
      sampler: the task sampler's state.
      updates: int32 [number of stages], updates done in each stage.
      stopped: bool [number of stages], whether each stage has stopped early.
      block: float32 [number of stages, 2], sum and count of each stage's early-stopping metric in
        its present block.
    """

    params: PyTree
    losses: dict[str, dict[str, PyTree]]
    optimizer: PyTree
    lanes: Lanes
    storages: dict[str, PyTree]
    sampler: PyTree
    updates: jax.Array
    stopped: jax.Array
    block: jax.Array

    @property
    def learnt(self) -> Learnt:
        """What gradient steps change."""
        return Learnt(self.params, self.losses, self.optimizer)

    def with_learnt(self, learnt: Learnt) -> TrainState:
        """Returns the state with what was learnt in place of what was before."""
        return replace(self, params=learnt.params, losses=learnt.losses, optimizer=learnt.optimizer)


def make_key(seed: int | jax.Array) -> jax.Array:
    """Returns the PRNG key of a run, or of a level."""
    return jax.random.key(seed, impl=PRNG_IMPLEMENTATION)


# Optimizers to which a parameter's shape and neighbours are nothing. On one flat vector they are a
# few kernels to compile and to launch, in place of several for each parameter.
_ELEMENTWISE = (optax.adam, optax.adamw, optax.rmsprop, optax.sgd)


def optimizer_for(settings: Any, learning_rate: jax.Array | float) -> optax.GradientTransformation:
    """Returns the pipeline's optimizer at a learning rate, after clipping by global norm."""
    optimizer = optax.chain(
        optax.clip_by_global_norm(settings.max_grad_norm),
        settings.optimizer(learning_rate, **settings.optimizer_options),
    )
    return optax.flatten(optimizer) if settings.optimizer in _ELEMENTWISE else optimizer


def init_params(experiment: Experiment, key: jax.Array) -> PyTree:
    """Initialises the model's parameters."""
    return experiment.model.init(key, *experiment.zero_inputs())


def _init_losses(experiment: Experiment, params: PyTree, key: jax.Array) -> dict[str, Any]:
    """Initialises the variables of all losses that have some; one name, one set of variables."""
    losses: dict[str, Loss] = {}
    for stage in experiment.pipeline.stages:
        for group in (stage.losses, *(storage.losses for storage in stage.storages.values())):
            losses |= {n: x for n, x in group.items() if x.has_variables and n not in losses}
    if not losses:
        return {}
    inputs = experiment.zero_inputs()
    output, _ = experiment.model.apply(params, *inputs)
    keys = jax.random.split(key, len(losses))
    variables = {
        name: loss.init(key, output, inputs[0], inputs[2])
        for key, (name, loss) in zip(keys, losses.items(), strict=True)
    }
    for name, loss in losses.items():
        if isinstance(loss, Following):
            variables[name] = loss.follow(variables[name], params)
    return variables


def load_data(experiment: Experiment) -> dict[str, PyTree]:
    """Reads what the experiment's storages need from outside, by the storage's name.

    Raises:
      JaxactError: it is not there, damaged, or of another world.
    """
    storages = experiment.pipeline.storages
    data = {name: storage.load(experiment.pomdp) for name, storage in storages.items()}
    return {name: arrays for name, arrays in data.items() if jax.tree.leaves(arrays)}


def start(experiment: Experiment, key: jax.Array, data: Mapping[str, PyTree]) -> TrainState:
    """Returns the state before the first update.

    Args:
      experiment: what is trained.
      key: of everything random.
      data: from `load_data`.
    """
    params_key, sampler_key, lanes_key = jax.random.split(key, 3)
    pipeline, pomdp = experiment.pipeline, experiment.pomdp
    params = init_params(experiment, params_key)
    losses = _init_losses(experiment, params, jax.random.fold_in(params_key, 1))
    sampler = pomdp.sampler.init(sampler_key)
    ahead = not pomdp.sampler.learns and pomdp.environment.max_lanes is None
    queue_length = QUEUE_LENGTH if ahead else SHORTEST_QUEUE_LENGTH
    lane_keys = jax.random.split(lanes_key, pipeline.lanes)
    storages = {
        name: storage.init(
            pomdp,
            experiment.model,
            jax.random.split(jax.random.fold_in(lanes_key, index), storage.width(pipeline.lanes)),
            data.get(name, ()),
        )
        for index, (name, storage) in enumerate(pipeline.storages.items())
    }
    stages = len(pipeline.stages)
    learnt = Learnt(params, losses, ())
    return TrainState(
        params=params,
        losses=losses,
        optimizer=optimizer_for(pipeline, 0.0).init(learnt.trained),
        lanes=start_lanes(pomdp, sampler, experiment.model, lane_keys, queue_length),
        storages=storages,
        sampler=sampler,
        updates=jnp.zeros(stages, jnp.int32),
        stopped=jnp.zeros(stages, bool),
        block=jnp.zeros((stages, 2), jnp.float32),
    )
