"""Reading and changing the parts of an experiment by dotted path, and describing it as JSON.

An experiment is a nest of frozen dataclasses, flax modules, mappings and tuples; anything else in
it is a leaf. Field names, mapping keys and tuple positions, joined by dots, name a part:
`pipeline.stages.0.losses.ppo.clip`. Nothing is changed in place.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import flax.linen as nn
import jax
import numpy as np

from jaxact.errors import JaxactError, unknown
from jaxact.parsing import Mismatch, convert, element_annotation, field_annotations

T = TypeVar("T")

_MODULE_FIELDS = ("parent", "name")


def override(config: T, assignments: Sequence[str] | Mapping[str, Any]) -> T:
    """Returns `config` with some of its leaves set anew.

    Args:
      config: a nest of dataclasses, mappings and tuples.
      assignments: texts `"dotted.path=value"`, or values by dotted path. Texts are read by the
        field's annotation and by the type of its present value: `1e6` is an int where it is
        integral, an int serves as a float, `true`, `false` and `none` are what they say, `[1, 2]`
        and `1,2` are tuples. All are set at once; of two with the same path the later one counts.

    Returns:
      A new config of the same type; parts without a change are shared with the old one.

    Raises:
      JaxactError: a path names no part, a value does not suit it, or a text has no `=`.
    """
    return _assign(config, _tree(_split(assignments)), "", Any)


def leaves(config: Any) -> dict[str, Any]:
    """Returns every leaf by its dotted path, in the order of declaration.

    A tuple of plain values, such as layer widths, is one leaf.
    """
    return dict(_walk(config, "", _is_leaf))


def numbers(config: Any) -> dict[str, float]:
    """Returns every Python float by its dotted path: the numbers one program can take as data.

    Bools and ints are structure, not data, and flax modules are not looked into, since a network's
    numbers are compiled in. So are those of classes that have `numbers_are_structure = True`, for
    example a camera's, from which Python computes before anything is compiled.
    """

    def is_leaf(value: Any) -> bool:
        fixed = getattr(type(value), "numbers_are_structure", False)
        return fixed or isinstance(value, nn.Module) or not _children(value)

    found = _walk(config, "", is_leaf)
    return {path: float(value) for path, value in found if isinstance(value, float)}


def with_numbers(config: T, values: Mapping[str, Any]) -> T:
    """Returns `config` with the leaves at the given paths replaced, without checks or conversion.

    The values may be traced arrays: they are neither hashed nor compared, and the `__post_init__`
    of the dataclasses on the way is not run.

    Args:
      config: a nest of dataclasses, mappings and tuples.
      values: new leaves by dotted path, for example arrays in place of all `numbers(config)`.

    Returns:
      A new config of the same type; parts without a change are shared with the old one.

    Raises:
      JaxactError: a path names no part.
    """
    return _insert(config, _tree(values), "")


def to_json(config: Any) -> Any:
    """Describes a config in JSON's types, the same way every time.

    Dataclasses and flax modules become `{"type": "module.Name", field: ...}`, mappings objects,
    tuples lists, functions and classes their qualified names, arrays `{"shape", "dtype", "sha256"}`
    and floats that JSON cannot hold the strings `"nan"`, `"inf"` and `"-inf"`.
    """
    if isinstance(config, enum.Enum):
        return f"{_qualified_name(type(config))}.{config.name}"
    if config is None or isinstance(config, bool | int | str):
        return config
    if isinstance(config, float):
        return float(config) if math.isfinite(config) else str(float(config))
    if dataclasses.is_dataclass(config) and not isinstance(config, type):
        parts = _children(config) or {}
        described = {name: to_json(part) for name, part in parts.items()}
        return {"type": _qualified_name(type(config)), **described}
    if isinstance(config, Mapping):
        return {str(key): to_json(part) for key, part in config.items()}
    if isinstance(config, tuple | list):
        return [to_json(part) for part in config]
    if isinstance(config, set | frozenset):
        return sorted((to_json(part) for part in config), key=json.dumps)
    return _leaf_to_json(config)


def fingerprint(config: Any) -> str:
    """Returns the SHA-256, in hexadecimal, of the canonical JSON of `to_json(config)`."""
    text = json.dumps(to_json(config), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _children(value: Any) -> dict[str, Any] | None:
    """Returns the named parts of a composite value, None for any other."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        skipped = _MODULE_FIELDS if isinstance(value, nn.Module) else ()
        names = [f.name for f in dataclasses.fields(value) if f.init and f.name not in skipped]
        return {name: getattr(value, name) for name in names}
    if isinstance(value, Mapping):
        return {str(key): part for key, part in value.items()}
    if isinstance(value, tuple | list):
        return {str(index): part for index, part in enumerate(value)}
    return None


def _is_leaf(value: Any) -> bool:
    parts = _children(value)
    if isinstance(value, tuple | list):
        return all(_children(part) is None and not callable(part) for part in value)
    return not parts


def _walk(value: Any, path: str, is_leaf: Callable[[Any], bool]) -> list[tuple[str, Any]]:
    if is_leaf(value):
        # A part without fields has nothing to set; an empty mapping or tuple is a value.
        return [] if dataclasses.is_dataclass(value) else [(path, value)]
    parts = _children(value) or {}
    return [
        leaf for name, part in parts.items() for leaf in _walk(part, _join(path, name), is_leaf)
    ]


