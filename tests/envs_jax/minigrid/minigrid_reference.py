"""Plays the Python package, records what it does, and replays it here."""

from __future__ import annotations

import warnings
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import minigrid  # noqa: F401 (it registers its ids)
import numpy as np
from minigrid.core.world_object import Ball, Box, Door, Floor, Goal, Key, Lava, Wall

import envs_jax
from envs_jax import minigrid as jax_minigrid
from envs_jax.minigrid import interop, tiles
from envs_jax.minigrid.obstacles import ObstacleWorld
from envs_jax.minigrid.state import GridState
from jaxact.pomdp import POMDP, State

# Worlds that the package can make: the pictures that its WFC worlds are made from are not in it.
PACKAGE_IDS = [
    name
    for name in envs_jax.ids()
    if name.startswith(("MiniGrid-", "BabyAI-")) and "-WFC-" not in name
]
COLORS = ("red", "green", "blue", "purple", "yellow", "grey")
STEPS = 48

# Left, right, forward, pickup, drop, toggle, done.
MOODS = {
    "uniform": [1, 1, 1, 1, 1, 1, 1],
    "walker": [2, 2, 8, 0.3, 0.3, 0.3, 0.2],
    "handler": [1, 1, 3, 3, 2, 3, 0.3],
}


@dataclass
class Recording:
    """An imported episode, the actions taken and what the package answered."""

    pomdp: POMDP
    state: State
    actions: np.ndarray
    first: dict[str, Any]
    answers: dict[str, np.ndarray]
    missions: list[str]
    # Where obstacles went, [step, obstacle, 2]; no world without them has any.
    moves: np.ndarray


def python_env(name: str, **options: Any) -> Any:
    with warnings.catch_warnings():
        # Gymnasium deprecates every id of which there is a newer version.
        warnings.simplefilter("ignore", DeprecationWarning)
        return gymnasium.make(name, disable_env_checker=True, **options).unwrapped


def play(
    env: Any, rng: np.random.Generator, *, seed: int, prefix: int, scrambled: bool
) -> Recording:
    """Records one episode from after `prefix` steps, the state scrambled if so wished."""
    env.reset(seed=seed)
    weights = np.array(list(MOODS.values())[rng.integers(len(MOODS))], float)
    draw = partial(rng.choice, 7, p=weights / weights.sum())
    for action in draw(size=prefix):
        if stays_inside(env, action):
            env.step(action)
    if scrambled:
        scramble(env, rng)
    return record_steps(env, lambda _: draw())


def play_as_expert(envs: Iterable[Any], rng: np.random.Generator, size: int) -> list[Recording]:
    """Records the end of an episode of each environment, led there by our expert.

    What the expert does from the beginning is computed here, for all of them in few programs (see
    `embedded`). All but the last steps before its success are taken first and not recorded.
    """
    groups: dict[Any, list[tuple[Any, State]]] = defaultdict(list)
    for env in envs:
        pomdp, state = interop.from_minigrid(env)
        none = np.zeros((STEPS, 0, 2), np.int32)
        whole = Recording(pomdp, state, np.zeros(STEPS), {}, {}, [], none)
        large = embedded(whole, size)
        plan = replace(large.pomdp, sampler=None, sensors={})
        shapes = tuple(np.shape(leaf) for leaf in jax.tree.leaves(large.state))
        groups[plan, shapes].append((env, large.state))
    recordings = []
    for (pomdp, _), group in groups.items():
        states = jax.tree.map(lambda *leaves: np.stack(leaves), *[state for _, state in group])
        actions, finished = jax.device_get(_follow_expert(pomdp, states))
        for (env, _), plan, ends in zip(group, actions, finished, strict=True):
            end = int(np.argmax(ends)) if ends.any() else len(plan) - 1
            begin = max(0, min(end + int(rng.integers(2, STEPS)), len(plan)) - STEPS)
            for action in plan[:begin]:
                env.step(int(action) if stays_inside(env, action) else 6)
            rest = iter(plan[begin:].tolist())
            recordings.append(record_steps(env, lambda _, rest=rest: next(rest)))
    return recordings


