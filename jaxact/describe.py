"""What an experiment is made of, for `--dry-run`: parts, values, shapes, FLOPs, memory."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from jaxact.experiment import Experiment
from jaxact.overrides import leaves, to_json
from jaxact.program import Program, choose_devices
from jaxact.train_state import init_params, make_key


def describe(experiment: Experiment, devices: int | None = None) -> str:
    """Compiles each stage without running it and tells what it will take.

    Args:
      experiment: to be described.
      devices: how many devices share the lanes, None for all.

    Returns:
      Text for a terminal. FLOPs and memory are XLA's own estimates for the compiled programs.
    """
    program = Program(experiment, choose_devices(devices))
    state = program.like()
    pomdp, pipeline = experiment.pomdp, experiment.pipeline
    lines = [f"experiment {experiment.name}", "", "parts"]
    for part in ("environment", "task", "sampler"):
        lines.append(f"  {part:12} {getattr(pomdp, part)}")
    lines += [f"  sensor       {n}: {_space(s)}" for n, s in pomdp.observation_space.spaces.items()]
    lines += [f"  actions      {pomdp.action_space}", "", "values (change with --set PATH=VALUE)"]
    values = {path: value for path, value in leaves(experiment).items() if not _is_array(value)}
    lines += [f"  {path} = {_text(value)}" for path, value in values.items()]

    lines += ["", "parameters"]
    for path, leaf in jax.tree_util.tree_leaves_with_path(state.params):
        name = jax.tree_util.keystr(path, simple=True, separator="/")
        lines.append(f"  {name:48} {leaf.dtype}{list(leaf.shape)}")
    lines.append(f"  {sum(math.prod(x.shape) for x in jax.tree.leaves(state.params)):,} in all")

    for index, stage in enumerate(pipeline.stages):
        compiled = program.compile_stage(index, 1)
        memory = compiled.memory_analysis()
        size = pipeline.steps_per_update(stage)
        lines += ["", f"stage {index}: {', '.join((*stage.losses, *stage.storages))}"]
        lines.append(f"  {pipeline.updates(stage):,} updates of {size:,} environment steps")
        lines.append(f"  {len(program.devices)} device(s), {_bytes(memory)} on each")
        lines.append(
            f"  {update_flops(experiment, index):,.0f} FLOPs an environment step (model only)"
        )
    return "\n".join(lines)


def model_flops(experiment: Experiment, lanes: int) -> float:
    """Returns XLA's count of the FLOPs of one step of the model on all of `lanes`.

    A step rather than a sequence, since XLA counts the body of a loop over time only once.
    """
    pomdp, model = experiment.pomdp, experiment.model

    def like(tree: Any) -> Any:
        return jax.tree.map(lambda x: jax.ShapeDtypeStruct((lanes, *x.shape), x.dtype), tree)

    key = make_key(0)
    params = jax.eval_shape(lambda: init_params(experiment, key))
    cost = (
        jax.jit(model.apply)
        .lower(
            params,
            like(pomdp.observation_space.structure),
            jax.eval_shape(lambda: model.initial_memory(lanes)),
            like(pomdp.action_space.structure),
            jax.ShapeDtypeStruct((lanes,), bool),
        )
        .compile()
        .cost_analysis()
    )
    return float(cost["flops"])  # type: ignore[index]


def update_flops(experiment: Experiment, stage_index: int) -> float:
    """Returns the model's FLOPs for each environment step of a stage: one pass to act, and one
    forward and two backward passes' worth in every epoch and for every step of a storage's batch.
    """
    pipeline, stage = experiment.pipeline, experiment.pipeline.stages[stage_index]
    forward = model_flops(experiment, pipeline.lanes) / pipeline.lanes
    epochs = pipeline.at(stage).epochs if stage.losses else 0
    stored = sum(storage.steps for storage in stage.storages.values())
    return forward * (stage.acts + 3 * (epochs + stored / pipeline.steps_per_update(stage)))


def _is_array(value: Any) -> bool:
    """Tells what cannot be set by a text, such as the parameters of a frozen policy."""
    return isinstance(value, jax.Array | np.ndarray)


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return repr(dict(value))
    return str(to_json(value)) if callable(value) else repr(value)


def _space(space: Any) -> str:
    leaf = space.structure
    return (
        f"{leaf.dtype}{list(leaf.shape)} in [{space.low}, {space.high}]"
        if hasattr(space, "low")
        else str(space)
    )


def _bytes(memory: Any) -> str:
    if memory is None:
        return "memory unknown to this backend"
    total = memory.argument_size_in_bytes + memory.temp_size_in_bytes
    return f"{total / 2**20:,.1f} MiB" if total >= 2**20 else f"{total / 2**10:,.1f} KiB"
