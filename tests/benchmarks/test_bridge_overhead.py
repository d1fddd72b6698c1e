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


@pytest.mark.slow
def test_systems_with_processes_are_timed_besides():
    arguments = bridge_overhead.Arguments(lanes=2, steps=8, repeats=1, processes=1, work=0.1)
    lines = {line["system"]: line for line in bridge_overhead.measure(arguments)}
    assert list(lines)[1:] == ["gymnasium", "rollout", "gymnasium_async", "rollout_processes"]
    assert [line["processes"] for line in list(lines.values())[1:]] == [0, 0, 2, 1]
    # Each step has taken its work: two lanes, 0.1 ms each.
    assert lines["rollout_processes"]["microseconds_per_call"] > 200
    assert lines["gymnasium"]["microseconds_per_call"] > 200


def test_numbers_that_cannot_be(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["bridge_overhead", "--lanes", "0"])
    with pytest.raises(SystemExit):
        bridge_overhead.main()
    assert "--lanes must be at least 1; got 0" in capsys.readouterr().err
