"""What a random search costs as one vmapped program, and as a process for each draw.

Run `python -m benchmarks.sweep_cost`; it prints JSON lines:

* the machine;
* `python -m jaxact.sweep`, all draws in one process: wall time from the process's start to its end,
  compilation and evaluations included, and its peak memory;
* `python -m jaxact.train` with a draw's numbers, for a few draws one after the other: the same of
  each, and of all draws from their median (`"extrapolated"`), if not all were measured;
* their ratios.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from typing import Annotated, Any

import tyro


@dataclass(frozen=True)
class Arguments:
    """Measures what a random search costs."""

    experiment: str = "benchmarks.tiny_experiment"
    """As `python -m jaxact.train` takes it."""
    draw: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """PATH=RANGE as `python -m jaxact.sweep` takes it (default:
    pipeline.learning_rate=log_uniform(1e-4,0.5))."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """PATH=VALUE overrides of the experiment."""
    draws: int = 50
    """Draws of the search."""
    processes: int = 5
    """Draws that are measured as processes of their own."""
    evaluations: int = 4
    """Evaluations of each draw."""
    episodes: int = 100
    """Held-out episodes of each evaluation."""


def main() -> None:
    """Parses the command line and prints the figures."""
    from jaxact.loading import load_experiment
    from jaxact.overrides import override
    from jaxact.search_space import SearchSpace

    arguments = tyro.cli(Arguments)
    experiment = override(load_experiment(arguments.experiment)[0], arguments.set)
    texts = arguments.draw or ("pipeline.learning_rate=log_uniform(1e-4,0.5)",)
    space = SearchSpace.parse(texts)
    space.check(experiment)
    _print_machine()
    options = [arguments.experiment, "--evaluation-episodes", str(arguments.episodes)]
    options += ["--no-progress", *_repeated("--set", arguments.set)]
    search = [*options, *_repeated("--draw", texts), "--draws", str(arguments.draws)]
    together = _run("jaxact.sweep", [*search, "--evaluations", str(arguments.evaluations)])
    about = {"id": arguments.experiment, "draws": arguments.draws}
    _print(about | {"system": "jaxact.sweep"} | together)

    total = experiment.pipeline.total_steps
    alone = []
    for index in range(min(arguments.processes, arguments.draws)):
        numbers = [f"{path}={x!r}" for path, x in space.draw(0, index).items()]
        every = ["--evaluate-every", str(-(-total // arguments.evaluations))]
        # A process that diverges stops early; the sweep's draws all go on to the end.
        alone.append(_run("jaxact.train", [*options, *_repeated("--set", numbers), *every]))
        _print({"id": arguments.experiment, "system": "jaxact.train", "draw": index} | alone[-1])
    finished = [run for run in alone if run["exit_code"] == 0] or alone
    seconds = [run["seconds"] for run in finished]
    whole = arguments.draws * statistics.median(seconds)
    memory = max(run["peak_memory_mb"] for run in finished)
    separate = {
        "system": "jaxact.train, one after the other",
        "processes_measured": len(finished),
        "extrapolated": len(finished) < arguments.draws,
        "seconds": round(whole, 1),
        "peak_memory_mb": memory,
    }
    _print(about | separate)
    ratios = {
        "system": "ratio",
        "seconds": round(whole / together["seconds"], 2),
        "peak_memory": round(together["peak_memory_mb"] / memory, 2),
        "environment_steps_per_second_together": round(
            arguments.draws * total / together["seconds"]
        ),
    }
    _print(about | ratios)


def _run(module: str, options: list[str]) -> dict[str, Any]:
    """Runs a module in a process, to its end."""
    with tempfile.TemporaryDirectory() as directory:
        command = [sys.executable, "-m", module, *options, "--output", directory]
        began = time.perf_counter()
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        assert process.stderr is not None
        errors = process.stderr.read()
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - began
    code = os.waitstatus_to_exitcode(status)
    process.returncode = code
    if code not in (0, 2):
        raise SystemExit(f"{' '.join(command)} ended with {code}: {errors}")
    return {
        "seconds": round(seconds, 1),
        "cpu_seconds": round(usage.ru_utime + usage.ru_stime, 1),
        "peak_memory_mb": round(usage.ru_maxrss / 1024),
        "exit_code": code,
        **({"error": errors.strip()} if code else {}),
    }


def _repeated(flag: str, values: tuple[str, ...] | list[str]) -> list[str]:
    return [text for value in values for text in (flag, value)]


def _print_machine() -> None:
    import jax
    import jaxlib

    machine = {
        "system": "machine",
        "cores": os.cpu_count(),
        "device": str(jax.devices()[0]),
        "jax": jax.__version__,
        "jaxlib": jaxlib.__version__,
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
    }
    _print(machine)


def _print(line: dict[str, Any]) -> None:
    print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
