"""FurnMove and FurnLift against their rules in plain Python, over thousands of steps."""

import dataclasses
import functools
import itertools
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import envs_jax
from envs_jax.furniture import DrawnRooms, WrittenRooms, read_map
from envs_jax.furniture.coordination import LIFT_ACTIONS, MOVE_ACTIONS
from envs_jax.furniture.footprints import DRESSER, NEAR, RADIUS, TELEVISION, covered, places
from jaxact import JaxactError
from jaxact.testing import check_pomdp
from tests.envs_jax.furniture import rules
from tests.envs_jax.furniture.joint_plans import Plans

ROOM = (
    "#############",
    "#...........#",
    "#...........#",
    "#....oo.....#",
    "#....oo.....#",
    "#...........#",
    "###.........#",
    "###.........#",
    "#...........#",
    "#...........#",
    "#.......ooo.#",
    "#...........#",
    "#############",
)
LANES, STEPS = 32, 40


def cell(array):
    return tuple(map(int, array))


def cells(mask):
    return cells_of_rows(mask.tobytes(), mask.shape[1])


@functools.cache
def cells_of_rows(data, width):
    return frozenset(divmod(i, width) for i, is_set in enumerate(data) if is_set)


def world_of(state, lane):
    one = jax.tree.map(lambda x: np.asarray(x)[lane], state.environment)
    return one, {
        "floor": cells(one.floor),
        "agents": [cell(a) for a in one.agents],
        "yaw": one.yaw.tolist(),
        "object": cell(one.object),
        "object_yaw": int(one.object_yaw),
    }


@functools.cache
def begun(pomdp):
    """First states and observations of lanes."""
    return jax.jit(jax.vmap(pomdp.reset))(jax.random.split(jax.random.key(0), LANES))


def play(pomdp, likely, near=None):
    """Yields states before and after, actions and results of random play, in NumPy."""
    keys = jax.random.split(jax.random.key(0), LANES)

    @jax.jit
    def run(state):
        if near is not None:
            state = dataclasses.replace(state, environment=near(state.environment))

        def one(state, key):
            count = len(pomdp.environment.action_names)
            weights = jnp.log(jnp.full(count, 1.0).at[jnp.int32(likely)].set(3.0))
            action = jax.random.categorical(key, weights, shape=(LANES, 2)).astype(jnp.int32)
            # Half of the time both do the same, as few random pairs are coordinated.
            same = jax.random.bernoulli(jax.random.fold_in(key, 1), 0.5, (LANES, 1))
            action = jnp.where(same, action[:, :1], action)
            after, result = jax.vmap(pomdp.step)(keys, state, action)
            return after, (state, action, after, result)

        return jax.lax.scan(one, state, jax.random.split(jax.random.key(1), STEPS))[1]

    return jax.tree.map(np.asarray, run(begun(pomdp)[0]))


@pytest.mark.parametrize(
    "options", [{}, {"maps": (ROOM,), "size": 16, "one_passes": False}], ids=["drawn", "written"]
)
def test_furn_move_is_as_its_rules_say(options):
    pomdp = envs_jax.make("FurnMove-v0", **options)
    one_passes = pomdp.environment.one_passes
    before, action, after, result = play(pomdp, [3, 4, 5, 6, 7])
    kinds = {None: 0, "individual": 1, "together": 2}
    seen = {"carried": 0, "pushed": 0, "turned": 0, "blocked": 0, "closer": 0, "walked": 0}
    for lane in range(LANES):
        _, start = world_of(jax.tree.map(lambda x: x[0], before), lane)
        goal = cell(before.environment.goal[0, lane])
        closest = initial = sum(abs(a - b) for a, b in zip(start["object"], goal, strict=True))
        # What may be covered is told by where furniture fits, which is tested by itself.
        air = AirOf(before.environment.places[0, lane])
        uncoordinated = failed = 0
        for t in range(STEPS):
            old, world = world_of(jax.tree.map(lambda x, t=t: x[t], before), lane)
            new, expected = world_of(jax.tree.map(lambda x, t=t: x[t], after), lane)
            under = rules.body(rules.DRESSER, goal, int(old.goal_yaw))
            assert not under & world["floor"]
            names = [MOVE_ACTIONS[a] for a in action[t, lane]]
            kind, done = rules.move(world, air, names, one_passes)
            assert world == expected, (lane, t, names)
            assert int(new.kind) == kinds[kind]
            assert new.succeeded.tolist() == done
            distance = sum(abs(a - b) for a, b in zip(world["object"], goal, strict=True))
            reward = [
                -0.01 - 0.02 * (not ok) + (distance < closest or distance <= 1) for ok in done
            ]
            np.testing.assert_allclose(result.reward[t, lane], reward, atol=1e-6)
            seen["closer"] += distance < closest
            closest = min(closest, distance)
            uncoordinated += kind is None
            failed += 2 - sum(done)
            reached = distance * 0.25 < 0.26
            assert bool(result.terminated[t, lane]) == bool(result.success[t, lane]) == reached
            spl = reached * (initial + 1e-4) / (max(initial, t + 1) + 1e-4)
            found = {name: x[t, lane] for name, x in result.metrics.items()}
            np.testing.assert_allclose(found["md_spl"], spl, rtol=1e-5)
            np.testing.assert_allclose(found["distance"], distance * 0.25, rtol=1e-6)
            np.testing.assert_allclose(found["invalid_actions"], uncoordinated / (t + 1), rtol=1e-5)
            np.testing.assert_allclose(found["failed_actions"], failed / (2 * t + 2), rtol=1e-5)
            if kind == "together":
                seen["blocked"] += not done[0]
                for word in ("rotate", "agents", "object"):
                    if f"{word}_" in names[0] and done[0]:
                        key = {"agents": "carried", "object": "pushed", "rotate": "turned"}[word]
                        seen[key] += 1
                        break
            seen["walked"] += "move_ahead" in names and done[names.index("move_ahead")]
    assert min(seen.values()) > 0, seen


