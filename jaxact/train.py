"""Training: `jaxact.train(experiment)` in Python, `python -m jaxact.train EXPERIMENT` in a shell.

Read from top to bottom this file tells what a run is: compile each stage, train in chunks of
updates, and between chunks log, evaluate, film and save.
"""

from __future__ import annotations

import dataclasses
import math
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxact.callable_module import make_callable
from jaxact.checkpoints import Checkpoints
from jaxact.errors import JaxactError, unknown
from jaxact.evaluation import Evaluation, evaluate_policy
from jaxact.experiment import Experiment
from jaxact.logs import RunLog
from jaxact.options import Options
from jaxact.overrides import fingerprint, to_json
from jaxact.policy import Policy
from jaxact.processes import is_first, largest, own_copy, text_of_first
from jaxact.program import Program, choose_devices, concatenate
from jaxact.progress import ProgressDisplay
from jaxact.recording import record_episode
from jaxact.runs import create_run, open_run, write_json
from jaxact.simulators import explained
from jaxact.train_state import TrainState, make_key
from jaxact.video import write_video


@dataclass(frozen=True)
class TrainResult:
    """What training leaves.

    Attributes:
      state: the train state at the end.
      metrics: named arrays [updates], one entry for each update that this call did; with "step",
        the environment steps after it, and "stage". Rates such as "train/success" are over the
        episodes that finished during that update, NaN where none did.
      policy: the trained policy.
      evaluation: on held-out episodes at the end; None if there was none.
      run: the run's directory, None if nothing was kept.
      interrupted: the signal that ended the run early, None if none did.
    """

    state: TrainState
    metrics: dict[str, np.ndarray]
    policy: Policy
    evaluation: Evaluation | None
    run: Path | None
    interrupted: signal.Signals | None


def train(experiment: Experiment, seed: int = 0, **options: Any) -> TrainResult:
    """Trains an experiment.

    Args:
      experiment: what to train.
      seed: of everything random; the same seed on the same machine gives the same numbers, bit for
        bit.
      **options: the fields of `Options`.

    Raises:
      JaxactError: the experiment or an option cannot work (before anything compiles), or a loss
        is not finite; checkpoints already written stay.
    """
    fields = {f.name for f in dataclasses.fields(Options)}
    for name in options:
        if name not in fields:
            raise unknown("training option", name, fields)
    paths = {n: Path(x) for n, x in options.items() if n in _PATHS and x is not None}
    return Run(experiment, seed, Options(**{**options, **paths})).run()


_PATHS = ("output", "resume", "initial_weights")


