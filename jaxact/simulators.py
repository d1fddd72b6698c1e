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
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Any, Protocol

import jax
import numpy as np

from jaxact.errors import JaxactError

# The columns of tickets, uint32 [N, 6].
HELD_OUT, SIMULATOR, EPISODE, STEPS, HORIZON = 0, 1, slice(2, 4), 4, 5
WIDTH = 6
# The columns of `Reading.numbers` before the metrics.
REWARD, TERMINATED, TRUNCATED, SUCCESS = range(4)


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


def seed_of(episode: Any) -> Any:
    """Returns the seed that an episode is reset to, in 0 … 2³¹ − 1.

    Args:
      episode: uint32 [..., 2], the ticket's words of it.
    """
    return episode[..., 0] >> 1


@dataclass
class _Slot:
    """A simulator, made when it is first needed, and what it is doing."""

    simulator: Simulator | None = None
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
      make: makes one.
      limit: at most how many.
      threads: how many are stepped at once, where they let other threads run meanwhile; with 0
        one follows the other.
      shapes: of the arrays of an observation.
      metrics: M, how many metrics there are.
    """

    make: Callable[[], Simulator]
    limit: int
    threads: int
    shapes: Sequence[jax.ShapeDtypeStruct]
    metrics: int
    _slots: list[_Slot] = field(default_factory=list, init=False)
    _lock: threading.RLock = field(default_factory=threading.RLock, init=False)
    _clock: int = field(default=0, init=False)
    _workers: ThreadPoolExecutor | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        atexit.register(self.close)

    def adopt(self, simulator: Simulator) -> None:
        """Takes in one that is made already."""
        self._slots.append(_Slot(simulator))

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
            self._run([self._reset_job(self._slots[row], ticket) for row, ticket in new.items()])
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
            readings: list[Reading | None] = [None] * len(tickets)
            jobs = []
            for row in np.flatnonzero(active).tolist():
                slot = self._slot_at(tickets[row])
                action = tuple(leaf[row] for leaf in actions)
                jobs.append(self._step_job(slot, tickets[row], action, readings, row))
            self._run(jobs)
            return self._joined(readings)

    def close(self) -> None:
        """Closes all simulators; episodes in play are given up."""
        with self._lock:
            for slot in self._slots:
                _discard(slot)
            self._slots.clear()
            if self._workers is not None:
                self._workers.shutdown()
                self._workers = None

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

    def _slot_at(self, ticket: np.ndarray) -> _Slot:
        """Returns the simulator that a ticket is the latest of."""
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
            return slot
        raise JaxactError(
            f"a state at step {steps} of the episode with seed {seed_of(ticket[EPISODE])} was to "
            f"be stepped from, but {found}: worlds outside of JAX go on from their latest state "
            "alone, can be neither copied nor saved, and each lane needs a simulator of its own"
        )

    def _reset_job(self, slot: _Slot, ticket: np.ndarray) -> Callable[[], None]:
        def job() -> None:
            slot.steps, slot.over = 0, False
            try:
                if slot.simulator is None:
                    slot.simulator = self.make()
                slot.first = self._checked(slot.simulator.reset(int(seed_of(ticket[EPISODE]))))
            except Exception as error:
                raise _blame(slot, ticket, "reset", error) from error

        return job

    def _step_job(
        self,
        slot: _Slot,
        ticket: np.ndarray,
        action: tuple[np.ndarray, ...],
        readings: list[Reading | None],
        row: int,
    ) -> Callable[[], None]:
        def job() -> None:
            assert slot.simulator is not None
            try:
                reading = self._checked(slot.simulator.step(action))
            except Exception as error:
                raise _blame(slot, ticket, f"step {slot.steps}", error) from error
            slot.steps += 1
            ended = bool(reading.numbers[TERMINATED] or reading.numbers[TRUNCATED])
            slot.over = ended or slot.steps >= int(ticket[HORIZON])
            readings[row] = reading

        return job

    def _run(self, jobs: Sequence[Callable[[], None]]) -> None:
        """Does all jobs; of several failures the first one is raised."""
        if self.threads == 0 or len(jobs) < 2:
            for job in jobs:
                job()
            return
        if self._workers is None:
            self._workers = ThreadPoolExecutor(self.threads, "simulators")
        futures = [self._workers.submit(job) for job in jobs]
        wait(futures)
        for future in futures:
            future.result()

    def _checked(self, reading: Reading) -> Reading:
        for seen, expected in zip(reading.observation, self.shapes, strict=True):
            if (seen.shape, seen.dtype) != (expected.shape, expected.dtype):
                raise JaxactError(
                    f"it observed {seen.dtype}{list(seen.shape)}, but its space says "
                    f"{expected.dtype}{list(expected.shape)}"
                )
        return reading

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


def _discard(slot: _Slot) -> None:
    """Closes a simulator, whatever state it is in."""
    simulator, slot.simulator, slot.episode, slot.over = slot.simulator, None, None, True
    if simulator is not None:
        with contextlib.suppress(Exception):
            simulator.close()


def _blame(slot: _Slot, ticket: np.ndarray, when: str, error: Exception) -> JaxactError:
    """Says when something failed in a simulator, which is not used again."""
    _discard(slot)
    kind = "" if isinstance(error, JaxactError) else f"{type(error).__name__}: "
    seed = seed_of(ticket[EPISODE])
    return JaxactError(
        f"a simulator failed at {when} of the episode with seed {seed}: {kind}{error}"
    )


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
