"""Shortest ways for a body with a width, exact at any angle: a visibility graph.

In plan a body is a point among boxes grown by its radius. A grown box has round corners; here each
is the octagon around it, so that a way past it is free of collisions and at most 9 % of the radius
longer at a right-angled corner. A shortest way bends only at corners of octagons. A `Roadmap` holds
those of a scene and the ways between them; a `GoalField` how far each is from an episode's goals,
and is all that a step needs:

    roadmap = build_roadmap(scene, body)                      # once a scene
    field = goal_field(roadmap, obstacles, body.radius, goals)      # once an episode
    metres, node = distance(field, obstacles, body.radius, position)  # at every step

where `obstacles = collision.obstacles(scene.boxes, body)`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from envs_jax.houses.collision import obstacles as find_obstacles
from envs_jax.houses.comparisons import greater, lesser
from envs_jax.houses.scene import CENTER, COSINE, HALF_SIZE, NOWHERE, SINE, Scene, to_local
from envs_jax.houses.state import Body

# How much further out than the octagons their corners are taken, so that neither rounding nor a way
# along an edge counts as crossing it.
MARGIN = 1e-3
# How far beside a corner there must be room for a way to bend there.
_PROBE = 0.02
_EIGHTH = math.tan(math.pi / 8)
_ROOT = math.sqrt(2.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Roadmap:
    """Where shortest ways in a scene can bend.

    Attributes:
      nodes: float32 [K, 2], plans.
      valid: bool [K], which of them are used.
      lengths: float32 [K, K], metres of the shortest way between two; infinite if there is none.
      overflow: bool scalar, whether there were more than K, so that ways may be too long.
    """

    nodes: jax.Array
    valid: jax.Array
    lengths: jax.Array
    overflow: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GoalField:
    """How far the goals are from where ways can bend; the goals themselves come first.

    Attributes:
      nodes: float32 [G + K, 2], plans.
      lengths: float32 [G + K], metres to the nearest goal, infinite if there is no way.
    """

    nodes: jax.Array
    lengths: jax.Array


def build_roadmap(scene: Scene, body: Body, size: int = 192) -> Roadmap:
    """Finds the corners of a scene as it stands, with its doors as they are.

    Args:
      scene: to walk in.
      body: of the walker.
      size: K, at most how many corners; with more, those outside of the rooms are dropped first.
    """
    boxes = find_obstacles(scene.boxes, body)
    corners, sideways = _corners(boxes, body.radius + MARGIN)
    somewhere = corners[:, 0] > NOWHERE / 2
    useful = somewhere & _outside(boxes, body.radius, corners)
    for side in (-_PROBE, _PROBE):
        useful &= _outside(boxes, body.radius, corners + side * sideways)
    low, high = jnp.min(scene.rooms[:, :2], axis=0), jnp.max(scene.rooms[:, 2:], axis=0)
    indoors = jnp.all((corners >= low) & (corners <= high), axis=-1)
    size = min(size, corners.shape[0])
    # Those indoors come first, without a sort.
    within, without = useful & indoors, useful & ~indoors
    after = jnp.sum(within, dtype=jnp.int32) - 1
    place = jnp.where(
        within,
        jnp.cumsum(within, dtype=jnp.int32) - 1,
        after + jnp.cumsum(without, dtype=jnp.int32),
    )
    place = jnp.where(useful, place, size)
    nodes = jnp.zeros((size, 2), jnp.float32).at[place].set(corners, mode="drop")
    valid = jnp.arange(size, dtype=jnp.int32) < jnp.sum(useful, dtype=jnp.int32)
    radii = jnp.full(boxes.shape[:1], body.radius, jnp.float32)
    seen = visible(boxes, radii, nodes[:, None], nodes) & valid[:, None] & valid
    lengths = jnp.where(seen, _length(nodes[:, None] - nodes), jnp.inf)

    def by_way_of(node: jax.Array, lengths: jax.Array) -> jax.Array:
        return jnp.minimum(lengths, lengths[:, node, None] + lengths[node])

    # Floyd and Warshall's: once a scene, so that an episode's field is one look at the table.
    lengths = jax.lax.fori_loop(0, size, by_way_of, lengths)
    overflow = jnp.sum(useful, dtype=jnp.int32) > size
    return Roadmap(nodes, valid, lengths, overflow)


def goal_field(
    roadmap: Roadmap,
    obstacles: jax.Array,
    radius: float,
    goals: jax.Array,
    present: jax.Array | None = None,
) -> GoalField:
    """Measures the ways from every node to the nearest goal.

    Args:
      roadmap: of the scene.
      obstacles: float32 [N, 8], of the scene.
      radius: of the body.
      goals: float32 [G, 2], plans; one that lies in an octagon is moved out of it, and what it is
        moved by is added to all ways.
      present: bool [G], which goals count; all, if None.
    """
    goals_free = jax.vmap(lambda goal: _push_out(obstacles, radius, goal))(goals)
    offsets = _length(goals - goals_free)
    if present is not None:
        offsets = jnp.where(present, offsets, jnp.inf)
    reach = jax.vmap(lambda goal: ways(obstacles, radius, goal, roadmap.nodes))(goals_free)
    first = jnp.min(reach + offsets[:, None], axis=0)
    first = jnp.where(roadmap.valid, first, jnp.inf)

    best = jnp.minimum(first, jnp.min(roadmap.lengths + first, axis=1))
    return GoalField(jnp.concatenate([goals_free, roadmap.nodes]), jnp.concatenate([offsets, best]))


def distance(
    field: GoalField, obstacles: jax.Array, radius: float, position: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Measures the shortest way to the nearest goal.

    Finite wherever a goal is present: who stands slightly within an octagon, as between its corner
    and the round one, walks out of it; and from where no node is seen the way leads to the best one
    straight through what is between.

    Args:
      field: of the goals.
      obstacles: float32 [N, 8], of the scene as it is now.
      radius: of the body.
      position: float32 [2], a plan.

    Returns:
      The float32 scalar metres, and the int32 node that the way leads to first.
    """
    straight = _length(field.nodes - position) + field.lengths
    metres = ways(obstacles, radius, position, field.nodes) + field.lengths
    metres = jnp.where(jnp.any(metres < jnp.inf), metres, straight)
    node = jnp.argmin(metres)
    return metres[node], node.astype(jnp.int32)


