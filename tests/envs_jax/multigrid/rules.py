"""The rules of Soccer and Collect once more, in plain Python on sets of cells."""

from __future__ import annotations

from dataclasses import dataclass, field

STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))
WALL, BALL, AGENT, GOAL = 2, 6, 10, 11
STILL, LEFT, RIGHT, FORWARD, PICKUP, DROP, TOGGLE, DONE = range(8)
NOBODY = None


@dataclass
class Agent:
    """Who stands where; `holds` is the index of a ball."""

    index: int
    cell: tuple[int, int]
    direction: int
    holds: int | None = None

    @property
    def front(self):
        dx, dy = STEPS[self.direction]
        return (self.cell[0] + dx, self.cell[1] + dy)


@dataclass
class Game:
    """A game as it stands; balls and goals are indices by cell."""

    walls: set
    balls: dict
    goals: dict
    agents: list
    carries: bool
    scored: list = field(default_factory=list)  # (number of the agent, ball's or goal's index)

    def who(self, cell):
        return next((agent for agent in self.agents if agent.cell == cell), NOBODY)

    def empty(self, cell):
        return not (cell in self.walls or cell in self.balls or cell in self.goals) and (
            self.who(cell) is NOBODY
        )

    def turn(self, number, action):
        """One agent acts on the grid as it is."""
        me = self.agents[number]
        cell, other = me.front, self.who(me.front)
        if action in (LEFT, RIGHT):
            me.direction = (me.direction + (1 if action == RIGHT else 3)) % 4
        elif action == FORWARD and self.empty(cell):
            me.cell = cell
        elif action == PICKUP and not self.carries:
            if self.balls.get(cell) in (0, me.index) and cell in self.balls:
                self.scored.append((number, self.balls.pop(cell)))
        elif action == PICKUP and me.holds is None:
            if cell in self.balls:
                me.holds = self.balls.pop(cell)
            elif other is not NOBODY:
                me.holds, other.holds = other.holds, None
        elif action == DROP and me.holds is not None:
            if cell in self.goals:
                if me.holds in (0, self.goals[cell]):
                    me.holds = None
                    self.scored.append((number, self.goals[cell]))
            elif other is not NOBODY:
                if other.holds is None:
                    me.holds, other.holds = None, me.holds
            elif self.empty(cell):
                self.balls[cell], me.holds = me.holds, None

    def step(self, actions, order, at_once=False):
        """All act, in turn or at once; forgets what was scored before."""
        self.scored = []
        if not at_once:
            for number in order:
                self.turn(number, actions[number])
            return
        able = [number for number in order if self._acts(number, actions[number])]
        busy = {
            n for n in able if self.carries and actions[n] in (PICKUP, DROP)
        }  # By number; they use their hands.
        cells, chosen = set(), []
        for number in able:  # In the order drawn, each cell has its first.
            other = self.who(self.agents[number].front)
            if other is not NOBODY and any(self.agents[n] is other for n in busy):
                continue
            if self.agents[number].front not in cells:
                cells.add(self.agents[number].front)
                chosen.append(number)
        turns = [n for n, action in enumerate(actions) if action in (LEFT, RIGHT)]
        # None of those chosen stands in another's way, except for who walks off: they go last.
        for number in sorted(chosen, key=lambda n: actions[n] == FORWARD) + turns:
            self.turn(number, actions[number])

    def _acts(self, number, action):
        """Whether the action would change anything but where the agent looks."""
        trial = Game(
            self.walls,
            dict(self.balls),
            self.goals,
            [Agent(a.index, a.cell, a.direction, a.holds) for a in self.agents],
            self.carries,
        )
        if action in (LEFT, RIGHT):
            return False
        trial.turn(number, action)
        return trial.agents != self.agents or bool(trial.scored)

    def rewards(self, credit, worth, zero_sum):
        """What each agent earned in the last step; `worth` is by index."""
        total = [0.0] * len(self.agents)
        for number, index in self.scored:
            to = {"color": index, "team": self.agents[number].index, "number": number}[credit]
            for j, agent in enumerate(self.agents):
                if agent.index in (0, to):
                    total[j] += worth[index]
                if zero_sum and (agent.index == 0 or agent.index != to):
                    total[j] -= worth[index]
        return total

    def encoded(self, cell, viewer):
        """The six channels of a cell."""
        other = self.who(cell)
        if other is not NOBODY:
            held = (0, 0) if other.holds is None else (BALL, other.holds)
            return (AGENT, other.index, *held, other.direction, int(other is viewer))
        for kind, where in ((BALL, self.balls), (GOAL, self.goals)):
            if cell in where:
                return (kind, where[cell], 0, 0, 0, 0)
        return (1, 0, 0, 0, 0, 0)

    def view(self, number, size, width, height):
        """The view of an agent, [vx][vy], of channels."""
        me = self.agents[number]
        (fx, fy), half = STEPS[me.direction], size // 2

        def cell(vx, vy):
            aside, ahead = vx - half, size - 1 - vy
            return (me.cell[0] + fx * ahead - fy * aside, me.cell[1] + fy * ahead + fx * aside)

        def wall(vx, vy):
            x, y = cell(vx, vy)
            return not (0 <= x < width and 0 <= y < height) or (x, y) in self.walls

        lit = {(half, size - 1)}
        for vy in reversed(range(size)):
            # Light goes along a row, first to the right, then to the left, and on to the next row.
            for sweep, side in ((range(size - 1), 1), (reversed(range(1, size)), -1)):
                for vx in sweep:
                    if (vx, vy) in lit and not wall(vx, vy):
                        lit |= {(vx + side, vy), (vx + side, vy - 1), (vx, vy - 1)}
        return [
            [
                (0,) * 6
                if (vx, vy) not in lit
                else (WALL, 5, 0, 0, 0, 0)
                if wall(vx, vy)
                else self.encoded(cell(vx, vy), me)
                for vy in range(size)
            ]
            for vx in range(size)
        ]
