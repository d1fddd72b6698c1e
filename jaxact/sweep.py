"""Random search: `jaxact.sweep(experiment, space)` in Python, `python -m jaxact.sweep` in a shell.

Numbers are data, so draws are trained side by side in one vmapped program, a chunk of runs at a
time. A run that diverges goes on with numbers that are not finite, beside the others and without
any influence on them, and is recorded as diverged.
"""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jaxact.callable_module import make_callable
from jaxact.checkpoints import Checkpoints
from jaxact.errors import JaxactError, unknown
from jaxact.experiment import Experiment
from jaxact.memory import free_bytes
from jaxact.options import SweepOptions
from jaxact.overrides import fingerprint, to_json
from jaxact.program import choose_devices
from jaxact.progress import ProgressDisplay
from jaxact.runs import CONFIG, create_run, open_run, write_json
from jaxact.search_space import Range, SearchSpace
from jaxact.sweep_chunk import Chunk
from jaxact.sweep_program import SweepProgram, pieces
from jaxact.sweep_records import (
    Record,
    append_records,
    check_same,
    read_records,
    read_sweep_config,
)

_DEFAULT_DRAWS = 50
_MEMORY_SHARE = 0.6
# What a sweep is made of; a resumed one keeps its own.
_KEPT = ("draw_seed", "seeds", "evaluations", "evaluation_episodes", "greedy")


@dataclass(frozen=True)
class SweepResult:
    """What a random search leaves.

    Attributes:
      records: of each draw and seed, in this order, as in `draws.jsonl`: "draw", "seed", "numbers"
        by path, "diverged" (environment steps after the first update with a loss that was not
        finite, None if there was none) and "evaluations": means over the held-out episodes by
        name, such as "success", "return" and "length", with the "step" they were taken at. A policy
        of parameters that are NaN takes the first of discrete actions; a mean that is not finite
        is None.
      directory: the sweep's, None if nothing was kept.
    """

    records: list[Record]
    directory: Path | None


def sweep(
    experiment: Experiment, space: Mapping[str | tuple[str, ...], Range], **options: Any
) -> SweepResult:
    """Draws numbers of an experiment at random, and trains and evaluates it with each draw.

    All draws are evaluated in the experiment's own world: numbers drawn under "pomdp" change what
    is trained on.

    Args:
      experiment: what to train.
      space: a range, such as `log_uniform(1e-4, 0.5)` of `jaxact.search_space`, for each number by
        its dotted path (`jaxact.overrides.numbers` lists them); a tuple of paths shares one draw.
      **options: the fields of `SweepOptions`.

    Raises:
      JaxactError: the experiment, the space or an option cannot work, or the directory to resume is
        that of another sweep.
    """
    fields = {f.name for f in dataclasses.fields(SweepOptions)}
    for name in options:
        if name not in fields:
            raise unknown("sweep option", name, fields)
    paths = {n: Path(options[n]) for n in ("output", "resume") if options.get(n) is not None}
    seeds = options.get("seeds", ())
    if isinstance(seeds, int):
        raise JaxactError(f"seeds must be several numbers, such as ({seeds},), got {seeds}")
    given = {"seeds": tuple(seeds)} if "seeds" in options else {}
    settings = SweepOptions(**{**options, **paths, **given})
    return Sweep(experiment, SearchSpace.of(space), settings).run()


