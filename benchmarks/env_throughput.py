"""How fast worlds step, beside their peers: `python -m benchmarks.env_throughput --help`.

Random actions, every observation consumed, episodes of different ages, fresh levels at turnover.
Each system runs in a process of its own, compiled and warm before the first repeat; then the
repeats go round the systems, so that whatever else the machine does falls on all alike. Prints
lines of JSON: the machine, one line for each world and system, ratios, and of several worlds a
summary.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, ClassVar, Self

import tyro

from benchmarks.env_lines import Line, Worlds, by_world, print_lines, ratios, read, summaries
from benchmarks.env_systems import PEERS, SYSTEMS, Job
from jaxact.errors import JaxactError, unknown

DEFAULT_IDS = (
    "MiniGrid-Empty-8x8-v0",
    "MiniGrid-FourRooms-v0",
    "MiniGrid-DoorKey-8x8-v0",
    "BabyAI-GoToLocal-v0",
)
PROGRAM = "benchmarks.env_throughput"


@dataclass(frozen=True)
class Arguments:
    """Times worlds under random actions, beside their peers, and prints lines of JSON."""

    known_peers: ClassVar[tuple[str, ...]] = PEERS

    ids: tuple[str, ...] = DEFAULT_IDS
    """Worlds, by Farama's ids."""
    all: bool = False
    """Every world there is, instead of --ids."""
    lanes: tuple[int, ...] = (2048,)
    """Worlds side by side; several numbers are measured one after the other."""
    steps: int = 1024
    """Steps of every lane in one repeat, enough for episode queues to be refilled in each (slow
    peers take a fraction of them; lines say it)."""
    repeats: int = 5
    """Repeats; the fastest and the median are reported."""
    peers: tuple[str, ...] = ()
    """Systems to measure beside jaxact: xminigrid, navix, envpool, minigrid."""
    devices: int | None = None
    """Devices that JAX systems shard their lanes over; on a CPU they are simulated (default: as
    many as there are cores, or accelerators)."""
    seed: int = 0
    """Of everything random."""
    variants: bool = True
    """Try each system in all its variants (for JAX systems: XLA flags) and report the fastest;
    without, the first one only."""
    output: Path | None = None
    """File for the lines, too, each as soon as it is there. Worlds that are in it already, from a
    run that was stopped, are not measured again."""


class Worker:
    """A process that measures one variant of one system."""

    def __init__(self, job: Job, environment: dict[str, str]) -> None:
        self.job, self.seconds = job, list[float]()
        self.facts: Line = {}
        self._errors: IO[str] = TemporaryFile("w+")  # noqa: SIM115 (closed in __exit__)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.env_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            env={**os.environ, **environment},
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._errors):
            with suppress(BrokenPipeError):
                if pipe is not None:
                    pipe.close()

    @property
    def works(self) -> bool:
        """Whether it can still be asked for repeats."""
        return not {"unsupported", "error"} & self.facts.keys()

    def start(self) -> None:
        """Lets it compile and warm up; returns when it is ready."""
        self._ask(json.dumps(asdict(self.job)))

    def repeat(self) -> None:
        """Runs one repeat."""
        if self.works:
            self._ask("repeat")
            if self.works:
                self.seconds.append(self.facts.pop("seconds"))

    def finish(self) -> None:
        """Ends the input and hears the last answer."""
        if self.works and self._process.stdin:
            self._process.stdin.close()
            self._hear()

    def _ask(self, line: str) -> None:
        with suppress(BrokenPipeError):  # It has died then; reading finds out why.
            print(line, file=self._process.stdin, flush=True)
        self._hear()

    def _hear(self) -> None:
        answer = self._process.stdout.readline() if self._process.stdout else ""
        self.facts |= json.loads(answer) if answer else {"error": self._last_words()}

    def _last_words(self) -> str:
        self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read().strip().splitlines()
        return lines[-1] if lines else f"the process ended with code {self._process.returncode}"


def main() -> None:
    """Runs the command line."""
    run(Arguments, PROGRAM)


def run(kind: type[Arguments], program: str) -> None:
    """Runs a command line with arguments of this kind."""
    arguments = tyro.cli(kind, prog=f"python -m {program}")
    try:
        lines = measure(arguments, read(arguments.output) if arguments.output else [])
        first = next(lines)  # All has been checked then, and the file may be written anew.
        print_lines(chain([first], lines), arguments.output)
    except JaxactError as error:
        print(f"{program}: {error}", file=sys.stderr)
        sys.exit(2)


def measure(arguments: Arguments, before: list[Line]) -> Iterator[Line]:
    """Yields the machine's line, one for each world, number of lanes and system, and the results.

    Args:
      arguments: what to measure.
      before: lines of a run that was stopped.

    Raises:
      JaxactError: an id, a peer or a number that cannot be, or a run before that was another.
    """
    ids = check(arguments)
    machine = describe_machine(arguments)
    if before and before[0] != machine:
        raise JaxactError(
            f"{arguments.output} is of another machine, or of other steps, repeats, seed or "
            "variants; give another --output"
        )
    yield machine
    done = {
        key: lines
        for key, lines in by_world(before).items()
        if [line["system"] for line in lines] == ["jaxact", *arguments.peers]
        and "error" not in lines[0]
    }
    for lines in done.values():
        yield from lines
    worlds: Worlds = {}
    for lanes in arguments.lanes:
        for name in ids:
            worlds[lanes, name] = done.get((lanes, name), [])
            if not worlds[lanes, name]:
                worlds[lanes, name] = measure_world(arguments, machine, name, lanes)
                yield from worlds[lanes, name]
    for lines in worlds.values():
        yield from ratios(lines)
    if len(ids) > 1:
        for lanes in arguments.lanes:
            yield from summaries([worlds[lanes, name] for name in ids])


