"""Exhaustive search in a plain Python model of MiniGrid's dynamics."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from envs_jax.minigrid import tiles
from envs_jax.minigrid.state import PADDING
from envs_jax.minigrid.tasks import GoToTask
from jaxact.pomdp import POMDP, State

LEFT, RIGHT, FORWARD, PICKUP, DROP, TOGGLE, DONE = range(7)
STEPS = [(1, 0), (0, 1), (-1, 0), (0, -1)]
WALKABLE = {tiles.EMPTY, tiles.FLOOR, tiles.OPEN_DOOR}
PORTABLE = {tiles.KEY, tiles.BALL, tiles.BOX}


@dataclass(frozen=True)
class Node:
    """A state of the model: the agent, its hands, and the cells that differ from the start."""

    x: int
    y: int
    d: int
    held: int
    changed: tuple[tuple[tuple[int, int], int], ...] = ()


@dataclass
class Model:
    """The reference: MiniGrid's rules on a dictionary of cells; `targets` makes it a GoTo task."""

    cells: dict[tuple[int, int], int]
    start: Node
    targets: set[tuple[int, int]] | None
    actions: tuple[int, ...]

    def at(self, node: Node, cell: tuple[int, int]) -> int:
        return dict(node.changed).get(cell, self.cells[cell])

    def front(self, node: Node) -> tuple[int, int]:
        return node.x + STEPS[node.d][0], node.y + STEPS[node.d][1]

    def edges(self, node: Node) -> Iterator[tuple[Node, bool]]:
        """Yields each next state and whether the step ends the episode with success."""
        for action in self.actions:
            after = self.step(node, action)
            if after is None:
                continue
            if self.targets is None:
                entered = self.at(node, self.front(node)) & 15 == tiles.GOAL
                yield after, action == FORWARD and entered
            else:
                yield after, self.front(after) in self.targets

    def step(self, node: Node, action: int) -> Node | None:
        """Returns the next state, or None where the action is deadly."""
        if action == LEFT:
            return replace(node, d=(node.d + 3) % 4)
        if action == RIGHT:
            return replace(node, d=(node.d + 1) % 4)
        front = self.front(node)
        tile = self.at(node, front)
        kind = tile & 15
        if action == FORWARD:
            if kind == tiles.LAVA:
                return None
            free = kind in WALKABLE or kind == tiles.GOAL
            return replace(node, x=front[0], y=front[1]) if free else node
        if action == PICKUP and kind in PORTABLE and not node.held:
            return replace(self.put(node, front, tiles.EMPTY_TILE), held=tile)
        if action == DROP and kind == tiles.EMPTY and node.held:
            return replace(self.put(node, front, node.held), held=0)
        if action == TOGGLE:
            color = tile & 240
            if kind == tiles.CLOSED_DOOR or (
                kind == tiles.LOCKED_DOOR and node.held == color | tiles.KEY
            ):
                return self.put(node, front, color | tiles.OPEN_DOOR)
            if kind == tiles.OPEN_DOOR:
                return self.put(node, front, color | tiles.CLOSED_DOOR)
        return node

    def put(self, node: Node, cell: tuple[int, int], tile: int) -> Node:
        changed = {**dict(node.changed), cell: tile}
        if self.cells[cell] == tile:
            del changed[cell]
        return replace(node, changed=tuple(sorted(changed.items())))

    def shortest(self) -> int | None:
        """Returns the fewest actions that lead to success, by breadth-first search."""
        queue, seen = deque([(self.start, 0)]), {self.start}
        while queue:
            node, cost = queue.popleft()
            for after, success in self.edges(node):
                if success:
                    return cost + 1
                if after not in seen:
                    seen.add(after)
                    queue.append((after, cost + 1))
        return None


def model_of(pomdp: POMDP, state: State, actions: tuple[int, ...]) -> Model:
    """Reads one lane (of NumPy arrays)."""
    width, height = pomdp.task.width, pomdp.task.height
    world = state.environment
    inner = np.s_[PADDING:-PADDING, PADDING:-PADDING]
    plane, marks = world.tiles[inner], world.marks[inner]
    targets = None
    if isinstance(pomdp.task, GoToTask):
        ghosts = [[row >> x & 1 for row in map(int, state.task.ghosts[0])] for x in range(width)]
        believed = (marks & 1).astype(int) ^ np.array(ghosts)
        targets = {(int(x), int(y)) for x, y in np.argwhere(believed)}
    return Model(
        cells={(x, y): int(plane[x, y]) for x in range(width) for y in range(height)},
        start=Node(*map(int, world.position), int(world.direction), int(world.carrying)),
        targets=targets,
        actions=actions,
    )
