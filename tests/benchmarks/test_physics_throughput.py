"""The benchmark of physics: its lines, and that both sides step the same."""

import json
import sys

import jax
import pytest

from benchmarks import physics_throughput
from jaxact import JaxactError


def lines_of(capsys, monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["physics_throughput", *arguments])
    # A process that has started JAX is not told of flags any more.
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")
    # Brax by itself relies on the default promotion of dtypes.
    with jax.numpy_dtype_promotion("standard"):
        physics_throughput.main()
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


SMALL = ("--ids", "Brax-fast-v0", "--lanes", "8", "--steps", "3", "--repeats", "2")


def test_pairs_of_systems(capsys, monkeypatch):
    machine, *lines = lines_of(capsys, monkeypatch, *SMALL)
    assert machine["system"] == "machine"
    assert [(line["turnover"], line.get("system")) for line in lines] == [
        (turnover, system) for turnover in ("none", "own") for system in ("jaxact", "brax", None)
    ]
    # Without turnover both have done the same: three repeats of the same actions.
    assert lines[0]["checksum"] == lines[1]["checksum"]
    for ours, theirs, ratio in (lines[:3], lines[3:]):
        rate = ours["steps_per_second"] / theirs["steps_per_second"]
        assert ratio["ratio"] == pytest.approx(rate, abs=2e-3)


def test_other_worlds_are_refused():
    arguments = physics_throughput.Arguments(ids=("MiniGrid-Empty-5x5-v0",))
    with pytest.raises(JaxactError, match="is no world of these: Brax-"):
        next(physics_throughput.measure(arguments))
    arguments = physics_throughput.Arguments(ids=(), train="Physics-Hopper-v0")
    with pytest.raises(JaxactError, match="is no world of these: Brax-…"):
        next(physics_throughput.measure(arguments))


@pytest.mark.slow
def test_training_beside_brax(capsys, monkeypatch):
    trained = ("--train", "Brax-fast-v0", "--updates", "1", "--layers", "8")
    *_, ours, theirs, ratio = lines_of(capsys, monkeypatch, *SMALL, *trained)
    assert (ours["system"], theirs["system"], ratio["ratio_to"]) == ("jaxact", "brax", "brax")
    assert ours["repeats"] == theirs["repeats"] == 2
    assert ratio["ratio"] > 0.0
