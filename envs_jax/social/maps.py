"""The whole map as each agent sees it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.social.grid import planes
from jaxact.pomdp import PyTree, Sensor
from jaxact.spaces import Agents, Box

# Pixels along each edge of a cell in pictures.
_CELL = 24
_COLORS = np.array([[80, 140, 255], [255, 120, 80], [150, 90, 40], [60, 180, 75]], np.float32)
_GROUND = np.array([235, 230, 215], np.float32)


class Mapped(Protocol):
    """A grid with agents and other things in it."""

    @property
    def size(self) -> int:
        """Cells along each edge."""
        ...

    @property
    def agents(self) -> int:
        """How many there are; the states have their cells, `agents` int32 [A, 2]."""
        ...

    def things(self, state: PyTree) -> list[jax.Array]:
        """Returns the cells of each kind of thing, int32 [n, 2]."""
        ...


@dataclass(frozen=True)
class MapSensor(Sensor):
    """Where everything is, uint8 [size, size, 2 + kinds] of each agent: itself, the others, and
    each kind of thing.

    Attributes:
      environment: whose map it is.
      kinds: how many kinds of things it has.
    """

    environment: Mapped
    kinds: int

    @property
    def space(self) -> Agents:
        """Zeros and ones."""
        size = self.environment.size
        return Agents(Box(0, 1, (size, size, 2 + self.kinds), "uint8"), self.environment.agents)

    def observe(self, state: PyTree, task_state: PyTree) -> jax.Array:
        """Returns the maps, [A, size, size, planes]."""
        del task_state
        count, size = self.environment.agents, self.environment.size
        things = self.environment.things(state)

        def seen(agent: jax.Array) -> jax.Array:
            # The others' list is as long as all agents', with one of the others in one's own place.
            others = jnp.where(
                (jnp.arange(count) == agent)[:, None],
                state.agents[(agent + 1) % count] if count > 1 else -1,
                state.agents,
            )
            return planes([state.agents[agent][None], others, *things], size)

        return jax.vmap(seen)(jnp.arange(count, dtype=jnp.int32))

    def picture(self, state: PyTree, task_state: PyTree) -> jax.Array:
        """Returns the first agent's map in colours: itself blue, the others red."""
        seen = self.observe(state, task_state)[0].astype(jnp.float32)
        colors = jnp.asarray(_COLORS[: seen.shape[-1]])
        total = jnp.sum(seen, axis=-1, keepdims=True)
        color = jnp.where(total > 0, seen @ colors / jnp.maximum(total, 1), jnp.asarray(_GROUND))
        frame = jnp.repeat(jnp.repeat(color, _CELL, axis=0), _CELL, axis=1)
        line = (jnp.arange(frame.shape[0]) % _CELL == 0)[:, None]
        frame = jnp.where((line | line.T)[..., None], frame * 0.85, frame)
        return frame.astype(jnp.uint8)
