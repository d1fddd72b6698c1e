"""A mapping that cannot change, so that what holds it can be hashed and shared."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TypeVar

K = TypeVar("K")
V = TypeVar("V")


class FrozenMapping(Mapping[K, V]):
    """An immutable dict that keeps the order of its keys; to JAX it is a leaf, not a tree.

    It equals every mapping with the same entries, and is hashable if they are. Dicts within are
    frozen too.
    """

    __slots__ = ("_entries",)

    def __init__(self, entries: Mapping[K, V] | Iterable[tuple[K, V]] = ()) -> None:
        self._entries = {key: _frozen(value) for key, value in dict(entries).items()}

    def __getitem__(self, key: K) -> V:
        return self._entries[key]

    def __iter__(self) -> Iterator[K]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __hash__(self) -> int:
        # Not taken before it is asked for: the values may be tracers, which have none.
        return hash(frozenset(self._entries.items()))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._entries})"


def _frozen(value: V) -> V:
    return FrozenMapping(value) if isinstance(value, dict) else value  # type: ignore[return-value]
