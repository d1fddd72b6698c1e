"""Import of what live Python MiniGrid worlds ask for: their step methods, as `rules`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from envs_jax.minigrid import rules, tiles
from envs_jax.minigrid.missions import COLOR_WORDS
from envs_jax.minigrid.rules import RuleState
from jaxact.errors import JaxactError

_KINDS = {"key": tiles.KEY, "ball": tiles.BALL, "box": tiles.BOX}


@dataclass(frozen=True)
class ImportedRule:
    """A rule and what it is about.

    Attributes:
      number: one of `rules.PLAY` ….
      target: packed tile, 0 when there is none.
      cells: up to two cells (x, y).
      tracked: the Python object that is to be picked up, if that is the rule.
    """

    number: int
    target: int = 0
    cells: tuple[tuple[int, int], ...] = ()
    tracked: Any = None

    def mark(self, thing: Any) -> int:
        """Returns the low byte of an object's mark: 1 if it is the tracked one, else 0."""
        return int(thing is self.tracked)

    def state(self, env: Any, mission: jax.Array) -> RuleState:
        """Returns the task's state in `env` as it stands."""
        cells = [*self.cells, (0, 0), (0, 0)][:2]
        things = [env.grid.get(*cell) for cell in cells]
        opened = [thing is not None and thing.type == "door" and thing.is_open for thing in things]
        return RuleState(
            steps=jnp.int32(env.step_count),
            max_steps=jnp.int32(env.max_steps),
            mission=mission,
            rule=jnp.int32(self.number),
            target=jnp.uint8(self.target),
            cells=jnp.asarray(cells, jnp.int32),
            opened=jnp.asarray(opened, bool),
        )


def import_rule(env: Any) -> ImportedRule | None:
    """Returns the rule that a Python environment follows, or None if it is none of `rules`.

    Raises:
      JaxactError: a door that the rule is about is not in the grid.
    """
    from minigrid import envs

    step = type(env).step
    if isinstance(env, envs.PlaygroundEnv):
        return ImportedRule(rules.PLAY)
    if step is envs.FetchEnv.step:
        return ImportedRule(rules.FETCH, _look(env.targetType, env.targetColor))
    if step in (envs.GoToDoorEnv.step, envs.GoToObjectEnv.step):
        return ImportedRule(rules.GO_NEXT_TO, cells=(_cell(env.target_pos),))
    if step is envs.PutNearEnv.step:
        target = _look(env.move_type, env.moveColor)
        return ImportedRule(rules.PUT_NEAR, target, (_cell(env.target_pos),))
    if step is envs.MemoryEnv.step:
        return ImportedRule(rules.MATCH, cells=(_cell(env.success_pos), _cell(env.failure_pos)))
    if step is envs.RedBlueDoorEnv.step:
        doors = _door_cell(env, env.red_door), _door_cell(env, env.blue_door)
        return ImportedRule(rules.OPEN_IN_TURN, cells=doors)
    if step is envs.UnlockEnv.step:
        return ImportedRule(rules.OPEN, cells=(_door_cell(env, env.door),))
    if step in (
        envs.UnlockPickupEnv.step,
        envs.BlockedUnlockPickupEnv.step,
        envs.KeyCorridorEnv.step,
        envs.ObstructedMazeEnv.step,
    ):
        return ImportedRule(rules.PICK_UP, tracked=env.obj)
    return None


def _look(kind: str, color: str) -> int:
    return tiles.tile(_KINDS[kind], COLOR_WORDS.index(color))


def _cell(position: Any) -> tuple[int, int]:
    x, y = position
    return int(x), int(y)


def _door_cell(env: Any, door: Any) -> tuple[int, int]:
    """Returns where a door is; not all doors of the package know that themselves."""
    for index, thing in enumerate(env.grid.grid):
        if thing is door:
            return index % env.width, index // env.width
    raise JaxactError(
        f"the grid of {type(env).__name__} has lost the {door.color} door that the task is about"
    )