def shortest(
    field: GoalField, obstacles: jax.Array, radius: float, position: jax.Array
) -> jax.Array:
    """Measures the shortest way to the nearest goal, like `distance`, if there is one.

    Returns:
      The float32 scalar metres, infinite if there is no way.
    """
    return jnp.min(ways(obstacles, radius, position, field.nodes) + field.lengths)


def nearby(
    field: GoalField,
    obstacles: jax.Array,
    radius: float,
    position: jax.Array,
    seen: int,
    hidden: int,
    near: float,
) -> tuple[GoalField, jax.Array]:
    """Picks a few nodes for measuring ways from places near a plan.

    Args:
      field: of the goals.
      obstacles: float32 [N, 8].
      radius: of the body.
      position: float32 [2], a plan.
      seen: how many nodes to keep of those seen from the plan, those on the shortest ways.
      hidden: how many of the others, likewise, as if they were seen.
      near: metres from the plan within which the others must be.

    Returns:
      The field of `seen + hidden` nodes, and the float32 scalar metres from the plan, as `distance`
      has them.
    """
    straight = _length(field.nodes - position)
    visible = ways(obstacles, radius, position, field.nodes) < jnp.inf
    lengths = straight + field.lengths
    lost = ~jnp.any(visible & (lengths < jnp.inf))
    # Who sees nothing is led straight on, as by `distance`.
    visible |= lost
    groups = (visible, seen), (~visible & (straight <= near), hidden)
    best, chosen = zip(
        *(jax.lax.top_k(-jnp.where(group, lengths, jnp.inf), size) for group, size in groups),
        strict=True,
    )
    rows = jnp.concatenate(chosen)
    kept = jnp.where(jnp.concatenate(best) > -jnp.inf, field.lengths[rows], jnp.inf)
    return GoalField(field.nodes[rows], kept), -best[0][0]


