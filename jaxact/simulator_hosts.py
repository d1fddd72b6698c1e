"""Where simulators run: the protocol of it, and the process of the caller.

A host keeps simulators by number, and makes each when it is first asked for. What fails there comes
back as an answer, so that one simulator's failure does not keep the others' answers back. See
`jaxact.simulator_processes` for the host whose simulators run in processes of their own.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from jaxact.errors import JaxactError

# A seed to reset to, or the leaves of an action's tree.
Request = int | tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Reading:
    """What a simulator says after a reset or a step.

    Attributes:
      observation: arrays, in an order of the simulator's own.
      numbers: float32 [4 + M]: the reward, whether the episode terminated and was truncated (0 or
        1), whether it is a success (-1 if the simulator does not say), and M metrics.
    """

    observation: tuple[np.ndarray, ...]
    numbers: np.ndarray


Answer = Reading | JaxactError


class Simulator(Protocol):
    """One world, somewhere."""

    def reset(self, seed: int) -> Reading:
        """Begins the episode of a seed."""
        ...

    def step(self, action: tuple[np.ndarray, ...]) -> Reading:
        """Takes one step; an action is given by the leaves of its tree."""
        ...

    def close(self) -> None:
        """Frees what the simulator holds."""
        ...


class Host(Protocol):
    """Where numbered simulators run."""

    def adopt(self, number: int, simulator: Simulator) -> None:
        """Takes over one that the caller made to learn its spaces, or closes it."""
        ...

    def ask(self, requests: Mapping[int, Request]) -> dict[int, Answer]:
        """Resets or steps simulators, by their numbers.

        Returns:
          What each answers; a JaxactError, whose cause is the error, if it failed.
        """
        ...

    def discard(self, number: int) -> None:
        """Closes a simulator; asked for again it is made anew."""
        ...

    def close(self) -> None:
        """Closes all."""
        ...


@dataclass
class LocalHost:
    """Simulators in the caller's process.

    Attributes:
      make: makes one.
      threads: how many are asked at once, where they let other threads run meanwhile; with 0 one
        follows the other.
    """

    make: Callable[[], Simulator]
    threads: int = 0
    _made: dict[int, Simulator] = field(default_factory=dict, init=False)
    _workers: ThreadPoolExecutor | None = field(default=None, init=False)

    def adopt(self, number: int, simulator: Simulator) -> None:
        """Takes over one that is made already."""
        self._made[number] = simulator

    def ask(self, requests: Mapping[int, Request]) -> dict[int, Answer]:
        """Resets or steps simulators; see `Host.ask`."""

        def one(number: int) -> Answer:
            return answer(self._made, self.make, number, requests[number])

        if self.threads == 0 or len(requests) < 2:
            return {number: one(number) for number in requests}
        if self._workers is None:
            self._workers = ThreadPoolExecutor(self.threads, "simulators")
        return dict(zip(requests, self._workers.map(one, requests), strict=True))

    def discard(self, number: int) -> None:
        """Closes a simulator, whatever state it is in."""
        simulator = self._made.pop(number, None)
        if simulator is not None:
            with contextlib.suppress(Exception):
                simulator.close()

    def close(self) -> None:
        """Closes all."""
        for number in tuple(self._made):
            self.discard(number)
        if self._workers is not None:
            self._workers.shutdown()
            self._workers = None


def answer(
    made: dict[int, Simulator], make: Callable[[], Simulator], number: int, request: Request
) -> Answer:
    """Resets or steps one simulator.

    Args:
      made: the simulators that there are; one to be reset is added if it is not there.
      make: makes one.
      number: which.
      request: a seed, or an action.
    """
    try:
        if isinstance(request, int):
            if number not in made:
                made[number] = make()
            return made[number].reset(request)
        if number not in made:
            raise JaxactError("it ended before, with the process that it was in")
        return made[number].step(request)
    except Exception as error:
        kind = "" if isinstance(error, JaxactError) else f"{type(error).__name__}: "
        failure = JaxactError(f"{kind}{error}")
        failure.__cause__ = error
        return failure
