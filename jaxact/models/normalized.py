"""Observations normalised by running statistics, which go wherever the parameters go."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxact.errors import unknown
from jaxact.moments import Moments

PyTree = Any
COLLECTION = "moments"


class Normalized(nn.Module):
    """An encoder whose readings are first normalised by all that was acted on in training.

    The running mean and variance of each entry of a reading are variables of the model, in a flax
    collection of their own, and so part of what a run saves, resumes, evaluates and freezes. No
    gradient step changes them: after what is learnt of a rollout, its observations are taken in
    (`observed`), those of all devices alike. So a policy acts and learns in one update with the
    same statistics, the first with none: mean 0 and variance 1. Stages that do not act leave them.

    For encoders of models, and of losses' networks that see all of their variables, as `SAC`'s
    critics do; for worlds of one agent.

    Attributes:
      encoder: module from named observations [..., …] to features [..., F].
      sensors: names of those to normalise; None for all whose readings are floats.
      clip: normalised readings lie within ± this.
    """

    encoder: nn.Module
    sensors: Sequence[str] | None = None
    clip: float = 10.0

    @nn.compact
    def __call__(self, observation: Mapping[str, jax.Array]) -> jax.Array:
        """Returns what the encoder makes of the normalised observation.

        Raises:
          JaxactError: there is no such sensor.
        """
        seen = dict(observation)
        for name in self._names(observation):
            # With the first observation there are lanes alone in front of what a lane reads.
            shape = observation[name].shape[1:]
            moments: Any = self.variable(COLLECTION, name, Moments.of_none, *shape)
            fixed = jax.lax.stop_gradient(moments.value)
            seen[name] = jnp.clip(fixed.normalize(observation[name]), -self.clip, self.clip)
        return self.encoder(seen)

    def _names(self, observation: Mapping[str, jax.Array]) -> Sequence[str]:
        if self.sensors is None:
            return [n for n, x in observation.items() if jnp.issubdtype(x.dtype, jnp.floating)]
        for name in self.sensors:
            if name not in observation:
                raise unknown("sensor to normalise", name, observation)
        return self.sensors


def observed(
    variables: PyTree, observation: Mapping[str, jax.Array], axis_name: str | None
) -> PyTree:
    """Takes a rollout's observations in, wherever there are statistics of them.

    Args:
      variables: trees of variables of `Normalized`, and anything else.
      observation: named arrays [T, B, ...], this device's.
      axis_name: the device axis, None on a single device.
    """
    return _map(lambda name, x: x.update(observation[name], axis_name), variables)


def held(updates: PyTree) -> PyTree:
    """Returns an optimizer's updates with none for statistics, which weight decay would shrink."""
    return _map(lambda name, x: jax.tree.map(jnp.zeros_like, x), updates)


def _map(change: Callable[[str, Moments], Moments], tree: PyTree) -> PyTree:
    """Changes the statistics in a tree, given the sensor's name, which they are under."""

    def at(path: tuple[Any, ...], x: Any) -> Any:
        return change(path[-1].key, x) if isinstance(x, Moments) else x

    return jax.tree_util.tree_map_with_path(at, tree, is_leaf=lambda x: isinstance(x, Moments))
