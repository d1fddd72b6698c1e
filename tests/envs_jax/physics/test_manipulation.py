"""Push, and pick and place: the hand does both as it is told, and moves as MuJoCo's does."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import envs_jax
from envs_jax.physics import MoveObject
from envs_jax.physics.hand import GRIP, HOME
from envs_jax.physics.rover import Velocities, rover
from jaxact.errors import JaxactError
from jaxact.testing import check_pomdp

PUSH, PICK = (envs_jax.make(f"Physics-{name}-v0") for name in ("Push", "PickPlace"))
WORLD = PUSH.environment
LANES, STEPS = 5, 60


def expert(task, target, state):
    """Over the cube, down to it, close, and off to the target; float32 [4]."""
    gap = task.gap(state)
    is_over = jnp.linalg.norm(gap[:2]) < 0.015
    is_down = jnp.abs(gap[2]) < 0.025
    # Of each finger, the cube is 0.02 m from the middle.
    is_closed = jnp.sum(state.position[3:5]) < 0.042
    to_cube = gap + jnp.where(is_over, 0, jnp.float32([0, 0, 0.1]))
    to_target = jnp.where(is_closed, target - task.place(state), 0)
    holds = is_over & is_down
    way = jnp.where(holds, to_target, to_cube)
    return jnp.clip(jnp.append(20 * way, jnp.where(holds, 1.0, -1.0)), -1, 1)


@pytest.fixture(scope="module")
def played():
    """The expert's episodes, the first half pushed: task states, and [lane, time] of states and
    actions."""

    @jax.jit
    @jax.vmap
    def play(state, target):
        def advance(state, _):
            action = expert(PUSH.task, target, state)
            after = WORLD.step(None, state, action)
            return after, (after, action)

        _, (states, actions) = jax.lax.scan(advance, state, length=STEPS)
        return jax.tree.map(lambda x, xs: jnp.concatenate([x[None], xs]), state, states), actions

    keys = jax.random.split(jax.random.key(1), LANES)
    sample = [jax.jit(jax.vmap(p.sampler.sample, (0, None))) for p in (PUSH, PICK)]
    starts = jax.tree.map(lambda *x: jnp.concatenate(x), *[f(keys, ()) for f in sample])
    return starts.task, *play(starts.environment, starts.task.target)


def test_episodes_begin_as_meta_worlds(played):
    tasks, states, _ = played
    hands = states.site_position[:, 0, WORLD.index("site", GRIP)]
    np.testing.assert_allclose(hands, np.tile(HOME, (2 * LANES, 1)), atol=1e-6)
    cubes = np.asarray(states.body_position[:, 0, WORLD.index("body", "cube")])
    for values, low, high in (
        (cubes, (-0.1, 0.6, 0.02), (0.1, 0.7, 0.02)),
        (tasks.target[:LANES], (-0.1, 0.8, 0.02), (0.1, 0.9, 0.02)),
        (tasks.target[LANES:], (-0.1, 0.8, 0.05), (0.1, 0.9, 0.3)),
    ):
        assert (low <= np.asarray(values) + 1e-6).all()
        assert (np.asarray(values) - 1e-6 <= high).all()
    assert (np.linalg.norm((tasks.target - cubes)[:, :2], axis=-1) >= 0.15).all()


@pytest.mark.parametrize("pomdp", [PUSH, PICK], ids=["push", "pick"])
def test_an_expert_succeeds(played, pomdp):
    tasks, states, actions = played
    lanes = slice(0, LANES) if pomdp is PUSH else slice(LANES, None)

    @jax.jit
    @jax.vmap
    def judge(progress, states, actions):
        def advance(progress, step):
            return pomdp.task.step(progress, *step)

        before = jax.tree.map(lambda x: x[:-1], states)
        after = jax.tree.map(lambda x: x[1:], states)
        return jax.lax.scan(advance, progress, (before, actions, after))[1]

    tasks, states, actions = jax.tree.map(lambda x: x[lanes], (tasks, states, actions))
    outcome = judge(tasks, states, actions)
    placed = np.asarray(outcome.success["placed"])
    assert placed.any(axis=1).all()
    assert not outcome.metrics["diverged"].any()
    assert not placed[:, :20].any()
    for lane in range(LANES):
        end = placed[lane].argmax() + 1
        paid = {name: np.asarray(x[lane, :end]) for name, x in outcome.reward.items()}
        assert outcome.terminated[lane, end - 1]
        assert paid["success"][-1] == 5 == paid["success"].sum()
        # What shaping pays in sum is the way that was made.
        way = tasks.distance[lane] - outcome.metrics["distance"][lane, end - 1]
        assert paid["shaping"].sum() == pytest.approx(5 * float(way), abs=1e-4)
        lifted = outcome.metrics["lifted"][lane, end - 1]
        assert paid["lift"].sum() == pytest.approx(pomdp.task.lift * float(lifted))
        assert pomdp is PUSH or lifted


def test_it_moves_and_carries_as_mujocos(played):
    _, states, actions = played
    # One that is pushed and one that is carried; all the while, though contacts are many.
    for lane in (0, LANES):
        controls = jax.vmap(lambda x: WORLD.controller.controls(WORLD, x, None, None, None))
        controls = np.asarray(controls(actions[lane]))
        data = mujoco.MjData(WORLD.model)
        data.qpos[:] = states.position[lane, 0]
        for step in range(STEPS):
            data.ctrl[:] = controls[step]
            for _ in range(WORLD.substeps):
                mujoco.mj_step(WORLD.model, data)
            np.testing.assert_allclose(states.position[lane, step + 1], data.qpos, atol=4e-3)


def test_what_the_hand_does_not_have_is_refused():
    with pytest.raises(JaxactError, match="unknown body of the model 'cub'; the nearest is 'cube'"):
        MoveObject(WORLD, body="cub")
    with pytest.raises(JaxactError, match=r"task\.world is of another model than the environment"):
        replace(PUSH, environment=rover(Velocities()))
    with pytest.raises(
        JaxactError, match="unknown robot that reaches 'hend'; the nearest is 'hand'"
    ):
        envs_jax.make("Physics-Reach-v0", robot="hend")


@pytest.mark.slow
@pytest.mark.parametrize(
    "pomdp",
    [PUSH, PICK, envs_jax.make("Physics-Reach-v0", robot="hand")],
    ids=["push", "pick", "reach"],
)
def test_they_are_sound(pomdp):
    check_pomdp(pomdp, lanes=2, steps=4)
