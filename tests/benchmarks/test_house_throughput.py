"""The benchmark of houses says what it should, and explains what cannot be."""

import sys

import pytest

from benchmarks import house_systems
from benchmarks.env_systems import Unsupported
from benchmarks.house_throughput import Arguments, main, measure


def test_prints_the_machine_and_a_line_for_each_system(monkeypatch):
    def missing(job):
        raise Unsupported("not installed")

    absent = house_systems.System(missing, "nothing", "nothing")
    monkeypatch.setitem(house_systems.SYSTEMS, "vizdoom", absent)
    arguments = Arguments(("depth",), (8,), (8,), (2,), 2, 2, peers=("vizdoom",), devices=1)
    machine, refused, peer, line = measure(arguments)
    assert machine["versions"]["jax"]
    assert peer == {"system": "vizdoom", "pixels": (8, 8), "unsupported": "not installed"}
    # Apartments have more boxes than so.
    assert refused["system"] == "jaxact"
    assert "need" in refused["unsupported"]
    assert (line["system"], line["reading"], line["pixels"]) == ("camera", "depth", (8, 8))
    assert (line["boxes"], line["lanes"], line["steps"], line["repeats"]) == (8, 2, 2, 2)
    assert line["frames_per_second"] >= line["frames_per_second_median"] > 0
    for name in ("compile_seconds", "memory_per_lane_kb", "checksum"):
        assert line[name] > 0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--peers", "minworld"], "the nearest is 'miniworld' (valid: miniworld, vizdoom)"),
        (["--readings", "dept"], "the nearest is 'depth'"),
        (["--lanes", "9", "--devices", "2"], "9 lanes cannot be divided among 2 devices"),
        (["--boxes", "0"], "--boxes must be at least 1; got 0"),
    ],
)
def test_bad_input_is_explained_in_a_sentence(arguments, sentence, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["house_throughput", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert sentence in printed.err
    assert printed.err.count("\n") == 1
