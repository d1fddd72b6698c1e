"""Levels have the package's distribution, and every one of them can be solved."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from minigrid_reference import COLORS, python_env
from scipy.stats import chi2_contingency

import envs_jax
from envs_jax.minigrid import decode_mission, rules, tiles
from envs_jax.minigrid.instructions import MAX_CLAUSES
from envs_jax.minigrid.rule_import import ImportedRule, import_rule
from envs_jax.minigrid.rules import RuleTask
from envs_jax.minigrid.samplers import placement
from envs_jax.minigrid.state import CONTENTS_SHIFT, PADDING, TRACKED_MASK

IDS = [name for name in envs_jax.ids() if name.startswith(("MiniGrid-", "BabyAI-"))]
# One or two of each kind of level.
SAMPLE = [
    "MiniGrid-Empty-8x8-v0",
    "MiniGrid-Empty-Random-6x6-v0",
    "MiniGrid-FourRooms-v0",
    "MiniGrid-DoorKey-5x5-v0",
    "MiniGrid-DoorKey-8x8-v0",
    "MiniGrid-LavaCrossingS9N2-v0",
    "MiniGrid-SimpleCrossingS9N3-v0",
    "MiniGrid-SimpleCrossingS11N5-v0",
    "MiniGrid-DistShift2-v0",
    "MiniGrid-LavaGapS7-v0",
    "MiniGrid-MultiRoom-N2-S4-v0",
    "MiniGrid-MultiRoom-N4-S5-v1",
    "MiniGrid-MultiRoom-N6-v0",
    "MiniGrid-LockedRoom-v0",
    "MiniGrid-Playground-v0",
    "MiniGrid-Fetch-5x5-N2-v0",
    "MiniGrid-Fetch-8x8-N3-v0",
    "MiniGrid-GoToObject-6x6-N2-v0",
    "MiniGrid-PutNear-6x6-N2-v0",
    "MiniGrid-PutNear-8x8-N3-v0",
    "MiniGrid-GoToDoor-5x5-v0",
    "MiniGrid-GoToDoor-8x8-v0",
    "MiniGrid-RedBlueDoors-6x6-v0",
    "MiniGrid-MemoryS7-v0",
    "MiniGrid-MemoryS13Random-v0",
    "MiniGrid-Unlock-v0",
    "MiniGrid-UnlockPickup-v0",
    "MiniGrid-BlockedUnlockPickup-v0",
    "MiniGrid-KeyCorridorS3R1-v0",
    "MiniGrid-KeyCorridorS3R2-v0",
    "MiniGrid-KeyCorridorS4R3-v0",
    "MiniGrid-KeyCorridorS6R3-v0",
    "MiniGrid-ObstructedMaze-1Dl-v0",
    "MiniGrid-ObstructedMaze-1Dlhb-v0",
    "MiniGrid-ObstructedMaze-2Dlhb-v0",
    "MiniGrid-ObstructedMaze-2Dlhb-v1",
    "MiniGrid-ObstructedMaze-Full-v0",
    "MiniGrid-ObstructedMaze-Full-v1",
    "MiniGrid-Dynamic-Obstacles-6x6-v0",
    "MiniGrid-Dynamic-Obstacles-Random-5x5-v0",
    "BabyAI-GoToObjS4-v0",
    "BabyAI-GoToLocalS5N2-v0",
    "BabyAI-GoToLocalS6N4-v0",
    "BabyAI-GoToLocal-v0",
    "BabyAI-GoToRedBall-v0",
    "BabyAI-GoToRedBallGrey-v0",
    "BabyAI-GoToRedBlueBall-v0",
    "BabyAI-GoToImpUnlock-v0",
    "BabyAI-GoToObjDoor-v0",
    "BabyAI-GoToObjMazeS4R2-v0",
    "BabyAI-GoToOpen-v0",
    "BabyAI-GoToSeqS5R2-v0",
    "BabyAI-Open-v0",
    "BabyAI-OpenDoor-v0",
    "BabyAI-OpenDoorsOrderN4-v0",
    "BabyAI-OpenRedBlueDoors-v0",
    "BabyAI-OpenRedDoor-v0",
    "BabyAI-PickupDist-v0",
    "BabyAI-PickupLoc-v0",
    "BabyAI-PickupAbove-v0",
    "BabyAI-UnblockPickup-v0",
    "BabyAI-PutNextLocalS5N3-v0",
    "BabyAI-PutNextS5N2Carrying-v0",
    "BabyAI-MoveTwoAcrossS8N9-v0",
    "BabyAI-Unlock-v0",
    "BabyAI-UnlockLocalDist-v0",
    "BabyAI-KeyInBox-v0",
    "BabyAI-UnlockPickupDist-v0",
    "BabyAI-BlockedUnlockPickup-v0",
    "BabyAI-UnlockToUnlock-v0",
    "BabyAI-ActionObjDoor-v0",
    "BabyAI-FindObjS5-v0",
    "BabyAI-KeyCorridorS3R3-v0",
    "BabyAI-OneRoomS12-v0",
    "BabyAI-SynthS5R2-v0",
    "BabyAI-SynthSeq-v0",
    "BabyAI-MiniBossLevel-v0",
    "BabyAI-BossLevel-v0",
    "BabyAI-BossLevelNoUnlock-v0",
]
QUICK_SAMPLE = [
    "MiniGrid-DoorKey-5x5-v0",
    "MiniGrid-SimpleCrossingS9N3-v0",
    "MiniGrid-MultiRoom-N4-S5-v1",
    "MiniGrid-PutNear-8x8-N3-v0",
    "MiniGrid-GoToDoor-8x8-v0",
    "MiniGrid-MemoryS13Random-v0",
    "MiniGrid-KeyCorridorS4R3-v0",
    "MiniGrid-ObstructedMaze-2Dlhb-v0",
    "MiniGrid-Dynamic-Obstacles-Random-5x5-v0",
    "BabyAI-GoToRedBlueBall-v0",
    "BabyAI-UnlockPickupDist-v0",
    "BabyAI-MiniBossLevel-v0",
]
# Levels in which objects are in reach of the agent without opening or moving anything.
ONE_ROOM = [
    name
    for name in IDS
    if re.match(r"BabyAI-(GoToObj|GoToLocal|GoToRed|PutNextLocal|PickupLoc)", name)
    and not re.search("Maze|Door", name)
]
# Levels that `assert_solvable` knows how to solve.
SOLVABLE = [name for name in IDS if name.startswith("MiniGrid")] + ONE_ROOM
KINDS = ("key", "ball", "box", "door", "object")
EMPTY, WALL, DOOR, KEY, BALL, BOX, GOAL, LAVA = 1, 2, 4, 5, 6, 7, 8, 9


@dataclass
class Level:
    """A first state: image [W, H, 3] in MiniGrid's encoding, the agent's pose, the mission."""

    image: np.ndarray
    position: tuple[int, int]
    direction: int
    mission: str
    horizon: int
    # What a rule is about: its target, its cells, and the cell of the object to be picked up.
    about: tuple[int, list[tuple[int, int]], list[tuple[int, int]]]
    # Colours of the keys that are hidden in boxes.
    hidden: list[int]

    def cells(self, *kinds: int) -> list[tuple[int, int]]:
        return [tuple(cell) for cell in np.argwhere(np.isin(self.image[..., 0], kinds)).tolist()]


def package_levels(name: str, count: int) -> list[Level]:
    env = python_env(name)
    levels = []
    for seed in range(count):
        env.reset(seed=seed)
        position = (int(env.agent_pos[0]), int(env.agent_pos[1]))
        if env.carrying is not None:  # It was taken up after the first observation.
            env.grid.set(*env.carrying.init_pos, env.carrying)
        rule = import_rule(env) or ImportedRule(rules.PLAY)
        tracked = [] if rule.tracked is None else [_cell(rule.tracked.cur_pos)]
        about = rule.target, list(rule.cells), tracked
        boxes = [thing for thing in env.grid.grid if thing is not None and thing.type == "box"]
        hidden = [COLORS.index(box.contains.color) for box in boxes if box.contains]
        pose = position, int(env.agent_dir)
        horizon = env.max_steps
        levels.append(Level(env.grid.encode(), *pose, env.mission, horizon, about, hidden))
    return levels


def _cell(position: Any) -> tuple[int, int]:
    return int(position[0]), int(position[1])


@cache
def our_states(name: str, count: int) -> tuple[Any, Any]:
    pomdp = envs_jax.make(name)
    pomdp = replace(pomdp, sensors={"mission": pomdp.sensors["mission"]})
    keys = jax.random.split(jax.random.key(0), count)
    return jax.device_get(jax.jit(jax.vmap(pomdp.reset))(keys))


def our_levels(name: str, count: int) -> list[Level]:
    pomdp = envs_jax.make(name)
    states, observations = our_states(name, count)
    world = states.environment
    inside = slice(PADDING, -PADDING)
    images = tiles.ENCODING[world.tiles[:, inside, inside]]
    missions = observations["mission"]
    marks = world.marks[:, inside, inside]
    assert (world.carrying == 0).all()
    levels = []
    for lane in range(count):
        about = 0, [], []
        if isinstance(pomdp.task, RuleTask):
            cells = [_cell(cell) for cell in states.task.cells[lane] if cell.any()]
            tracked = [_cell(cell) for cell in np.argwhere(marks[lane] & TRACKED_MASK)]
            about = int(states.task.target[lane]), cells, tracked
        pose = _cell(world.position[lane]), int(world.direction[lane])
        mission, horizon = decode_mission(missions[lane]), int(states.horizon[lane])
        contents = marks[lane].T.reshape(-1) >> CONTENTS_SHIFT
        hidden = [int(content) - 1 for content in contents if content]
        levels.append(Level(images[lane], *pose, mission, horizon, about, hidden))
    return levels


def features(level: Level) -> Iterator[tuple[str, object]]:
    """What is counted; pairs of (feature, value)."""
    yield "agent", level.position
    yield "direction", level.direction
    yield "mission", level.mission
    words = level.mission.split()
    yield "horizon", level.horizon
    yield "colours named", sum(word in COLORS for word in words)
    yield (
        "shape of the mission",
        " ".join("…" if word in COLORS + KINDS else word for word in words),
    )
    for name, kind in (("door", DOOR), ("key", KEY), ("ball", BALL), ("box", BOX), ("goal", GOAL)):
        cells = level.cells(kind)
        yield f"number of {name}", len(cells)
        for x, y in cells:
            yield f"{name} cell", (x, y)
            yield f"{name} looks", tuple(level.image[x, y, 1:])
    for state in range(3):
        shown = level.image[..., 2] == state
        yield f"doors in state {state}", int(((level.image[..., 0] == DOOR) & shown).sum())
    wall = np.isin(level.image[..., 0], (WALL, LAVA))
    for axis, length in enumerate(wall.shape):
        for line in {2, 4, length // 2}:
            if line < length - 2:
                yield f"line {line} along axis {axis}", wall.take(line, axis).tobytes()
        yield f"extent along axis {axis}", tuple(wall.any(axis=1 - axis).nonzero()[0][[0, -1]])
    yield "number of walls", int(wall.sum())
    nearest = [abs(x - level.position[0]) + abs(y - level.position[1]) for x, y in things(level)]
    target, cells, tracked = level.about
    yield "target", (target, level.mission)
    yield "number of cells", (len(cells), len(tracked))
    for number, (x, y) in enumerate(cells + tracked):
        yield f"what is in cell {number}", (tuple(level.image[x, y]), level.mission)
        yield f"cell {number}", (x, y)
        # MemoryEnv's cells are next to objects, one of which is like that at the start.
        beside = level.image[x, y - 1 : y + 2, 0].tolist()
        cue = level.image[1, level.image.shape[1] // 2 - 1, 0]
        yield f"what is beside cell {number}", (*beside, int(cue))
    locked = {color for _, color, _ in level.image[level.image[..., 2] == 2].tolist()}
    yield "hidden keys", (len(level.hidden), len(locked), locked.issuperset(level.hidden))
    for number, color in enumerate(level.hidden):
        yield f"hidden key {number}", color
    yield "distance of the nearest thing", min(nearest, default=-1)


def things(level: Level) -> list[tuple[int, int]]:
    return level.cells(KEY, BALL, BOX, GOAL)


def p_value(ours: Counter, theirs: Counter) -> float:
    """Returns the p-value of the two samples having one distribution; rare values are pooled."""
    kept = [value for value in ours | theirs if ours[value] + theirs[value] >= 20]
    table = [[sample[value] for value in kept] for sample in (ours, theirs)]
    for row, sample in zip(table, (ours, theirs), strict=True):
        row.append(sample.total() - sum(row))
    columns = np.array(table)[:, np.sum(table, axis=0) > 0]
    return 1.0 if columns.shape[1] < 2 else chi2_contingency(columns).pvalue


@pytest.mark.parametrize("name", SAMPLE)
@pytest.mark.slow
def test_levels_of_every_kind_have_the_packages_distribution(name):
    compare_distributions(name, 4000, 4000)


@pytest.mark.parametrize("name", QUICK_SAMPLE)
def test_levels_have_the_packages_distribution(name):
    compare_distributions(name, 1000, 500)


def compare_distributions(name: str, our_count: int, their_count: int) -> None:
    counts: dict[str, tuple[Counter, Counter]] = {}
    for side, levels in enumerate((our_levels(name, our_count), package_levels(name, their_count))):
        for level in levels:
            for feature, value in features(level):
                counts.setdefault(feature, (Counter(), Counter()))[side][value] += 1
    for feature, (ours, theirs) in counts.items():
        assert p_value(ours, theirs) > 1e-5, feature


def flood(level: Level, passable: tuple[int, ...]) -> set[tuple[int, int]]:
    """Returns the cells that the agent can stand on, going over cells of the given types."""
    seen, queue = set(), [level.position]
    while queue:
        x, y = queue.pop()
        if (x, y) in seen:
            continue
        seen.add((x, y))
        for cell in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            if level.image[cell][0] in passable:
                queue.append(cell)
    return seen


def touched(cells: set[tuple[int, int]], x: int, y: int) -> bool:
    return bool({(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)} & cells)


@pytest.mark.parametrize("name", SOLVABLE)
@pytest.mark.slow
def test_every_level_of_every_world_can_be_solved(name):
    assert_solvable(name, 2000)


@pytest.mark.parametrize("name", [name for name in QUICK_SAMPLE if name in SOLVABLE])
def test_every_level_can_be_solved(name):
    assert_solvable(name, 1000)


def assert_solvable(name: str, count: int) -> None:
    for level in our_levels(name, count):
        assert level.image[level.position][0] == EMPTY
        if name.startswith("BabyAI"):
            stands = flood(level, (EMPTY,))
            assert all(touched(stands, x, y) for x, y in things(level))
            continue
        if level.cells(GOAL):
            (goal,) = level.cells(GOAL)
            # Obstacles make way.
            passable = (EMPTY, GOAL, BALL) if "Obstacles" in name else (EMPTY, GOAL, KEY, DOOR)
            assert goal in flood(level, passable)
        if "DoorKey" in name:
            stands = flood(level, (EMPTY,))
            (key,), (door,) = level.cells(KEY), level.cells(DOOR)
            assert touched(stands, *key)
            assert goal not in flood(level, (EMPTY, GOAL, KEY))
            assert tuple(level.image[door][1:]) == (tiles.YELLOW, 2)


def test_the_target_is_what_the_mission_says():
    assert_targets("BabyAI-GoToRedBlueBall-v0", 1000)


@pytest.mark.parametrize("name", [name for name in ONE_ROOM if name.startswith("BabyAI-GoTo")])
@pytest.mark.slow
def test_all_targets_are_what_the_missions_say(name):
    assert_targets(name, 2000)


def assert_targets(name: str, count: int) -> None:
    states, observations = our_states(name, count)
    for marks, codes, mission in zip(
        states.environment.marks,
        states.environment.tiles,
        observations["mission"],
        strict=True,
    ):
        (code,) = set(codes[marks == 1].tolist())
        *_, article, color, kind = decode_mission(mission).split()
        kind_code = {"key": KEY, "ball": BALL, "box": BOX}[kind]
        named = COLORS.index(color)
        assert code == tiles.tile(kind_code, named)
        assert (marks == 1).sum() == (codes == code).sum()
        assert article == ("a" if (marks == 1).sum() > 1 else "the")


# How many levels are rejected for one that is accepted is most of what a sampler's checks do.
@pytest.mark.parametrize("name", ["BabyAI-GoToSeqS5R2-v0", "BabyAI-PutNextLocalS5N3-v0"])
def test_levels_are_rejected_as_often_as_in_the_package(name, capsys):
    sampler = envs_jax.make(name).sampler
    draws = jax.random.uniform(jax.random.key(1), (2000, sampler.num_draws), jnp.float32)
    _, valid = jax.jit(jax.vmap(sampler.draw))(draws)
    capsys.readouterr()
    accepted = 500
    package_levels(name, accepted)
    rejected = len(re.findall("Sampling rejected|Timeout", capsys.readouterr().out))
    table = [[int(valid.sum()), int((~valid).sum())], [accepted, rejected]]
    assert chi2_contingency(table).pvalue > 1e-5


def test_what_the_agent_begins_with_in_its_hands_shows_only_after_the_first_step():
    name = "BabyAI-PutNextS5N2Carrying-v0"
    pomdp = envs_jax.make(name)
    keys = jax.random.split(jax.random.key(0), 100)
    state, first = jax.jit(jax.vmap(pomdp.reset))(keys)
    after, step = jax.jit(jax.vmap(pomdp.step, in_axes=(0, 0, None)))(keys, state, jnp.int32(6))
    assert (state.environment.carrying == 0).all()
    assert (first["image"][:, 3, 6, 0] == EMPTY).all()
    held = after.environment.carrying
    np.testing.assert_array_equal(step.observation["image"][:, 3, 6, 0], held & tiles.TYPE_MASK)
    put = after.environment.carrying_mark >> MAX_CLAUSES & 1
    assert (put == 1).all()
    objects = [
        (np.asarray(one.tiles) & 15 >= KEY).sum() for one in (state.environment, after.environment)
    ]
    assert objects == [400, 300]
    assert not step.terminated.any()


def test_choose_cell_is_uniform_over_the_free_cells_and_says_when_there_are_none():
    free = np.array([[False, True, True], [True, False, True]])
    draws = (np.arange(400, dtype=np.float32) + 0.5) / 400
    choose = jax.vmap(placement.choose_cell, in_axes=(0, None))
    cells, found = choose(draws, jnp.asarray(free))
    assert found.all()
    assert Counter(map(tuple, np.asarray(cells).tolist())) == {
        (0, 1): 100,
        (0, 2): 100,
        (1, 0): 100,
        (1, 2): 100,
    }
    assert not placement.choose_cell(np.float32(0.5), jnp.zeros((2, 3), bool))[1]
    last, _ = placement.choose_cell(np.nextafter(np.float32(1), np.float32(0)), jnp.asarray(free))
    assert last.tolist() == [1, 2]


def test_objects_behind_others_are_not_reachable():
    board = placement.walled(6, 6)
    board[1, 2] = board[2, 1] = tiles.tile(tiles.BALL, tiles.RED)
    assert placement.objects_reachable(board, np.array([4, 4], np.int32))
    board[1, 1] = tiles.tile(tiles.KEY, tiles.BLUE)
    assert not placement.objects_reachable(board, np.array([4, 4], np.int32))
    board[2, 1] = tiles.tile(tiles.LOCKED_DOOR, tiles.RED)
    assert placement.objects_reachable(board, np.array([4, 4], np.int32))
