"""Shortest ways against an independent visibility graph with finely rounded corners."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra
from small_houses import BODY, ROOMS, cluttered, free_plans, walls

from envs_jax.houses.categories import index
from envs_jax.houses.collision import obstacles
from envs_jax.houses.geodesic import build_roadmap, distance, goal_field, path, shortest
from envs_jax.houses.scene import make_scene

# Sides of a quarter of a circle in the reference.
FINE = 8


def rounded(boxes, radius):
    """Convex polygons float64 [N, V, 2] around boxes grown by a radius, counter-clockwise."""
    boxes = np.asarray(boxes, np.float64)
    boxes = boxes[boxes[:, 1] > -1e3]
    steps = (np.arange(4 * FINE) + 0.5) * (np.pi / 2 / FINE)
    corner = np.stack([np.cos(steps), np.sin(steps)], axis=-1)
    # Corners of a polygon around the circle, so that the reference is free of collisions as well.
    local = boxes[:, None, [3, 5]] * np.sign(corner) + radius / np.cos(np.pi / 4 / FINE) * corner
    cosine, sine = boxes[:, None, 6], boxes[:, None, 7]
    x = cosine * local[..., 0] + sine * local[..., 1]
    z = cosine * local[..., 1] - sine * local[..., 0]
    return np.stack([x + boxes[:, None, 0], z + boxes[:, None, 2]], axis=-1)


def clear(polygons, start, end):
    """Whether segments [M, 2] to [M, 2] enter no polygon, by clipping them edge by edge."""
    seen = np.ones(len(start), bool)
    way = end - start
    for polygon in polygons:
        edge = np.roll(polygon, -1, axis=0) - polygon
        outward = np.stack([edge[:, 1], -edge[:, 0]], axis=-1)
        outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
        if np.dot(outward[0], polygon.mean(axis=0) - polygon[0]) > 0:
            outward = -outward
        height = start @ outward.T - np.sum(outward * polygon, axis=-1) + 1e-7
        slope = way @ outward.T
        with np.errstate(divide="ignore", invalid="ignore"):
            share = -height / slope
        enter = np.where(slope < 0, share, np.where((slope == 0) & (height > 0), 2.0, 0.0))
        leave = np.where(slope > 0, share, 1.0)
        seen &= np.maximum(enter.max(axis=1), 0) >= np.minimum(leave.min(axis=1), 1)
    return seen


def reference(boxes, radius, starts, goals):
    """Geodesic metres from each start to its goal, float64."""
    polygons = rounded(boxes, radius)
    nodes = polygons.reshape(-1, 2)
    inside = np.zeros(len(nodes), bool)
    for polygon in polygons:
        edge = np.roll(polygon, -1, axis=0) - polygon
        side = edge[:, 0] * (nodes[:, None, 1] - polygon[:, 1])
        side -= edge[:, 1] * (nodes[:, None, 0] - polygon[:, 0])
        inside |= np.all(side > 1e-7, axis=1) | np.all(side < -1e-7, axis=1)
    nodes = np.concatenate([starts, goals, nodes[~inside]])
    count = len(nodes)
    first, second = np.triu_indices(count, 1)
    seen = clear(polygons, nodes[first], nodes[second])
    lengths = np.full((count, count), np.inf)
    metres = np.linalg.norm(nodes[first] - nodes[second], axis=-1)
    lengths[first[seen], second[seen]] = metres[seen]
    graph = np.where(np.isfinite(lengths), lengths, 0)
    found = dijkstra(graph, directed=False, indices=np.arange(len(starts)))
    return found[np.arange(len(starts)), len(starts) + np.arange(len(goals))]


@pytest.fixture(scope="module")
def measure():
    """Measures metres from starts to goals, and whether there is a way, in one program."""

    @jax.jit
    def run(scene, starts, goals):
        boxes = obstacles(scene.boxes, BODY)
        roadmap = build_roadmap(scene, BODY, 128)

        def one(start, goal):
            field = goal_field(roadmap, boxes, BODY.radius, goal[None])
            metres, _ = distance(field, boxes, BODY.radius, start)
            reachable = shortest(field, boxes, BODY.radius, start) < jnp.inf
            return metres, reachable, path(field, boxes, BODY.radius, start, 16)

        return roadmap.overflow, *jax.vmap(one)(starts, goals)

    return run


def compare(measure, seed):
    scene = cluttered(seed, size=28)
    boxes = np.asarray(obstacles(scene.boxes, BODY))
    plans = free_plans(seed, boxes, BODY.radius, 48)
    starts, goals = plans[:24], plans[24:]
    overflow, metres, reachable, ways = measure(scene, starts, goals)
    assert not bool(overflow)
    expected = reference(boxes, BODY.radius, starts.astype(float), goals.astype(float))
    both = np.isfinite(expected) & np.asarray(reachable)
    error = np.abs(np.asarray(metres)[both] / expected[both] - 1)
    agree = np.isfinite(expected) == np.asarray(reachable)
    return error, agree, (scene, starts, goals, np.asarray(metres), np.asarray(ways), both)


def check(measure, seeds):
    errors, agreements = [], []
    for seed in seeds:
        error, agree, _ = compare(measure, seed)
        errors.append(error)
        agreements.append(agree)
    error, agree = np.concatenate(errors), np.concatenate(agreements)
    print(f"{len(error)} ways: 95 % within {np.quantile(error, 0.95):.4f}, worst {error.max():.4f}")
    assert len(error) > 10 * len(list(seeds))
    assert agree.mean() > 0.95
    assert np.quantile(error, 0.95) < 0.01
    assert np.mean(error < 0.02) >= 0.98


def test_distances_are_those_of_a_finer_visibility_graph(measure):
    check(measure, (0,))


@pytest.mark.slow
def test_distances_hold_in_many_houses(measure):
    check(measure, range(1, 13))


@pytest.mark.slow
def test_distances_are_a_metric_and_paths_have_their_length(measure):
    _, _, (scene, starts, goals, metres, ways, both) = compare(measure, 3)
    _, back, reachable, _ = measure(scene, goals, starts)
    np.testing.assert_allclose(back[both], metres[both], rtol=1e-4, atol=3e-3)
    assert bool(np.asarray(reachable)[both].all())
    straight = np.linalg.norm(starts - goals, axis=-1)
    assert np.all(metres >= straight - 1e-4)
    # From each start to the first goal by way of any other place.
    same = np.broadcast_to(goals[0], goals.shape)
    _, to_first, reachable, _ = measure(scene, starts, same)
    _, between, linked, _ = measure(scene, starts, np.roll(starts, 1, axis=0))
    held = np.asarray(reachable & np.roll(reachable, 1) & linked)
    to_first, between = np.asarray(to_first), np.asarray(between)
    assert held.any()
    assert np.all(to_first[held] <= (between + np.roll(to_first, 1))[held] + 3e-3)
    lengths = np.linalg.norm(np.diff(ways, axis=1), axis=-1).sum(axis=1)
    np.testing.assert_allclose(lengths[both], metres[both], rtol=1e-4, atol=3e-3)
    np.testing.assert_allclose(ways[both, -1], goals[both], atol=3e-3)


def test_a_wall_is_walked_around():
    wall = (2, 0.5, 2, 2, 1, 0.1, 0)
    scene = make_scene([wall], [index("Wall")], ROOMS, size=4)

    @jax.jit
    def metres(start, goal):
        boxes = obstacles(scene.boxes, BODY)
        field = goal_field(build_roadmap(scene, BODY, 8), boxes, BODY.radius, goal[None])
        return distance(field, boxes, BODY.radius, start)[0]

    start, goal = jnp.array([2, 1], jnp.float32), jnp.array([2, 3], jnp.float32)
    # A tangent to the circle around each corner, two arcs and what is straight between them.
    across = np.hypot(1, 0.95)
    tangent = np.sqrt(across**2 - BODY.radius**2)
    arc = np.pi / 2 - np.arctan2(0.95, 1) + np.arcsin(BODY.radius / across)
    exact = 2 * tangent + 0.1 + 2 * BODY.radius * arc
    assert float(metres(start, goal)) == pytest.approx(exact, rel=0.02)
    # Anywhere that is not free there is still a distance, and it varies little.
    inside = jnp.array([2, 1.9], jnp.float32)
    assert jnp.isfinite(metres(inside, goal))
    edge = jnp.array([2, 2 - 0.05 - BODY.radius + 1e-4], jnp.float32)
    assert float(metres(edge, goal)) == pytest.approx(
        float(metres(edge.at[1].add(-2e-3), goal)), abs=5e-3
    )


def test_too_many_corners_are_told():
    scene = make_scene(walls(), [index("Wall")] * 7, ROOMS)
    assert bool(jax.jit(lambda: build_roadmap(scene, BODY, 4).overflow)())
