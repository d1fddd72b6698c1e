"""How fast houses are seen in the first person: `python -m benchmarks.house_throughput --help`.

PointNav is walked at random, as are houses by the camera alone, and every pixel is consumed. All
systems are compiled and warm before the first repeat; then the repeats go round them, so that
whatever else the machine does falls on all alike. Prints lines of JSON: the machine, then one for
each system and size.
"""

from __future__ import annotations

import os
import statistics
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import jax
import tyro

from benchmarks.env_lines import Line, print_lines
from benchmarks.env_systems import Facts, Running, Unsupported
from benchmarks.env_worker import machine
from benchmarks.house_systems import OWN, PEERS, READINGS, SYSTEMS, Job
from jaxact.errors import JaxactError, unknown

PROGRAM = "benchmarks.house_throughput"


@dataclass(frozen=True)
class Arguments:
    """Times pictures of houses, beside those of peers, and prints lines of JSON."""

    readings: tuple[str, ...] = ("depth", "rgb")
    """What jaxact's camera takes: depth, instance, depth+semantic, rgb, "rgb 2x2"."""
    pixels: tuple[int, ...] = (32, 64)
    """Edges of pictures."""
    boxes: tuple[int, ...] = (64,)
    """Boxes of a house."""
    lanes: tuple[int, ...] = (256,)
    """Houses side by side."""
    steps: int = 64
    """Pictures of each lane in a repeat (PointNav takes 8 times as many, so that its queues of
    episodes are refilled; peers, of which there is one lane, take more too)."""
    repeats: int = 5
    """Repeats; the fastest and the median are reported."""
    peers: tuple[str, ...] = ()
    """Systems to measure beside jaxact: miniworld, vizdoom."""
    devices: int | None = None
    """Devices that jaxact's lanes are sharded over; on a CPU they are simulated (default: as many
    as there are cores, or accelerators)."""
    seed: int = 0
    """Of everything random."""
    output: Path | None = None
    """File for the lines, too."""


def main() -> None:
    """Runs the command line."""
    arguments = tyro.cli(Arguments, prog=f"python -m {PROGRAM}")
    try:
        check(arguments)
    except JaxactError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        sys.exit(2)
    jax.config.update("jax_num_cpu_devices", arguments.devices or os.cpu_count() or 1)
    # Shardy of jaxlib 0.10 cannot compile philox ("Unable to convert MHLO to StableHLO").
    jax.config.update("jax_use_shardy_partitioner", False)
    print_lines(measure(arguments), arguments.output)


def check(arguments: Arguments) -> None:
    """Raises JaxactError for a name or a number that cannot be."""
    for peer in arguments.peers:
        if peer not in PEERS:
            raise unknown("peer", peer, PEERS)
    for reading in arguments.readings:
        if reading not in READINGS:
            raise unknown("reading", reading, READINGS)
    for name in ("pixels", "boxes", "lanes", "steps", "repeats", "devices"):
        value = getattr(arguments, name)
        least = min(value, default=0) if isinstance(value, tuple) else value
        if least is not None and least < 1:
            raise JaxactError(f"--{name} must be at least 1; got {least}")
    for lanes in arguments.lanes:
        if lanes % (arguments.devices or 1):
            raise JaxactError(f"{lanes} lanes cannot be divided among {arguments.devices} devices")


def measure(arguments: Arguments) -> Iterator[Line]:
    """Yields the machine's line and, for each size, those of all systems, measured in turns."""
    settings = ("steps", "repeats", "seed")
    yield machine() | {name: getattr(arguments, name) for name in settings}
    devices = arguments.devices or jax.device_count()
    for lanes, boxes, pixels in product(arguments.lanes, arguments.boxes, arguments.pixels):
        shared = devices if lanes % devices == 0 else 1

        def job(
            system: str,
            reading: str,
            size: tuple[int, int, int] = (lanes, boxes, pixels),
            shared: int = shared,
        ) -> Job:
            lanes, boxes, pixels = size
            steps = max(1, round(arguments.steps * SYSTEMS[system].share))
            seed = arguments.seed
            return Job(system, reading, pixels, boxes, lanes, steps, seed, shared)

        jobs = [job(system, reading) for system in OWN for reading in arguments.readings]
        yield from measure_in_turns(
            jobs + [job(peer, "") for peer in arguments.peers], arguments.repeats
        )


def measure_in_turns(jobs: list[Job], repeats: int) -> Iterator[Line]:
    """Yields the line of each job; those that cannot run say why."""
    running: list[tuple[Job, Running, Facts, list[float]]] = []
    for job in jobs:
        head = {"system": job.system, "pixels": (job.pixels, job.pixels)}
        try:
            loop, facts = SYSTEMS[job.system].build(job)
        except Unsupported as error:
            yield head | {"unsupported": str(error)}
        else:
            running.append((job, loop, head | facts, []))
    for _ in range(repeats):
        for _, loop, _, seconds in running:
            seconds.append(loop.run())
    for job, loop, facts, seconds in running:
        yield facts | summarise(job, loop, facts, seconds)


def summarise(job: Job, loop: Running, facts: dict[str, Any], seconds: list[float]) -> Line:
    """Returns what was measured of a job."""
    frames = job.steps * facts.get("lanes", 1)
    devices = job.devices if job.system in OWN else 1
    tallies = loop.tallies()
    return {
        "frames_per_second": round(frames / min(seconds), 1),
        "frames_per_second_per_device": round(frames / min(seconds) / devices, 1),
        "frames_per_second_median": round(frames / statistics.median(seconds), 1),
        "compile_seconds": round(loop.compile_seconds, 2),
        "steps": job.steps,
        "repeats": len(seconds),
        "devices": devices,
        "episodes": tallies["finished"],
        "checksum": tallies["checksum"],
        "observation": SYSTEMS[job.system].observation,
        "does": SYSTEMS[job.system].does,
    }


if __name__ == "__main__":
    main()
