"""The benchmark of worlds runs, says what it should, and explains what cannot be."""

import json
import subprocess
import sys

import pytest

from benchmarks.env_throughput import ratios


def _run(*arguments):
    command = [sys.executable, "-m", "benchmarks.env_throughput", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def test_prints_the_machine_and_a_line_for_each_world():
    small = ["--lanes", "8", "--steps", "4", "--repeats", "2", "--devices", "1", "--no-variants"]
    done = _run("--ids", "MiniGrid-Empty-5x5-v0", *small)
    assert done.returncode == 0, done.stderr
    machine, line = map(json.loads, done.stdout.splitlines())
    assert machine["system"] == "machine"
    assert machine["versions"]["jax"]
    assert {"processor", "cores", "device", "xla_flags"} <= machine.keys()
    assert (line["id"], line["system"]) == ("MiniGrid-Empty-5x5-v0", "jaxact")
    assert (line["lanes"], line["steps"], line["repeats"], line["devices"]) == (8, 4, 2, 1)
    assert line["steps_per_second"] >= line["steps_per_second_median"] > 0
    for name in ("compile_seconds", "peak_memory_mb", "checksum", "steps_per_second_mean"):
        assert line[name] > 0
    assert line["prng"] == "philox2x32"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--ids", "MiniGrid-Emty-8x8-v0"], "the nearest is 'MiniGrid-Empty-8x8-v0'"),
        (["--peers", "navx"], "the nearest is 'navix' (valid: envpool, minigrid, navix, xmini"),
        (["--lanes", "9", "--devices", "2"], "9 lanes cannot be divided among 2 devices"),
        (["--repeats", "0"], "--repeats must be at least 1; got 0"),
    ],
)
def test_bad_input_is_explained_in_a_sentence(arguments, sentence):
    done = _run(*arguments)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr


def test_ratios_leave_out_what_was_not_measured():
    def line(system, **facts):
        return {"id": "w", "system": system, "lanes": 8, **facts}

    lines = [
        line("jaxact", steps_per_second=9.0, steps_per_second_median=8.0),
        line("navix", steps_per_second=3.0, steps_per_second_median=2.0),
        line("envpool", unsupported="no such world"),
    ]
    assert ratios(lines) == [
        {"id": "w", "lanes": 8, "ratio_to": "navix", "ratio": 3.0, "ratio_median": 4.0}
    ]
