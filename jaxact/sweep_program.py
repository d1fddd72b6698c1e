"""Many training runs of one experiment side by side: its programs, vmapped over numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxact import train_state
from jaxact.evaluation import Player, policy_player
from jaxact.experiment import Experiment
from jaxact.gradients import Metrics
from jaxact.multiply_high import spell_out_multiply_high
from jaxact.overrides import numbers as numbers_of
from jaxact.overrides import with_numbers
from jaxact.pipeline import TrainingPipeline
from jaxact.program import Data, Numbers, run_updates
from jaxact.train_state import TrainState

_AXIS = "runs"
# Looks at a chunk of runs in the course of training.
_LOOKS = 100


@dataclass(frozen=True)
class Piece:
    """Updates that are done in one call.

    Attributes:
      stage: index.
      updates: how many.
      evaluate: whether policies are evaluated after them.
    """

    stage: int
    updates: int
    evaluate: bool


def pieces(pipeline: TrainingPipeline, evaluations: int) -> list[Piece]:
    """Cuts training at evenly spaced points, and in between where somebody may want to look.

    Args:
      pipeline: of the experiment.
      evaluations: points in environment steps, the last at the end; where an update is longer than
        the space between them there are fewer.
    """
    total = pipeline.total_steps
    cut: list[Piece] = []
    before = 0
    for index, stage in enumerate(pipeline.stages):
        size, updates = pipeline.steps_per_update(stage), pipeline.updates(stage)
        targets = [total * (i + 1) - before * evaluations for i in range(evaluations)]
        points = {-(-target // (size * evaluations)) for target in targets}
        evaluated = {point for point in points if 0 < point <= updates}
        look = max(1, total // _LOOKS // size)
        done = 0
        for end in sorted({*evaluated, *range(look, updates, look), updates}):
            cut.append(Piece(index, end - done, end in evaluated))
            done = end
        before += updates * size
    return cut


@dataclass(frozen=True)
class SweepProgram:
    """The compiled programs that train and evaluate a chunk of runs; arrays have a leading [C].

    Attributes:
      experiment: what is trained.
      paths: its numbers that differ between runs.
      chunk: C, how many runs there are; a multiple of the number of devices.
      devices: runs are sharded over these.
      pieces: how training is cut.
      greedy: whether evaluation takes the most likely actions.
    """

    experiment: Experiment
    paths: tuple[str, ...]
    chunk: int
    devices: tuple[Any, ...]
    pieces: Sequence[Piece]
    greedy: bool

    def __post_init__(self) -> None:
        if len(self.devices) > 1:
            spell_out_multiply_high()

    def numbers(self, draws: Sequence[Mapping[str, float]]) -> dict[str, np.ndarray]:
        """Returns all numbers of the experiment: those drawn as [C], the others as scalars."""
        drawn = {path: [draw[path] for draw in draws] for path in self.paths}
        return {n: np.asarray(drawn.get(n, x), np.float32) for n, x in self._defaults.items()}

    def start(self, seeds: Sequence[int], numbers: Numbers) -> TrainState:
        """Returns the states before the first update, of runs with these seeds [C]."""
        return self._compiled["start"](_keys(seeds), numbers, self._data)

    def like(self) -> TrainState:
        """Returns the shapes, dtypes and placement of the states."""
        placed = NamedSharding(self._mesh, PartitionSpec(_AXIS))
        return jax.tree.map(
            lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=placed),
            self._traced_start.out_info,
        )

    def advance(
        self, piece: Piece, state: TrainState, numbers: Numbers
    ) -> tuple[TrainState, dict[str, np.ndarray]]:
        """Does the updates of a piece and consumes the state.

        Returns:
          The states after them, and metrics [C, updates].
        """
        stage = self._compiled[piece.stage]
        state, metrics = stage(state, numbers, np.int32(piece.updates), self._data)
        return state, {n: x[:, : piece.updates] for n, x in jax.device_get(metrics).items()}

    @cached_property
    def player(self) -> Player:
        """(parameters [C], beginnings [B], step keys [B]) -> finished episodes [C, B]."""
        experiment = self.experiment
        play = policy_player(experiment.pomdp, experiment.model, self.greedy)
        return self._over_runs(play, 0, None, None)

    @property
    def bytes_needed(self) -> int:
        """XLA's estimate of what training takes at the most, on all devices of one memory."""
        needed = []
        for compiled in self._compiled.values():
            memory = compiled.memory_analysis()
            if memory is not None:
                kept = memory.output_size_in_bytes - memory.alias_size_in_bytes
                needed.append(memory.argument_size_in_bytes + memory.temp_size_in_bytes + kept)
        shared = len(self.devices) if self.devices[0].platform == "cpu" else 1
        return shared * max(needed, default=0)

    @property
    def _mesh(self) -> Mesh:
        return Mesh(np.asarray(self.devices), (_AXIS,))

    @cached_property
    def _defaults(self) -> dict[str, float]:
        return numbers_of(self.experiment)

    @cached_property
    def _compiled(self) -> dict[str | int, Any]:
        """What starts runs and what trains each stage; traced in turn, compiled side by side."""
        traced: dict[str | int, Any] = {"start": self._traced_start}
        for index in range(len(self.experiment.pipeline.stages)):
            run = self._over_runs(self._stage(index), 0, self._varying, None, None, donate=0)
            traced[index] = run.trace(self.like(), self._any_numbers, np.int32(0), self._data)
        with ThreadPoolExecutor(len(traced)) as threads:
            waiting = {n: threads.submit(x.lower().compile) for n, x in traced.items()}
            return {name: compiled.result() for name, compiled in waiting.items()}

    @cached_property
    def _traced_start(self) -> Any:
        start = self._on_devices(self._starts, 0, self._varying, None)
        return start.trace(_keys([0] * self.chunk), self._any_numbers, self._data)

    @cached_property
    def _data(self) -> dict[str, Any]:
        """What the experiment's storages read from outside, once for all runs."""
        everywhere = NamedSharding(self._mesh, PartitionSpec())
        return jax.device_put(train_state.load_data(self.experiment), everywhere)

    @property
    def _varying(self) -> dict[str, int | None]:
        """The axis of each number."""
        return {name: 0 if name in self.paths else None for name in self._defaults}

    @property
    def _any_numbers(self) -> dict[str, np.ndarray]:
        return self.numbers([dict.fromkeys(self.paths, 0.0)] * self.chunk)

    def _starts(self, keys: jax.Array, numbers: Numbers, data: Data) -> TrainState:
        # One after the other: orthogonal initialization factorizes, and LAPACK's calls for a batch
        # wait for threads of the pool that they run on. As many of them as it has threads, and
        # none ever returns.
        def start(run: tuple[jax.Array, Numbers]) -> TrainState:
            key, drawn = run
            configured = with_numbers(self.experiment, {**numbers, **drawn})
            return train_state.start(configured, key, data)

        return jax.lax.map(start, (keys, {path: numbers[path] for path in self.paths}))

    def _stage(
        self, index: int
    ) -> Callable[[TrainState, Numbers, jax.Array, Data], tuple[TrainState, Metrics]]:
        length = max(piece.updates for piece in self.pieces if piece.stage == index)

        def run(
            state: TrainState, numbers: Numbers, limit: jax.Array, data: Data
        ) -> tuple[TrainState, Metrics]:
            configured = with_numbers(self.experiment, numbers)
            return run_updates(configured, index, state, data, length, limit)

        return run

    def _over_runs(
        self, function: Callable[..., Any], *axes: Any, donate: int | tuple[int, ...] = ()
    ) -> Any:
        """Jits a function of one run for a chunk of them, each device taking its share."""
        return self._on_devices(jax.vmap(function, in_axes=axes), *axes, donate=donate)

    def _on_devices(
        self, batched: Callable[..., Any], *axes: Any, donate: int | tuple[int, ...] = ()
    ) -> Any:
        """Jits a function of a chunk of runs, each device taking its share of those on an axis."""
        mesh, runs = self._mesh, PartitionSpec(_AXIS)
        specs = jax.tree.map(
            lambda axis: PartitionSpec() if axis is None else runs,
            axes,
            is_leaf=lambda axis: axis is None,
        )
        if len(self.devices) > 1:
            batched = jax.shard_map(
                batched, mesh=mesh, in_specs=specs, out_specs=runs, check_vma=False
            )
        # Without being told, XLA returns arrays without elements replicated.
        return jax.jit(
            batched,
            donate_argnums=donate,
            in_shardings=jax.tree.map(lambda spec: NamedSharding(mesh, spec), specs),
            out_shardings=NamedSharding(mesh, runs),
        )


def _keys(seeds: Sequence[int]) -> jax.Array:
    return jnp.stack([train_state.make_key(seed) for seed in seeds])
