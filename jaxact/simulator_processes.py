"""Simulators in processes of their own, for those that hold Python's lock or a GPU's context.

Each process is a new interpreter, nothing forked: JAX has threads, and a GPU's context does not
outlive a fork. It is told what to do by one message for all of its simulators, does that in order,
and answers for each. It knows neither the program that started it nor the others, and ends when its
connection does: with the program, however that ends.

Gymnasium's `AsyncVectorEnv` has a process for each environment and steps all of them at once;
episodes here begin and end each at its own time, in no more processes than there are cores.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.machinery import PathFinder
from multiprocessing.connection import Connection, wait
from typing import Any

import cloudpickle

from jaxact.errors import JaxactError
from jaxact.simulator_hosts import Answer, Request, Simulator, answer

# Seconds that a process has to close its simulators.
_GRACE = 10.0
# Seconds that one has to end whose connection has ended.
_MOMENT = 5.0
_SERVE = "from jaxact.simulator_processes import serve; serve({descriptor})"


class RemoteError(Exception):
    """An error in another process, as its traceback there."""


@dataclass
class _Process:
    """One process, and the simulators' numbers that it has yet to answer for, in order."""

    popen: subprocess.Popen[bytes]
    connection: Connection
    asked: list[int] = field(default_factory=list)
    deadline: float = 0.0


@dataclass
class ProcessHost:
    """Simulators spread over processes: number n is in process n modulo how many there are.

    Attributes:
      make: makes one; sent to the processes by cloudpickle.
      processes: how many.
      timeout: seconds that a simulator may take for one answer, the start of its process included.

    Raises:
      JaxactError: `make` cannot be sent.
    """

    make: Callable[[], Simulator]
    processes: int
    timeout: float
    _pickled: bytes = field(init=False)
    _running: dict[int, _Process] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self._pickled = _pickled(self.make)

    def adopt(self, number: int, simulator: Simulator) -> None:
        """Closes one of the caller's process."""
        del number
        simulator.close()

    def ask(self, requests: Mapping[int, Request]) -> dict[int, Answer]:
        """Resets or steps simulators, all processes at once; see `Host.ask`."""
        answers: dict[int, Answer] = {}
        shares: dict[int, list[tuple[int, Request]]] = {}
        for number, request in requests.items():
            shares.setdefault(number % self.processes, []).append((number, request))
        for place in shares.keys() - self._running.keys():
            self._running[place] = _started(self._pickled)
        try:
            for place, share in shares.items():
                self._send(place, share, answers)
            while waiting := {p: x for p, x in self._running.items() if x.asked}:
                self._receive(waiting, answers)
        finally:
            # Only if this was itself interrupted is one left that owes an answer.
            for place in [place for place, process in self._running.items() if process.asked]:
                self._end(place, 0.0)
        return {number: answers[number] for number in requests}

    def discard(self, number: int) -> None:
        """Closes a simulator."""
        process = self._running.get(number % self.processes)
        if process is not None:
            with contextlib.suppress(OSError):
                process.connection.send([(number, None)])

    def close(self) -> None:
        """Has all simulators closed, and the processes end."""
        for process in self._running.values():
            process.connection.close()
        limit = time.monotonic() + _GRACE
        for place in tuple(self._running):
            self._end(place, max(limit - time.monotonic(), 0.0))

    def _send(
        self, place: int, share: list[tuple[int, Request]], answers: dict[int, Answer]
    ) -> None:
        process = self._running[place]
        process.asked = [number for number, _ in share]
        process.deadline = time.monotonic() + self.timeout
        try:
            process.connection.send(share)
        except OSError:
            self._fail(place, answers)

    def _receive(self, waiting: Mapping[int, _Process], answers: dict[int, Answer]) -> None:
        """Takes what answers there are, and gives up those who took too long."""
        left = min(process.deadline for process in waiting.values()) - time.monotonic()
        ready = wait([process.connection for process in waiting.values()], max(left, 0.0))
        for place, process in waiting.items():
            if process.connection in ready:
                try:
                    number, said = process.connection.recv()
                except (EOFError, OSError):
                    self._fail(place, answers)
                    continue
                process.asked.remove(number)
                process.deadline = time.monotonic() + self.timeout
                answers[number] = _failure(*said) if isinstance(said, tuple) else said
            elif time.monotonic() >= process.deadline:
                self._fail(place, answers)

    def _fail(self, place: int, answers: dict[int, Answer]) -> None:
        """Ends a process that broke off or takes too long, and answers for it."""
        process = self._running[place]
        late = time.monotonic() >= process.deadline
        code = self._end(place, 0.0 if late else _MOMENT)
        if late:
            why = f"no answer within {self.timeout:g} s"
        elif code < 0:
            why = f"its process was ended by {signal.Signals(-code).name}"
        else:
            why = f"its process ended with exit code {code}"
        answers.update((number, JaxactError(why)) for number in process.asked)

    def _end(self, place: int, patience: float) -> int:
        """Ends a process, and those it has started; returns its exit code."""
        process = self._running.pop(place)
        process.connection.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.popen.wait(patience)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.popen.pid, signal.SIGKILL)
        return process.popen.wait()


