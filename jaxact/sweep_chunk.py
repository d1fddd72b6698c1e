"""Training a chunk of runs side by side, and noting how each of them fares."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jaxact.checkpoints import Checkpoints
from jaxact.evaluation import Evaluation, evaluate_policies
from jaxact.progress import ProgressDisplay
from jaxact.sweep_program import Piece, SweepProgram
from jaxact.sweep_records import Record
from jaxact.train_state import TrainState


class Chunk:
    """Runs that are trained side by side.

    Args:
      program: compiled for at least as many.
      first: how many runs of the sweep come before them.
      records: of each run, with its draw, seed and numbers; the rest is filled in.
      episodes: held-out episodes of an evaluation.
      checkpoints: where to save after evaluations, None for nowhere.
      display: of the sweep's progress.
    """

    def __init__(
        self,
        program: SweepProgram,
        first: int,
        records: Sequence[Record],
        episodes: int,
        checkpoints: Checkpoints | None,
        display: ProgressDisplay,
    ) -> None:
        self._program = program
        self._first = first
        self._records = list(records)
        self._episodes = episodes
        self._checkpoints = checkpoints
        self._display = display
        self._pipeline = program.experiment.pipeline
        sizes = [self._pipeline.steps_per_update(stage) for stage in self._pipeline.stages]
        self._sizes = np.array(sizes, np.int64)

    def train(self) -> list[Record]:
        """Trains and evaluates all runs, from the start or from where a checkpoint is."""
        program, done, state = self._program, 0, self._restore()
        # The last chunk is filled up with its last run, so that one program serves all.
        padding = [self._records[-1]] * (program.chunk - len(self._records))
        filled = [*self._records, *padding]
        numbers = program.numbers([record["numbers"] for record in filled])
        if state is None:
            state = program.start([record["seed"] for record in filled], numbers)
        else:
            done = self._newest() % len(program.pieces)
        for index in range(done, len(program.pieces)):
            piece, before = program.pieces[index], self._steps(state)
            state, metrics = program.advance(piece, state, numbers)
            steps = self._steps(state)
            self._note_divergence(piece, before, metrics)
            self._show(piece, steps, metrics)
            if piece.evaluate:
                self._evaluate(state, steps)
                if index + 1 < len(program.pieces):
                    self._save(index + 1, state)
        return self._records

    def _steps(self, state: TrainState) -> np.ndarray:
        """Returns environment steps so far, int64 [C]."""
        return np.asarray(state.updates) @ self._sizes

    def _note_divergence(
        self, piece: Piece, before: np.ndarray, metrics: dict[str, np.ndarray]
    ) -> None:
        watched = [x for n, x in metrics.items() if n.startswith("losses/")]
        finite = np.all(np.isfinite([*watched, metrics["train/gradient_norm"]]), axis=0)
        bad = metrics["active"] & ~finite
        for i, record in enumerate(self._records):
            if record["diverged"] is None and bad[i].any():
                updates = int(np.argmax(bad[i])) + 1
                record["diverged"] = int(before[i] + updates * self._sizes[piece.stage])

    def _evaluate(self, state: TrainState, steps: np.ndarray) -> None:
        pomdp, player = self._program.experiment.pomdp, self._program.player
        outcomes = evaluate_policies(pomdp, player, state.params, self._episodes)
        for record, outcome, step in zip(self._records, outcomes, steps.tolist(), strict=False):
            record["evaluations"].append({"step": step, **_means(outcome)})
        success = [record["evaluations"][-1]["success"] for record in self._records]
        best = self._records[int(np.argmax(success))]
        diverged = sum(record["diverged"] is not None for record in self._records)
        self._display.message(
            f"{self._name()}, {int(steps.max()):,} steps: success {max(success):.1%} at best "
            f"(draw {best['draw']}), {float(np.median(success)):.1%} in the median of "
            f"{len(success)} runs, {diverged} diverged"
        )

    def _show(self, piece: Piece, steps: np.ndarray, metrics: dict[str, np.ndarray]) -> None:
        count = float(metrics["episodes/count"].sum())
        means = {
            f"train/{name}": float(metrics[f"episodes/{name}"].sum()) / count if count else math.nan
            for name in ("success", "return", "length")
        }
        total = self._pipeline.total_steps
        done = self._first * total + len(self._records) * int(steps.max())
        self._display.update(f"{self._name()}, stage {piece.stage}", done, means)

    def _name(self) -> str:
        return f"draws {self._records[0]['draw']}-{self._records[-1]['draw']}"

    def _save(self, done: int, state: TrainState) -> None:
        if self._checkpoints is not None:
            metadata = {"chunk": self._program.chunk, "records": self._records}
            number = self._first * len(self._program.pieces) + done
            self._checkpoints.save(number, state, metadata=metadata)

    def _restore(self) -> TrainState | None:
        """Returns the newest checkpoint's state and takes over its records, if it is of these."""
        number = self._newest()
        if self._checkpoints is None or number < 0:
            return None
        saved = self._checkpoints.metadata(number)
        if saved["chunk"] != self._program.chunk or _runs(saved["records"]) != _runs(self._records):
            return None
        state: TrainState = self._checkpoints.restore(number, self._program.like()).state
        self._records = saved["records"]
        return state

    def _newest(self) -> int:
        steps = [] if self._checkpoints is None else self._checkpoints.steps()
        return steps[-1] if steps else -1


def _runs(records: Sequence[Record]) -> list[tuple[int, int]]:
    return [(record["draw"], record["seed"]) for record in records]


def _means(outcome: Evaluation) -> dict[str, float | None]:
    """Means of an evaluation, for JSON."""
    summary = outcome.summary()
    means = {name: x["mean"] for name, x in summary.items() if isinstance(x, dict)}
    return {name: x if math.isfinite(x) else None for name, x in means.items()}