class AirOf:
    """Cells that a television may cover, as far as it is known where it fits."""

    def __init__(self, places):
        self.bodies = {
            frozenset(rules.body(rules.TELEVISION, cell(at), yaw))
            for yaw in range(4)
            for at in np.argwhere(places[yaw])
        }

    def __ge__(self, body):
        return frozenset(body) in self.bodies


def test_furn_lift_is_as_its_rules_say():
    pomdp = envs_jax.make("FurnLift-v0", agents_block=True)

    def around(state):
        """Every other lane's agents stand on both sides of the television, looking at it."""
        sides = state.object[:, None] + jnp.int32([[0, -4], [0, 4]])
        near = (jnp.arange(LANES) % 2 == 0)[:, None]
        return dataclasses.replace(
            state,
            floor=jnp.ones_like(state.floor),
            agents=jnp.where(near[..., None], sides, state.agents),
            yaw=jnp.where(near, jnp.int32([1, 3]), state.yaw),
        )

    def mean_gap(agents, middle):
        return np.mean([abs(r - middle[0]) + abs(c - middle[1]) for r, c in agents])

    drawn, _ = begun(pomdp)
    before, action, after, result = play(pomdp, [0, 4], around)
    seen = {"lifted": 0, "missed": 0, "failed": 0, "walked": 0, "blocked": 0}
    for lane in range(LANES):
        failed = missed = 0
        # Of the episode as it was drawn, before its agents were moved around the television.
        _, start = world_of(drawn, lane)
        initial = mean_gap(start["agents"], start["object"])
        for t in range(STEPS):
            _, world = world_of(jax.tree.map(lambda x, t=t: x[t], before), lane)
            new, expected = world_of(jax.tree.map(lambda x, t=t: x[t], after), lane)
            names = [LIFT_ACTIONS[a] for a in action[t, lane]]
            liftable, lifted, done = rules.lift(world, names, block=True)
            assert world == expected, (lane, t, names)
            assert (bool(new.liftable), bool(new.lifted)) == (liftable, lifted)
            assert new.succeeded.tolist() == done
            misses = [name == "pickup" and not lifted for name in names]
            reward = [
                1.0 if lifted else -0.01 - 0.02 * (not ok) - 0.1 * miss
                for ok, miss in zip(done, misses, strict=True)
            ]
            np.testing.assert_allclose(result.reward[t, lane], reward, atol=1e-6)
            assert bool(result.terminated[t, lane]) == bool(result.success[t, lane]) == lifted
            failed += sum(misses)
            missed += liftable and not lifted
            found = {name: x[t, lane] for name, x in result.metrics.items()}
            spl = lifted * (initial + 1e-4) / (max(initial, t + 1) + 1e-4)
            np.testing.assert_allclose(found["md_spl"], spl, rtol=1e-5)
            apart = mean_gap(world["agents"], world["object"])
            np.testing.assert_allclose(found["distance"], apart * 0.25, rtol=1e-6)
            assert result.metrics["failed_pickups"][t, lane] == failed
            assert result.metrics["missed_pickups"][t, lane] == missed
            seen["lifted"] += lifted
            seen["walked"] += "move_ahead" in names and done[names.index("move_ahead")]
            seen["blocked"] += "move_ahead" in names and not done[names.index("move_ahead")]
        seen["failed"] += failed
        seen["missed"] += missed
    assert min(seen.values()) > 0, seen


