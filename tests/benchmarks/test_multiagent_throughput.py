"""The benchmark of worlds of several agents: its systems run, and say what they are of."""

import importlib.util
import sys
import warnings

import jax
import numpy as np
import pytest

from benchmarks import env_systems
from benchmarks.env_systems import PEERS_OF_AGENTS, Job, Unsupported, build
from benchmarks.jax_loop import draw_actions
from benchmarks.multiagent_throughput import Arguments, main
from jaxact.spaces import Agents, Discrete


def job(system, name="Markov-StagHunt-v0"):
    return Job(name, system, lanes=4, steps=3, seed=0, devices=1, variant="", horizon=5)


def test_lines_of_several_agents_say_how_many_and_what_they_see():
    running, facts = build(job("jaxact"))
    assert running.run() > 0
    assert facts["agents"] == 2
    assert facts["observation"] == "map 5×5×4 of each agent"
    assert facts["horizon"] == 1000


def test_actions_are_drawn_for_all_agents_at_once():
    drawn = draw_actions(Agents(Discrete(3), 2), jax.random.key(0), 100)
    assert drawn.shape == (100, 2)
    assert set(np.unique(drawn)) == {0, 1, 2}


@pytest.mark.parametrize("name", PEERS_OF_AGENTS)
def test_jaxmarls_worlds_run(name):
    if importlib.util.find_spec("jaxmarl") is None:
        pytest.skip("jaxmarl is not installed (pip install -e '.[bench]')")
    with warnings.catch_warnings(), jax.numpy_dtype_promotion("standard"):
        warnings.simplefilter("ignore")
        running, facts = build(job(name))
        before = running.tallies()["finished"]
        for _ in range(4):
            running.run()
    assert facts == {"lanes": 4, "agents": 2}
    # Episodes are of five steps, and twelve were taken.
    assert 8 <= running.tallies()["finished"] - before <= 12


def test_what_is_not_there_is_unsupported(monkeypatch):
    monkeypatch.setattr(env_systems, "find_spec", lambda package: None)
    with pytest.raises(Unsupported, match="jaxmarl is not installed: run pip install"):
        build(job("jaxmarl-coin"))
    monkeypatch.setattr(env_systems, "find_spec", lambda package: package)
    with pytest.raises(Unsupported, match="set beside those of several agents only"):
        build(job("jaxmarl-coin", "MiniGrid-Empty-5x5-v0"))


def test_all_worlds_of_several_agents_are_measured_and_other_peers_refused(monkeypatch, capsys):
    worlds = (
        *("FurnLift-v0", "FurnMove-v0"),
        *("Markov-Escalation-v0", "Markov-Harvest-v0", "Markov-StagHunt-v0"),
        *("MultiGrid-Collect4HEnv10x10N2-v0", "MultiGrid-Soccer4HEnv10x15N2-v0"),
    )
    assert sorted(Arguments().ids) == sorted(worlds)
    monkeypatch.setattr(sys, "argv", ["multiagent_throughput", "--peers", "navix"])
    with pytest.raises(SystemExit):
        main()
    assert "benchmarks.multiagent_throughput: unknown peer 'navix'" in capsys.readouterr().err
