"""What the agent senses: its knowledge, as numbers or as a row of a factorial design."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.lighthouse.environment import LighthouseState, corners
from envs_jax.lighthouse.tasks import SearchState
from envs_jax.lighthouse.views import WALL, look
from jaxact.pomdp import Sensor
from jaxact.spaces import Box

# Colours of pictures, and about how many pixels wide they are.
_DARK, _IN_VIEW, _GOAL, _AGENT = (30, 30, 30), (90, 90, 90), (0, 255, 0), (255, 0, 0)
_FRAME = 160


@dataclass(frozen=True)
class CornerSensor(Sensor):
    """What an agent with this view knows, float32[2^dim + 2].

    For each corner what `look` tells of it, then the border touched and the last action.
    """

    dim: int
    radius: int
    view_radius: int

    @property
    def space(self) -> Box:
        """A vector of small whole numbers."""
        return Box(0, max(WALL, 2 * self.dim), (2**self.dim + 2,), "float32")

    def observe(self, state: LighthouseState, task_state: SearchState) -> jax.Array:
        """Returns the vector."""
        known, border = look(state, task_state.goal, self.radius, self.view_radius)
        return jnp.concatenate([known, jnp.stack([border, state.last_action])]).astype(jnp.float32)

    def picture(self, state: LighthouseState, task_state: SearchState) -> jax.Array:
        """Returns the world from above: the agent red, the goal green, what is in view lighter."""
        axes = [jnp.arange(-self.radius, self.radius + 1, dtype=jnp.int32)] * self.dim
        cells = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1)
        cells = cells.reshape(-1, *cells.shape[-2:])  # A line is a row.
        goal = self.radius * jnp.asarray(corners(self.dim))[task_state.goal]
        layers = (
            (jnp.max(jnp.abs(cells - state.position), axis=-1) <= self.view_radius, _IN_VIEW),
            (jnp.all(cells == goal, axis=-1), _GOAL),
            (jnp.all(cells == state.position, axis=-1), _AGENT),
        )
        frame = jnp.broadcast_to(jnp.asarray(_DARK, jnp.uint8), (*cells.shape[:-1], 3))
        for mask, color in layers:
            frame = jnp.where(mask[..., None], jnp.asarray(color, jnp.uint8), frame)
        pixels = max(1, _FRAME // (2 * self.radius + 1))
        return jnp.repeat(jnp.repeat(frame, pixels, axis=0), pixels, axis=1)


@dataclass(frozen=True)
class DesignSensor(Sensor):
    """A `CornerSensor`'s reading as a row of a factorial design, uint8[n] of zeros and ones.

    Its entries are taken as categories. Without a `degree` every combination of them has an entry
    of its own, 81 on a line and 6,400 in a square, so that a linear policy is a table. With one
    there is a constant, an entry for each category but the first of each variable, and their
    products up to that many variables.
    """

    dim: int
    radius: int
    view_radius: int
    degree: int | None = None

    @property
    def levels(self) -> tuple[int, ...]:
        """How many categories each variable has; on a line there are no walls but corners."""
        seen = WALL if self.dim == 1 else WALL + 1
        return (seen,) * 2**self.dim + (2 * self.dim + 1,) * 2

    @property
    def space(self) -> Box:
        """Zeros and ones."""
        if self.degree is None:
            return Box(0, 1, (math.prod(self.levels),), "uint8")
        size = sum(
            math.prod(self.levels[i] - 1 for i in chosen)
            for chosen in self._interactions(self.degree)
        )
        return Box(0, 1, (size,), "uint8")

    def observe(self, state: LighthouseState, task_state: SearchState) -> jax.Array:
        """Returns the row."""
        values = self._plain.observe(state, task_state).astype(jnp.int32)
        if self.degree is None:
            place = jnp.int32(0)
            for value, level in zip(values, self.levels, strict=True):
                place = place * level + value
            return jax.nn.one_hot(place, math.prod(self.levels), dtype=jnp.uint8)
        coded = [
            jax.nn.one_hot(value, level, dtype=jnp.uint8)[1:]
            for value, level in zip(values, self.levels, strict=True)
        ]
        rows = []
        for chosen in self._interactions(self.degree):
            row = jnp.ones(1, jnp.uint8)
            for i in chosen:
                row = (row[:, None] * coded[i]).reshape(-1)
            rows.append(row)
        return jnp.concatenate(rows)

    def picture(self, state: LighthouseState, task_state: SearchState) -> jax.Array:
        """Returns the world from above; see `CornerSensor.picture`."""
        return self._plain.picture(state, task_state)

    @property
    def _plain(self) -> CornerSensor:
        return CornerSensor(self.dim, self.radius, self.view_radius)

    def _interactions(self, degree: int) -> list[tuple[int, ...]]:
        """Returns which variables enter each product, none for the constant."""
        variables = range(len(self.levels))
        return [
            chosen
            for size in range(degree + 1)
            for chosen in itertools.combinations(variables, size)
        ]
