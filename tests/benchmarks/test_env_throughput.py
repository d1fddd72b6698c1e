"""The benchmark of worlds runs, says what it should, and explains what cannot be."""

import json
import subprocess
import sys

import pytest

from benchmarks.env_lines import by_world, ratios, read, summaries
from benchmarks.env_throughput import main


def test_prints_the_machine_and_a_line_for_each_world():
    small = ["--lanes", "8", "--steps", "4", "--repeats", "2", "--devices", "1", "--no-variants"]
    command = [sys.executable, "-m", "benchmarks.env_throughput", *small]
    command += ["--ids", "MiniGrid-Empty-5x5-v0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
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
def test_bad_input_is_explained_in_a_sentence(arguments, sentence, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["env_throughput", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert sentence in printed.err
    assert printed.err.count("\n") == 1


def line(system, rate=None, name="w", **facts):
    """A line of 8 lanes; without a rate, of what was not measured."""
    if rate is not None:
        facts |= {"steps_per_second": rate, "steps_per_second_median": rate - 1}
    return {"id": name, "system": system, "lanes": 8, **facts}


def test_ratios_leave_out_what_was_not_measured():
    lines = [
        line("jaxact", 9.0),
        line("navix", 3.0),
        line("envpool", unsupported="no such world"),
    ]
    assert ratios(lines) == [
        {"id": "w", "lanes": 8, "ratio_to": "navix", "ratio": 3.0, "ratio_median": 4.0}
    ]


def test_summaries_are_of_what_was_measured():
    def world(name, rate, seconds, **peer):
        return [line("jaxact", rate, name, compile_seconds=seconds), line("envpool", **peer)]

    rates = {"a": 8.0, "b": 20.0, "c": 4.0, "d": 6.0, "e": 50.0, "f": 5.0, "g": 7.0}
    worlds = [world(name, rate, rate / 2, unsupported="no") for name, rate in rates.items()]
    worlds[0][1] = line("envpool", 4.0)
    worlds[4][1] = line("envpool", 6.25)
    worlds.append([line("jaxact", name="h", error="lost")])
    assert summaries(worlds) == [
        {"lanes": 8, "summary": "median", "worlds": 7, "steps_per_second": 7.0},
        {
            "lanes": 8,
            "summary": "slowest",
            "steps_per_second": {"c": 4.0, "f": 5.0, "d": 6.0, "g": 7.0, "a": 8.0},
        },
        {"lanes": 8, "summary": "compilation", "longest": {"e": 25.0}},
        {
            "lanes": 8,
            "summary": "ratio",
            "ratio_to": "envpool",
            "worlds": 2,
            "geometric_mean": 4.0,
            "least": {"a": 2.0},
            "greatest": {"e": 8.0},
        },
        {"lanes": 8, "summary": "failed", "ids": ["h"]},
    ]


def test_worlds_of_a_run_that_was_stopped_are_found_in_its_file(tmp_path):
    whole = [line("jaxact", 9.0, "a"), line("envpool", 3.0, "a")]
    half = [line("jaxact", 9.0, "b")]
    texts = map(json.dumps, [{"system": "machine"}, *whole, *half, *ratios(whole)])
    path = tmp_path / "lines.jsonl"
    path.write_text("\n".join(texts) + '\n{"id": "c", "syst')
    assert by_world(read(path)) == {(8, "a"): whole, (8, "b"): half}
    assert read(tmp_path / "none.jsonl") == []
