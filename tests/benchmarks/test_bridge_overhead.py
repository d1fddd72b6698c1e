"""The bridge's benchmark runs, says what it should, and explains what cannot be."""

import sys

import pytest

from benchmarks import bridge_overhead


def test_both_systems_are_timed():
    arguments = bridge_overhead.Arguments(lanes=2, steps=16, repeats=2)
    machine, own, rollout = bridge_overhead.measure(arguments)
    assert machine["system"] == "machine"
    assert (own["system"], rollout["system"]) == ("gymnasium", "rollout")
    assert own["share_of_gymnasium"] == own["share_of_gymnasium_median"] == 1
    for line in (own, rollout):
        assert line["steps_per_second"] >= line["steps_per_second_median"] > 0
        assert line["episodes"] > 0


def test_numbers_that_cannot_be(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["bridge_overhead", "--lanes", "0"])
    with pytest.raises(SystemExit):
        bridge_overhead.main()
    assert "--lanes must be at least 1; got 0" in capsys.readouterr().err
