"""Samplers that learn, in training: what they are told is how the lanes' episodes ended."""

import dataclasses

import jax
import numpy as np

from jaxact.checkpoints import Checkpoints
from jaxact.program import Program, choose_devices
from jaxact.samplers import FixedSeeds, LadderSampler, PrioritizedLevelReplay
from jaxact.train_state import make_key
from tests.corridor import RandomStart, corridor
from tests.tiny import assert_same, experiment


def compiled(sampler):
    """The program of an experiment with this sampler, and its first stage for two updates."""
    pomdp = dataclasses.replace(corridor(), sampler=sampler)
    program = Program(experiment(pomdp), choose_devices(1))
    return program, program.stage(0, 2)


def trained(program, advance, updates, checkpoints=None):
    """The state after so many updates of the first stage, and again so many, and their metrics.

    Between them it is saved and restored, if it is said where.
    """
    state, rows = program.start(make_key(0)), []
    for count in updates:
        state, metrics = advance(state, program.numbers(), np.int32(count))
        rows += [jax.tree.map(lambda x, i=i: float(x[i]), metrics) for i in range(count)]
        if checkpoints is not None:
            checkpoints.save(len(rows), state, metadata={})
            state = checkpoints.restore(None, program.like()).state
    return state, rows


def test_levels_are_scored_and_replayed(tmp_path):
    """Among few levels most episodes that end in the second update are of levels known by then."""
    levels = FixedSeeds(RandomStart(), (1, 2, 3))
    sampler = PrioritizedLevelReplay(levels, size=64, replay=1.0)
    program, advance = compiled(sampler)
    state, rows = trained(program, advance, (2, 1))
    assert rows[0]["train/sampler/levels"] == rows[0]["episodes/count"] > 0
    assert rows[0]["train/sampler/score"] > 0
    assert int(state.sampler.episodes) == sum(row["episodes/count"] for row in rows)
    # Two at once or one, and also from disk: the same bits.
    assert_same(state, trained(program, advance, (1, 2), Checkpoints(tmp_path))[0])


def test_the_ladder_is_climbed():
    """The expert acts: every episode of the first rung succeeds, and after four the next begins.

    From the next update on, of the first there is only what has begun: one episode a lane.
    """
    rungs = {"short": RandomStart(horizon=10), "hopeless": RandomStart(horizon=1)}
    ladder = LadderSampler(rungs, promote_at=0.5, episodes=4, rehearsal=0.0)
    state, rows = trained(*compiled(ladder), (2,))
    assert rows[0]["episodes/kinds/short/count"] >= 4
    assert rows[0]["episodes/kinds/hopeless/count"] == 0
    assert rows[1]["episodes/kinds/hopeless/count"] > 0
    assert rows[1]["episodes/kinds/short/count"] <= 8
    assert int(state.sampler.rung) == rows[-1]["train/sampler/rung"] == 1.0