def serve(descriptor: int) -> None:
    """Runs simulators until the connection ends: what a process of `ProcessHost` does.

    Args:
      descriptor: of the connection's socket.
    """
    connection = Connection(descriptor)
    made: dict[int, Simulator] = {}
    try:
        make = _unpickled(connection.recv_bytes())
        while True:
            for number, request in connection.recv():
                if request is None:
                    _close(made, number)
                    continue
                said = answer(made, make, number, request)
                if isinstance(said, JaxactError):
                    trace = "".join(traceback.format_exception(said.__cause__))
                    connection.send((number, (str(said), trace)))
                else:
                    connection.send((number, said))
    except (EOFError, ConnectionError):
        pass
    finally:
        for number in tuple(made):
            _close(made, number)


def _unpickled(pickled: bytes) -> Callable[[], Simulator]:
    """Returns what makes a simulator; if it cannot be had here, what says so for each."""
    try:
        make: Callable[[], Simulator] = cloudpickle.loads(pickled)
    except Exception as error:
        failure = error

        def make() -> Simulator:
            raise failure

    return make


def _close(made: dict[int, Simulator], number: int) -> None:
    simulator = made.pop(number, None)
    if simulator is not None:
        with contextlib.suppress(Exception):
            simulator.close()


def _failure(sentence: str, trace: str) -> JaxactError:
    failure = JaxactError(sentence)
    failure.__cause__ = RemoteError("\n" + trace)
    return failure


def _started(make: bytes) -> _Process:
    """Starts a process."""
    ours, theirs = socket.socketpair()
    # It imports what this program can, and gets no Ctrl-C that is meant for it.
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    with theirs:
        popen = subprocess.Popen(
            [sys.executable, "-c", _SERVE.format(descriptor=theirs.fileno())],
            stdin=subprocess.DEVNULL,
            pass_fds=(theirs.fileno(),),
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": path},
        )
    connection = Connection(ours.detach())
    # What ends before it has read this is noticed when it is asked for something.
    with contextlib.suppress(OSError):
        connection.send_bytes(make)
    return _Process(popen, connection)


def _pickled(make: Callable[[], Simulator]) -> bytes:
    """Pickles by value what is in a module that another process would not find by its name."""
    foreign = [module for module in tuple(sys.modules.values()) if _is_foreign(module)]
    for module in foreign:
        cloudpickle.register_pickle_by_value(module)
    try:
        return cloudpickle.dumps(make)
    except Exception as error:
        raise JaxactError(
            "what makes an environment cannot be sent to another process "
            f"({type(error).__name__}: {error}): make it of modules' functions and of plain values"
        ) from error
    finally:
        for module in foreign:
            cloudpickle.unregister_pickle_by_value(module)


def _is_foreign(module: Any) -> bool:
    """Whether a module was loaded from a file that is not on the path, as experiments are."""
    file = getattr(module, "__file__", None)
    name = getattr(module, "__name__", None)
    if not isinstance(file, str) or not isinstance(name, str) or name not in sys.modules:
        return False
    if "." in name or name == "__main__":
        return False
    found = PathFinder.find_spec(name)
    return (
        found is None
        or found.origin is None
        or os.path.realpath(found.origin) != os.path.realpath(file)
    )
