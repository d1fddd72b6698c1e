"""Proof that a level cannot be solved: a search that allows more than MiniGrid does.

Whatever the agent gets at is its own for good, and out of the way: hands hold any number of things,
keys are never put down, doors stay open, boxes are opened and carried off at once. So what can be
reached only grows, and no order of doing things needs to be tried. All that MiniGrid allows is
allowed here. What cannot be done even so, cannot be done.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from envs_jax.minigrid import tiles
from envs_jax.minigrid.missions import COLOR_WORDS, decode_mission
from envs_jax.minigrid.state import CONTENTS_SHIFT, PADDING
from jaxact.pomdp import State

WALKABLE = {
    tiles.EMPTY,
    tiles.FLOOR,
    tiles.GOAL,
    tiles.OPEN_DOOR,
    tiles.CLOSED_DOOR,
    tiles.OPEN_LOCKED_DOOR,
}
DOORS = {tiles.OPEN_DOOR, tiles.CLOSED_DOOR, tiles.LOCKED_DOOR, tiles.OPEN_LOCKED_DOOR}
KINDS = {"key": {tiles.KEY}, "ball": {tiles.BALL}, "box": {tiles.BOX}, "door": DOORS}
STEPS = [(1, 0), (0, 1), (-1, 0), (0, -1)]

Cell = tuple[int, int]


@dataclass(frozen=True)
class Level:
    """A level and its mission of one clause.

    Attributes:
      cells: tiles without padding.
      contents: the colours of the keys in boxes.
      start: the agent's cell.
      held: tile in the agent's hands, 0 if they are empty.
      mission: "open …", "go to …" or "pick up …", and what.
      strict: picking up anything else fails the mission.
    """

    cells: dict[Cell, int]
    contents: dict[Cell, int]
    start: Cell
    held: int
    mission: str
    strict: bool

    def is_target(self, tile: int) -> bool:
        """Says whether the mission may mean the tile: by kind and colour, wherever it is."""
        words = self.mission.split()
        kinds = [kinds for word, kinds in KINDS.items() if word in words]
        colors = [color for color, word in enumerate(COLOR_WORDS) if word in words]
        return (not kinds or tile & 15 in kinds[0]) and (not colors or tile >> 4 in colors)

    def may_be_solved(self) -> bool:
        """Returns whether the mission can be done if all of the above is allowed; False is a proof
        that it cannot be done."""
        keys = {self.held >> 4} if self.held & 15 == tiles.KEY else set()
        has_target = self.held != 0 and self.is_target(self.held)
        reached, size = {self.start}, 0
        while size != len(reached) + len(keys):
            size = len(reached) + len(keys)
            for x, y in sorted(reached):
                for step_x, step_y in STEPS:
                    cell = x + step_x, y + step_y
                    if self._can_be_entered(cell, keys):
                        reached.add(cell)
                    has_target |= self._gives_target(self.cells[cell], keys)
                    if cell in self.contents:
                        content = tiles.tile(tiles.KEY, self.contents[cell])
                        has_target |= self._gives_target(content, keys)
        return has_target

    def _can_be_entered(self, cell: Cell, keys: set[int]) -> bool:
        """Says whether a cell next to one that was reached can be entered; takes keys from it."""
        kind, color = self.cells[cell] & 15, self.cells[cell] >> 4
        if kind == tiles.LOCKED_DOOR:
            return color in keys
        if kind not in (tiles.KEY, tiles.BALL, tiles.BOX):
            return kind in WALKABLE
        if self.strict and not self.is_target(self.cells[cell]):
            # To open a box is no failure, to take the key out of it is one.
            return kind == tiles.BOX and cell not in self.contents
        if kind == tiles.KEY:
            keys.add(color)
        elif cell in self.contents:
            keys.add(self.contents[cell])
        return True

    def _gives_target(self, tile: int, keys: set[int]) -> bool:
        """Says whether it fulfils the mission to face the tile."""
        if tile & 15 == tiles.WALL or not self.is_target(tile):
            return False
        opens = self.mission.startswith("open")
        return not opens or tile & 15 != tiles.LOCKED_DOOR or tile >> 4 in keys


def level_of(state: State, strict: bool) -> Level:
    """Reads one lane (of NumPy arrays) as an episode begins."""
    world = state.environment
    inner = np.s_[PADDING:-PADDING, PADDING:-PADDING]
    plane, marks = world.tiles[inner], world.marks[inner].astype(int) >> CONTENTS_SHIFT
    x, y = map(int, world.position)
    return Level(
        cells={(int(x), int(y)): int(tile) for (x, y), tile in np.ndenumerate(plane)},
        contents={(int(x), int(y)): mark - 1 for (x, y), mark in np.ndenumerate(marks) if mark > 0},
        start=(x, y),
        held=int(world.carrying),
        mission=decode_mission(state.task.mission),
        strict=strict,
    )