def check(arguments: Arguments) -> list[str]:
    """Returns the ids to measure.

    Raises:
      JaxactError: an id, a peer or a number that cannot be.
    """
    import envs_jax

    for peer in arguments.peers:
        if peer not in arguments.known_peers:
            raise unknown("peer", peer, arguments.known_peers)
    for name in arguments.ids:
        envs_jax.make(name)
    numbers = {"lanes": min(arguments.lanes, default=0), "steps": arguments.steps}
    numbers |= {"repeats": arguments.repeats, "devices": arguments.devices or 1}
    for name, number in numbers.items():
        if number < 1:
            raise JaxactError(f"--{name} must be at least 1; got {number}")
    for lanes in arguments.lanes:
        if lanes % (arguments.devices or 1):
            raise JaxactError(f"{lanes} lanes cannot be divided among {arguments.devices} devices")
    return envs_jax.ids() if arguments.all else list(arguments.ids)


def describe_machine(arguments: Arguments) -> Line:
    """Returns the line about the machine."""
    job = Job("", "machine", 0, 0, 0, 1, "")
    with Worker(job, {}) as worker:
        worker.start()
        settings = ("steps", "repeats", "seed", "variants")
        return worker.facts | {name: getattr(arguments, name) for name in settings}


def measure_world(arguments: Arguments, machine: Line, name: str, lanes: int) -> list[Line]:
    """Returns one line for each system, measured in turns."""
    with ExitStack() as stack:

        def start(system: str, horizon: int = 0) -> list[Worker]:
            job = Job(name, system, lanes, arguments.steps, arguments.seed, 1, "", horizon)
            group = [
                stack.enter_context(make_worker(arguments, machine, replace(job, variant=variant)))
                for variant in variants_of(arguments, machine, system)
            ]
            for worker in group:
                worker.start()
            return group

        groups = [start("jaxact")]
        # Peers' episodes are as long as jaxact's.
        horizons = [worker.facts["horizon"] for worker in groups[0] if worker.works]
        if horizons:
            groups += [start(peer, horizons[0]) for peer in arguments.peers]
        workers = [worker for group in groups for worker in group]
        for _ in range(arguments.repeats):
            for worker in workers:
                worker.repeat()
        for worker in workers:
            worker.finish()
        return [summarise(group) for group in groups]


def variants_of(arguments: Arguments, machine: Line, system: str) -> tuple[str, ...]:
    """Returns the ways to run a system that are tried."""
    variants = SYSTEMS[system].variants
    user_chose = "xla_cpu_use_fusion_emitters" in machine.get("xla_flags", "")
    if SYSTEMS[system].is_jax and (machine.get("platform") != "cpu" or user_chose):
        return variants[:1]
    return variants if arguments.variants else variants[:1]


def make_worker(arguments: Arguments, machine: Line, job: Job) -> Worker:
    """Returns the process that measures one variant of one system, its steps and devices chosen."""
    devices, environment, lanes = 1, {}, job.lanes
    if SYSTEMS[job.system].is_jax:
        on_cpu = machine.get("platform") == "cpu"
        present = machine["cores"] if on_cpu else machine.get("devices", 1)
        # Without a number from the user: as many as there are, if the lanes can be shared out.
        devices = arguments.devices or (present if lanes % present == 0 else 1)
        flags = f"{os.environ.get('XLA_FLAGS', '')} {job.variant}".strip()
        environment = {"XLA_FLAGS": flags, "JAX_NUM_CPU_DEVICES": str(devices)}
        if devices > 1:
            # Shardy of jaxlib 0.10 cannot compile philox ("Unable to convert MHLO to StableHLO").
            environment["JAX_USE_SHARDY_PARTITIONER"] = "false"
    steps = max(1, round(job.steps * SYSTEMS[job.system].share))
    return Worker(replace(job, steps=steps, devices=devices), environment)


def summarise(group: list[Worker]) -> Line:
    """Returns the line of a system: that of its fastest variant."""
    working = [worker for worker in group if worker.works and worker.seconds]
    head = {"id": group[0].job.id, "system": group[0].job.system}
    if not working:
        return head | {"lanes": group[0].job.lanes} | group[0].facts
    rates = {w.job.variant: _rate(w, min(w.seconds)) for w in working}
    best = max(working, key=lambda worker: rates[worker.job.variant])
    system, facts = SYSTEMS[best.job.system], best.facts
    taken = len(best.seconds) * best.job.steps * facts["lanes"]
    agents = {"agents": facts["agents"]} if "agents" in facts else {}
    line = head | {
        "lanes": facts["lanes"],
        **agents,
        "steps_per_second": rates[best.job.variant],
        "steps_per_second_median": _rate(best, statistics.median(best.seconds)),
        "steps_per_second_mean": _rate(best, statistics.mean(best.seconds)),
        "compile_seconds": round(facts["compile_seconds"], 2),
        "peak_memory_mb": round(facts["peak_memory_mb"], 1),
        "steps": best.job.steps,
        "repeats": len(best.seconds),
        "devices": best.job.devices,
        "variant": best.job.variant or "default",
        "prng": system.prng,
        "episodes_per_step": round(facts["finished"] / taken, 6),
        "checksum": facts["checksum"],
        "observation": facts.get("observation", system.observation),
        "turnover": system.turnover,
    }
    others = {name or "default": rate for name, rate in rates.items() if name != best.job.variant}
    return line | ({"other_variants": others} if others else {})


def _rate(worker: Worker, seconds: float) -> float:
    return round(worker.facts["lanes"] * worker.job.steps / seconds, 1)


if __name__ == "__main__":
    main()
