"""How much memory there is."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

_MEMINFO = Path("/proc/meminfo")
# Where a container's limit and what it uses are found.
_CGROUP = Path("/sys/fs/cgroup")


def free_bytes(device: Any) -> float:
    """Returns the free memory of a device, of the host for a CPU; infinity where nobody knows."""
    if device.platform != "cpu":
        stats = device.memory_stats() or {}
        limit = stats.get("bytes_limit")
        return math.inf if limit is None else limit - stats.get("bytes_in_use", 0)
    if not _MEMINFO.exists():
        return math.inf
    lines = dict(line.split(":", 1) for line in _MEMINFO.read_text().splitlines())
    available = float(lines["MemAvailable"].split()[0]) * 1024
    try:
        limit, used = ((_CGROUP / f"memory.{x}").read_text() for x in ("max", "current"))
        return min(available, int(limit) - int(used))
    except (OSError, ValueError):  # no such control group, or one without a limit
        return available
