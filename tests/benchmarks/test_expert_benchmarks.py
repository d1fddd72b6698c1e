"""The benchmarks of experts run, say what they should, and explain what cannot be."""

import json
import sys

import pytest

from benchmarks import expert_success, expert_throughput
from benchmarks.env_lines import read

EMPTY = "MiniGrid-Empty-5x5-v0"


def test_success_is_printed_and_kept(tmp_path, monkeypatch, capsys):
    path = tmp_path / "success.jsonl"
    command = ["expert_success", "--ids", EMPTY, "--episodes", "4", "--output", str(path)]
    monkeypatch.setattr(sys, "argv", command)
    expert_success.main()
    line = json.loads(capsys.readouterr().out)
    assert line.pop("seconds") > 0
    expected = {"success": 1.0, "abstained": 0.0, "lost": 0.0, "mean_length": 5.0}
    assert line == {"id": EMPTY, "episodes": 4, "seed": 0} | expected
    (kept,) = read(path)
    assert kept.items() >= line.items()


def test_worlds_of_a_run_that_was_stopped_are_not_played_again(monkeypatch):
    monkeypatch.setattr(expert_success, "play", lambda name, *numbers: (name, *numbers))
    lines = [{"id": name, "episodes": 4, "seed": seed} for name, seed in [("a", 0), ("b", 1)]]
    arguments = expert_success.Arguments(episodes=4)
    found = list(expert_success.measure(arguments, ["a", "b", "c"], lines))
    assert found == [lines[0], ("b", 4, 0), ("c", 4, 0)]


def test_rates_are_positive():
    arguments = expert_throughput.Arguments(ids=(EMPTY,), lanes=8, repeats=2)
    machine, line = expert_throughput.measure(arguments)
    assert machine["system"] == "machine"
    assert (line["id"], line["lanes"], line["repeats"], line["devices"]) == (EMPTY, 8, 2, 1)
    assert line["compile_seconds"] > 0
    assert line["plans_per_second"] >= line["plans_per_second_median"] > 0


@pytest.mark.parametrize(
    ("program", "arguments", "sentence"),
    [
        (expert_success, ["--episodes", "0"], "--episodes must be at least 1; got 0"),
        (expert_success, ["--ids", "MiniGrid-Emty-5x5-v0"], f"the nearest is '{EMPTY}'"),
        (expert_throughput, ["--repeats", "0"], "--repeats must be at least 1; got 0"),
        (expert_throughput, ["--ids", "MiniGrid-Emty-5x5-v0"], f"the nearest is '{EMPTY}'"),
        (
            expert_throughput,
            ["--lanes", "9", "--devices", "2"],
            "9 lanes cannot be divided among 2 devices",
        ),
    ],
)
def test_bad_input_is_explained_in_a_sentence(program, arguments, sentence, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["benchmark", *arguments])
    with pytest.raises(SystemExit) as ended:
        program.main()
    assert ended.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert sentence in printed.err
    assert printed.err.count("\n") == 1
