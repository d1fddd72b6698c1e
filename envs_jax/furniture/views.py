"""What agents see of a map: the part before them, turned as they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.furniture.footprints import DIRECTIONS
from jaxact.errors import JaxactError
from jaxact.pomdp import PyTree, Sensor
from jaxact.spaces import Agents, Box

# Pixels along each edge of a cell in pictures.
_PIXELS = 12
_GROUND = np.array([70, 70, 80], np.float32)
_AGENTS = np.array([[220, 50, 50], [50, 90, 220]], np.float32)
_DARK = np.array([20, 20, 20], np.float32)


class Mapped(Protocol):
    """A world of two agents on a map; its states have `agents` int32 [2, 2] and `yaw` int32 [2]."""

    @property
    def colors(self) -> tuple[tuple[int, int, int], ...]:
        """Of the map's planes in pictures, each drawn over those before it."""
        ...

    def map(self, state: PyTree) -> jax.Array:
        """Returns bool [planes, S, S]."""
        ...


def forward_view(planes: jax.Array, cell: jax.Array, yaw: jax.Array, view: int) -> jax.Array:
    """Cuts out what is before someone, in the middle of the last row, who looks up in it.

    Args:
      planes: [C, S, S].
      cell: int32 [2], where they stand.
      yaw: int32 scalar.
      view: cells along each edge, odd.

    Returns:
      [view, view, C]; zeros beyond the map.
    """
    size, half = planes.shape[-1], view // 2
    ahead = jnp.arange(view - 1, -1, -1, dtype=jnp.int32)[:, None, None]
    aside = jnp.arange(-half, half + 1, dtype=jnp.int32)[None, :, None]
    directions = jnp.asarray(DIRECTIONS)
    cells = cell + ahead * directions[yaw] + aside * directions[(yaw + 1) % 4]
    on_map = jnp.all((cells >= 0) & (cells < size), axis=-1)
    rows, columns = jnp.moveaxis(jnp.clip(cells, 0, size - 1), -1, 0)
    seen = jnp.moveaxis(planes[:, rows, columns], 0, -1)
    return jnp.where(on_map[..., None], seen, jnp.zeros((), planes.dtype))


@dataclass(frozen=True)
class EgocentricView(Sensor):
    """The map before each agent, uint8 [2, view, view, 4 + planes]: the other agent, in a plane for
    each of the quarter turns that it is turned by against oneself, and the map's planes.

    It is that of CORDIAL-SYNC's grid worlds.

    Attributes:
      environment: whose map it is.
      view: cells along each edge, odd.
    """

    environment: Mapped
    view: int = 15

    def __post_init__(self) -> None:
        if self.view < 3 or self.view % 2 == 0:
            raise JaxactError(f"view must be an odd number of at least 3 cells, got {self.view}")

    @property
    def space(self) -> Agents:
        """Zeros and ones."""
        shape = (self.view, self.view, 4 + len(self.environment.colors))
        return Agents(Box(0, 1, shape, "uint8"), 2)

    def observe(self, state: PyTree, task_state: PyTree) -> jax.Array:
        """Returns the views, [2, view, view, 4 + planes]."""
        del task_state
        planes = self.environment.map(state)
        index = jnp.arange(planes.shape[-1], dtype=jnp.int32)

        def seen(agent: jax.Array) -> jax.Array:
            other = 1 - agent
            row, column = state.agents[other]
            at = (index == row)[:, None] & (index == column)
            turned = (state.yaw[other] - state.yaw[agent]) % 4
            others = at & (jnp.arange(4, dtype=jnp.int32) == turned)[:, None, None]
            everything = jnp.concatenate([others, planes])
            return forward_view(everything, state.agents[agent], state.yaw[agent], self.view)

        return jax.vmap(seen)(jnp.arange(2, dtype=jnp.int32)).astype(jnp.uint8)

    def picture(self, state: PyTree, task_state: PyTree) -> jax.Array:
        """Returns the whole map from above; agents are red and blue, dark where they look."""
        del task_state
        planes = self.environment.map(state)
        image = jnp.broadcast_to(jnp.asarray(_GROUND), (*planes.shape[1:], 3))
        for plane, color in zip(planes, self.environment.colors, strict=True):
            image = jnp.where(plane[..., None], jnp.asarray(color, jnp.float32), image)
        image = jnp.repeat(jnp.repeat(image, _PIXELS, axis=0), _PIXELS, axis=1)
        rows, columns = jnp.meshgrid(
            *[jnp.arange(image.shape[0], dtype=jnp.float32)] * 2, indexing="ij"
        )
        for i in range(2):
            ahead = jnp.asarray(DIRECTIONS)[state.yaw[i]].astype(jnp.float32)
            middle = (state.agents[i].astype(jnp.float32) + 0.5) * _PIXELS - 0.5
            for offset, radius, paint in ((0.0, 0.45, _AGENTS[i]), (0.3, 0.15, _DARK)):
                row, column = middle + offset * _PIXELS * ahead
                disk = (rows - row) ** 2 + (columns - column) ** 2 <= (radius * _PIXELS) ** 2
                image = jnp.where(disk[..., None], jnp.asarray(paint), image)
        return image.astype(jnp.uint8)
