"""What samplers made of several named ones share: drawing from one of them, and telling them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from jaxact.compaction import for_each_chosen, put_rows
from jaxact.errors import JaxactError
from jaxact.pomdp import Episode, FinishedEpisodes, PyTree, TaskSampler

# With P parts, a turn of drawing is for 1 / (_TURNS · P) of the batch.
_TURNS = 4


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PartOrigin:
    """Where an episode of several parts came from.

    Attributes:
      part: int32, the part's position.
      inner: the origin that the part noted.
    """

    part: jax.Array
    inner: PyTree


def init_parts(parts: Mapping[str, TaskSampler], key: jax.Array) -> tuple[PyTree, ...]:
    """Returns the first state of each part.

    Raises:
      JaxactError: there are none, or the episodes of one differ from those of the first in
        structure, shapes or dtypes.
    """
    if not parts:
        raise JaxactError("a sampler made of others needs at least one")
    keys = jax.random.split(key, len(parts))
    states = tuple(part.init(keys[i]) for i, part in enumerate(parts.values()))
    shapes = [jax.eval_shape(p.sample, key, s) for p, s in zip(parts.values(), states, strict=True)]
    names = list(parts)
    for name, shape in zip(names[1:], shapes[1:], strict=True):
        difference = _difference(shapes[0], shape)
        if difference is not None:
            raise JaxactError(
                f"episodes of {name!r} cannot be mixed with those of {names[0]!r}: {difference}"
            )
    return states


def _difference(one: PyTree, other: PyTree) -> str | None:
    """Says how the second of two trees of shapes differs from the first; None if it does not."""
    leaves = [
        {jax.tree_util.keystr(path): x for path, x in jax.tree_util.tree_leaves_with_path(tree)}
        for tree in (one, other)
    ]
    for path in [*leaves[0], *leaves[1]]:
        if path not in leaves[0]:
            return f"they have {path} in addition"
        if path not in leaves[1]:
            return f"they lack {path}"
        first, second = (f"{x[path].dtype}{list(x[path].shape)}" for x in leaves)
        if first != second:
            return f"their {path} is {second}, not {first}"
    if jax.tree.structure(one) != jax.tree.structure(other):  # type: ignore[operator]
        return "their trees differ in structure"
    return None


def draw_part(
    parts: Sequence[TaskSampler], part: jax.Array, key: jax.Array, states: tuple[PyTree, ...]
) -> Episode:
    """Samples an episode from one part; its origin is a `PartOrigin`.

    Under `vmap` a `switch` samples from every part for every episode and throws all but one away.
    Here the batch is taken apart: each part samples only for the episodes that are its own, in
    turns of a share of the batch. With P parts and a batch of 32 P or more, at most 1.25 times
    as many episodes are drawn as are needed, in at most 5 P turns one after another. Turns are of
    at least 8 episodes.

    Args:
      parts: the samplers.
      part: int32 scalar, which one.
      key: for the episode.
      states: of the samplers.
    """

    @custom_vmap
    def draw(part: jax.Array, key: jax.Array, states: tuple[PyTree, ...]) -> Episode:
        def branch(index: int) -> Any:
            return lambda key, states: parts[index].sample(key, states[index])

        return jax.lax.switch(part, [branch(i) for i in range(len(parts))], key, states)

    @draw.def_vmap
    def draw_batch(
        size: int, batched: Any, part: jax.Array, key: jax.Array, states: tuple[PyTree, ...]
    ) -> tuple[Episode, Any]:
        given, batched = (part, key, states), tuple(batched)

        def of_rows(rows: jax.Array) -> tuple[jax.Array, jax.Array, tuple[PyTree, ...]]:
            return jax.tree.map(lambda x, many: x[rows] if many else x, given, batched)

        axes = jax.tree.map(lambda many: 0 if many else None, batched)
        which = jnp.broadcast_to(part, (size,))
        _, first_key, first_states = of_rows(jnp.int32(0))
        shape = jax.eval_shape(parts[0].sample, first_key, first_states[0])
        episodes = jax.tree.map(lambda x: jnp.zeros((size, *x.shape), x.dtype), shape)
        for index, sampler in enumerate(parts):

            def sample(
                places: jax.Array,
                rows: jax.Array,
                episodes: Episode,
                index: int = index,
                sampler: TaskSampler = sampler,
            ) -> tuple[jax.Array, Episode]:
                _, keys, states = of_rows(rows)
                drawn = jax.vmap(sampler.sample, (axes[1], axes[2][index]), axis_size=rows.size)(
                    keys, states[index]
                )
                return jnp.zeros_like(places, bool), put_rows(episodes, places, drawn)

            share = _TURNS * len(parts)
            episodes = for_each_chosen(which == index, episodes, sample, share)
        return episodes, jax.tree.map(lambda _: True, episodes)

    episode = draw(part, key, states)
    return replace(episode, origin=PartOrigin(part, episode.origin))


def update_parts(
    parts: Sequence[TaskSampler], states: tuple[PyTree, ...], finished: FinishedEpisodes
) -> tuple[PyTree, ...]:
    """Tells each part how its own episodes ended."""
    origin: PartOrigin = finished.origin
    return tuple(
        part.update(
            state,
            replace(finished, mask=finished.mask & (origin.part == index), origin=origin.inner),
        )
        for index, (part, state) in enumerate(zip(parts, states, strict=True))
    )


def kinds_of_parts(parts: Mapping[str, TaskSampler], origin: PartOrigin) -> dict[str, jax.Array]:
    """Returns one kind for each part, and the kinds of the parts under "part/kind"."""
    kinds = {}
    for index, (name, part) in enumerate(parts.items()):
        own = origin.part == index
        kinds[name] = own
        for inner, mask in part.kinds(origin.inner).items():
            kinds[f"{name}/{inner}"] = own & mask
    return kinds


def metrics_of_parts(
    parts: Mapping[str, TaskSampler], states: tuple[PyTree, ...]
) -> dict[str, jax.Array]:
    """Returns the metrics of the parts under "part/metric"."""
    return {
        f"{name}/{metric}": value
        for (name, part), state in zip(parts.items(), states, strict=True)
        for metric, value in part.metrics(state).items()
    }
