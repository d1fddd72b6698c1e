"""Moves, collisions, looks, doors and things that are carried, and the noise of robots."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_houses import BODY, ROOMS, cluttered, free_plans

from envs_jax.houses.categories import index
from envs_jax.houses.collision import clearance, obstacles, sweep
from envs_jax.houses.environment import ACTIONS, House
from envs_jax.houses.noise import PRESETS, preset
from envs_jax.houses.scene import make_scene
from jaxact import JaxactError

WALL, DOOR, TABLE, MUG = (index(name) for name in ("Wall", "Door", "DiningTable", "Mug"))
# A thin wall across z = 2 with a shut door in it, and a table with a mug behind the agent.
SCENE = make_scene(
    [
        (0, 1, 2, 2, 2, 0.01, 0),
        (1.5, 1, 2, 1, 2, 0.01, 0),
        (0, 0.25, -1.5, 1, 0.5, 1, 0),
        (0, 0.56, -1.1, 0.1, 0.1, 0.1, 0),
        (0, 1.4, 1.2, 4, 0.2, 0.2, 0),
    ],
    [WALL, DOOR, TABLE, MUG, index("Shelf")],
    ROOMS,
    size=6,
    other_boxes=[None, (2.0, 1, 2.5, 0.01, 2, 1, 0), None, None, None],
    portable=[3],
)
FAIL = House(BODY, ACTIONS)
KEY = jax.random.key(0)
MOVES = House(BODY, ACTIONS[:3])
STEP = {name: jax.jit(replace(MOVES, collision=name).step) for name in ("slide", "stop")}
STEP["fail"] = jax.jit(FAIL.step)
START = jax.jit(FAIL.start)


def act(state, *names, collision="fail"):
    for name in names:
        state = STEP[collision](KEY, state, np.int32(ACTIONS.index(name)))
    return state


def at(x, z, yaw=0.0, scene=SCENE):
    return START(scene, np.array([x, z], np.float32), np.float32(yaw))


def test_moves_turns_and_looks():
    state = act(at(0, 0), "rotate_right", "rotate_right", "rotate_right", "move_ahead")
    np.testing.assert_allclose(state.position, [0.25, 0], atol=1e-6)
    assert float(state.yaw) == 90
    assert float(act(at(0, 0), "rotate_left").yaw) == 330
    np.testing.assert_allclose(act(at(0, 0), "move_back").position, [0, -0.25], atol=1e-6)
    assert float(act(at(0, 0), "look_down", "look_down", "look_down").pitch) == 60
    assert float(act(at(0, 0), "look_up", "look_up").pitch) == -30
    assert int(state.last_action) == ACTIONS.index("move_ahead")


def test_what_hangs_higher_than_the_body_is_no_obstacle():
    assert not bool(act(at(0, 1), "move_ahead").collided)


def test_a_move_into_a_wall_fails_stops_or_slides():
    start = at(-0.5, 1.75, 30.0)
    failed = act(start, "move_ahead")
    assert bool(failed.collided)
    assert np.array_equal(failed.position, start.position)
    stopped = act(start, "move_ahead", collision="stop").position
    assert 1.995 - BODY.radius - 0.003 < float(stopped[1]) < 1.995 - BODY.radius
    np.testing.assert_allclose(stopped[0] + 0.5, (stopped[1] - 1.75) * np.tan(np.pi / 6), atol=1e-4)
    slid = act(start, "move_ahead", collision="slide").position
    np.testing.assert_allclose(slid, [-0.5 + 0.125, stopped[1]], atol=2e-3)


def test_no_wall_is_too_thin_to_stop_a_move():
    start, move = np.zeros(2, np.float32), np.array([0, 50], np.float32)
    share, row = jax.jit(lambda: sweep(obstacles(SCENE.boxes, BODY), BODY.radius, start, move))()
    assert int(row) == 0
    assert float(share) == pytest.approx((1.995 - BODY.radius) / 50, abs=1e-6)


def test_sweeps_agree_with_small_steps():
    scene = cluttered(5)
    boxes = jax.jit(lambda: obstacles(scene.boxes, BODY))()
    rng = np.random.default_rng(0)
    starts = jnp.asarray(rng.uniform((0.3, 0.3), (7.7, 4.7), (200, 2)), jnp.float32)
    moves = jnp.asarray(rng.normal(0, 0.7, (200, 2)), jnp.float32)

    @jax.jit
    def both(starts, moves):
        def one(start, move):
            share, _ = sweep(boxes, BODY.radius, start, move)
            shares = jnp.linspace(0, 1, 200, dtype=jnp.float32)
            places = start + shares[:, None] * move
            gaps = jax.vmap(lambda place: jnp.min(clearance(boxes, place)[0]))(places)
            inside = gaps < BODY.radius
            first = jnp.where(jnp.any(inside), shares[jnp.argmax(inside)], jnp.inf)
            return share, first, gaps[0] >= BODY.radius, jnp.min(gaps)

        return jax.vmap(one)(starts, moves)

    share, first, free, least = map(np.asarray, both(starts, moves))
    clear = free & (np.abs(least - BODY.radius) > 1e-3)
    assert clear.sum() > 80
    assert np.array_equal((share < 1)[clear], np.isfinite(first)[clear])
    hit = clear & np.isfinite(first)
    assert hit.sum() > 20
    late = first[hit] - share[hit]
    assert np.all(late >= -1e-4)
    assert np.all(late <= 1 / 199 + 1e-4)


@pytest.mark.parametrize(
    "collision",
    [
        "slide",
        pytest.param("fail", marks=pytest.mark.slow),
        pytest.param("stop", marks=pytest.mark.slow),
    ],
)
def test_no_walk_ends_in_an_obstacle(collision):
    scene = cluttered(6)
    boxes = jax.jit(lambda: obstacles(scene.boxes, BODY))()
    house = House(BODY, ("move_ahead", "rotate_left"), collision=collision)
    house = replace(house, noise=PRESETS["pyrobot_locobot_ilqr"])

    @jax.jit
    def walk(key, position):
        def step(state, key):
            draw, noise = jax.random.split(key)
            action = jax.random.bernoulli(draw, 0.3).astype(jnp.int32)
            state = house.step(noise, state, action)
            return state, jnp.min(clearance(boxes, state.position)[0])

        start = house.start(scene, position)
        return jax.lax.scan(step, start, jax.random.split(key, 400))[1]

    gaps = walk(KEY, free_plans(0, boxes, BODY.radius, 1)[0])
    assert float(jnp.min(gaps)) > BODY.radius - 2e-4


def test_doors_open_and_shut():
    before = at(1.5, 1.6)
    assert bool(act(before, "move_ahead").collided)
    opened = act(before, "open")
    assert bool(opened.scene.opened[1])
    assert not bool(act(opened, "move_ahead").collided)
    # It would hit who stands in its way.
    assert bool(act(opened, "move_ahead", "move_ahead", "rotate_right", "close").scene.opened[1])
    assert not bool(act(opened, "rotate_right", "close").scene.opened[1])
    assert not bool(act(at(1.5, 0), "open").scene.opened[1])


def test_things_are_carried():
    state = act(at(0, -0.6, 180.0), "pick_up")
    assert int(state.held) == 3
    assert not bool(state.scene.present[3])
    # Nothing else can be taken, and it lands on the floor where there is nothing in front.
    away = act(state, *["rotate_left"] * 3, "put_down")
    assert int(away.held) == -1
    np.testing.assert_allclose(away.scene.boxes[3, :3], [0.475, 0.051, -0.6], atol=1e-3)
    on_table = act(state, "put_down")
    np.testing.assert_allclose(on_table.scene.boxes[3, 1], 0.551, atol=1e-3)
    assert int(act(at(0, -0.6), "pick_up").held) == -1


def test_what_is_not_there_to_do_is_refused():
    with pytest.raises(JaxactError, match="move_ahead"):
        House(BODY, ("move_ahaed",))
    with pytest.raises(JaxactError, match="slide"):
        House(BODY, ACTIONS, collision="slid")
    with pytest.raises(JaxactError, match="once"):
        House(BODY, ("end", "end"))
    with pytest.raises(JaxactError, match="ai2thor_locobot"):
        preset("ai2thor_locbot")


def moments(mean, deviation, low, high):
    """Mean and deviation of a normal distribution that is cut off, by quadrature."""
    if deviation == 0:
        return mean, 0.0
    values = np.linspace(low, high, 20001)
    weight = np.exp(-0.5 * values**2)
    weight /= weight.sum()
    center = (weight * values).sum()
    spread = np.sqrt((weight * (values - center) ** 2).sum())
    return mean + deviation * center, deviation * spread


DRAWS = 100_000


@pytest.fixture(scope="module")
def draws():
    """For each noise DRAWS draws of a move of 0.25 m and of a turn of 30 degrees to the left."""

    @jax.jit
    def draw(keys):
        def one(key):
            zero = jnp.float32(0)
            return [
                (noise.sample(key, jnp.float32(0.25), zero), noise.sample(key, zero, zero - 30))
                for noise in PRESETS.values()
            ]

        return jax.vmap(one)(keys)

    return dict(zip(PRESETS, draw(jax.random.split(jax.random.key(1), DRAWS)), strict=True))


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("turns", [False, True])
def test_noise_has_its_moments(draws, name, turns):
    noise = preset(name)
    step, angle = (0.0, -30.0) if turns else (0.25, 0.0)
    # Means of headings are of turns to the left.
    drawn = np.asarray(draws[name][turns], np.float64) * (1, 1, -1)
    drift = noise.turn if turns else noise.move
    for column, spread in enumerate((drift.forward, drift.right, drift.turn)):
        low, high = (-3.0, 3.0) if noise.truncated else (-8.0, 8.0)
        command = (abs(step), 0.0, abs(angle))[column]
        if noise.truncated and command:
            low = max(low, (-0.95 * command - spread.mean) / spread.deviation)
            assert drawn[:, column].min() >= -0.95 * command - 1e-6
        mean, deviation = moments(spread.mean, spread.deviation, low, high)
        error = 4 * deviation / np.sqrt(DRAWS) + 1e-6
        assert drawn[:, column].mean() == pytest.approx(mean, abs=error)
        assert drawn[:, column].std() == pytest.approx(deviation, abs=error)


def test_nothing_errs_that_is_not_commanded():
    @jax.jit
    def draw():
        zero = jnp.float32(0)
        return [noise.sample(KEY, zero, zero) for noise in PRESETS.values()]

    assert not np.any(draw())
