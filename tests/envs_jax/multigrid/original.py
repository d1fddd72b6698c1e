"""gym-multigrid itself, played from any state with an order of agents that is given.

It was written for a gym of 2020, of which it needs next to nothing: where there is none, stand-ins
are put in its place while it is imported.
"""

from __future__ import annotations

import contextlib
import importlib
import sys
from types import ModuleType, SimpleNamespace

import numpy as np

from tests.envs_jax.multigrid.rules import Agent, Game


def _stand_ins():
    gym, utils, window = ModuleType("gym"), ModuleType("gym.utils"), ModuleType("window")
    utils.seeding = SimpleNamespace(np_random=lambda seed: (np.random.RandomState(seed), seed))
    spaces = SimpleNamespace(Discrete=SimpleNamespace, Box=SimpleNamespace)
    spaces.Discrete = lambda n: SimpleNamespace(n=n)
    spaces.Box = lambda low, high, shape, dtype: SimpleNamespace(shape=shape)
    gym.Env, gym.error, gym.spaces, gym.utils = object, None, spaces, utils
    window.Window = None
    return {"gym": gym, "gym.utils": utils, "gym_multigrid.window": window}


@contextlib.contextmanager
def _replaced(modules):
    before = {name: sys.modules.get(name) for name in modules}
    sys.modules.update(modules)
    try:
        yield
    finally:
        for name, module in before.items():
            if module is None:
                sys.modules.pop(name, None)
            else:
                sys.modules[name] = module


def load():
    """Returns the modules of the engine and of its two games."""
    with _replaced(_stand_ins()):
        names = ("multigrid", "envs.soccer_game", "envs.collect_game")
        return [importlib.import_module(f"gym_multigrid.{name}") for name in names]


class Original:
    """A game of the original's, beginning as a `Game` stands."""

    def __init__(self, game: Game, width, height, view_size, zero_sum, worth):
        self.engine, soccer, collect = load()
        options = {
            "size": None,
            "width": width,
            "height": height,
            "agents_index": [agent.index for agent in game.agents],
            "zero_sum": zero_sum,
            "view_size": view_size,
        }
        make = soccer.SoccerGameEnv if game.carries else collect.CollectGameEnv
        self.env, self.carries = make(**options), game.carries
        world, grid = self.engine.World, self.engine.Grid(width, height)
        for cell in game.walls:
            grid.set(*cell, self.engine.Wall(world))
        for cell, index in game.balls.items():
            grid.set(*cell, self.engine.Ball(world, index, worth[index]))
        for cell, index in game.goals.items():
            grid.set(*cell, self.engine.ObjectGoal(world, index, "ball", worth[index]))
        for agent, new in zip(self.env.agents, game.agents, strict=True):
            agent.pos, agent.dir = np.array(new.cell), new.direction
            if new.holds is not None:
                agent.carrying = self.engine.Ball(world, new.holds, worth[new.holds])
            grid.set(*new.cell, agent)
        self.env.grid = grid

    def step(self, actions, order):
        """Returns the views, rewards and whether it is over."""
        drawn, np.random.permutation = np.random.permutation, lambda count: np.array(order)
        try:
            views, rewards, done, _ = self.env.step(actions)
        finally:
            np.random.permutation = drawn
        return views, rewards, done

    def game(self):
        """Returns how it stands."""
        found = Game(set(), {}, {}, [], self.carries)
        grid = self.env.grid
        for y in range(grid.height):
            for x in range(grid.width):
                thing = grid.get(x, y)
                if thing is None or thing.type == "agent":
                    continue
                if thing.type == "wall":
                    found.walls.add((x, y))
                else:
                    {"ball": found.balls, "objgoal": found.goals}[thing.type][x, y] = thing.index
        for agent in self.env.agents:
            assert grid.get(*agent.pos) is agent
            holds = agent.carrying.index if agent.carrying else None
            found.agents.append(
                Agent(agent.index, tuple(map(int, agent.pos)), int(agent.dir), holds)
            )
        return found
