"""Instructions of every shape, followed step by step as the Python package follows them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from minigrid.core.actions import Actions
from minigrid.core.world_object import Ball, Box, Door, Key
from minigrid.envs.babyai.core import verifier
from minigrid_reference import compare, python_env, record_steps

COLORS = ("red", "blue")
SIZE = 5


def small_room(rng: np.random.Generator) -> Any:
    """Returns a room of 3 × 3 cells with a few things in it and a random instruction."""
    env = python_env("BabyAI-GoToObj-v0", room_size=SIZE)
    env.reset(seed=int(rng.integers(2**31)))
    inside = [(x, y) for x in range(1, SIZE - 1) for y in range(1, SIZE - 1)]
    rng.shuffle(inside)
    for cell in inside:
        env.grid.set(*cell, None)
    for cell in inside[: rng.integers(2, 6)]:
        env.put_obj(random_thing(rng), *cell)
    env.agent_pos, env.agent_dir = inside[-1], int(rng.integers(4))
    env.instrs = random_instruction(env, rng)
    env.instrs.reset_verifier(env)
    env.max_steps = 1000
    return env


def random_thing(rng: np.random.Generator) -> Any:
    color = COLORS[rng.integers(2)]
    content = Key(COLORS[rng.integers(2)]) if rng.random() < 0.5 else None
    door = Door(color, is_open=bool(rng.integers(2)), is_locked=bool(rng.integers(2)))
    return [Key(color), Ball(color), Box(color, content), door][rng.integers(4)]


def random_instruction(env: Any, rng: np.random.Generator) -> Any:
    def clause() -> Any:
        return random_clause(env, rng)

    def side() -> Any:
        return clause() if rng.random() < 0.5 else verifier.AndInstr(clause(), clause())

    shape = rng.integers(4)
    if shape == 0:
        return clause()
    if shape == 1:
        return verifier.AndInstr(clause(), clause())
    return (verifier.BeforeInstr if shape == 2 else verifier.AfterInstr)(side(), side())


def random_clause(env: Any, rng: np.random.Generator) -> Any:
    def describe(*kinds: str) -> verifier.ObjDesc:
        things = [thing for thing in env.grid.grid if thing is not None and thing.type in kinds]
        thing = things[rng.integers(len(things))] if things else Door("red")
        kind = thing.type if "door" in kinds or rng.random() < 0.7 else None
        color = thing.color if rng.random() < 0.6 else None
        location = verifier.LOC_NAMES[rng.integers(4)] if rng.random() < 0.2 else None
        return verifier.ObjDesc(kind if things else kinds[0], color, location)

    portable = ("key", "ball", "box")
    strict = bool(rng.random() < 0.25)
    verb = rng.integers(4)
    if verb == 0:
        return verifier.GoToInstr(describe(*portable, "door"))
    if verb == 1:
        return verifier.OpenInstr(describe("door"), strict)
    if verb == 2:
        return verifier.PickupInstr(describe(*portable), strict)
    return verifier.PutNextInstr(describe(*portable), describe(*portable, "door"), strict)


def choose(env: Any, rng: np.random.Generator) -> int:
    """Prefers actions that do something."""
    ahead = env.grid.get(*env.front_pos)
    if rng.random() < 0.15:
        return int(rng.integers(7))
    if ahead is None:
        wish = [Actions.drop] if env.carrying and rng.random() < 0.4 else [Actions.forward]
    elif ahead.type == "wall":
        wish = [Actions.left, Actions.right]
    elif ahead.type == "door":
        wish = [Actions.toggle, Actions.toggle, Actions.left, Actions.forward]
    else:
        wish = [Actions.pickup, Actions.pickup, Actions.toggle, Actions.left, Actions.right]
    return int(wish[rng.integers(len(wish))])


def play_small_rooms(episodes: int, seed: int) -> list:
    rng = np.random.default_rng(seed)
    recordings = []
    for _ in range(episodes):
        env = small_room(rng)
        for _ in range(int(rng.integers(12))):
            env.step(choose(env, rng))
        recordings.append(record_steps(env, lambda env: choose(env, rng)))
    return recordings


def check_small_rooms(episodes: int, seed: int) -> int:
    recordings = play_small_rooms(episodes, seed)
    answers = [recording.answers for recording in recordings]
    fulfilled = sum((a["reward"] > 0).any() for a in answers)
    failed = sum((a["terminated"] & (a["reward"] == 0)).any() for a in answers)
    assert fulfilled >= 0.15 * episodes
    assert failed >= 0.03 * episodes
    return compare(recordings)


def test_random_instructions_in_small_rooms_agree():
    assert check_small_rooms(200, seed=0) == 200 * 48


@pytest.mark.slow
def test_many_random_instructions_in_small_rooms_agree():
    for seed in range(1, 21):
        check_small_rooms(1000, seed)
