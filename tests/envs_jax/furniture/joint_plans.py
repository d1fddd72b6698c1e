"""Whether two agents can carry a television to where it should go: a search over all they can do.

Their yaws do not matter, as agents can always turn, one after the other; so a state is a pose of
the television (row, column, yaw) and the agents' cells around it. Sets of pairs of cells are held
in the bits of an int: bit a · CELLS + b is the pair (a, b), where cells are numbered row by row in
a square around the television's middle, whose rim nobody can stand on.
"""

from __future__ import annotations

import functools
import heapq

from tests.envs_jax.furniture import rules

RADIUS = 6
EDGE = 2 * RADIUS + 1
CELLS = EDGE**2


def number(offset):
    """The number of a cell that is so far from the television's middle."""
    return (offset[0] + RADIUS) * EDGE + offset[1] + RADIUS


@functools.cache
def near(yaw):
    """Offsets of the cells where agents may stand around a television."""
    inside = range(1 - RADIUS, RADIUS)
    return [(r, c) for r in inside for c in inside if rules.can_stand({}, (r, c), (0, 0), yaw)]


def shifted(bits, amount):
    return bits << amount if amount > 0 else bits >> -amount


def walked(pairs, allowed):
    """All pairs that can be got to by one agent's step after the other."""
    new = pairs
    while new:
        found = 0
        for row, column in rules.STEPS.values():
            step = row * EDGE + column
            found |= shifted(new, step) | shifted(new, step * CELLS)
        new = found & allowed & ~pairs
        pairs |= new
    return pairs


class Plans:
    """What can be reached in one room.

    Args:
      floor: set of cells where agents can stand.
      places: set of (row, column, yaw), where the television can have its middle.
    """

    def __init__(self, floor, places):
        self.floor, self.places, self.known = floor, places, {}

    def allowed(self, pose):
        """Pairs of different cells around a pose where agents may stand."""
        if pose not in self.known:
            row, column, yaw = pose
            stands = [number(o) for o in near(yaw) if (row + o[0], column + o[1]) in self.floor]
            one = sum(1 << b for b in stands)
            self.known[pose] = sum((one & ~(1 << a)) << a * CELLS for a in stands)
        return self.known[pose]

    def onwards(self, pose, pairs):
        """Yields poses that both can bring it to, and the pairs in which they then are."""
        row, column, yaw = pose
        turned = (row, column, (yaw + 1) % 4)
        ways = [(turned, pairs)]
        for r, c in rules.STEPS.values():
            # Pushed, the agents' cells are one step back around its new middle.
            pushed = shifted(pairs, -(r * EDGE + c) * (CELLS + 1))
            ways.append(((row + r, column + c, yaw), pairs | pushed))
        for to, found in ways:
            if to in self.places:
                yield to, found & self.allowed(to)

    def reaches(self, pose, agents, goal):
        """Whether its middle can be brought to at most one cell from the goal's."""
        a, b = (number((r - pose[0], c - pose[1])) for r, c in agents)
        reached, queue = {pose: 1 << a * CELLS + b}, [(0, pose)]
        assert reached[pose] & self.allowed(pose)
        while queue:
            _, pose = heapq.heappop(queue)
            if abs(pose[0] - goal[0]) + abs(pose[1] - goal[1]) <= 1:
                return True
            reached[pose] = walked(reached[pose], self.allowed(pose))
            for to, found in self.onwards(pose, reached[pose]):
                before = reached.get(to, 0)
                if found & ~before:
                    reached[to] = before | found
                    # The nearest first: most goals are found soon.
                    gap = abs(to[0] - goal[0]) + abs(to[1] - goal[1])
                    heapq.heappush(queue, (gap, to))
        return False
