"""A simulator that does what it is told, for the tests of where simulators run."""

from __future__ import annotations

import os
import sys
import time

import numpy as np

from jaxact.simulator_hosts import Reading

COUNT, RAISE, HANG, EXIT = range(4)


class Unruly:
    """Says the seed it was reset to, how often it was made to count, and its process."""

    def reset(self, seed: int) -> Reading:
        self.seed, self.total = seed, 0
        return self._reading()

    def step(self, action: tuple[np.ndarray, ...]) -> Reading:
        match int(action[0]):
            case 1:
                raise RuntimeError("a joint is out of order")
            case 2:
                time.sleep(600)
            case 3:
                sys.exit(7)
        self.total += 1
        return self._reading()

    def close(self) -> None:
        raise OSError("nothing is closed")

    def _reading(self) -> Reading:
        seen = np.array([self.seed, self.total, os.getpid()], np.int64)
        return Reading((seen,), np.zeros(4, np.float32))
