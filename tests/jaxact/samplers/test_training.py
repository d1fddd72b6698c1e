"""Samplers that learn, in training: what they are told is how the lanes' episodes ended."""

import dataclasses

import jax
import numpy as np

from jaxact.program import Program, choose_devices
from jaxact.samplers import FixedSeeds, LadderSampler, PrioritizedLevelReplay
from jaxact.train_state import make_key
from tests.corridor import RandomStart, corridor
from tests.tiny import assert_same, experiment


def trained(sampler, updates):
    """The state after some updates of the first stage, done one by one, and their metrics."""
    program = Program(
        experiment(dataclasses.replace(corridor(), sampler=sampler)), choose_devices(1)
    )
    advance = program.stage(0, 2)
    state, rows = program.start(make_key(0)), []
    for count in updates:
        state, metrics = advance(state, program.numbers(), np.int32(count))
        rows += [jax.tree.map(lambda x, i=i: float(x[i]), metrics) for i in range(count)]
    return state, rows


def test_levels_are_scored_and_replayed():
    """Among few levels most episodes that end in the second update are of levels known by then."""
    levels = FixedSeeds(RandomStart(), (1, 2, 3))
    sampler = PrioritizedLevelReplay(levels, size=64, replay=1.0)
    state, rows = trained(sampler, (2, 1))
    assert rows[0]["train/sampler/levels"] == rows[0]["episodes/count"] > 0
    assert rows[0]["train/sampler/score"] > 0
    assert int(state.sampler.episodes) == sum(row["episodes/count"] for row in rows)
    # One by one or two at once: the same bits.
    assert_same(state, trained(sampler, (1, 2))[0])


def test_the_ladder_is_climbed():
    """The expert acts: every episode of the first rung succeeds, and after four the next begins."""
    rungs = {"short": RandomStart(horizon=10), "hopeless": RandomStart(horizon=1)}
    state, rows = trained(LadderSampler(rungs, promote_at=0.5, episodes=4), (2,))
    assert rows[0]["episodes/kinds/short/count"] >= 4
    assert rows[0]["episodes/kinds/hopeless/count"] == 0
    assert int(state.sampler.rung) == rows[-1]["train/sampler/rung"] == 1.0
