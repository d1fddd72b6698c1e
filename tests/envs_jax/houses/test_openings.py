"""Doors and drawers of furniture: what is kept behind them, and what they are in the way of."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs_jax.houses import generator
from envs_jax.houses.categories import index
from envs_jax.houses.environment import House
from envs_jax.houses.furnishing import PASSAGE, Pieces
from envs_jax.houses.openings import add_openings
from envs_jax.houses.scene import make_scene
from envs_jax.houses.state import Body
from envs_jax.houses.visibility import ROBOTHOR_SIGHT, is_visible
from jaxact.errors import JaxactError

BODY = Body(0.175, 0.9, 0.87)
ACTIONS = ("move_ahead", "rotate_left", "rotate_right", "open", "close", "pick_up")
HOUSE = House(BODY, ACTIONS)
FRIDGE, DRESSER, SAFE, EGG = (index(name) for name in ("Fridge", "Dresser", "Safe", "Egg"))
# A dresser, a sofa, a safe and a fridge in a row, all with their fronts towards −z.
KINDS = (DRESSER, index("Sofa"), SAFE, FRIDGE)
PLANS = np.array([[0, 2], [2, 2], [4, 2], [6, 2]], np.float32)
SIZES = np.array([[1.2, 0.9, 0.5], [2, 0.9, 0.9], [0.4, 0.4, 0.4], [1, 1.8, 0.7]], np.float32)


def furniture(kinds=KINDS):
    rows = np.zeros((4, 19), np.float32)
    rows[:, 2] = kinds
    rows[:, 3] = -1  # Turned by 180 degrees.
    rows[:, 5], rows[:, 6], rows[:, 7] = PLANS[:, 0], SIZES[:, 1] / 2, PLANS[:, 1]
    rows[:, 8:11] = SIZES / 2
    return Pieces(jnp.asarray(rows))


@pytest.fixture(scope="module")
def house():
    """The scene, and functions that act in it and say whether an egg is visible."""
    pieces, opens = jax.jit(add_openings, static_argnums=(2, 3))(
        [jnp.full(4, 0.2), jnp.full((1, 2), 0.5)], furniture(), 4, (EGG,)
    )
    boxes = jnp.concatenate([pieces.center, pieces.half_size, pieces.turn], axis=1)
    kinds = [*KINDS, EGG, *np.asarray(opens.category).tolist()]
    scene = make_scene([(0, 0, 0, 0, 0, 0, 0)] * 9, kinds, [(-3, -3, 9, 3)], portable=[4])
    there = opens.category > 0
    nowhere = jnp.array([-1e4, -1e4, -1e4, 0, 0, 0, 1, 0], jnp.float32)
    shut, opened = (
        jnp.concatenate([boxes, opens.kept, jnp.where(there[:, None], rows, nowhere)])
        for rows in (opens.boxes, opens.other_boxes)
    )
    openable = jnp.concatenate([jnp.zeros(5, bool), there])
    scene = replace(scene, boxes=shut, other_boxes=opened, openable=openable)
    step = jax.jit(HOUSE.step)

    def act(state, *names):
        for name in names:
            state = step(jax.random.key(0), state, jnp.int32(ACTIONS.index(name)))
        return state

    @jax.jit
    def sees(state):
        wanted = state.scene.category == EGG
        boxes, pose = state.scene.boxes, (state.position, state.yaw, state.pitch)
        return is_visible(ROBOTHOR_SIGHT, BODY, boxes, wanted, *pose)

    return scene, act, sees


def before(scene, piece, metres):
    """Somebody who faces a piece of furniture, so many metres before its front."""
    place = PLANS[piece] - np.array([0, SIZES[piece, 2] / 2 + metres], np.float32)
    return HOUSE.start(scene, jnp.asarray(place))


def test_fridges_come_first_and_sofas_do_not_open(house):
    scene, _, _ = house
    assert np.asarray(scene.category)[5:].tolist() == [FRIDGE, index("Drawer"), SAFE, 0]
    assert np.asarray(scene.openable).tolist() == [False] * 5 + [True] * 3 + [False]
    boxes = np.asarray(scene.boxes)
    # The fridge that opens stands on the part of it that does not.
    np.testing.assert_allclose(boxes[3, 1] + boxes[3, 4], 0.7, atol=1e-6)
    np.testing.assert_allclose(boxes[5, 1] - boxes[5, 4], 0.7, atol=1e-6)
    np.testing.assert_allclose(boxes[5, 1] + boxes[5, 4], 1.8, atol=1e-6)


def test_what_is_in_a_fridge_is_seen_and_taken_once_it_is_open(house):
    scene, act, sees = house
    shut = replace(before(scene, 3, 0.45), pitch=jnp.float32(30))
    assert not sees(shut)
    assert int(act(shut, "pick_up").held) == -1
    opened = act(shut, "open")
    assert np.asarray(opened.scene.opened).nonzero()[0].tolist() == [5]
    assert sees(opened)
    assert int(act(opened, "pick_up").held) == 4
    # Who stands before it turns to its door to shut it.
    again = act(opened, "rotate_right", "rotate_right", "close", "rotate_left", "rotate_left")
    assert not sees(again)
    np.testing.assert_array_equal(again.scene.boxes, scene.boxes)


def test_drawers_come_out_and_are_in_the_way(house):
    scene, act, _ = house
    shut = before(scene, 0, 0.6)
    assert not bool(act(shut, "move_ahead").collided)
    opened = act(shut, "open")
    assert np.asarray(opened.scene.opened).nonzero()[0].tolist() == [6]
    assert bool(act(opened, "move_ahead").collided)
    # It is not opened into who stands there.
    assert not np.any(act(before(scene, 0, 0.3), "open").scene.opened)


def test_open_or_shut_they_stay_within_what_is_kept_free(house):
    scene, _, _ = house
    front = PLANS[[3, 0, 2], 1] - SIZES[[3, 0, 2], 2] / 2
    width = SIZES[[3, 0, 2], 0] / 2
    for rows, reach in ((scene.boxes, 0.005), (scene.other_boxes, PASSAGE / 2)):
        row = np.asarray(rows)[5:8]
        assert np.all(front - (row[:, 2] - row[:, 5]) <= reach)
        assert np.all(np.abs(row[:, 0] - PLANS[[3, 0, 2], 0]) + row[:, 3] <= width + 1e-6)


def test_without_fridge_nothing_is_kept():
    kinds = (DRESSER, index("Sofa"), SAFE, DRESSER)
    _, opens = jax.jit(add_openings, static_argnums=(2, 3))(
        [jnp.full(4, 0.2), jnp.full((1, 2), 0.5)], furniture(kinds), 4, (EGG,)
    )
    assert np.asarray(opens.kept_category).tolist() == [0]
    assert np.asarray(opens.category).tolist() == [index("Drawer"), SAFE, index("Drawer"), 0]
    with pytest.raises(JaxactError, match="fronts must be at least 1"):
        replace(generator.APARTMENT, fronts=0)
