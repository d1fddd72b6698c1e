"""Import of live BabyAI instructions: what their clauses demand, and how far each has come."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid.instructions import (
    GO_TO,
    MAX_CLAUSES,
    OPEN,
    PICK_UP,
    PUT_NEXT,
    Program,
    Progress,
)
from envs_jax.minigrid.tasks import GoToTask, InstructionState, InstructionTask
from jaxact.errors import JaxactError
from jaxact.pomdp import Task


@dataclass(frozen=True)
class _Clause:
    """One clause of a live instruction.

    Attributes:
      verb: what it demands, see `instructions`.
      instr: the package's `ActionInstr`.
      later: it counts only when the clauses that are not later are done.
      done: it is done for good.
      reached: the package looks at it every step by now, if it is not done.
    """

    verb: int
    instr: Any
    later: bool
    done: bool
    reached: bool

    @property
    def place(self) -> Any | None:
        """The description of what to go to, or to put something next to."""
        attribute = {GO_TO: "desc", PUT_NEXT: "desc_fixed"}.get(self.verb)
        return None if attribute is None else getattr(self.instr, attribute)

    @property
    def thing(self) -> Any | None:
        """The description of what to open, pick up or put."""
        attribute = {OPEN: "desc", PICK_UP: "desc", PUT_NEXT: "desc_move"}.get(self.verb)
        return None if attribute is None else getattr(self.instr, attribute)


@dataclass(frozen=True)
class ImportedInstruction:
    """The instruction of a live BabyAI environment, at any moment of an episode."""

    env: Any
    clauses: tuple[_Clause, ...]

    @classmethod
    def of(cls, env: Any, name: str) -> ImportedInstruction:
        """Reads `env.instrs`; `name` is for messages.

        Raises:
          JaxactError: the instruction is of a kind that no registered level has, or hands were
            filled or emptied by hand so that nothing can stand for it.
        """
        from minigrid.envs.babyai.core.verifier import AfterInstr, BeforeInstr

        top = env.instrs
        if isinstance(top, BeforeInstr | AfterInstr) and top.strict:
            raise JaxactError(f"{name} has a strict {type(top).__name__}, which is not supported")
        if not isinstance(top, BeforeInstr | AfterInstr):
            clauses = _group(name, top, later=False, done=False, reached=True)
        else:
            is_before = isinstance(top, BeforeInstr)
            done = (top.a_done if is_before else top.b_done) == "success"
            named_first = _group(name, top.instr_a, not is_before, done and is_before, is_before)
            named_last = _group(name, top.instr_b, is_before, done and not is_before, not is_before)
            clauses = named_first + named_last
            if done:
                clauses = [_Clause(c.verb, c.instr, c.later, c.done, True) for c in clauses]
        instruction = cls(env, tuple(clauses))
        for clause in clauses:
            instruction._check_hands(clause, name)
        return instruction

    def task(self, size: tuple[int, int], own: Task | None) -> InstructionTask:
        """Returns the task of following it.

        Args:
          size: width and height of the world.
          own: the task of the world that is registered under the environment's id, if any. It is
            preferred where it can go on with this instruction.
        """
        is_go_to = [clause.verb for clause in self.clauses] == [GO_TO]
        beliefs = max((n + 1 for n, c in enumerate(self.clauses) if c.verb == GO_TO), default=0)
        suits = is_go_to or not isinstance(own, GoToTask)
        if suits and isinstance(own, InstructionTask) and own.beliefs >= beliefs:
            return replace(own, width=size[0], height=size[1])
        return GoToTask(*size) if is_go_to else InstructionTask(*size)

    def mark(self, thing: Any) -> int:
        """Returns which clauses an object is a place or a thing of, as the low byte of its mark."""
        mark = 0
        for number, clause in enumerate(self.clauses):
            mark |= int(_will_find(clause.place, thing)) << number
            mark |= int(_tracks(clause.thing, thing)) << (MAX_CLAUSES + number)
        return mark

    def state(self, task: InstructionTask, mission: jax.Array) -> InstructionState:
        """Returns the state of `task` in the environment as it stands."""
        is_general = not isinstance(task, GoToTask)
        return InstructionState(
            steps=jnp.int32(self.env.step_count),
            max_steps=jnp.int32(self.env.max_steps),
            mission=mission,
            program=self._program().pack() if is_general else None,
            progress=self._progress().pack() if is_general else None,
            ghosts=jnp.asarray(self._ghosts(task.beliefs)),
        )

    def _program(self) -> Program:
        """Returns what there is to do."""
        verbs = (GO_TO, OPEN, PICK_UP, PUT_NEXT)
        go_to, open_, pick_up, put_next = (
            self._set(c.verb == verb for c in self.clauses) for verb in verbs
        )
        return Program(
            go_to,
            open_,
            pick_up,
            put_next,
            strict=self._set(getattr(c.instr, "strict", False) for c in self.clauses),
            later=self._set(c.later for c in self.clauses),
        )

    def _progress(self) -> Progress:
        """Returns how far it was followed."""
        return Progress(
            done=self._set(c.done for c in self.clauses),
            begun=self._set(c.reached and self._knows_hands(c) for c in self.clauses),
        )

    def _ghosts(self, beliefs: int) -> np.ndarray:
        """Returns uint32[beliefs, height]: where the first clauses err about their places."""
        rows = np.zeros((beliefs, self.env.height), np.uint32)
        cells = [(x, y) for x in range(self.env.width) for y in range(self.env.height)]
        for number, clause in enumerate(self.clauses):
            if clause.verb == GO_TO:
                believed = {(int(x), int(y)) for x, y in clause.instr.desc.obj_poss}
                actual = {c for c in cells if _will_find(clause.place, self.env.grid.get(*c))}
                for x, y in believed ^ actual:
                    rows[number, y] |= np.uint32(1 << x)
        return rows

    def _set(self, flags: Any) -> Any:
        return jnp.uint32(sum(int(flag) << number for number, flag in enumerate(flags)))

    def _knows_hands(self, clause: _Clause) -> bool:
        """Whether the clause takes what the agent holds for what it held a step ago."""
        before = getattr(clause.instr, "preCarrying", None)
        return before is not None or self.env.carrying is None

    def _check_hands(self, clause: _Clause, name: str) -> None:
        before, held = getattr(clause.instr, "preCarrying", None), self.env.carrying
        looks = clause.reached and not clause.done
        exchanged = looks and before is not None and before is not held
        if exchanged and (held is None or _tracks(clause.thing, held)):
            raise JaxactError(
                f"{name}: what the agent held was exchanged by hand, and its instruction still "
                "counts on it; take a step before from_minigrid"
            )
        if clause.verb == PUT_NEXT and _tracks(clause.thing, held):
            # Only where it was put into the hands by hand does it still have a position.
            for x, y in clause.instr.desc_fixed.obj_poss:
                if abs(held.cur_pos[0] - x) + abs(held.cur_pos[1] - y) == 1:
                    raise JaxactError(
                        f"{name}: what the agent holds has a position beside the object to put it "
                        "next to; set its cur_pos to (-1, -1), as picking it up does"
                    )


def _group(name: str, instr: Any, later: bool, done: bool, reached: bool) -> list[_Clause]:
    """Returns the clauses of an action, or of an And of two."""
    from minigrid.envs.babyai.core.verifier import AndInstr

    if isinstance(instr, AndInstr):
        sides = ((instr.instr_a, instr.a_done), (instr.instr_b, instr.b_done))
        return [
            _Clause(_verb(name, side), side, later, done or status == "success", reached)
            for side, status in sides
        ]
    return [_Clause(_verb(name, instr), instr, later, done, reached)]


def _verb(name: str, instr: Any) -> int:
    from minigrid.envs.babyai.core import verifier

    verbs: dict[Any, int] = {
        verifier.GoToInstr: GO_TO,
        verifier.OpenInstr: OPEN,
        verifier.PickupInstr: PICK_UP,
        verifier.PutNextInstr: PUT_NEXT,
    }
    if type(instr) not in verbs:
        raise JaxactError(f"{name} has a {type(instr).__name__}, which is not supported")
    return verbs[type(instr)]


def _tracks(description: Any, thing: Any) -> bool:
    """Whether `thing` is one of the objects that `description` was found to fit."""
    return description is not None and any(thing is other for other in description.obj_set)


def _will_find(description: Any, thing: Any) -> bool:
    """Whether `description` will find `thing` again when it next looks (it follows identities)."""
    return (
        _tracks(description, thing)
        and description.type in (None, thing.type)
        and description.color in (None, thing.color)
    )
