"""Simulators outside of JAX, and which episode each of them plays.

A compiled program holds tickets in place of worlds. A ticket names an episode, the simulator that
plays it and how far it is; a ticket that is not the latest of its episode is refused, so that no
call that is lost, doubled or out of order goes unnoticed. Which simulator plays an episode has no
part in what happens in it, for every episode begins with a reset to a seed of its own.
"""

from __future__ import annotations

import atexit
import contextlib
import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from jaxact.errors import JaxactError
from jaxact.simulator_hosts import Answer, Host, Reading, Request, Simulator

# The columns of tickets, uint32 [N, 6].
HELD_OUT, SIMULATOR, EPISODE, STEPS, HORIZON = 0, 1, slice(2, 4), 4, 5
WIDTH = 6
# The columns of `simulator_hosts.Reading.numbers` before the metrics.
REWARD, TERMINATED, TRUNCATED, SUCCESS = range(4)


def seed_of(episode: Any) -> Any:
    """Returns the seed that an episode is reset to, in 0 … 2³¹ − 1.

    Args:
      episode: uint32 [..., 2], the ticket's words of it.
    """
    return episode[..., 0] >> 1


@dataclass
class _Slot:
    """What a simulator is doing."""

    episode: tuple[int, int] | None = None
    steps: int = 0
    over: bool = True
    touched: int = 0
    first: Reading | None = None


