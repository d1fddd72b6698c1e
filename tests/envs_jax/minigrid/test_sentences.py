"""Levels mean the same in the Python package, rebuilt there from what can be seen of them."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest
from minigrid.core.world_object import Ball, Box, Door, Key, Wall
from minigrid.envs.babyai.core import verifier
from minigrid_reference import COLORS, python_env

import envs_jax
from envs_jax.minigrid import decode_mission, interop, tiles
from envs_jax.minigrid.instructions import MAX_CLAUSES, Program
from envs_jax.minigrid.state import CONTENTS_SHIFT, PADDING, TRACKED_MASK
from envs_jax.minigrid.tasks import GoToTask

IDS = [name for name in envs_jax.ids() if name.startswith("BabyAI-")]
QUICK_IDS = [
    "BabyAI-ActionObjDoor-v0",
    "BabyAI-MiniBossLevel-v0",
    "BabyAI-MoveTwoAcrossS5N2-v0",
    "BabyAI-OpenDoorsOrderN4Debug-v0",
    "BabyAI-PickupDistDebug-v0",
    "BabyAI-PickupLoc-v0",
]
LOCATIONS = {
    "on your left": "left",
    "on your right": "right",
    "in front of you": "front",
    "behind you": "behind",
}


def parse(text: str, strict: tuple[bool, ...]) -> Any:
    """Returns the package's instruction that a mission is the surface form of."""
    flags = iter(strict)
    if ", then " in text:
        first, second = text.split(", then ")
        return verifier.BeforeInstr(parse_side(first, flags), parse_side(second, flags))
    if " after you " in text:
        first, second = text.split(" after you ")
        return verifier.AfterInstr(parse_side(first, flags), parse_side(second, flags))
    return parse_side(text, flags)


def parse_side(text: str, strict: Any) -> Any:
    clauses = [parse_clause(clause, strict) for clause in text.split(" and ")]
    return clauses[0] if len(clauses) == 1 else verifier.AndInstr(*clauses)


def parse_clause(text: str, strict: Any) -> Any:
    is_strict = next(strict)
    if text.startswith("go to "):
        return verifier.GoToInstr(parse_description(text.removeprefix("go to ")))
    if text.startswith("open "):
        return verifier.OpenInstr(parse_description(text.removeprefix("open ")), is_strict)
    if text.startswith("pick up "):
        return verifier.PickupInstr(parse_description(text.removeprefix("pick up ")), is_strict)
    move, fixed = text.removeprefix("put ").split(" next to ")
    return verifier.PutNextInstr(parse_description(move), parse_description(fixed), is_strict)


def parse_description(text: str) -> verifier.ObjDesc:
    pattern = r"(?:a|the)(?: (red|green|blue|purple|yellow|grey))? (key|ball|box|door|object)(.*)"
    match = re.fullmatch(pattern, text)
    assert match is not None, text
    color, kind, rest = match.groups()
    location = LOCATIONS[rest.strip()] if rest else None
    return verifier.ObjDesc(None if kind == "object" else kind, color, location)


def rebuild(name: str, state: Any) -> Any:
    """Returns a Python environment with the tiles, the agent and the mission of a sampled level."""
    env = python_env(name)
    env.reset(seed=0)
    world = state.environment
    inside = (slice(PADDING, -PADDING),) * 2
    plane, marks = world.tiles[inside], world.marks[inside]
    for (x, y), code in np.ndenumerate(plane):
        env.grid.set(x, y, thing_of(int(code), int(marks[x, y]) >> CONTENTS_SHIFT))
        if env.grid.get(x, y) is not None:
            env.grid.get(x, y).cur_pos = (x, y)
    env.agent_pos, env.agent_dir = tuple(world.position.tolist()), int(world.direction)
    env.carrying = None
    flags = Program.unpack(state.task.program).strict if state.task.program is not None else 0
    present = present_clauses(state)
    strict = tuple(bool(int(flags) >> clause & 1) for clause in present)
    env.instrs = parse(decode_mission(state.task.mission), strict)
    env.mission = env.instrs.surface(env)
    env.instrs.reset_verifier(env)
    if not env.fixed_max_steps:
        rooms = env.num_rows * env.num_cols
        env.max_steps = env.room_size**2 * rooms * env.num_navs_needed(env.instrs)
    return env


def thing_of(code: int, content: int) -> Any:
    kind, color = code & tiles.TYPE_MASK, COLORS[code >> tiles.COLOR_SHIFT]
    key = Key(COLORS[content - 1]) if content else None
    return {
        tiles.EMPTY: lambda: None,
        tiles.WALL: lambda: Wall(color),
        tiles.KEY: lambda: Key(color),
        tiles.BALL: lambda: Ball(color),
        tiles.BOX: lambda: Box(color, key),
        tiles.OPEN_DOOR: lambda: Door(color, is_open=True),
        tiles.CLOSED_DOOR: lambda: Door(color),
        tiles.LOCKED_DOOR: lambda: Door(color, is_locked=True),
    }[kind]()


def present_clauses(state: Any) -> list[int]:
    """Returns the numbers of the clauses that there are: levels may leave gaps between them."""
    if state.task.program is None:
        return [0]
    program = Program.unpack(np.uint32(state.task.program))
    clauses = int(program.go_to | program.open | program.pick_up | program.put_next)
    return [number for number in range(MAX_CLAUSES) if clauses >> number & 1]


def closed_up(bits: Any, present: list[int]) -> np.ndarray:
    """Returns sets of clauses with the gaps between them closed."""
    bits = np.asarray(bits, np.int64)
    return sum((bits >> old & 1) << new for new, old in enumerate(present))


def check_levels(name: str, count: int) -> None:
    pomdp = envs_jax.make(name)
    keys = jax.random.split(jax.random.key(7), count)
    unseen = replace(pomdp, sensors={})
    states, _ = jax.device_get(jax.jit(jax.vmap(unseen.reset))(keys))
    for lane in range(count):
        state = jax.tree.map(lambda leaf, lane=lane: leaf[lane], states)
        env = rebuild(name, state)
        assert env.mission == decode_mission(state.task.mission)
        imported_pomdp, imported = interop.from_minigrid(env)
        assert imported_pomdp.task == pomdp.task
        np.testing.assert_array_equal(imported.task.mission, state.task.mission)
        assert imported.horizon == state.horizon == state.task.max_steps
        assert not state.task.ghosts.any()
        present = present_clauses(state)
        theirs, ours = imported.environment.marks, state.environment.marks
        np.testing.assert_array_equal(theirs & TRACKED_MASK & 15, closed_up(ours & 15, present))
        things = closed_up((ours & TRACKED_MASK) >> MAX_CLAUSES, present)
        np.testing.assert_array_equal((theirs & TRACKED_MASK) >> MAX_CLAUSES, things)
        if isinstance(pomdp.task, GoToTask):
            continue
        assert state.task.progress == 0
        our_program = Program.unpack(np.uint32(state.task.program))
        their_program = Program.unpack(np.uint32(imported.task.program))
        for one, other in zip(their_program, our_program, strict=True):
            assert int(one) == int(closed_up(other, present))


@pytest.mark.parametrize("name", QUICK_IDS)
def test_levels_mean_the_same_in_the_package(name):
    check_levels(name, 40)


@pytest.mark.parametrize("name", IDS)
@pytest.mark.slow
def test_all_levels_mean_the_same_in_the_package(name):
    check_levels(name, 200)