@partial(jax.jit, static_argnums=0)
def _follow_expert(pomdp: POMDP, states: State) -> tuple[jax.Array, jax.Array]:
    """Returns what the expert does and whether the episode is over, [lanes, 5 * STEPS]."""

    def act(states: State, key: jax.Array) -> tuple[State, tuple[jax.Array, jax.Array]]:
        keys = jax.random.split(key, states.steps.shape[0])
        advice = jax.vmap(pomdp.expert)(keys, states)
        states, step = jax.vmap(pomdp.step)(keys, states, advice.action)
        return states, (advice.action, step.finished)

    _, played = jax.lax.scan(act, states, jax.random.split(jax.random.key(0), 5 * STEPS))
    return jax.tree.map(lambda x: jnp.moveaxis(x, 0, 1), played)


def record_steps(env: Any, choose: Callable[[Any], int]) -> Recording:
    """Records what the package does on the actions chosen, whether or not the episode ends.

    An action that would make the package's step fail is `done` instead.
    """
    pomdp, state = interop.from_minigrid(env)
    first = env.gen_obs()
    actions, missions, moves = [], [], []
    answers = defaultdict(list)
    for _ in range(STEPS):
        action = choose(env)
        actions.append(action if stays_inside(env, action) else 6)
        observation, reward, terminated, truncated, _ = env.step(actions[-1])
        answers["image"].append(observation["image"])
        answers["direction"].append(observation["direction"])
        answers["reward"].append(reward)
        answers["terminated"].append(terminated)
        answers["truncated"].append(truncated)
        missions.append(observation["mission"])
        moves.append([ball.cur_pos for ball in getattr(env, "obstacles", [])])
    stacked = {name: np.array(values) for name, values in answers.items()}
    return Recording(
        pomdp, state, np.array(actions), first, stacked, missions, np.array(moves, np.int32)
    )


def stays_inside(env: Any, action: int) -> bool:
    """Whether the agent will not face a cell beyond the grid, where the package's step fails."""
    turn = {0: -1, 1: 1}.get(action, 0)
    dx, dy = ((1, 0), (0, 1), (-1, 0), (0, -1))[(env.agent_dir + turn) % 4]
    reach = 2 if action == 2 else 1
    x, y = env.agent_pos[0] + reach * dx, env.agent_pos[1] + reach * dy
    return 0 <= x < env.width and 0 <= y < env.height


def scramble(env: Any, rng: np.random.Generator) -> None:
    """Changes the world by hand: things, doors, hands, pose, what time is left."""
    empty = [(x, y) for x in range(env.width) for y in range(env.height) if not env.grid.get(x, y)]
    rng.shuffle(empty)
    for x, y in empty[: rng.integers(min(9, len(empty)))]:
        env.put_obj(random_thing(rng), x, y)
    for thing in env.grid.grid:
        if thing is not None and thing.type == "door" and rng.random() < 0.5:
            thing.is_open, thing.is_locked = bool(rng.integers(2)), bool(rng.integers(2))
    if hasattr(env, "instrs") and rng.random() < 0.3:
        move_something(env, rng)
    if rng.random() < 0.5:
        passable = [
            (x, y)
            for x in range(1, env.width - 1)
            for y in range(1, env.height - 1)
            if env.grid.get(x, y) is None or env.grid.get(x, y).can_overlap()
        ]
        env.agent_pos = passable[rng.integers(len(passable))]
        env.agent_dir = int(rng.integers(4))
    if rng.random() < 0.5:
        face_something(env, rng)
    if rng.random() < 0.4:
        env.carrying = random_portable(rng)
    elif rng.random() < 0.4 and env.carrying is None:
        take_something(env, rng)
    if rng.random() < 0.5:
        env.max_steps = env.step_count + int(rng.integers(1, STEPS))


