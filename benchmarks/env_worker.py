"""One process that measures one system on one world: `python -m benchmarks.env_worker`.

`benchmarks.env_throughput` starts it and talks to it in lines of JSON. The first line in is a
`Job`; the first line out says that the program is compiled and warm. Each further line in asks for
one repeat and is answered with its seconds. At the end of the input the process says what it saw.
"""

from __future__ import annotations

import json
import os
import platform
import resource
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TextIO

from benchmarks.env_systems import Job, Unsupported, build

PACKAGES = ("jax", "jaxlib", "flax", "numpy", "xminigrid", "navix", "envpool", "minigrid")
PACKAGES += ("miniworld", "vizdoom", "jaxmarl")


def main() -> None:
    """Serves one job."""
    # Whatever libraries print goes to stderr; the real stdout carries the answers.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    job = json.loads(sys.stdin.readline())
    if job["system"] == "machine":
        _say(answers, machine())
        return
    try:
        running, facts = build(Job(**job))
    except Unsupported as error:
        _say(answers, {"unsupported": str(error)})
        return
    except Exception as error:
        _say(answers, {"error": f"{type(error).__name__}: {error}"})
        return
    before = running.tallies()
    _say(answers, facts | {"compile_seconds": running.compile_seconds})
    for _ in sys.stdin:
        _say(answers, {"seconds": running.run()})
    after = running.tallies()
    _say(
        answers,
        {
            "checksum": after["checksum"],
            "finished": after["finished"] - before["finished"],
            "peak_memory_mb": peak_memory_mb(),
        },
    )


def _say(answers: TextIO, message: dict[str, Any]) -> None:
    print(json.dumps(message), file=answers, flush=True)


def peak_memory_mb() -> float:
    """Returns the most memory this process has held, in megabytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


def machine() -> dict[str, Any]:
    """Returns hardware, versions and settings that figures depend on."""
    import jax

    device = jax.devices()[0]
    return {
        "system": "machine",
        "processor": _processor(),
        "cores": os.cpu_count(),
        "platform": device.platform,
        "device": device.device_kind,
        "devices": jax.device_count(),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in PACKAGES},
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


if __name__ == "__main__":
    main()
