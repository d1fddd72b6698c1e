"""ArmPointNav: a mobile arm finds its object, takes it and brings it where it is to be."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import envs_jax
from envs_jax.physics.arm_point_nav import ArmPointNav, seen_from
from envs_jax.physics.hand import hand
from envs_jax.physics.mobile_arm import HALF_ROOM, gap, holds
from jaxact.errors import JaxactError
from jaxact.testing import check_pomdp

POMDP_ = envs_jax.make("Physics-ArmPointNav-v0")
EASY = envs_jax.make("Physics-ArmPointNav-v0", easy=True, disturbance=2.0)
WORLD, TASK = POMDP_.environment, POMDP_.task
NAMES = WORLD.action_names
# The last one only drives ahead.
LANES, STEPS = 7, 70


def expert(state, goal):
    """Raises the hand, drives until the aim is in reach, then brings the hand over it and down."""
    held, hand = holds(state), state.site_position[WORLD.index("site", "hand")]
    way = jnp.where(held, goal - TASK.place(state), gap(WORLD, state))
    aim = hand + way - jnp.append(state.position[:2], 0)
    ahead, left, _ = seen_from(state.position[2], aim[None])[0]
    forward, sideward, upward = seen_from(state.position[2], way[None])[0]
    in_reach = (ahead > 0.3) & (ahead < 0.8) & (jnp.abs(left) < 0.4)
    bearing = jnp.rad2deg(jnp.arctan2(left, ahead))
    off = 0.03
    is_over = (jnp.abs(forward) < off) & (jnp.abs(sideward) < off)

    def name(choice):
        return NAMES.index(choice)

    choices = [
        (held & (jnp.max(jnp.abs(way)) < 0.06), name("end")),
        (~held & (jnp.linalg.norm(way) < 0.08), name("pickup")),
        (~is_over & (hand[2] < 0.68), name("arm_height_plus")),
        (~in_reach & (state.position[6] > 0.02), name("arm_z_minus")),
        (~in_reach & (bearing > 24), name("rotate_left")),
        (~in_reach & (bearing < -24), name("rotate_right")),
        (~in_reach, name("move_ahead")),
        (forward > off, name("arm_z_plus")),
        (forward < -off, name("arm_z_minus")),
        (sideward > off, name("arm_x_minus")),
        (sideward < -off, name("arm_x_plus")),
        (upward > 0, name("arm_height_plus")),
    ]
    return jnp.select([x for x, _ in choices], [x for _, x in choices], name("arm_height_minus"))


@pytest.fixture(scope="module")
def starts():
    """First states of the world and of the task, [lane]."""
    keys = jax.random.split(jax.random.key(0), LANES)
    episodes = jax.jit(jax.vmap(POMDP_.sampler.sample, (0, None)))(keys, ())
    return episodes.environment, episodes.task


@pytest.fixture(scope="module")
def played(starts):
    """The expert's episodes: [lane, time] of actions, states and outcomes."""

    def play(state, progress, is_straight):
        def advance(carry, _):
            before, progress = carry
            choice = expert(before, progress.goal)
            action = jnp.where(is_straight, NAMES.index("move_ahead"), choice)
            after = WORLD.step(None, before, action)
            progress, outcome = TASK.step(progress, before, action, after)
            return (after, progress), (action, after, outcome)

        return jax.lax.scan(advance, (state, progress), length=STEPS)[1]

    return jax.jit(jax.vmap(play))(*starts, jnp.arange(LANES) == LANES - 1)


def lane(tree, *index):
    return jax.tree.map(lambda x: x[index], tree)


def test_episodes_begin_between_two_tables(starts):
    states, tasks = starts
    tables = np.asarray(states.mocap_position)
    objects = np.asarray(states.site_position[:, WORLD.index("site", "object")])
    others = np.asarray(tasks.others)
    # Tables are 0.5 m high and 0.5 m by 0.7 m wide, and balls 0.04 m thick.
    np.testing.assert_allclose(tables[..., 2], 0.25)
    assert (tables[:, 0, 0] * tables[:, 1, 0] < -1).all()
    for places, number in ((objects, 0), (others[:, 0], 0), (others[:, 1], 1), (tasks.goal, 1)):
        assert (np.abs(places - tables[:, number])[:, :2] <= [0.2, 0.3 + 1e-6]).all()
    np.testing.assert_allclose(objects[:, 2], 0.54, atol=1e-6)
    assert ((tasks.goal[:, 2] >= 0.59) & (tasks.goal[:, 2] <= 0.84)).all()
    assert len({x > 0 for x in objects[:, 0].tolist()}) == 2
    assert (np.linalg.norm(others[:, 0] - objects, axis=-1) > 0.1).all()


