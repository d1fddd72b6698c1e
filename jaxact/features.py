"""What a model computes on the way to its output, as arrays and as pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxact.errors import unknown
from jaxact.policy import Policy, PolicyMemory
from jaxact.pomdp import POMDP
from jaxact.train_state import make_key

# A picture shows so many channels of a map, or entries of a vector, and is about so large.
_SHOWN = 64
_PIXELS = 320

_POSITIVE = np.array([255, 176, 59], np.float32)
_NEGATIVE = np.array([86, 140, 255], np.float32)
_GAP = 40


def intermediates(
    policy: Policy, observation: Mapping[str, jax.Array], memory: PolicyMemory
) -> dict[str, jax.Array]:
    """Returns what each part of a model puts out on one lane.

    Args:
      policy: the model and its parameters.
      observation: named arrays of one lane.
      memory: of one lane, from `policy.initial_memory()` or `policy.act`.

    Returns:
      By the module's path, such as "encoder/Convolution_0"; of a module that puts out several
      arrays each by its place or name among them, such as "memory/0" and "actor/logits". Without
      the lane's axis.
    """
    observation, memory = jax.tree.map(lambda x: x[None], (dict(observation), memory))
    _, kept = policy.model.apply(
        policy.params,
        observation,
        memory.model,
        memory.previous_action,
        memory.is_first,
        capture_intermediates=True,
        mutable=["intermediates"],
    )
    found = {}
    for path, value in jax.tree_util.tree_leaves_with_path(kept["intermediates"]):
        if name := _name(path):
            found[name] = value[0]
    return found


def check_names(pomdp: POMDP, policy: Policy, names: Sequence[str]) -> None:
    """Looks for intermediates by their names, without computing anything.

    Raises:
      JaxactError: the model has none of such a name.
    """

    def start(key: jax.Array) -> dict[str, jax.Array]:
        return intermediates(policy, pomdp.reset(key)[1], policy.initial_memory())

    found = jax.eval_shape(start, make_key(0)) if names else {}
    for name in names:
        if name not in found:
            raise unknown("intermediate of the model", name, found)


def draw(values: np.ndarray) -> np.ndarray:
    """Draws an intermediate: positive values amber, negative ones blue, by the greatest of all.

    Args:
      values: [H, W, C], a map whose first channels are laid out as tiles; or [H, W]; or [N], whose
        first entries are laid out row by row; anything else is flattened to [N]. The first axis
        goes down: in maps of MiniGrid's views that is x, so that the agent looks to the left.

    Returns:
      uint8 [H', W', 3].
    """
    values = np.asarray(values, np.float32)
    if values.ndim == 2:
        tiles = values[None]
    elif values.ndim == 3:
        tiles = np.moveaxis(values[..., :_SHOWN], -1, 0)
    else:
        tiles = values.reshape(-1, 1, 1)[:_SHOWN]
    greatest = np.max(np.abs(tiles), initial=0.0, where=np.isfinite(tiles))
    share = np.clip(np.nan_to_num(tiles) / (greatest or 1.0), -1.0, 1.0)[..., None]
    colors = np.where(share > 0, share * _POSITIVE, -share * _NEGATIVE)
    columns = int(np.ceil(np.sqrt(len(tiles))))
    rows = -(-len(tiles) // columns)
    height, width = tiles.shape[1:]
    factor = max(1, _PIXELS // max(rows * height, columns * width))
    canvas = np.full((rows * (height * factor + 1), columns * (width * factor + 1), 3), _GAP)
    for i, tile in enumerate(np.repeat(np.repeat(colors, factor, axis=1), factor, axis=2)):
        top = i // columns * (height * factor + 1)
        left = i % columns * (width * factor + 1)
        canvas[top : top + height * factor, left : left + width * factor] = tile
    return canvas.astype(np.uint8)


def _name(path: Sequence[Any]) -> str:
    """Returns a leaf's name; none for the outputs of the model as a whole."""
    steps = [jax.tree_util.keystr((key,), simple=True) for key in path]
    call = steps.index("__call__")
    # After the method comes which of its calls it was: modules are called once.
    return "/".join(steps[:call] + steps[call + 2 :]) if call else ""
