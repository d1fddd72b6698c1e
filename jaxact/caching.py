"""Remembers compiled functions of parts that cannot be hashed, such as modules with dicts."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def cached_by_identity(function: Callable[P, R], size: int = 16) -> Callable[P, R]:
    """Remembers the last `size` results, telling arguments apart by which object they are."""
    results: OrderedDict[tuple[int, ...], tuple[Any, R]] = OrderedDict()

    @wraps(function)
    def remembered(*args: P.args, **kwargs: P.kwargs) -> R:
        key = tuple(id(argument) for argument in (*args, *kwargs.values()))
        if key not in results:
            # The arguments are kept too, so that no other object can come by their identity.
            results[key] = (args, kwargs), function(*args, **kwargs)
        results.move_to_end(key)
        if len(results) > size:
            results.popitem(last=False)
        return results[key][1]

    return remembered
