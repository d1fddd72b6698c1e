"""Names of worlds: `register` declares one, `make` builds it, `ids` lists them."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Parameter, signature
from typing import Any

from jaxact.errors import unknown
from jaxact.pomdp import POMDP

_BUILDERS: dict[str, Callable[..., POMDP]] = {}


def register(name: str, builder: Callable[..., POMDP]) -> None:
    """Declares a world under `name`.

    Raises:
      ValueError: the name is taken.
    """
    if name in _BUILDERS:
        raise ValueError(f"the id {name!r} is already registered")
    _BUILDERS[name] = builder


def make(name: str, **options: Any) -> POMDP:
    """Builds the world registered as `name`.

    Args:
      name: an id of `ids()`; Farama's own ids for grid worlds.
      **options: what the world's builder takes. For grid worlds: `observation`, one of "image",
        "packed", "full", "rgb" and "rgb_full"; `view_size`; `tile_size`.

    Raises:
      JaxactError: no such id or option; the message names the nearest.
    """
    if name not in _BUILDERS:
        raise unknown("environment id", name, _BUILDERS)
    taken = signature(_BUILDERS[name]).parameters
    if not any(parameter.kind == Parameter.VAR_KEYWORD for parameter in taken.values()):
        for option in options:
            if option not in taken:
                raise unknown(f"option of {name}", option, taken)
    return _BUILDERS[name](**options)


def ids() -> list[str]:
    """Returns all registered ids, sorted."""
    return sorted(_BUILDERS)
