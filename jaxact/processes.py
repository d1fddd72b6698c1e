"""What the processes of one run have to agree on; to a single one all of this is nothing.

Every process runs the same host loop, and all have to call the functions here at the same points of
it. The first process alone makes the run's directory, logs, films and shows progress.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils

from jaxact.errors import JaxactError

PyTree = Any


def is_first() -> bool:
    """Whether this process is the one that writes."""
    return jax.process_index() == 0


def text_of_first(make: Callable[[], str]) -> str:
    """Returns in all processes what `make` returns in the first, which alone calls it.

    Raises:
      JaxactError: `make` raised it; it is raised in all, so that none is left waiting.
    """
    if jax.process_count() == 1:
        return make()
    failed, text = False, ""
    if is_first():
        try:
            text = make()
        except JaxactError as error:
            failed, text = True, str(error)
    encoded = np.frombuffer(text.encode(), np.uint8)
    failed, size = _of_first(np.array([failed, encoded.size], np.int32)).tolist()
    text = bytes(_of_first(np.resize(encoded, size)).astype(np.uint8)).decode()
    if failed:
        raise JaxactError(text)
    return text


def largest(number: int) -> int:
    """Returns the largest of the processes' numbers."""
    if jax.process_count() == 1:
        return number
    return int(np.max(multihost_utils.process_allgather(np.int32(number))))


def own_copy(replicated: PyTree) -> PyTree:
    """Returns replicated arrays as ones of this process alone, for programs that only it runs."""
    if jax.process_count() == 1:
        return replicated
    return jax.tree.map(lambda x: x.addressable_data(0), replicated)


def _of_first(array: np.ndarray) -> np.ndarray:
    return np.asarray(multihost_utils.broadcast_one_to_all(array))
