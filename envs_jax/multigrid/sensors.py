"""What each agent sees, in gym-multigrid's encoding, and what people are shown."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from envs_jax.minigrid import pictures, sight, tiles
from envs_jax.minigrid.sensors import MAX_VIEW_SIZE
from envs_jax.multigrid.environment import OBJECT_GOAL, MultiGrid, MultiGridState
from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import PyTree, Sensor
from jaxact.spaces import Agents, Box

VIEW_SIZE = 7
OBSERVATIONS = ("image", "full")
# Type, colour, what is carried: its type and its colour, direction, whether it is oneself.
CHANNELS = 6

_OPAQUE = 1 << tiles.WALL
# Row `code` holds the channels of a packed tile that is no agent.
_ENCODING = np.pad(
    np.stack([np.arange(256) & tiles.TYPE_MASK, np.arange(256) >> tiles.COLOR_SHIFT], axis=-1),
    ((0, 0), (0, CHANNELS - 2)),
).astype(np.uint8)
_ENCODING[tiles.UNSEEN] = 0

# Pixels along the longer edge of pictures, at most.
_PICTURE = 192


def _with_agents(state: MultiGridState) -> jax.Array:
    """Returns the tiles uint8[W, H] with each agent as AGENT of its own number for a colour."""
    numbers = jnp.arange(len(state.directions), dtype=jnp.uint8) << tiles.COLOR_SHIFT
    x, y = state.positions.T
    return state.tiles.at[x, y].set(numbers | tiles.AGENT)


def _decode(codes: jax.Array, state: MultiGridState, agents_index: tuple[int, ...]) -> jax.Array:
    """Turns tiles uint8[...] with agents among them into channels uint8[..., 6]."""
    rows = jnp.stack(
        [
            jnp.full(len(agents_index), tiles.AGENT, jnp.uint8),
            jnp.array(agents_index, jnp.uint8),
            state.carrying & tiles.TYPE_MASK,
            state.carrying >> tiles.COLOR_SHIFT,
            state.directions.astype(jnp.uint8),
            jnp.zeros(len(agents_index), jnp.uint8),
        ],
        axis=-1,
    )
    is_agent = codes & tiles.TYPE_MASK == tiles.AGENT
    number = jnp.where(is_agent, codes >> tiles.COLOR_SHIFT, jnp.uint8(0))
    others = jnp.asarray(_ENCODING).at[codes].get(mode="promise_in_bounds")
    return jnp.where(is_agent[..., None], rows[number], others)


@dataclass(frozen=True)
class MultiGridSensor(Sensor):
    """What each agent sees, uint8[A, view_size, view_size, 6]; or of the "full" grid, [A, W, H, 6].

    The channels are the type (11 is a goal for objects), the colour, type and colour of what an
    agent carries, its direction on the grid, and 1 where it is oneself. Views are indexed
    [agent, vx, vy, channel], vx from left to right and vy from far to one's own row, in whose
    middle one stands, looking towards vy = 0. Walls hide what is behind them, as in MiniGrid;
    agents, balls and goals do not. What is out of sight is 0, beyond the grid are walls.

    Source: `gen_obs`, `encode_for_agents` and `process_vis` of gym-multigrid (77b0ee0).

    Attributes:
      environment: whose grid it is.
      observation: "image" for the agents' views, "full" for the whole grid.
      view_size: edge of views in cells, odd, from 3 to 31.
    """

    environment: MultiGrid
    observation: str = "image"
    view_size: int = VIEW_SIZE

    def __post_init__(self) -> None:
        if self.observation not in OBSERVATIONS:
            raise unknown("observation", self.observation, OBSERVATIONS)
        if self.view_size not in range(3, MAX_VIEW_SIZE + 1, 2):
            raise JaxactError(
                f"view_size must be odd, from 3 to {MAX_VIEW_SIZE}; got {self.view_size!r}"
            )

    @property
    def space(self) -> Agents:
        """Shape, dtype and bounds of each agent's image."""
        world = self.environment
        edges = (world.width, world.height)
        if self.observation == "image":
            edges = (self.view_size, self.view_size)
        return Agents(Box(0, 255, (*edges, CHANNELS), "uint8"), world.agents)

    def observe(self, state: MultiGridState, task_state: PyTree) -> jax.Array:
        """Returns the image of each agent."""
        del task_state
        world, size = self.environment, self.view_size
        plane = _with_agents(state)
        if self.observation == "full":
            image = jnp.broadcast_to(
                _decode(plane, state, world.agents_index),
                (world.agents, world.width, world.height, CHANNELS),
            )
            everybody, (x, y) = jnp.arange(world.agents), state.positions.T
            return image.at[everybody, x, y, CHANNELS - 1].set(jnp.uint8(1))
        plane = jnp.pad(plane, size - 1, constant_values=tiles.WALL_TILE)

        def look(position: jax.Array, direction: jax.Array) -> jax.Array:
            rows = sight.rows_ahead(plane, position + size - 1, direction, size)
            return sight.in_sight(rows, rows[-1, size // 2], _OPAQUE).T

        codes = jax.vmap(look)(state.positions, state.directions)
        image = _decode(codes, state, world.agents_index)
        return image.at[:, size // 2, size - 1, CHANNELS - 1].set(jnp.uint8(1))

    def picture(self, state: MultiGridState, task_state: PyTree) -> jax.Array:
        """Returns the grid from above; what agents carry is drawn small on them."""
        del task_state
        world = self.environment
        edge = max(8, _PICTURE // max(world.width, world.height))
        kind, color = state.tiles & tiles.TYPE_MASK, state.tiles >> tiles.COLOR_SHIFT
        # Goals for objects look as MiniGrid's goals do.
        kind = jnp.where(kind == OBJECT_GOAL, jnp.uint8(tiles.GOAL), kind).astype(jnp.int32)
        tile = kind * tiles.NUM_COLORS + color.astype(jnp.int32)
        frames = jnp.asarray(pictures.atlas(edge))[tile * pictures.NUM_AGENTS * 2]
        canvas, paints = pictures.Canvas(edge), jnp.asarray(pictures.COLORS, jnp.uint8)
        triangles = jnp.asarray(np.stack([canvas.agent(direction) for direction in range(4)]))
        small = jnp.asarray(canvas.circle(0.5, 0.5, 0.18))
        ring = jnp.asarray(canvas.circle(0.5, 0.5, 0.24))
        for a, index in enumerate(world.agents_index):
            x, y = state.positions[a]
            has = state.carrying[a] != 0
            held = paints[state.carrying[a] >> tiles.COLOR_SHIFT]
            frame = jnp.where(
                triangles[state.directions[a]][..., None], paints[index], frames[x, y]
            )
            frame = jnp.where((ring & has)[..., None], jnp.uint8(0), frame)
            frames = frames.at[x, y].set(jnp.where((small & has)[..., None], held, frame))
        return frames.transpose(1, 2, 0, 3, 4).reshape(world.height * edge, world.width * edge, 3)
