"""A small environment of Gymnasium for the tests of worlds outside of JAX."""

from __future__ import annotations

import functools
from typing import Any, ClassVar

import gymnasium
import numpy as np

from jaxact.from_gymnasium import from_gymnasium
from jaxact.pomdp import POMDP

LENGTH = 4


class Countdown(gymnasium.Env):  # type: ignore[type-arg]
    """Counts down from a length drawn by the seed; action 1 counts, action 0 waits.

    At zero it terminates, with a reward of 1 and a success; after `patience` steps it truncates.
    Its observation is what is left, and the digit of its seed that tells episodes apart.
    """

    # Seeds of all resets, in order.
    resets: ClassVar[list[int]] = []
    # The step at which it raises an error.
    fails_at: ClassVar[int | None] = None
    # The step from which on what it observes is not a number.
    comes_apart_at: ClassVar[int | None] = None

    def __init__(self, patience: int = 6) -> None:
        self.patience = patience
        self.observation_space = gymnasium.spaces.Dict(
            {
                "left": gymnasium.spaces.Box(0, 10, (1,), np.float64),
                "digit": gymnasium.spaces.Discrete(10),
            }
        )
        self.action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        assert seed is not None
        self.resets.append(seed)
        self.left, self.digit, self.taken = 1 + seed % LENGTH, seed % 10, 0
        return self._seen(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert isinstance(action, np.int64)
        self.taken += 1
        if self.taken == self.fails_at:
            raise RuntimeError("a joint is out of order")
        self.left -= int(action)
        done, late = self.left == 0, self.taken >= self.patience
        info = {"taken": self.taken, "is_success": done}
        return self._seen(), float(done), done, late, info

    def _seen(self) -> dict[str, Any]:
        is_apart = self.taken == self.comes_apart_at
        return {"left": np.array([np.nan if is_apart else self.left]), "digit": self.digit}


def countdown(simulators: int = 8, patience: int = 6, **options: Any) -> POMDP:
    make = functools.partial(Countdown, patience)
    return from_gymnasium(make, simulators=simulators, metrics=("taken",), **options)