@dataclass
class Simulators:
    """Up to `limit` simulators, and the episodes they play.

    A new episode goes to a simulator whose episode is over; if there is none to one that is not
    made yet; and if all are made to the one that was idle the longest, whose own is then given up.

    Attributes:
      host: where they run.
      limit: at most how many.
      shapes: of the arrays of an observation.
      metrics: M, how many metrics there are.
      kind: what errors call them.
    """

    host: Host
    limit: int
    shapes: Sequence[jax.ShapeDtypeStruct]
    metrics: int
    kind: str = "worlds"
    _slots: list[_Slot] = field(default_factory=list, init=False)
    _lock: threading.RLock = field(default_factory=threading.RLock, init=False)
    _clock: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        atexit.register(self.close)

    def adopt(self, simulator: Simulator) -> None:
        """Takes in one that is made already."""
        self.host.adopt(len(self._slots), simulator)
        self._slots.append(_Slot())

    def begin(self, tickets: np.ndarray) -> tuple[np.ndarray, ...]:
        """Begins episodes.

        Args:
          tickets: uint32 [N, 6]. One that is asked for twice, or again before its first step, is
            begun once.

        Returns:
          uint32 [N], the simulators that play them; numbers and observations [N, ...] as in
          `Reading`.

        Raises:
          JaxactError: there are fewer simulators, or one of them fails.
        """
        with self._lock:
            self._clock += 1
            rows = [self._slot_for(ticket) for ticket in tickets]
            new = {row: t for row, t in zip(rows, tickets, strict=True) if self._is_new(row)}
            for row in new:
                self._slots[row].steps, self._slots[row].over = 0, False
            seeds = {row: int(seed_of(ticket[EPISODE])) for row, ticket in new.items()}
            for row, reading in self._asked(seeds, new).items():
                self._slots[row].first = reading
            readings = [self._slots[row].first for row in rows]
            return np.asarray(rows, np.uint32), *self._joined(readings)

    def step(
        self, tickets: np.ndarray, active: np.ndarray, *actions: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Takes a step in the episodes that are active.

        Args:
          tickets: uint32 [N, 6].
          active: bool [N].
          *actions: the leaves of the actions' tree [N, ...].

        Returns:
          Numbers and observations [N, ...] as in `Reading`; zeros of those that are not active.

        Raises:
          JaxactError: a ticket is not the latest of its episode, or a simulator fails.
        """
        with self._lock:
            self._clock += 1
            lanes: dict[int, int] = {}
            for lane in np.flatnonzero(active).tolist():
                lanes[self._slot_at(tickets[lane])] = lane
            actions_of: dict[int, Request] = {
                row: tuple(leaf[lane] for leaf in actions) for row, lane in lanes.items()
            }
            played = {row: tickets[lane] for row, lane in lanes.items()}
            readings: list[Reading | None] = [None] * len(tickets)
            for row, reading in self._asked(actions_of, played).items():
                slot = self._slots[row]
                slot.steps += 1
                ended = bool(reading.numbers[TERMINATED] or reading.numbers[TRUNCATED])
                slot.over = ended or slot.steps >= int(played[row][HORIZON])
                readings[lanes[row]] = reading
            return self._joined(readings)

    def close(self) -> None:
        """Closes all simulators; episodes in play are given up."""
        with self._lock:
            self._slots.clear()
            self.host.close()

    def _slot_for(self, ticket: np.ndarray) -> int:
        """Chooses who plays a new episode, and gives it to them."""
        episode = _episode(ticket)
        for row, slot in enumerate(self._slots):
            if slot.episode == episode:
                slot.touched = self._clock
                return row
        free = [row for row, slot in enumerate(self._slots) if slot.over and not self._just(slot)]
        if not free and len(self._slots) < self.limit:
            self._slots.append(_Slot())
            free = [len(self._slots) - 1]
        idle = free or [row for row, slot in enumerate(self._slots) if not self._just(slot)]
        if not idle:
            raise JaxactError(
                f"more episodes are to begin at once than there are simulators, {self.limit}: "
                "have no more lanes than simulators"
            )
        chosen = min(idle, key=lambda row: self._slots[row].touched)
        slot = self._slots[chosen]
        slot.episode, slot.first, slot.touched = episode, None, self._clock
        return chosen

    def _just(self, slot: _Slot) -> bool:
        """Whether a simulator was given an episode in this very call."""
        return slot.touched == self._clock

    def _is_new(self, row: int) -> bool:
        slot = self._slots[row]
        return slot.first is None or slot.steps > 0 or slot.over

    def _slot_at(self, ticket: np.ndarray) -> int:
        """Returns the number of the simulator that a ticket is the latest of."""
        number, steps = int(ticket[SIMULATOR]), int(ticket[STEPS])
        slot = self._slots[number] if number < len(self._slots) else None
        if slot is None or slot.episode != _episode(ticket) or slot.first is None:
            found = "no simulator is playing its episode any more"
        elif slot.touched == self._clock:
            found = "another lane is playing the same episode"
        elif slot.over or slot.steps != steps:
            found = f"its simulator is at step {slot.steps} already"
        else:
            slot.touched = self._clock
            return number
        raise JaxactError(
            f"a state at step {steps} of the episode with seed {seed_of(ticket[EPISODE])} was to "
            f"be stepped from, but {found}: worlds outside of JAX go on from their latest state "
            "alone, can be neither copied nor saved, and each lane needs a simulator of its own"
        )

    def _asked(
        self, requests: Mapping[int, Request], tickets: Mapping[int, np.ndarray]
    ) -> dict[int, Reading]:
        """Resets or steps simulators, by their numbers; of several failures the first is raised.

        One that fails is closed, and its episode given up.
        """
        failure: JaxactError | None = None
        readings: dict[int, Reading] = {}
        for row, answer in self.host.ask(requests).items():
            checked = self._checked(answer)
            if isinstance(checked, Reading):
                readings[row] = checked
                continue
            slot = self._slots[row]
            when = "reset" if isinstance(requests[row], int) else f"step {slot.steps}"
            seed = seed_of(tickets[row][EPISODE])
            blamed = JaxactError(
                f"simulator {row} of {self.kind} failed at {when} of the episode with seed {seed}: "
                f"{checked}"
            )
            blamed.__cause__ = checked.__cause__
            failure = failure or blamed
            slot.episode, slot.over = None, True
            self.host.discard(row)
        if failure is not None:
            raise failure
        return readings

    def _checked(self, answer: Answer) -> Answer:
        if isinstance(answer, Reading):
            for seen, expected in zip(answer.observation, self.shapes, strict=True):
                if (seen.shape, seen.dtype) != (expected.shape, expected.dtype):
                    return JaxactError(
                        f"it observed {seen.dtype}{list(seen.shape)}, but its space says "
                        f"{expected.dtype}{list(expected.shape)}"
                    )
        return answer

    def _joined(self, readings: Sequence[Reading | None]) -> tuple[np.ndarray, ...]:
        """Puts readings side by side."""
        count = len(readings)
        numbers = np.zeros((count, SUCCESS + 1 + self.metrics), np.float32)
        seen = [np.zeros((count, *shape.shape), shape.dtype) for shape in self.shapes]
        for row, reading in enumerate(readings):
            if reading is not None:
                numbers[row] = reading.numbers
                for array, leaf in zip(seen, reading.observation, strict=True):
                    array[row] = leaf
        return numbers, *seen


def _episode(ticket: np.ndarray) -> tuple[int, int]:
    first, second = ticket[EPISODE].tolist()
    return first, second


_failures: list[JaxactError] = []


def called_back(work: Callable[..., tuple[np.ndarray, ...]]) -> Callable[..., Any]:
    """Makes what a compiled program can call of a function of arrays; see `explained`."""

    def call(*arguments: Any) -> tuple[np.ndarray, ...]:
        try:
            return work(*(np.asarray(argument) for argument in arguments))
        except JaxactError as error:
            _failures.append(error)
            raise

    return call


@contextlib.contextmanager
def explained() -> Iterator[None]:
    """Raises the failure of a simulator as it was, in place of what XLA makes of it."""
    _failures.clear()
    try:
        yield
    except jax.errors.JaxRuntimeError:
        if not _failures:
            raise
        failure = _failures[0]
        raise failure from failure.__cause__


class _Explained(logging.Filter):
    """Keeps JAX from printing a traceback of what `explained` raises."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Returns whether it is something else."""
        return not (record.exc_info and isinstance(record.exc_info[1], JaxactError))


logging.getLogger("jax._src.callback").addFilter(_Explained())