@dataclass
class Sweep:
    """A random search in the making; `run()` is the story.

    Attributes:
      experiment: what is trained.
      space: what is drawn.
      options: how.
      source: the file that defines the experiment, to be kept with the sweep.
      config: what to write into `config.json` besides the experiment itself.
    """

    experiment: Experiment
    space: SearchSpace
    options: SweepOptions
    source: Path | None = None
    config: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.options.check()
        self.experiment.check()
        self.experiment.pomdp.check_in_jax("sweeps are")
        self.space.check(self.experiment)
        self.devices = choose_devices(self.options.devices)
        self.directory: Path | None = None
        self.records: dict[tuple[int, int], Record] = {}

    def run(self) -> SweepResult:
        """Trains every draw with every seed, but those that a resumed sweep has already."""
        config = self._fresh_config() if self.options.resume is None else self._resume()
        draws = self.options.draws or _DEFAULT_DRAWS
        runs = [(draw, seed) for draw in range(draws) for seed in self.options.seeds]
        if any(run not in self.records for run in runs):
            program = self._fitting_program(len(runs))
            config = {**config, "draws": draws, "chunk": program.chunk}
            if self.directory is not None:
                write_json(self.directory / CONFIG, config)
            elif self.options.output is not None:
                name = self.experiment.name
                self.directory = create_run(self.options.output, name, config, self.source)
            self._train(program, runs)
        return SweepResult([self.records[run] for run in runs], self.directory)

    def _fresh_config(self) -> dict[str, Any]:
        return {
            "fingerprint": fingerprint(to_json(self.experiment)),
            "space": self.space.to_texts(),
            **{name: getattr(self.options, name) for name in _KEPT},
            **self.config,
            "experiment": to_json(self.experiment),
        }

    def _resume(self) -> dict[str, Any]:
        """Reads what a sweep has, and takes over how it was begun; returns its config."""
        options = self.options
        assert options.resume is not None
        self.directory = open_run(options.resume)
        config = read_sweep_config(self.directory)
        check_same(self.directory, config, self.experiment, self.space)
        kept = {name: config[name] for name in _KEPT} | {"seeds": tuple(config["seeds"])}
        anew = {name: getattr(options, name) or config[name] for name in ("draws", "chunk")}
        self.options = dataclasses.replace(options, **kept, **anew)
        self.records = {(x["draw"], x["seed"]): x for x in read_records(self.directory)}
        return config

    def _fitting_program(self, runs: int) -> SweepProgram:
        """Compiles for as many runs at once as were asked for, or as fit into memory."""
        options = self.options
        cut = pieces(self.experiment.pipeline, options.evaluations)

        def program(chunk: int) -> SweepProgram:
            whole = -(-chunk // len(self.devices)) * len(self.devices)
            return SweepProgram(
                self.experiment, self.space.paths, whole, self.devices, cut, options.greedy
            )

        if options.chunk is not None:
            return program(options.chunk)
        gigabytes = options.memory_gb
        limit = (
            _MEMORY_SHARE * free_bytes(self.devices[0]) if gigabytes is None else gigabytes * 1e9
        )
        fitting = program(runs)
        while fitting.bytes_needed > limit:
            needed = fitting.bytes_needed / fitting.chunk
            fit = int(limit / needed / len(self.devices)) * len(self.devices)
            if fitting.chunk == len(self.devices):
                raise JaxactError(
                    f"{fitting.chunk} run(s) of {self.experiment.name} need "
                    f"{fitting.bytes_needed / 1e9:.2f} GB, and only {limit / 1e9:.2f} GB may be "
                    "taken: allow more with memory_gb, or set a chunk to try all the same"
                )
            # In parts of one size, so that the last of them is no padding for the most part.
            parts = -(-runs // max(1, fit))
            fitting = program(-(-runs // parts))
        return fitting

    def _train(self, program: SweepProgram, runs: Sequence[tuple[int, int]]) -> None:
        options, checkpoints = self.options, None
        steps = self.experiment.pipeline.total_steps * len(runs)
        if self.directory is not None:
            checkpoints = Checkpoints(self.directory / "checkpoints", keep_last=1, keep_best=0)
        with ProgressDisplay(steps, options.progress) as display:
            for first in range(0, len(runs), program.chunk):
                members = runs[first : first + program.chunk]
                if all(run in self.records for run in members):
                    continue
                records = [self._fresh_record(*run) for run in members]
                chunk = Chunk(
                    program, first, records, options.evaluation_episodes, checkpoints, display
                )
                self._keep(chunk.train())
        if self.directory is not None:
            shutil.rmtree(self.directory / "checkpoints", ignore_errors=True)

    def _fresh_record(self, draw: int, seed: int) -> Record:
        numbers = self.space.draw(self.options.draw_seed, draw)
        run = {"draw": draw, "seed": seed, "numbers": numbers}
        return {**run, "diverged": None, "evaluations": []}

    def _keep(self, records: Sequence[Record]) -> None:
        """Adds records that are not there yet, in one write."""
        new = [x for x in records if (x["draw"], x["seed"]) not in self.records]
        self.records |= {(x["draw"], x["seed"]): x for x in new}
        if self.directory is not None:
            append_records(self.directory, new)


make_callable(__name__)


if __name__ == "__main__":
    from jaxact.command_line import run_sweep

    run_sweep()