def _with_children(value: T, changes: dict[str, Any], construct: bool) -> T:
    """Rebuilds a composite with some parts exchanged, by its constructor or around it."""
    if isinstance(value, nn.Module):
        return value.clone(**changes)
    if isinstance(value, Mapping):
        rebuilt = {key: changes.get(str(key), part) for key, part in value.items()}
        return type(value)(rebuilt)  # type: ignore[call-arg]
    if isinstance(value, tuple | list):
        items = [changes.get(str(index), part) for index, part in enumerate(value)]
        return type(value)(*items) if hasattr(value, "_fields") else type(value)(items)
    if construct:
        return dataclasses.replace(value, **changes)  # type: ignore[type-var]
    copy = object.__new__(type(value))
    for field in dataclasses.fields(value):  # type: ignore[arg-type]
        if field.name in changes or hasattr(value, field.name):
            part = changes[field.name] if field.name in changes else getattr(value, field.name)
            object.__setattr__(copy, field.name, part)
    return copy


def _split(assignments: Sequence[str] | Mapping[str, Any]) -> dict[str, Any]:
    if isinstance(assignments, Mapping):
        return dict(assignments)
    if isinstance(assignments, str):
        assignments = [assignments]
    split = {}
    for text in assignments:
        path, equals, value = text.partition("=")
        if not equals or not path.strip():
            raise JaxactError(f"expected path=value, for example seed=1, but got {text!r}")
        split[path.strip()] = value.strip()
    return split


class _New:
    """A value to be put in place of a part."""

    def __init__(self, value: Any) -> None:
        self.value = value


def _tree(values: Mapping[str, Any]) -> dict[str, Any]:
    """Nests {"a.b": value} as {"a": {"b": _New(value)}}."""
    tree: dict[str, Any] = {}
    for path, value in values.items():
        *parents, last = path.split(".")
        node: Any = tree
        for name in parents:
            node = node.setdefault(name, {})
            if isinstance(node, _New):
                break
        if isinstance(node, _New) or isinstance(node.get(last), dict):
            raise JaxactError(f"{path} is set both as a whole and in part; keep one of the two")
        node[last] = _New(value)
    return tree


def _part(value: Any, name: str, path: str) -> Any:
    """Returns a composite's part; the error names the nearest one there is."""
    parts = _children(value)
    where = f"{path} ({type(value).__name__})" if path else type(value).__name__
    if not parts:
        raise JaxactError(f"{where} has no parts, so {_join(path, name)} cannot be set")
    if name in parts:
        return parts[name]
    if isinstance(value, tuple | list):
        raise JaxactError(f"{where} has no item {name!r}; expected 0 to {len(value) - 1}")
    kind = "key" if isinstance(value, Mapping) else "field"
    raise JaxactError(f"{where}: {unknown(kind, name, parts)}")


def _assign(value: Any, tree: dict[str, Any], path: str, annotation: Any) -> Any:
    """Sets what `tree` holds, checked."""
    changes = {}
    cls: type = type(value)
    annotations = field_annotations(cls) if dataclasses.is_dataclass(value) else None
    for name, change in tree.items():
        current = _part(value, name, path)
        where = _join(path, name)
        if annotations is None:
            expected = element_annotation(annotation, value, name)
        else:
            expected = annotations.get(name, Any)
        if isinstance(change, _New):
            changes[name] = _checked(change.value, expected, current, where)
        else:
            changes[name] = _assign(current, change, where, expected)
    return _with_children(value, changes, construct=True)


def _checked(given: Any, annotation: Any, current: Any, path: str) -> Any:
    try:
        return convert(given, annotation, current)
    except Mismatch as mismatch:
        inner = list(leaves(current)) if not _is_leaf(current) else []
        if inner and isinstance(given, str):
            raise JaxactError(
                f"{path} is a whole part ({type(current).__name__}) and cannot be given as text; "
                f"set one of its leaves, for example {_join(path, inner[0])}=..."
            ) from None
        shown = repr(given) if isinstance(given, str) else f"{given!r} ({type(given).__name__})"
        raise JaxactError(f"{path}: expected {mismatch.expected}, but got {shown}") from None


def _insert(value: Any, tree: dict[str, Any], path: str) -> Any:
    """Sets what `tree` holds, unchecked."""
    changes = {}
    for name, change in tree.items():
        current = _part(value, name, path)
        if isinstance(change, _New):
            changes[name] = change.value
        else:
            changes[name] = _insert(current, change, _join(path, name))
    return _with_children(value, changes, construct=False) if changes else value


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _qualified_name(value: Any) -> str:
    name = getattr(value, "__qualname__", None) or getattr(value, "__name__", "")
    return f"{getattr(value, '__module__', '')}.{name}"


def _leaf_to_json(value: Any) -> Any:
    if isinstance(value, np.generic):
        return to_json(value.item())
    if isinstance(value, jax.Array | np.ndarray):
        described = {"shape": list(value.shape), "dtype": str(value.dtype)}
        return described if isinstance(value, jax.core.Tracer) else described | _digest(value)
    if isinstance(value, np.dtype):
        return str(value)
    if isinstance(value, functools.partial):
        keywords = dict(sorted(value.keywords.items()))
        return {
            "type": "functools.partial",
            "function": to_json(value.func),
            "arguments": to_json(value.args),
            "keywords": to_json(keywords),
        }
    if hasattr(value, "__self__") and hasattr(value, "__func__"):
        return {"type": "method", "name": value.__name__, "self": to_json(value.__self__)}
    if hasattr(value, "__qualname__") or isinstance(value, type):
        return _qualified_name(value)
    return {"type": _qualified_name(type(value))}


def _digest(array: jax.Array | np.ndarray) -> dict[str, str]:
    if jax.dtypes.issubdtype(array.dtype, jax.dtypes.prng_key):
        array = jax.random.key_data(array)
    return {"sha256": hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()}
