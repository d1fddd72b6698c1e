"""From updates to compiled programs: the loop that both drivers of training share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxact import train_state
from jaxact.errors import JaxactError
from jaxact.experiment import Experiment
from jaxact.gradients import Metrics, stack_metrics
from jaxact.multiply_high import spell_out_multiply_high
from jaxact.overrides import numbers as numbers_of
from jaxact.overrides import with_numbers
from jaxact.train_state import TrainState
from jaxact.update import update

Numbers = Mapping[str, Any]
Data = Mapping[str, Any]
AXIS = "lanes"

# Which parts of a train state are sharded over devices: those with lanes, and nothing else.
_SPECS = TrainState(
    params=PartitionSpec(),
    losses=PartitionSpec(),  # type: ignore[arg-type]
    optimizer=PartitionSpec(),
    lanes=PartitionSpec(AXIS),  # type: ignore[arg-type]
    storages=PartitionSpec(AXIS),  # type: ignore[arg-type]
    sampler=PartitionSpec(),
    updates=PartitionSpec(),  # type: ignore[arg-type]
    stopped=PartitionSpec(),  # type: ignore[arg-type]
    block=PartitionSpec(),  # type: ignore[arg-type]
)


def run_updates(
    experiment: Experiment,
    stage_index: int,
    state: TrainState,
    data: Data,
    length: int,
    limit: jax.Array | int,
    axis_name: str | None = None,
) -> tuple[TrainState, Metrics]:
    """Does up to `limit` ≤ `length` updates of a stage, fewer where it ends before.

    Returns:
      The state after them, and metrics [length] with "active" telling which updates were done.
    """
    total = experiment.pipeline.updates(experiment.pipeline.stages[stage_index])

    def do(state: TrainState) -> tuple[TrainState, Metrics]:
        return update(experiment, stage_index, state, data, axis_name)

    # Traced once and kept, to know the metrics' shapes; tracing is a good part of starting up.
    traced, (_, shapes) = jax.make_jaxpr(do, return_shape=True)(state)
    structure = jax.tree.structure((state, shapes))

    def goes_on(carry: tuple[jax.Array, TrainState, jax.Array]) -> jax.Array:
        done, state, _ = carry
        ended = state.stopped[stage_index] | (state.updates[stage_index] >= total)
        return (done < jnp.minimum(limit, length)) & ~ended

    def step(
        carry: tuple[jax.Array, TrainState, jax.Array],
    ) -> tuple[jax.Array, TrainState, jax.Array]:
        done, state, rows = carry
        flat = jaxpr_as_fun(traced)(*jax.tree.leaves(state))
        state, metrics = jax.tree.unflatten(structure, flat)
        return done + 1, state, rows.at[done].set(stack_metrics(metrics))

    rows = jnp.zeros((length, len(shapes)), jnp.float32)
    done, state, rows = jax.lax.while_loop(goes_on, step, (jnp.int32(0), state, rows))
    columns = dict(zip(shapes, rows.T, strict=True))
    return state, {**columns, "active": jnp.arange(length, dtype=jnp.int32) < done}


def make_train(
    experiment: Experiment,
) -> Callable[..., tuple[TrainState, Metrics]]:
    """Makes one pure function of the whole training run, all stages in one program.

    Args:
      experiment: what to train.

    Returns:
      train(key, numbers=None, data=None) -> (state, metrics [updates of all stages]), to be jitted,
      and vmapped over keys and over any of the experiment's numbers: `numbers` maps dotted paths
      such as "pipeline.learning_rate" (see `jaxact.overrides.numbers`) to scalars. A vmapped sweep
      compiles once. An experiment with recorded data takes it as `data`, from
      `jaxact.train_state.load_data`.

    Raises:
      JaxactError: the experiment cannot work (see `Experiment.check`), or no such number.
    """
    experiment.check()

    def train(
        key: jax.Array, numbers: Numbers | None = None, data: Data | None = None
    ) -> tuple[TrainState, Metrics]:
        configured = with_numbers(experiment, dict(numbers or {}))
        data = data or {}
        state = train_state.start(configured, key, data)
        rows = []
        for index, stage in enumerate(experiment.pipeline.stages):
            updates = experiment.pipeline.updates(stage)
            state, metrics = run_updates(configured, index, state, data, updates, updates)
            rows.append({**metrics, "stage": jnp.full(updates, index, jnp.int32)})
        return state, concatenate(rows, jnp)

    return train


def concatenate(rows: list[dict[str, Any]], backend: Any = np) -> dict[str, Any]:
    """Joins metrics of several scans end to end; a metric that some lack is NaN there.

    Args:
      rows: metrics [n] each.
      backend: `numpy` or `jax.numpy`.
    """
    if not rows:
        return {}
    names = sorted(set().union(*rows))

    def column(row: Metrics, name: str) -> Any:
        length = row["active"].shape[0]
        return row.get(name, backend.full(length, backend.nan, backend.float32))

    return {name: backend.concatenate([column(row, name) for row in rows]) for name in names}


@dataclass(frozen=True)
class Program:
    """The compiled programs of a run on some devices, for a host loop that trains in chunks.

    Attributes:
      experiment: what is trained.
      devices: lanes are sharded over these.
    """

    experiment: Experiment
    devices: tuple[Any, ...]

    def __post_init__(self) -> None:
        self.experiment.check(len(self.devices))
        if len(self.devices) > 1:
            spell_out_multiply_high()

    @property
    def mesh(self) -> Mesh:
        """The one-axis mesh of devices."""
        return Mesh(np.asarray(self.devices), (AXIS,))

    def numbers(self) -> dict[str, jax.Array]:
        """The experiment's numbers, as data for the compiled programs."""
        return {n: jnp.float32(x) for n, x in numbers_of(self.experiment).items()}

    @cached_property
    def data(self) -> dict[str, Any]:
        """What the experiment's storages read from outside, on all devices."""
        everywhere = NamedSharding(self.mesh, PartitionSpec())
        return jax.device_put(train_state.load_data(self.experiment), everywhere)

    @cached_property
    def _start(self) -> Any:
        """The traced function (key, numbers, data) -> the state before the first update."""

        def begin(key: jax.Array, numbers: Numbers, data: Data) -> TrainState:
            return train_state.start(with_numbers(self.experiment, dict(numbers)), key, data)

        key = jax.eval_shape(lambda: train_state.make_key(0))
        return jax.jit(begin, out_shardings=self._shardings).trace(key, self.numbers(), self.data)

    def start(self, key: jax.Array, meanwhile: Callable[[], object] | None = None) -> TrainState:
        """Returns the state before the first update, placed on the devices.

        Args:
          key: of everything random.
          meanwhile: called while XLA compiles; to trace and compile something else.
        """
        lowered = self._start.lower()
        with ThreadPoolExecutor(1) as thread:
            compiling = thread.submit(lowered.compile)
            if meanwhile is not None:
                meanwhile()
            state: TrainState = compiling.result()(key, self.numbers(), self.data)
        return state

    def like(self) -> TrainState:
        """Returns the shapes, dtypes and placement of a train state, without computing one."""

        def place(sharding: NamedSharding, part: Any) -> Any:
            return jax.tree.map(
                lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=sharding), part
            )

        return jax.tree.map(place, self._shardings, self._start.out_info)

    @property
    def _shardings(self) -> Any:
        return jax.tree.map(lambda spec: NamedSharding(self.mesh, spec), _SPECS)

    def compile_stage(self, index: int, length: int) -> Any:
        """Returns `stage(index, length)` compiled, before there is a state to call it on."""
        arguments = (self.like(), self.numbers(), np.int32(0), self.data)
        return self.stage(index, length).lower(*arguments).compile()

    def stage(self, index: int, length: int) -> Any:
        """Returns a stage's jitted function (state, numbers, limit, data=None) -> (state, metrics
        [length]), where `data` is `self.data`, or None when there is none.

        It does up to `limit` ≤ `length` updates, and consumes its state: the arrays given must not
        be used again.
        """
        axis_name = AXIS if len(self.devices) > 1 else None

        def run(
            state: TrainState, numbers: Numbers, limit: Any, data: Data | None = None
        ) -> tuple[TrainState, Metrics]:
            configured = with_numbers(self.experiment, dict(numbers))
            return run_updates(configured, index, state, data or {}, length, limit, axis_name)

        if axis_name is None:
            return jax.jit(run, donate_argnums=0)

        def sharded(
            state: TrainState, numbers: Numbers, limit: Any, data: Data | None = None
        ) -> tuple[TrainState, Metrics]:
            return jax.shard_map(
                run,
                mesh=self.mesh,
                in_specs=(_SPECS, PartitionSpec(), PartitionSpec(), PartitionSpec()),
                out_specs=(_SPECS, PartitionSpec()),
                check_vma=False,
            )(state, numbers, limit, data)

        # Without being told, XLA returns arrays without elements replicated, whatever they were.
        everywhere = NamedSharding(self.mesh, PartitionSpec())
        return jax.jit(sharded, donate_argnums=0, out_shardings=(self._shardings, everywhere))


def choose_devices(count: int | None) -> tuple[Any, ...]:
    """Returns the first `count` devices of the default backend, or all of them.

    Raises:
      JaxactError: there are fewer.
    """
    devices = jax.devices()
    if count is None:
        return tuple(devices)
    if not 1 <= count <= len(devices):
        raise JaxactError(
            f"{count} devices were asked for, but jax sees {len(devices)} "
            f"({devices[0].platform}); simulate more on a CPU with JAX_NUM_CPU_DEVICES={count}"
        )
    return tuple(devices[:count])
