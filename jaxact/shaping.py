"""Rewards beside a task's own, without touching the task."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.errors import JaxactError
from jaxact.frozen import FrozenMapping
from jaxact.pomdp import POMDP, Dependent, Expert, ExpertAction, Outcome, PyTree, Task

Term = Callable[[PyTree, PyTree, PyTree, PyTree, PyTree], jax.Array]


@dataclass(frozen=True)
class Potential:
    """Shaping γΦ(s′) − Φ(s), which changes no policy's rank (Ng, Harada & Russell 1999).

    Φ counts as zero where the task has terminated, whatever the function says; where the horizon
    has cut an episode off, it does not.

    Attributes:
      function: Φ, from the environment's and the task's state to a float32 scalar.
      discount: γ; policies keep their rank if it is that of the training.
    """

    function: Callable[[PyTree, PyTree], jax.Array]
    discount: float = 0.99


@dataclass(frozen=True)
class Shaped(Task):
    """A task with further named components of the reward; all else is the task's.

    A component is a `Potential` or a function (before, action, after, task_state,
    next_task_state) -> float32 scalar, where before and after are the environment's states. The
    task's expert, if it has one, is that of the shaped task.

    Attributes:
      task: to be shaped.
      terms: the components by name.
    """

    task: Task
    terms: Mapping[str, Term | Potential]

    def __new__(cls, task: Task | None = None, *args: Any, **kwargs: Any) -> Shaped:
        """Makes a task that can be demonstrated of one that can."""
        chosen = ShapedWithExpert if cls is Shaped and isinstance(task, Expert) else cls
        return super().__new__(chosen)

    def __post_init__(self) -> None:
        if not self.terms:
            raise JaxactError("there is nothing to shape the task with: give terms by name")
        object.__setattr__(self, "terms", FrozenMapping(self.terms))

    def check(self, pomdp: POMDP) -> None:
        """Refuses what the task refuses."""
        if isinstance(self.task, Dependent):
            self.task.check(pomdp)

    def step(
        self, task_state: PyTree, before: PyTree, action: PyTree, after: PyTree
    ) -> tuple[PyTree, Outcome]:
        """Judges the step as the task does, and adds the terms.

        Raises:
          JaxactError: the task has a component of the same name.
        """
        next_state, outcome = self.task.step(task_state, before, action, after)
        reward = dict(outcome.reward)
        for name, term in self.terms.items():
            if name in reward:
                raise JaxactError(
                    f"{type(self.task).__name__} already has a reward component {name!r}"
                )
            if isinstance(term, Potential):
                reached = jnp.where(outcome.terminated, 0.0, term.function(after, next_state))
                value = term.discount * reached - term.function(before, task_state)
            else:
                value = term(before, action, after, task_state, next_state)
            reward[name] = jnp.asarray(value, jnp.float32)
        return next_state, replace(outcome, reward=reward)


class ShapedWithExpert(Shaped):
    """What `Shaped` makes of a task with an expert."""

    def expert(self, key: jax.Array, task_state: PyTree, state: PyTree) -> ExpertAction:
        """Returns the action of the task's expert."""
        assert isinstance(self.task, Expert)
        return self.task.expert(key, task_state, state)