@pytest.mark.parametrize("one_passes", [True, False])
def test_coordination_is_as_the_rules_say_at_all_yaws(one_passes):
    world = envs_jax.make("FurnMove-v0", one_passes=one_passes).environment
    kinds = {None: 0, "individual": 1, "together": 2}
    for yaws in itertools.product(range(4), repeat=2):
        expected = [
            [kinds[rules.coordinated((a, b), yaws, one_passes)] for b in MOVE_ACTIONS]
            for a in MOVE_ACTIONS
        ]
        np.testing.assert_array_equal(world.matrices[yaws], expected)
        assert (world.matrices[yaws] == 2).sum() == 9
    lift = envs_jax.make("FurnLift-v0").environment.matrices[0, 0]
    assert lift.tolist() == [[1, 1, 1, 1, 0]] * 4 + [[0, 0, 0, 0, 2]]


def test_episodes_begin_as_they_should():
    pomdp = envs_jax.make("FurnMove-v0")
    room = jax.jit(jax.vmap(DrawnRooms().sample))(jax.random.split(jax.random.key(3), LANES))
    assert not bool(jnp.any(room.floor & ~room.air))
    state, seen = begun(pomdp)
    for lane in range(LANES):
        one, world = world_of(state, lane)
        fits = AirOf(one.places)
        assert rules.body(rules.TELEVISION, world["object"], world["object_yaw"]) <= fits
        assert all(
            a in world["floor"] and rules.can_stand(world, a, world["object"], world["object_yaw"])
            for a in world["agents"]
        )
        assert len(set(world["agents"])) == 2
        # A television can be put onto the dresser, and it is not there yet.
        assert one.places[one.goal_yaw, one.goal[0], one.goal[1]]
        assert abs(one.object - one.goal).sum() > 1
        for i in range(2):
            ahead = np.dot(one.object - one.agents[i], rules.STEPS[int(one.yaw[i])])
            assert ahead >= 0
            view = np.asarray(seen["view"])[lane, i]
            gap = one.agents[1 - i] - one.agents[i]
            forward = int(np.dot(gap, rules.STEPS[int(one.yaw[i])]))
            aside = int(np.dot(gap, rules.STEPS[int(one.yaw[i] + 1) % 4]))
            in_view = forward >= 0 and abs(aside) <= 7
            assert view[..., :4].sum() == in_view
            if in_view:
                turned = int(one.yaw[1 - i] - one.yaw[i]) % 4
                assert view[14 - forward, 7 + aside, turned] == 1
            assert view[14, 7, 5] == 1  # Oneself stands on the floor.


def has_plan(state):
    """Whether a first state, in NumPy, has a joint plan."""
    yaws, rows, columns = np.nonzero(state.places)
    places = set(zip(rows.tolist(), columns.tolist(), yaws.tolist(), strict=True))
    pose = (*cell(state.object), int(state.object_yaw))
    plans = Plans(cells(state.floor), places)
    return plans.reaches(pose, [cell(a) for a in state.agents], cell(state.goal))


def test_plans_lead_where_there_is_a_way():
    room = np.pad(np.ones((10, 20), bool), 2)
    state = {"object": (6, 6), "object_yaw": 0, "agents": [(8, 6), (4, 6)], "goal": (6, 15)}

    def solved(floor, air):
        square = [np.pad(x, ((0, 10), (0, 0))) for x in (floor, air)]
        fits = np.asarray(places(TELEVISION, jnp.asarray(square[1])))
        return has_plan(types.SimpleNamespace(places=fits, floor=square[0], **state))

    def without(row, column):
        """The room, but for these rows and columns."""
        left = room.copy()
        left[row, column] = False
        return left

    everywhere = slice(None)
    assert solved(room, room)
    # Over a table it can be pushed as far as arms reach.
    assert solved(without(everywhere, slice(11, 13)), room)
    assert not solved(without(everywhere, slice(8, 20)), room)
    # Through a gap in a wall it fits with one ahead and one behind; not if the gap is narrower.
    wall = without(everywhere, 12)
    assert not solved(wall, wall)
    for height, fits in ((3, True), (2, False)):
        wall = without(everywhere, 12)
        wall[4 : 4 + height, 12] = True
        assert solved(wall, wall) == fits


@pytest.mark.slow
def test_nearly_all_drawn_episodes_have_a_plan():
    """As many as `DrawnRooms` says, give or take chance."""
    pomdp = envs_jax.make("FurnMove-v0")
    keys = jax.random.split(jax.random.key(1), 500)
    state = jax.tree.map(np.asarray, jax.jit(jax.vmap(pomdp.reset))(keys)[0].environment)
    solved = [has_plan(jax.tree.map(lambda x, i=i: x[i], state)) for i in range(len(keys))]
    assert sum(solved) >= len(keys) - 4