@dataclass
class Run:
    """One training run in the making; `run()` is the story.

    Attributes:
      experiment: what is trained.
      seed: of everything random.
      options: how it is watched and kept.
      source: the file that defines the experiment, to be kept with the run.
      config: what to write into `config.json` besides the experiment itself.
    """

    experiment: Experiment
    seed: int
    options: Options
    source: Path | None = None
    config: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.options.check()
        self.program = Program(self.experiment, choose_devices(self.options.devices))
        self.fingerprint = fingerprint(to_json(self.experiment))
        self.stages: dict[int, Any] = {}
        self.directory: Path | None = None
        self.checkpoints: Checkpoints | None = None
        self.log: RunLog | None = None
        self.evaluation: Evaluation | None = None
        self.evaluated_at = -1
        self.received: signal.Signals | None = None
        self.interrupted: signal.Signals | None = None

    @explained()
    def run(self) -> TrainResult:
        """Trains from the start, or from where a resumed run was."""
        total = self.options.total_steps or self.experiment.pipeline.total_steps
        state = self._begin()
        history: list[dict[str, Any]] = []
        numbers = self.program.numbers()
        with (
            self.log or nullcontext(),
            ProgressDisplay(total, self.options.progress and is_first()) as self.display,
            self._signals(),
        ):
            for index in range(len(self.experiment.pipeline.stages)):
                state = self._train_stage(index, state, numbers, total, history)
            if self.interrupted is None:
                self._finish(state)
        return TrainResult(
            state=state,
            metrics=concatenate(history),
            policy=self._policy(state),
            evaluation=self.evaluation,
            run=self.directory,
            interrupted=self.interrupted,
        )

    def _begin(self) -> TrainState:
        """Makes or opens the run's directory; returns the first train state."""
        options = self.options
        key, params = make_key(self.seed), None
        resumed = options.resume is not None
        if options.resume is not None:
            self.directory = open_run(options.resume)
        elif options.initial_weights is not None:
            weights = Checkpoints(open_run(options.initial_weights) / "checkpoints")
            params = weights.restore_part(None, "params", self.program.like().params).state
        if options.output is not None and not resumed:
            config = {"seed": self.seed, "fingerprint": self.fingerprint, **self.config}
            config["experiment"] = to_json(self.experiment)
            make = partial(create_run, options.output, self.experiment.name, config, self.source)
            self.directory = Path(text_of_first(lambda: str(make())))
        if self.directory is not None:
            self.checkpoints = Checkpoints(self.directory / "checkpoints", options.keep_last)
        state = self._restore() if resumed else self.program.start(key, lambda: self._compiled(0))
        if params is not None:
            state = dataclasses.replace(state, params=params)
        steps = self._steps(state) if resumed else None
        if self.directory is not None and is_first():
            self.log = RunLog(self.directory, resume_step=steps)
        return state

    def _restore(self) -> TrainState:
        """Reads the newest checkpoint of the run that is resumed; checked before compiling."""
        assert self.checkpoints is not None
        state = self.checkpoints.restore(
            None, self.program.like(), name=self.experiment.name, fingerprint=self.fingerprint
        ).state
        if self.experiment.pomdp.environment.max_lanes is None:
            return state
        # What is saved of worlds outside of JAX is where they were, not what they were.
        lanes = dataclasses.replace(state.lanes, is_first=state.lanes.is_first | True)
        return dataclasses.replace(state, lanes=lanes)

    def _train_stage(
        self,
        index: int,
        state: TrainState,
        numbers: Mapping[str, Any],
        total: int,
        history: list[dict[str, np.ndarray]],
    ) -> TrainState:
        """Trains a stage to its end, in chunks of updates."""
        pipeline = self.experiment.pipeline
        stage = pipeline.stages[index]
        size = pipeline.steps_per_update(stage)
        chunk, advance = self._chunk(index), self._compiled(index)
        while self.interrupted is None:
            done = int(state.updates[index])
            left = min(pipeline.updates(stage) - done, -(-(total - self._steps(state)) // size))
            if left <= 0 or bool(state.stopped[index]):
                break
            # Kept to multiples of the chunk, so that a resumed run falls into step.
            limit = min(left, chunk - done % chunk)
            before = self._steps(state)
            state, metrics = advance(state, numbers, np.int32(limit), self.program.data)
            rows = {n: x[np.asarray(metrics["active"])] for n, x in jax.device_get(metrics).items()}
            self._check_finite(index, before, rows)
            count = len(rows["active"])
            rows["step"] = before + size * np.arange(1, count + 1, dtype=np.int64)
            rows["stage"] = np.full(count, index, np.int32)
            history.append(_rates(rows))
            self._after_chunk(state, before, rows)
        return state

    def _chunk(self, index: int) -> int:
        """Updates of a stage between two looks at them."""
        pipeline = self.experiment.pipeline
        stage = pipeline.stages[index]
        every = self._interval("log_every", 100) // pipeline.steps_per_update(stage)
        return max(1, min(every, pipeline.updates(stage)))

    def _compiled(self, index: int) -> Any:
        """Returns the compiled program of a stage; only the newest is kept."""
        if index not in self.stages:
            self.stages = {index: self.program.compile_stage(index, self._chunk(index))}
        return self.stages[index]

    def _after_chunk(self, state: TrainState, before: int, rows: dict[str, np.ndarray]) -> None:
        """Logs, and evaluates, films and saves when it is time."""
        step = self._steps(state)
        means = _summarise(rows)
        self.display.update(f"stage {int(rows['stage'][-1])}", step, means)
        if self.log is not None:
            self.log.scalars(step, {"stage": float(rows["stage"][-1]), **means})
        finished = self._is_finished(state)

        def due(name: str, parts: int) -> bool:
            every = self._interval(name, parts)
            return every > 0 and before // every < step // every and not finished

        if due("evaluate_every", 5):
            self._evaluate(state)
        if self.options.video_every and due("video_every", 1):
            self._film(state)
        # One process may have been told to stop and another not yet, but all have to save together.
        number = largest(0 if self.received is None else self.received)
        self.interrupted = signal.Signals(number) if number else None
        if self.interrupted is not None or due("checkpoint_every", 10):
            self._save(state)

    def _finish(self, state: TrainState) -> None:
        if self.options.evaluation_episodes:
            self._evaluate(state)
        if self.log is not None and self.experiment.pomdp.has_pictures:
            self._film(state)
        self._save(state)

    def _evaluate(self, state: TrainState) -> None:
        step = self._steps(state)
        episodes, greedy = self.options.evaluation_episodes, self.options.greedy
        if not episodes:
            return
        self.evaluation = evaluate_policy(
            self.experiment.pomdp, self._policy(state), episodes, seed=self.seed, greedy=greedy
        )
        self.evaluated_at = step
        summary = self.evaluation.summary()
        low, high = summary["success"]["interval"]
        self.display.message(
            f"{step:,} steps: success {summary['success']['mean']:.1%} "
            f"[{low:.1%}, {high:.1%}] of {summary['episodes']} held-out episodes, "
            f"return {summary['return']['mean']:.3f}, length {summary['length']['mean']:.1f}"
        )
        if self.log is not None and self.directory is not None:
            scalars = {
                f"evaluation/{n}": x["mean"] for n, x in summary.items() if isinstance(x, dict)
            }
            self.log.scalars(step, scalars)
            record = {"step": step, "seed": self.seed, "greedy": greedy, **summary}
            (self.directory / "evaluation").mkdir(exist_ok=True)
            write_json(self.directory / "evaluation" / f"{step:012d}.json", record)

    def _film(self, state: TrainState) -> None:
        if self.log is None or self.directory is None:
            return
        step = self._steps(state)
        frames = record_episode(self.experiment.pomdp, self._policy(state), seed=self.seed)
        (self.directory / "videos").mkdir(exist_ok=True)
        write_video(self.directory / "videos" / f"{step:012d}.gif", frames)
        self.log.video("episode", step, frames, fps=8)

    def _save(self, state: TrainState) -> None:
        if self.checkpoints is None:
            return
        step, score = self._steps(state), None
        if self.evaluation is not None and self.evaluated_at == step:
            score = float(self.evaluation.success.mean())
        self.checkpoints.save(
            step,
            state,
            metadata={"name": self.experiment.name, "fingerprint": self.fingerprint},
            score=score,
        )

    def _policy(self, state: TrainState) -> Policy:
        pomdp = self.experiment.pomdp
        return Policy(self.experiment.model, own_copy(state.params), pomdp.action_space)

    def _steps(self, state: TrainState) -> int:
        pipeline = self.experiment.pipeline
        sizes = [pipeline.steps_per_update(stage) for stage in pipeline.stages]
        return sum(
            n * size for n, size in zip(np.asarray(state.updates).tolist(), sizes, strict=True)
        )

    def _is_finished(self, state: TrainState) -> bool:
        pipeline = self.experiment.pipeline
        total = self.options.total_steps or pipeline.total_steps
        last = pipeline.stages[-1]
        done = int(state.updates[-1]) >= pipeline.updates(last) or bool(state.stopped[-1])
        return done or self._steps(state) >= total

    def _interval(self, name: str, parts: int) -> int:
        given = getattr(self.options, name)
        return self.experiment.pipeline.total_steps // parts if given is None else given

    def _check_finite(self, index: int, before: int, rows: dict[str, np.ndarray]) -> None:
        for name in sorted(rows):
            if name.startswith("losses/") and not np.all(np.isfinite(rows[name])):
                raise JaxactError(
                    f"{name} became {rows[name][~np.isfinite(rows[name])][0]} in stage {index} "
                    f"after {before:,} steps: lower pipeline.learning_rate or look at the rewards; "
                    "checkpoints written before are intact"
                )

    @contextmanager
    def _signals(self) -> Iterator[None]:
        """Makes the first Ctrl-C or SIGTERM end the run after the chunk, with a checkpoint."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def stop(number: int, _: Any) -> None:
            if self.received is not None:
                raise KeyboardInterrupt
            self.received = signal.Signals(number)
            self.display.message(
                f"{self.received.name}: saving after this chunk; once more to leave at once"
            )

        old = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in old.items():
                signal.signal(number, handler)


def _rates(rows: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Turns sums over finished episodes into means, for each update."""
    rates = {}
    for name, values in rows.items():
        if name.startswith("episodes/") and not _is_count(name):
            count = rows[_count_of(name)]
            mean = np.full(len(count), np.nan, np.float32)
            np.divide(values, count, out=mean, where=count > 0)
            rates[f"train/{name.removeprefix('episodes/')}"] = mean
        else:
            rates[name] = values
    return rates


def _summarise(rows: dict[str, np.ndarray]) -> dict[str, float]:
    """Means over the updates of a chunk; of episodes, over all that finished in it."""
    means = {}
    for name, values in rows.items():
        tag = f"train/{name.removeprefix('episodes/')}"
        if _is_count(name):
            means[f"{tag.removesuffix('count')}episodes"] = float(values.sum())
        elif name.startswith("episodes/"):
            count = float(rows[_count_of(name)].sum())
            means[tag] = float(values.sum()) / count if count else math.nan
        elif name.startswith(("losses/", "train/")):
            means[name] = float(np.mean(values))
    return means


def _is_count(name: str) -> bool:
    return name.startswith("episodes/") and _count_of(name) == name


def _count_of(name: str) -> str:
    """Returns the count by which a sum over episodes is to be divided."""
    of_kind = name.startswith("episodes/kinds/")
    return name.rpartition("/")[0] + "/count" if of_kind else "episodes/count"


make_callable(__name__)


if __name__ == "__main__":
    from jaxact.command_line import run_train

    run_train()
