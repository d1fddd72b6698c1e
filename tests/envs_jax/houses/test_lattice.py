"""Shortest walks on a lattice, beside a search over everything that the dynamics allow."""

from collections import deque
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from envs_jax.houses import lattice as lattices
from envs_jax.houses import presets
from envs_jax.houses.categories import index
from envs_jax.houses.scene import make_scene
from envs_jax.houses.visibility import seen_points

SIZE = 13
TASK = presets.object_nav("ithor")
STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0))
# A mug on a cupboard in the corner of a room of 3 by 3 m, behind a screen; a turned box in the way.
BOXES = [
    (1.5, 1.25, 0, 3, 2.5, 0.1, 0),
    (1.5, 1.25, 3, 3, 2.5, 0.1, 0),
    (0, 1.25, 1.5, 0.1, 2.5, 3, 0),
    (3, 1.25, 1.5, 0.1, 2.5, 3, 0),
    (1.9, 1, 1.6, 2, 2, 0.06, 0),
    (0.5, 0.2, 2.3, 0.3, 0.4, 0.2, 40),
    (2.75, 0.45, 2.75, 0.3, 0.9, 0.3, 0),
    (2.75, 1, 2.75, 0.1, 0.2, 0.1, 0),
]
KINDS = [*[index("Wall")] * 5, index("Box"), index("DiningTable"), index("Mug")]


@pytest.fixture(scope="module")
def surveyed():
    scene = make_scene(BOXES, KINDS, [(0, 0, 3, 3)])
    house, sight = TASK.house, TASK.sight
    axis = jnp.arange(SIZE, dtype=jnp.float32) * 0.25
    plans = jnp.stack(jnp.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)

    @jax.jit
    def survey(scene):
        wanted = scene.category == index("Mug")

        def go(plan, yaw):
            state = house.start(scene, plan, yaw)
            after = house.step(jax.random.key(0), state, house.actions.index("move_ahead"))
            return ~after.collided

        def look(plan):
            return jnp.any(seen_points(sight, house.body, scene.boxes, wanted, plan)[1])

        def advise(plan, yaw):
            state = house.start(scene, plan, yaw)
            return lattices.walk(house, found, state)

        found = lattices.survey(house, sight, scene, wanted, SIZE)
        yaws = jnp.arange(0, 360, 90).astype(jnp.float32)
        goes = jax.vmap(lambda plan: jax.vmap(lambda yaw: go(plan, yaw))(yaws))(plans)
        advice = jax.vmap(lambda plan: jax.vmap(lambda yaw: advise(plan, yaw))(yaws))(plans)
        return goes, jax.vmap(look)(plans), found.moves, advice

    goes, sees, moves, (action, valid) = jax.tree.map(np.asarray, survey(scene))
    shape = (SIZE, SIZE, 4)
    action, valid = action.reshape(shape), valid.reshape(shape)
    return goes.reshape(shape), sees.reshape(SIZE, SIZE), moves, action, valid


def test_walks_are_as_short_as_can_be(surveyed):
    goes, sees, moves, action, valid = surveyed
    names = TASK.house.actions
    ends = np.argwhere((moves == lattices.SEES).any(axis=-1) & sees)
    assert len(ends)
    metres = np.full((SIZE, SIZE), -1)
    queue = deque(map(tuple, ends.tolist()))
    for x, z in queue:
        metres[x, z] = 0
    while queue:
        x, z = queue.popleft()
        for heading, (right, up) in enumerate(STEPS):
            before = x - right, z - up
            inside = 0 <= before[0] < SIZE and 0 <= before[1] < SIZE
            if inside and goes[(*before, heading)] and metres[before] < 0:
                metres[before] = metres[x, z] + 1
                queue.append(before)
    walkers = np.argwhere((moves >= lattices.AHEAD) & (metres >= 0)[..., None])
    assert metres.max() > 8
    assert len(walkers) > 100
    for x, z, heading in walkers.tolist():
        start, walked = (x, z), 0
        for _ in range(60):
            if moves[x, z, heading] == lattices.SEES:
                break
            assert valid[x, z, heading]
            name = names[action[x, z, heading]]
            if name == "move_ahead":
                assert goes[x, z, heading]
                x, z, walked = x + STEPS[heading][0], z + STEPS[heading][1], walked + 1
            else:
                heading = (heading + {"rotate_right": 1, "rotate_left": -1}[name]) % 4
        assert moves[x, z, heading] == lattices.SEES
        assert walked == metres[start]


def test_agents_that_leave_the_lattice_have_none():
    assert lattices.fits(TASK.house)
    assert not lattices.fits(replace(TASK.house, turn=30.0))
    assert not lattices.fits(presets.object_nav("habitat").house)
