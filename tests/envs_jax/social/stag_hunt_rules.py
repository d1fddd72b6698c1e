"""The rules of the stag hunt once more, in plain Python: what may follow from a state."""

from __future__ import annotations

import itertools

DELTAS = ((-1, 0), (0, 1), (1, 0), (0, -1))


def moved(cell, action, size):
    x, y = (c + d for c, d in zip(cell, DELTAS[action], strict=True))
    return (min(max(x, 0), size - 1), min(max(y, 0), size - 1))


def body(corner, side):
    return {(corner[0] + x, corner[1] + y) for x, y in itertools.product(range(side), repeat=2)}


def stag_places(taken, world):
    """Where a stag may come up: where it is on no cell that is taken, or anywhere if it must be."""
    places = set(itertools.product(range(world.size - world.stag_side + 1), repeat=2))
    return {p for p in places if body(p, world.stag_side).isdisjoint(taken)} or places


def stag_moves(stag, agents, world):
    """Every cell that the stag may go to."""
    if world.stag == "stands":
        return {stag}
    room = world.size - world.stag_side + 1
    steps = [(stag[0] + x, stag[1] + y) for x, y in DELTAS]
    steps = [s for s in steps if 0 <= s[0] < room and 0 <= s[1] < room]
    if world.stag == "follows":
        half = (world.stag_side - 1) / 2

        def gap(corner, agent):
            return [abs(a - c - half) for a, c in zip(agent, corner, strict=True)]

        distances = [sum(g * g for g in gap(stag, agent)) for agent in agents]
        least = min(distances)
        nearest = [a for a, d in zip(agents, distances, strict=True) if d == least][-1]
        before = gap(stag, nearest)
        steps = [
            s for s in steps if any(a < b for a, b in zip(gap(s, nearest), before, strict=True))
        ]
    return set(steps) or {stag}


def outcomes(agents, stag, plants, actions, world, task):
    """Yields (agents, stag, rewards, stag comes up anew, plants that do) for each of its moves."""
    after = [moved(a, action, world.size) for a, action in zip(agents, actions, strict=True)]
    for goes_to in stag_moves(stag, agents, world):
        on_stag = [a in body(goes_to, world.stag_side) for a in after]
        on_plant = [a in plants and not s for a, s in zip(after, on_stag, strict=True)]
        caught = sum(on_stag) >= world.hunters
        rewards = []
        for s, p in zip(on_stag, on_plant, strict=True):
            if s:
                rewards.append(task.stag_reward if caught else -task.maul_penalty)
            else:
                rewards.append(task.plant_reward if p and not caught else 0.0)
        anew = caught or (world.flees and any(on_stag))
        eaten = [
            not anew and any(a == plant and not s for a, s in zip(after, on_stag, strict=True))
            for plant in plants
        ]
        yield after, goes_to, rewards, anew, eaten