def path(
    field: GoalField, obstacles: jax.Array, radius: float, position: jax.Array, size: int = 32
) -> jax.Array:
    """Returns the corners of the shortest way, plans float32 [size, 2] that repeat the last."""

    def follow(
        carry: tuple[jax.Array, jax.Array], _: None
    ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
        place, bound = carry
        nearer = GoalField(field.nodes, jnp.where(field.lengths < bound, field.lengths, jnp.inf))
        node = distance(nearer, obstacles, radius, place)[1]
        left = nearer.lengths[node]
        place = jnp.where(left < jnp.inf, field.nodes[node], place)
        return (place, left - 1e-6), place

    first = (position, jnp.float32(jnp.inf))
    _, corners = jax.lax.scan(follow, first, length=size - 1)
    return jnp.concatenate([position[None], corners])


def visible(obstacles: jax.Array, radii: jax.Array, start: jax.Array, end: jax.Array) -> jax.Array:
    """Returns bool [...]: whether no octagon has points of the segment inside it.

    Two convex shapes are apart if they are on one of the normals of their edges: two of a box, two
    of its cut corners, and that of the segment.

    Args:
      obstacles: float32 [N, 8].
      radii: float32 [N], by which each is grown.
      start: float32 [..., 2].
      end: float32 [..., 2], may broadcast.
    """

    middle, half = (start + end) / 2, (end - start) / 2
    # Taken apart here, so that every turn of the loop reads numbers that lie in a row.
    middle_x, middle_z, half_x, half_z = (
        ends[..., axis] for ends in (middle, half) for axis in (0, 1)
    )

    def look(gap: jax.Array, obstacle: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        box, radius = obstacle
        size_x, size_z, cosine, sine = box[3], box[5], box[COSINE], box[SINE]
        x, z = middle_x - box[0], middle_z - box[2]
        x, z = cosine * x - sine * z, sine * x + cosine * z
        u = cosine * half_x - sine * half_z
        v = sine * half_x + cosine * half_z
        a, b = jnp.abs(u), jnp.abs(v)
        apart = greater(jnp.abs(x) - a - size_x, jnp.abs(z) - b - size_z) - radius
        diagonal = greater(jnp.abs(x + z) - jnp.abs(u + v), jnp.abs(x - z) - jnp.abs(u - v))
        apart = greater(apart, diagonal - (size_x + size_z + _ROOT * radius))
        across = size_x * b + size_z * a
        across += radius * (greater(a, b) + _EIGHTH * lesser(a, b))
        return lesser(gap, greater(apart, jnp.abs(x * v - z * u) - across)), None

    shape = jnp.broadcast_shapes(start.shape, end.shape)[:-1]
    # The compiler makes vectors of numbers, but not of truths.
    gap, _ = jax.lax.scan(look, jnp.zeros(shape, jnp.float32), (obstacles, radii), unroll=2)
    return gap >= 0


def ways(obstacles: jax.Array, radius: float, start: jax.Array, nodes: jax.Array) -> jax.Array:
    """Returns the metres [M] from a plan to each node it sees, infinite for the others.

    Octagons that the plan is in are made smaller, until it is not.
    """
    radii = jnp.minimum(radius, _grown(obstacles, start) - MARGIN)
    seen = visible(obstacles, radii, start, nodes)
    return jnp.where(seen, _length(nodes - start), jnp.inf)


def _grown(obstacles: jax.Array, plans: jax.Array) -> jax.Array:
    """Returns float32 [..., N]: the radius at which each octagon reaches plans [..., 2]."""
    beyond = jnp.abs(to_local(obstacles, plans)) - obstacles[:, HALF_SIZE][:, ::2]
    return jnp.maximum(jnp.max(beyond, axis=-1), jnp.sum(beyond, axis=-1) / _ROOT)


def _outside(obstacles: jax.Array, radius: float, plans: jax.Array) -> jax.Array:
    """Returns bool [...]: which plans [..., 2] are in no octagon."""
    return jnp.all(_grown(obstacles, plans) >= radius, axis=-1)


def _push_out(obstacles: jax.Array, radius: float, plan: jax.Array) -> jax.Array:
    """Returns a plan near by that is in no octagon; where that is too crowded, one in the way."""
    normals = jnp.array([[1, 0], [0, 1], [1 / _ROOT, 1 / _ROOT]], jnp.float32)

    def push(_: jax.Array, place: jax.Array) -> jax.Array:
        grown = _grown(obstacles, place)
        row = jnp.argmin(grown)
        box = obstacles[row]
        local = to_local(box[None], place)[0]
        beyond = jnp.abs(local) - box[HALF_SIZE][::2]
        normal = normals[jnp.argmax(normals @ beyond)] * jnp.where(local < 0, -1, 1)
        cosine, sine = box[COSINE], box[SINE]
        outward = jnp.stack(
            [cosine * normal[0] + sine * normal[1], cosine * normal[1] - sine * normal[0]]
        )
        depth = radius + MARGIN - grown[row]
        return jnp.where(grown[row] < radius, place + depth * outward, place)

    return jax.lax.fori_loop(0, 8, push, plan)


def _corners(boxes: jax.Array, radius: float) -> tuple[jax.Array, jax.Array]:
    """Returns the octagons' corners and unit vectors along their outside there, [8 N, 2] each."""
    signs = jnp.array([[1, 1], [1, -1], [-1, 1], [-1, -1]], jnp.float32)
    reach = jnp.array([[1, _EIGHTH], [_EIGHTH, 1]], jnp.float32)
    size = boxes[:, None, None, HALF_SIZE][..., ::2]
    local = signs[:, None] * (size + radius * reach)
    long, short = math.cos(math.pi / 8), math.sin(math.pi / 8)
    along = jnp.array([[-short, long], [-long, short]], jnp.float32)
    sideways = jnp.broadcast_to(signs[:, None] * along, local.shape)
    cosine, sine = boxes[:, None, None, COSINE], boxes[:, None, None, SINE]

    def turn(vectors: jax.Array) -> jax.Array:
        x, z = vectors[..., 0], vectors[..., 1]
        return jnp.stack([cosine * x + sine * z, cosine * z - sine * x], axis=-1)

    corners = turn(local) + boxes[:, None, None, CENTER][..., ::2]
    return corners.reshape(-1, 2), turn(sideways).reshape(-1, 2)


def _length(vectors: jax.Array) -> jax.Array:
    """Returns Euclidean lengths [...] of vectors [..., 2]."""
    return jnp.sqrt(jnp.sum(vectors**2, axis=-1))