def test_the_rules_are_manipulathors(starts):
    state, progress = lane(starts, 0)
    goal = progress.goal
    held = replace(state, activation=jnp.ones_like(state.activation))
    row = WORLD.index("site", "object")

    def at_goal(off):
        return replace(held, site_position=held.site_position.at[row].set(goal + off))

    judge = jax.jit(TASK.step)

    def outcome(name, after):
        return judge(progress, state, NAMES.index(name), after)[1]

    # Who did not move was blocked, and nothing was picked up.
    for name, after, failed, success, ended in (
        ("move_ahead", state, True, False, False),
        ("arm_x_plus", state, True, False, False),
        ("pickup", state, True, False, False),
        ("pickup", held, False, False, False),
        ("end", state, True, False, True),
        ("end", at_goal(jnp.float32([0.09, -0.09, 0.09])), False, True, True),
        ("end", at_goal(jnp.float32([0.11, 0, 0])), True, False, True),
        ("end", replace(at_goal(0), activation=state.activation), True, False, True),
        ("pickup", at_goal(0), False, False, False),
    ):
        result = outcome(name, after)
        assert float(result.reward["failure"]) == pytest.approx(-0.03 * failed), name
        assert float(result.metrics[f"succeeded/{name}"]) == (not failed)
        assert float(result.metrics[f"chosen/{name}"]) == 1
        assert bool(result.success["goal"]) == success
        assert bool(result.terminated) == ended
        assert float(result.reward["success"]) == 10 * success
        assert float(result.reward["pickup"]) == 5 * bool(holds(after))
    # The easy way ends by itself. Both balls are off their places, one of them by 3 cm.
    assert EASY.environment.action_names == NAMES[:11]
    after = at_goal(0)
    place = WORLD.index("site", "other 0")
    moved = after.site_position.at[place, 1].add(0.03).at[place + 1, 0].add(0.005)
    begun = EASY.task.start(state, goal)
    ended = EASY.task.step(begun, state, 0, replace(after, site_position=moved))[1]
    assert bool(ended.terminated)
    assert bool(ended.success["goal"])
    assert float(ended.reward["disturbance"]) == pytest.approx(-2 * 0.035, abs=1e-5)
    assert float(ended.metrics["objects_moved"]) == 1
    assert float(ended.metrics["success_without_disturbance"]) == 0


def test_other_worlds_are_refused():
    with pytest.raises(JaxactError, match=r"task\.world has to be the mobile arm's"):
        ArmPointNav(hand())
    with pytest.raises(JaxactError, match=r"task\.world is moved by ArmMoves\(easy=False"):
        replace(POMDP_, environment=EASY.environment)


@pytest.mark.slow
def test_an_expert_succeeds(played):
    _, _, outcome = played
    success = np.asarray(outcome.success["goal"])
    assert success[:-1].any(axis=1).all()
    for index in range(LANES - 1):
        end = success[index].argmax()
        assert outcome.terminated[index, end]
        assert not outcome.terminated[index, :end].any()
        paid = {name: np.asarray(x[index, : end + 1]) for name, x in outcome.reward.items()}
        assert paid["pickup"].sum() == 5
        assert paid["success"].sum() == 10
        result = {name: float(x[index, end]) for name, x in outcome.metrics.items()}
        assert result["picked_up"] == result["success_without_disturbance"] == 1
        assert result["pickup_steps"] == paid["pickup"].argmax() + 1
        assert result["distance_left"] < 0.1
        assert sum(x for name, x in result.items() if "chosen/" in name) == pytest.approx(1)


@pytest.mark.slow
def test_tables_and_walls_are_in_the_way(played):
    _, states, outcome = played
    last = lane(states, LANES - 1, -1)
    assert (np.abs(last.position[:2]) < HALF_ROOM - 0.15).all()
    assert float(outcome.reward["failure"][LANES - 1, 0]) == 0
    assert float(outcome.reward["failure"][LANES - 1, -1]) == np.float32(-0.03)
    assert not outcome.metrics["diverged"].any()


@pytest.mark.slow
def test_it_moves_as_mujocos(starts, played):
    actions, states, _ = played
    model = WORLD.model
    data = mujoco.MjData(model)
    first = lane(starts[0], 0)
    data.qpos[:] = first.position
    data.mocap_pos[:] = first.mocap_position
    controls = jax.jit(lambda *x: WORLD.controller.controls(WORLD, *x, None))
    for step in range(40):
        before = lane(states, 0, step - 1) if step else first
        # Where a move begins is read from the run: near the magnet's reach little would decide.
        for _ in range(WORLD.substeps):
            data.ctrl[:] = controls(actions[0, step], before, jnp.float32(data.qpos))
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(states.position[0, step], data.qpos, atol=2e-3)
        np.testing.assert_allclose(states.activation[0, step], data.act, atol=1e-6)


@pytest.mark.slow
def test_it_is_sound():
    check_pomdp(EASY, lanes=2, steps=4)