def test_furniture_covers_its_cells_and_fits_where_they_are_free():
    air = np.random.default_rng(0).random((16, 16)) < 0.97
    free = cells(air)
    for shape, cells_of in ((TELEVISION, rules.TELEVISION), (DRESSER, rules.DRESSER)):
        fits = np.asarray(places(shape, jnp.asarray(air)))
        for yaw in range(4):
            expected = {
                at
                for at in itertools.product(range(16), repeat=2)
                if rules.body(cells_of, at, yaw) <= free
            }
            assert cells(fits[yaw]) == expected
            assert 0 < len(expected) < 150
            found = covered(shape, jnp.int32([7, 9]), jnp.int32(yaw), 16)
            assert cells(np.asarray(found)) == rules.body(cells_of, (7, 9), yaw)


def test_who_holds_a_television_stands_within_its_reach():
    for yaw in range(4):
        for at in itertools.product(range(2 * RADIUS + 1), repeat=2):
            offset = (at[0] - RADIUS, at[1] - RADIUS)
            assert NEAR[yaw][at] == rules.can_stand({}, offset, (0, 0), yaw)


@pytest.mark.parametrize(
    "name", [pytest.param("FurnMove-v0", marks=pytest.mark.slow), "FurnLift-v0"]
)
def test_the_worlds_are_sound(name):
    pomdp = envs_jax.make(name, maps=(ROOM,), size=14)
    check_pomdp(pomdp)
    picture = jax.jit(lambda key: pomdp.pictures(pomdp.reset(key)[0])["view"])
    found = np.asarray(picture(jax.random.key(0)))
    assert found.shape == (168, 168, 3)
    # Dark is only where agents look.
    assert (found == [20, 20, 20]).all(-1).any()


def test_rooms_are_read_from_reachable_points(tmp_path):
    points = np.float32([[x, z] for x in range(6) for z in range(4) if (x, z) != (5, 3)]) * 0.25
    np.save(tmp_path / "points.npy", points - 1.0)
    assert read_map(tmp_path / "points.npy") == (
        "ooooooo#",
        "o.....oo",
        *["o......o"] * 3,
        "oooooooo",
    )
    np.save(tmp_path / "points.npy", points * 1.1)
    with pytest.raises(JaxactError, match=r"grid of 0\.25 m"):
        read_map(tmp_path / "points.npy")
    for mistake in (np.nan, np.inf, 1e300):
        np.save(tmp_path / "points.npy", [[0.0, 0.0], [0.0, mistake]])
        with pytest.raises(JaxactError, match="no further than 5000 m from the origin"):
            read_map(tmp_path / "points.npy")


def test_rooms_in_which_an_episode_cannot_begin_are_refused():
    refused = [
        ("FurnMove-v0", ("." * 4,) * 4, "4 by 4 cells, has nowhere that two can hold"),
        ("FurnLift-v0", ("." * 4,) * 4, "4 by 4 cells, has nowhere that two can lift"),
        # Room for the television, but none to stand.
        ("FurnMove-v0", ("o" * 8,) * 3 + (".ooooooo",), "nowhere that two can hold"),
        ("FurnLift-v0", ("o" * 8,) * 8, "nowhere that two can lift"),
        # Room for the dresser too, but not wherever the two happen to stand.
        ("FurnMove-v0", ("." * 6,) * 5, r"no place for the dresser, .* is held over \[1, 2\]"),
        ("FurnMove-v0", ("oooooooo",) * 3 + ("........",) * 2, "no place for the dresser"),
    ]
    for name, rows, sentence in refused:
        with pytest.raises(JaxactError, match=rf"^maps\[1\], a room of .*{sentence}"):
            envs_jax.make(name, maps=(ROOM, rows), size=14)
    for name in ("FurnMove-v0", "FurnLift-v0"):
        envs_jax.make(name, maps=(("." * 10,) * 10,), size=14)


def test_what_cannot_be_is_refused():
    with pytest.raises(JaxactError, match="not 'x'"):
        WrittenRooms(((".x",),), 5)
    with pytest.raises(JaxactError, match="a map of 13 by 13 cells does not fit on 12"):
        envs_jax.make("FurnMove-v0", maps=(ROOM,), size=12)
    with pytest.raises(JaxactError, match="rooms must have edges of 10 to 10 cells"):
        envs_jax.make("FurnMove-v0", size=12)
    with pytest.raises(JaxactError, match="view must be an odd number"):
        envs_jax.make("FurnLift-v0", view=4)