def actions_of(instr: Any) -> list[Any]:
    """Returns the clauses of an instruction."""
    if not hasattr(instr, "instr_a"):
        return [instr]
    return actions_of(instr.instr_a) + actions_of(instr.instr_b)


def descriptions_of(instr: Any) -> list[Any]:
    """Returns all descriptions of objects in an instruction."""
    names = ("desc", "desc_move", "desc_fixed")
    return [getattr(a, name) for a in actions_of(instr) for name in names if hasattr(a, name)]


def move_something(env: Any, rng: np.random.Generator) -> None:
    """Moves a tracked object by hand, so that the instruction believes it elsewhere."""
    descriptions = descriptions_of(env.instrs)
    believed = descriptions[rng.integers(len(descriptions))].obj_poss
    x, y = believed[0] if believed else (0, 0)
    empty = [index for index, thing in enumerate(env.grid.grid) if thing is None]
    thing = env.grid.get(x, y)
    if empty and thing is not None and thing.type != "wall":
        env.grid.set(x, y, None)
        index = empty[rng.integers(len(empty))]
        env.grid.grid[index] = thing
        thing.cur_pos = (index % env.width, index // env.width)
        if env.carrying is not None:  # What is held since the beginning still has its position.
            env.carrying.cur_pos = (-1, -1)


def face_something(env: Any, rng: np.random.Generator) -> None:
    """Puts the agent in front of a random thing that is no wall, if there is room."""
    poses = []
    for x, y in np.ndindex(env.width, env.height):
        thing = env.grid.get(x, y)
        for direction, (dx, dy) in enumerate(((1, 0), (0, 1), (-1, 0), (0, -1))):
            here = x - dx, y - dy
            inside = 0 < here[0] < env.width - 1 and 0 < here[1] < env.height - 1
            if thing is not None and thing.type != "wall" and inside and not env.grid.get(*here):
                poses.append((here, direction))
    if poses:
        env.agent_pos, env.agent_dir = poses[rng.integers(len(poses))]


def take_something(env: Any, rng: np.random.Generator) -> None:
    """Puts a random thing of the grid, if there is one, into the agent's hands."""
    places = [
        index
        for index, thing in enumerate(env.grid.grid)
        if thing is not None and thing.can_pickup() and thing not in getattr(env, "obstacles", [])
    ]
    if places:
        index = places[rng.integers(len(places))]
        env.carrying, env.grid.grid[index] = env.grid.grid[index], None
        env.carrying.cur_pos = (-1, -1)  # As picking it up does.


def random_portable(rng: np.random.Generator) -> Any:
    color = COLORS[rng.integers(6)]
    content = Key(COLORS[rng.integers(6)]) if rng.random() < 0.6 else None
    return [Key(color), Ball(color), Box(color, content)][rng.integers(3)]


def random_thing(rng: np.random.Generator) -> Any:
    color = COLORS[rng.integers(6)]
    door = Door(color, is_open=bool(rng.integers(2)), is_locked=bool(rng.integers(2)))
    scenery = [door, door, Goal(), Lava(), Floor(color), Wall(color)]
    return random_portable(rng) if rng.random() < 0.6 else scenery[rng.integers(len(scenery))]


class ScriptedObstacles(ObstacleWorld):
    """Obstacles whose moves are given, in the place of a key."""

    def draw_moves(self, key: jax.Array, state: Any) -> jax.Array:
        return key


@partial(jax.jit, static_argnums=0)
def _replay(pomdp: POMDP, states: State, actions: jax.Array, moves: jax.Array) -> tuple[Any, Any]:
    world = pomdp.environment
    if isinstance(world, ObstacleWorld):
        pomdp = replace(pomdp, environment=ScriptedObstacles(world.width, world.height))

    def one(state: State, actions: jax.Array, moves: jax.Array) -> tuple[Any, Any]:
        _, steps = jax.lax.scan(lambda s, x: pomdp.step(x[1], s, x[0]), state, (actions, moves))
        return pomdp.observe(state), steps

    return jax.vmap(one)(states, actions, moves)


def embed(world: GridState, width: int, height: int, size: int) -> GridState:
    """Puts a W × H world into the corner of a size × size one, so that one program serves all."""

    def enlarge(plane: Any, fill: int) -> np.ndarray:
        more = ((0, size - width), (0, size - height))
        return np.pad(plane, more, constant_values=fill)

    return replace(
        world, tiles=enlarge(world.tiles, tiles.WALL_TILE), marks=enlarge(world.marks, 0)
    )


def embedded(recording: Recording, size: int) -> Recording:
    """Puts the world of a recording into the corner of a larger one, with nothing but walls round.

    That makes no difference, but for the program that is compiled: one serves worlds of all sizes.
    For the same reason the mission is left out.
    """
    pomdp, state = recording.pomdp, recording.state
    width, height = pomdp.environment.width, pomdp.environment.height
    sensors = {name: sensor for name, sensor in pomdp.sensors.items() if name != "mission"}
    sensors["image"] = replace(sensors["image"], width=size, height=size)
    pomdp = replace(
        pomdp,
        environment=replace(pomdp.environment, width=size, height=size),
        task=replace(pomdp.task, width=size, height=size),
        sensors=sensors,
    )
    task = replace(state.task, mission=np.zeros(0, np.int32))
    if hasattr(task, "ghosts"):
        task = replace(task, ghosts=np.pad(task.ghosts, [(0, 0), (0, size - height)]))
    world = embed(state.environment, width, height, size)
    return replace(recording, pomdp=pomdp, state=replace(state, environment=world, task=task))


def compare(recordings: Iterable[Recording], size: int | None = None) -> int:
    """Replays the recordings, asserts that all agrees; returns the number of compared steps.

    With a `size`, worlds are `embedded`.
    """
    groups: dict[Any, list[Recording]] = defaultdict(list)
    for recording in recordings:
        _check_mission(recording)
        if size is not None:
            recording = embedded(recording, size)
        key = replace(recording.pomdp, sampler=None), recording.moves.shape
        groups[key].append(recording)
    compared = 0
    for (pomdp, _), group in groups.items():
        states = jax.tree.map(lambda *leaves: np.stack(leaves), *[one.state for one in group])
        actions = jnp.asarray(np.stack([one.actions for one in group]), jnp.int32)
        moves = jnp.asarray(np.stack([one.moves for one in group]))
        first, steps = jax.device_get(_replay(pomdp, states, actions, moves))
        for lane, recording in enumerate(group):
            _check(recording, lane, first, steps)
            compared += len(recording.actions)
    return compared


def _check_mission(recording: Recording) -> None:
    sensor, state = recording.pomdp.sensors["mission"], recording.state
    text = jax_minigrid.decode_mission(sensor.observe(state.environment, state.task))
    assert {text} == {recording.first["mission"]} == set(recording.missions)


def _check(recording: Recording, lane: int, first: Any, steps: Any) -> None:
    for name in ("image", "direction"):
        np.testing.assert_array_equal(first[name][lane], recording.first[name])
        np.testing.assert_array_equal(steps.observation[name][lane], recording.answers[name])
    if "mission" in first:
        assert (steps.observation["mission"][lane] == first["mission"][lane]).all()
    np.testing.assert_array_equal(steps.terminated[lane], recording.answers["terminated"])
    np.testing.assert_array_equal(steps.truncated[lane], recording.answers["truncated"])
    reward = recording.answers["reward"].astype(float)
    assert (np.abs(steps.reward[lane] - reward) <= 1e-6 * np.maximum(1, np.abs(reward))).all()
