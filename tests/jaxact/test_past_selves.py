"""Past selves: snapshots of the policy that is trained, when they should be taken, and no other."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact import Experiment, JaxactError, Stage, TrainingPipeline, make_key
from jaxact.evaluation import begin_held_out
from jaxact.losses import PPO
from jaxact.models import GRU, ActorCritic, AgentsActorCritic, Concatenated, Vector
from jaxact.opponents import against
from jaxact.past_selves import against_past_selves
from jaxact.policy import Policy
from jaxact.program import Program, choose_devices
from jaxact.samplers import FixedSeeds
from jaxact.spaces import Discrete
from jaxact.testing import check_pomdp
from tests.corridor import corridor
from tests.crowd import crowd
from tests.tiny import assert_same

ENCODER = Concatenated({"vector": Vector((16,))})
MODEL = ActorCritic(Discrete(2), ENCODER, GRU(8))
WORLD = against_past_selves(crowd(2), MODEL, size=2, every=3)
UPDATE = 4 * 8
EXPERIMENT = Experiment(
    "past_selves",
    WORLD,
    MODEL,
    TrainingPipeline(
        (Stage({"ppo": PPO()}, 20 * UPDATE),),
        lanes=4,
        rollout_length=8,
        epochs=1,
        minibatches=1,
        learning_rate=1e-2,
    ),
)


@pytest.fixture(scope="module")
def states():
    """The train state before the first update and after each of eight."""
    program = Program(EXPERIMENT, choose_devices(1))
    states = [program.start(make_key(0))]
    stage = program.stage(0, 1)
    for _ in range(8):
        copy = jax.tree.map(jnp.copy, states[-1])
        states.append(stage(copy, program.numbers(), jnp.int32(1))[0])
    return states


def place(pool, index):
    return jax.tree.map(lambda x: x[index], pool)


def flat(params):
    return np.concatenate([x.reshape(x.shape[0], -1) for x in jax.tree.leaves(params)], axis=1)


def same(one, other):
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.array_equal(*pair) for pair in pairs)


def test_snapshots_are_taken_when_they_are_due_and_the_oldest_goes(states):
    """Before updates 0, 3 and 6, of what the policy was then."""
    pools = [state.sampler for state in states]
    assert [int(pool.taken) for pool in pools] == [0, 1, 1, 1, 2, 2, 2, 3, 3]
    assert not same(states[3].params, states[0].params)
    for update in range(1, 9):
        latest = {1: 0, 4: 3, 7: 6}
        expected = [states[taken].params for due, taken in latest.items() if due <= update][-2:]
        if update >= 7:
            expected = expected[::-1]  # The third is in the place of the first.
        for i, params in enumerate(expected):
            assert_same(place(pools[update].params, i), params)


def test_opponents_are_snapshots_from_the_beginning_of_an_episode_to_its_end(states):
    kept = [states[i].params for i in (0, 3, 6)]

    def played(state, lane):
        (params,) = state.lanes.state.environment.params
        found = [same(place(params, lane), each) for each in kept]
        assert sum(found) == 1
        return found.index(True)

    seen = set()
    for before, after in itertools.pairwise(states[1:]):
        for lane in range(4):
            seen |= {played(after, lane)}
            begun = int(after.lanes.queue.served[lane]) > int(before.lanes.queue.served[lane])
            assert begun or played(before, lane) == played(after, lane)
    assert len(seen) > 1


def test_all_that_are_kept_are_drawn_alike(states):
    draw = jax.jit(jax.vmap(WORLD.sampler.sample, in_axes=(0, None)))
    keys = jax.random.split(jax.random.key(0), 400)
    for update, shares in ((2, [1.0, 0.0]), (8, [0.5, 0.5])):
        pool = states[update].sampler
        (params,) = draw(keys, pool).environment.params
        drawn, kept = flat(params), flat(pool.params)
        found = [np.mean(np.all(drawn == row, axis=1)) for row in kept]
        np.testing.assert_allclose(found, shares, atol=0.1)


def test_a_past_self_plays_as_the_policy_it_was(states):
    """Beside the same parameters as a frozen policy, the learner has the same episodes."""
    pool = states[8].sampler
    key = jax.random.key(5)
    state, _ = jax.jit(WORLD.reset)(key, pool)
    (params,) = state.environment.params
    frozen = against(crowd(2), {1: Policy(MODEL, params, Discrete(2))})
    other = frozen.begin(
        dataclasses.replace(
            jax.jit(frozen.sampler.sample)(key, ()),
            environment=dataclasses.replace(state.environment, params=((),)),
            task=state.task,
        )
    )
    step_one, step_other = jax.jit(WORLD.step), jax.jit(frozen.step)
    for t in range(8):
        step_key, action = jax.random.fold_in(key, t), jnp.int32(t % 2)
        state, step = step_one(step_key, state, action)
        other, expected = step_other(step_key, other, action)
        assert_same(step, expected)


def test_the_world_is_one_like_any_other():
    check_pomdp(WORLD, steps=4)


def test_evaluation_is_against_the_untrained():
    untrained = place(WORLD.sampler.init(jax.random.key(0)).params, 0)
    state, _ = jax.jit(lambda key: begin_held_out(WORLD, key))(jax.random.key(1))
    assert_same(state.environment.params, (untrained,))


def test_past_selves_of_several_learners_play_as_many():
    pair = AgentsActorCritic(crowd(2).action_space, ENCODER, GRU(8))
    world = against_past_selves(crowd(4), pair, learners=(1, 3))
    assert [opponent.agents for opponent in world.environment.opponents] == [(0, 2)]
    alone = against_past_selves(crowd(3), MODEL, learners=(1,))
    assert [opponent.agents for opponent in alone.environment.opponents] == [(0,), (2,)]
    for pomdp, shape in ((world, (2, 12)), (alone, (12,))):
        state, _ = jax.eval_shape(pomdp.reset, jax.random.key(0))
        action = pomdp.action_space.structure
        after, step = jax.eval_shape(pomdp.step, jax.random.key(0), state, action)
        assert step.observation["vector"].shape == shape
        assert jax.tree.structure(after) == jax.tree.structure(state)


def test_what_cannot_be_is_refused():
    other = ActorCritic(Discrete(2), ENCODER, GRU(9))
    with pytest.raises(JaxactError, match="past selves are of the model that is trained"):
        dataclasses.replace(EXPERIMENT, model=other).check()
    with pytest.raises(JaxactError, match="FixedSeeds cannot be told of what the policy has"):
        dataclasses.replace(WORLD, sampler=FixedSeeds(WORLD.sampler, seeds=(0, 1)))
    with pytest.raises(JaxactError, match=r"of 2 learner\(s\) cannot play 1 other agent\(s\)"):
        against_past_selves(crowd(3), MODEL, learners=(0, 1))
    with pytest.raises(JaxactError, match="there is no agent 2: they are 0 to 1"):
        against_past_selves(crowd(2), MODEL, learners=(2,))
    with pytest.raises(JaxactError, match="past selves are for worlds of several agents"):
        against_past_selves(corridor(), MODEL)
    with pytest.raises(JaxactError, match="every must be at least 1, got 0"):
        against_past_selves(crowd(2), MODEL, every=0)
