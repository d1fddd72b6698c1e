"""Simulators in processes of their own: the same numbers, and no process that is left behind."""

import importlib
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import cloudpickle
import jax
import numpy as np
import pytest

from jaxact import JaxactError
from jaxact.from_gymnasium import from_gymnasium
from jaxact.loading import _load_file
from jaxact.simulator_hosts import Reading, answer
from jaxact.simulator_processes import ProcessHost, RemoteError, _pickled, _unpickled
from jaxact.simulators import explained
from tests.jaxact.test_from_gymnasium import play
from tests.simulated import Countdown, countdown
from tests.unruly import COUNT, EXIT, HANG, RAISE, Unruly


def step(code):
    return (np.int32(code),)


def is_alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # One that has ended stays listed until its parent asks for it.
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"


def pids_of(host):
    return {place: process.popen.pid for place, process in host._running.items()}


@pytest.fixture(scope="module")
def host():
    made = ProcessHost(Unruly, 2, 60.0)
    yield made
    pids = pids_of(made)
    assert pids
    made.close()
    assert not any(map(is_alive, pids.values()))


@pytest.fixture
def begun(host):
    """A host with three simulators in two processes, at the beginning of their episodes."""
    host.timeout = 60.0
    host.ask({0: 10, 1: 11, 2: 12})
    return host


def test_requests_are_answered_by_number(begun):
    answers = begun.ask({2: step(COUNT), 1: 5, 0: step(COUNT)})
    seen = {number: answer.observation[0].tolist() for number, answer in answers.items()}
    pids = pids_of(begun)
    assert seen == {2: [12, 1, pids[0]], 1: [5, 0, pids[1]], 0: [10, 1, pids[0]]}
    assert os.getpid() not in pids.values()
    begun.discard(1)
    assert "it ended before" in str(begun.ask({1: step(COUNT)})[1])


def test_an_error_is_told_and_others_go_on(begun):
    answers = begun.ask({0: step(RAISE), 1: step(COUNT), 2: step(COUNT)})
    assert str(answers[0]) == "RuntimeError: a joint is out of order"
    assert isinstance(answers[0].__cause__, RemoteError)
    assert "in step\n    raise RuntimeError" in str(answers[0].__cause__)
    assert isinstance(answers[1], Reading)
    assert isinstance(answers[2], Reading)


@pytest.mark.parametrize(
    ("end", "message"),
    [
        (EXIT, "its process ended with exit code 7"),
        (HANG, "no answer within 0.5 s"),
        (signal.SIGKILL, "its process was ended by SIGKILL"),
    ],
)
def test_a_process_that_ends_or_hangs_is_told_and_replaced(begun, end, message):
    """What else ran in it has to begin anew; the other process goes on."""
    pids = pids_of(begun)
    if isinstance(end, signal.Signals):
        os.kill(pids[0], end)
        answers = begun.ask({0: step(COUNT), 1: step(COUNT)})
    else:
        begun.timeout = 0.5
        answers = begun.ask({0: step(end), 1: step(COUNT)})
    assert str(answers[0]) == message
    assert answers[1].observation[0].tolist() == [11, 1, pids[1]]
    assert not is_alive(pids[0])
    begun.timeout = 60.0
    assert "with the process that it was in" in str(begun.ask({2: step(COUNT)})[2])
    assert begun.ask({0: 3})[0].observation[0][0] == 3
    assert pids_of(begun)[1] == pids[1]


def test_worlds_are_the_same_in_processes():
    """Bit for bit; and an error names the environment."""
    action = np.random.default_rng(0).normal(size=(5, 3, 1)).astype(np.float32)
    here, there = (from_gymnasium("Pendulum-v1", simulators=3, processes=n) for n in (0, 2))
    played = [play(pomdp, 3, 5, action) for pomdp in (here, there)]
    jax.tree.map(np.testing.assert_array_equal, *played)
    assert there.environment.pool(held_out=False).host._running
    pids = pids_of(there.environment.pool(held_out=False).host)
    for pid in pids.values():
        os.kill(pid, signal.SIGKILL)
    message = r"^simulator \d of Pendulum-v1 failed at reset of the episode with seed \d+: its proc"
    with pytest.raises(JaxactError, match=message), explained():
        play(there, 3, 1, action)
    there.environment.close()
    assert not any(map(is_alive, pids.values()))


EXPERIMENT = """
    import gymnasium

    class Own(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(0, 1, (1,))
        action_space = gymnasium.spaces.Discrete(2)

        def again(self):
            return Own()
"""


def test_what_an_experiment_file_defines_is_sent_whole(tmp_path, monkeypatch):
    """Its module is on no path of another process."""
    path = tmp_path / "own_world.py"
    path.write_text(textwrap.dedent(EXPERIMENT))
    module = _load_file(path)
    sent = _pickled(module.Own)
    monkeypatch.delitem(sys.modules, "own_world")
    assert cloudpickle.loads(sent)().again().action_space.n == 2


def test_what_another_process_cannot_import_is_told(tmp_path, monkeypatch):
    """When it is asked for, in a sentence."""
    (tmp_path / "passing.py").write_text("def make(): ...")
    monkeypatch.syspath_prepend(tmp_path)
    sent = _pickled(importlib.import_module("passing").make)
    (tmp_path / "passing.py").unlink()
    importlib.invalidate_caches()
    monkeypatch.delitem(sys.modules, "passing")
    said = answer({}, _unpickled(sent), 0, 5)
    assert str(said) == "ModuleNotFoundError: No module named 'passing'"


def test_bad_input_is_answered_in_a_sentence():
    lock = threading.Lock()

    def make():
        assert lock
        return Countdown()

    with pytest.raises(JaxactError, match=r"cannot be sent to another process \(TypeError: .*lock"):
        from_gymnasium(make, processes=1)
    with pytest.raises(JaxactError, match="2 threads and 3 processes exclude each other"):
        countdown(threads=2, processes=3)
    with pytest.raises(JaxactError, match="processes of a simulated world must be a whole number"):
        countdown(processes="2")
    with pytest.raises(JaxactError, match="processes of a simulated world must be at least 0"):
        countdown(processes=-1)
    with pytest.raises(JaxactError, match="timeout of a simulated world must be a number above 0"):
        countdown(processes=1, timeout=0.0)


@pytest.mark.slow
def test_processes_end_with_the_program():
    """Though it was killed and closed nothing."""
    script = """
        import os, signal
        from jaxact.simulator_processes import ProcessHost
        from tests.unruly import Unruly

        host = ProcessHost(Unruly, 2, 60.0)
        host.ask({0: 1, 1: 2})
        print(*(process.popen.pid for process in host._running.values()), flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
    """
    command = [sys.executable, "-c", textwrap.dedent(script)]
    ended = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    assert ended.returncode == -signal.SIGKILL
    pids = [int(pid) for pid in ended.stdout.split()]
    assert len(pids) == 2
    until = time.monotonic() + 10
    while any(map(is_alive, pids)) and time.monotonic() < until:
        time.sleep(0.05)
    assert not any(map(is_alive, pids))
