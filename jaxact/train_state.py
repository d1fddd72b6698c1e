"""The whole state of a training run, as one pytree: saving it is saving the run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import optax

from jaxact.experiment import Experiment
from jaxact.pomdp import PyTree
from jaxact.rollout import QUEUE_LENGTH, QUEUE_LENGTH_IF_LEARNING, Lanes, start_lanes

# Exact under vmap, the same on every backend, and several times faster on CPUs than the default.
PRNG_IMPLEMENTATION = "philox2x32"


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TrainState:
    """A training run, as it stands.

    Attributes:
      params: of the model.
      optimizer: the optimizer's state.
      lanes: worlds in progress; the only part with a lane axis (sharded over devices).
      sampler: the task sampler's state.
      updates: int32 [number of stages], updates done in each stage.
      stopped: bool [number of stages], whether each stage has stopped early.
      block: float32 [number of stages, 2], sum and count of each stage's early-stopping metric in
        its present block.
    """

    params: PyTree
    optimizer: PyTree
    lanes: Lanes
    sampler: PyTree
    updates: jax.Array
    stopped: jax.Array
    block: jax.Array


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
    pomdp, model = experiment.pomdp, experiment.model
    zeros = jax.tree.map(lambda x: x[None], pomdp.observation_space.zeros())
    action = jax.tree.map(lambda x: x[None], pomdp.action_space.zeros())
    memory = model.initial_memory(1)
    return model.init(key, zeros, memory, action, jnp.ones(1, bool))


def start(experiment: Experiment, key: jax.Array) -> TrainState:
    """Returns the state before the first update."""
    params_key, sampler_key, lanes_key = jax.random.split(key, 3)
    pipeline = experiment.pipeline
    params = init_params(experiment, params_key)
    pomdp = experiment.pomdp
    sampler = pomdp.sampler.init(sampler_key)
    queue_length = QUEUE_LENGTH_IF_LEARNING if pomdp.sampler.learns else QUEUE_LENGTH
    lane_keys = jax.random.split(lanes_key, pipeline.lanes)
    stages = len(pipeline.stages)
    return TrainState(
        params=params,
        optimizer=optimizer_for(pipeline, 0.0).init(params),
        lanes=start_lanes(pomdp, sampler, experiment.model, lane_keys, queue_length),
        sampler=sampler,
        updates=jnp.zeros(stages, jnp.int32),
        stopped=jnp.zeros(stages, bool),
        block=jnp.zeros((stages, 2), jnp.float32),
    )
