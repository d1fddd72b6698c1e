"""Reading a value from text, or checking one that is given, by a field's annotation."""

from __future__ import annotations

import collections.abc
import contextlib
import enum
import functools
import math
import types
import typing
from typing import Any, Literal, TypeVar

from jaxact.errors import unknown

_SEQUENCES = (tuple, list, collections.abc.Sequence)
_SCALARS = (bool, int, float, str)


class Mismatch(Exception):
    """The value is not of the annotated type; `expected` says in words what is."""

    def __init__(self, expected: str) -> None:
        super().__init__(expected)
        self.expected = expected


@functools.cache
def field_annotations(cls: type) -> dict[str, Any]:
    """Returns the resolved annotations of a class; none where one of them cannot be resolved."""
    try:
        return typing.get_type_hints(cls)
    except (NameError, TypeError, AttributeError):
        return {}


def element_annotation(annotation: Any, container: Any, name: str) -> Any:
    """Returns the annotation of one item of an annotated mapping or sequence, Any if unknown."""
    for member in _members(annotation):
        origin, arguments = typing.get_origin(member), typing.get_args(member)
        if not isinstance(origin, type) or not isinstance(container, origin) or not arguments:
            continue
        if issubclass(origin, collections.abc.Mapping):
            return arguments[-1]
        if issubclass(origin, tuple) and Ellipsis not in arguments:
            return arguments[int(name)] if int(name) < len(arguments) else Any
        return arguments[0]
    return Any


def convert(given: Any, annotation: Any, current: Any = None) -> Any:
    """Returns `given` as a value of the annotated type.

    Args:
      given: a text to be read, or a value to be checked.
      annotation: a type, as `typing.get_type_hints` gives it.
      current: the present value; its type is tried first among the members of a union, and it is
        all there is to go by where the annotation says nothing that a text could be read as.

    Raises:
      Mismatch: it is none.
    """
    members = _members(annotation)
    if Any in members:
        if not isinstance(given, str) and not isinstance(current, (*_SCALARS, tuple)):
            return given
        members = _members_like(current)
    elif isinstance(current, _SCALARS) and not any(map(_is_readable, members)):
        members = members + _members_like(current)
    expected = []
    for member in sorted(members, key=lambda member: _rank(member, current)):
        try:
            return _convert_one(given, member)
        except Mismatch as mismatch:
            expected.append(mismatch.expected)
    raise Mismatch(" or ".join(dict.fromkeys(expected)))


def _members(annotation: Any) -> list[Any]:
    """Flattens unions; type variables and `object` say nothing."""
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return [one for member in typing.get_args(annotation) for one in _members(member)]
    if typing.get_origin(annotation) in (typing.Annotated, typing.Final):
        return _members(typing.get_args(annotation)[0])
    if isinstance(annotation, TypeVar) or annotation is object:
        return [Any]
    return [annotation]


def _members_like(current: Any) -> list[Any]:
    if isinstance(current, tuple) and current and isinstance(current[0], _SCALARS):
        return [tuple[type(current[0]), ...]]  # type: ignore[misc]
    return [type(current)] if current is not None else [type(None), bool, int, float, str]


def _is_readable(member: Any) -> bool:
    origin = typing.get_origin(member) or member
    if origin is Literal or origin in _SEQUENCES or origin in _SCALARS:
        return True
    return isinstance(member, type) and issubclass(member, enum.Enum)


def _rank(member: Any, current: Any) -> int:
    if member is type(None):
        return 0
    if member is str:
        return 3  # takes every text, so it comes last
    return 1 if member is type(current) else 2


def _convert_one(given: Any, member: Any) -> Any:
    origin = typing.get_origin(member) or member
    if member is type(None):
        return _none(given)
    if origin is Literal:
        return _literal(given, typing.get_args(member))
    if member in (bool, int, float):
        return {bool: _bool, int: _int, float: _float}[member](given)
    if origin in _SEQUENCES:
        return _sequence(given, origin, typing.get_args(member))
    if origin is collections.abc.Callable and callable(given):
        return given
    if isinstance(member, type) and issubclass(member, enum.Enum) and isinstance(given, str):
        return _literal(given, tuple(member))
    if isinstance(origin, type) and _is_instance(given, origin):
        return given
    raise Mismatch(_describe(member))


def _is_instance(given: Any, origin: type) -> bool:
    try:
        return isinstance(given, origin)
    except TypeError:  # a protocol that cannot be checked
        return not isinstance(given, str)


def _none(given: Any) -> None:
    if given is not None and str(given).lower() not in ("none", "null"):
        raise Mismatch("none")


def _bool(given: Any) -> bool:
    if isinstance(given, bool):
        return given
    if isinstance(given, str) and given.lower() in ("true", "false"):
        return given.lower() == "true"
    raise Mismatch("true or false")


def _int(given: Any) -> int:
    if isinstance(given, str):
        try:
            return int(given)
        except ValueError:
            pass
        try:
            given = float(given)
        except ValueError:
            raise Mismatch("an integer") from None
    with contextlib.suppress(TypeError):
        if not isinstance(given, bool) and math.isfinite(given) and given == int(given):
            return int(given)
    raise Mismatch("an integer")


def _float(given: Any) -> float:
    with contextlib.suppress(ValueError, TypeError):
        if not isinstance(given, bool):
            return float(given)
    raise Mismatch("a number")


def _literal(given: Any, choices: tuple[Any, ...]) -> Any:
    for choice in choices:
        name = choice.name if isinstance(choice, enum.Enum) else str(choice)
        if given in (choice, name):
            return choice
    names = [choice.name if isinstance(choice, enum.Enum) else str(choice) for choice in choices]
    nearest = str(unknown("value", str(given), names)).split("; ")[1].split(" (")[0]
    raise Mismatch(f"{_one_of(names)} ({nearest})")


def _sequence(given: Any, origin: type, arguments: tuple[Any, ...]) -> Any:
    items = _split_items(given) if isinstance(given, str) else given
    if not isinstance(items, tuple | list):
        raise Mismatch("a list such as 1,2")
    if origin is tuple and arguments and Ellipsis not in arguments:
        if len(arguments) != len(items):
            raise Mismatch(f"a list of {len(arguments)}")
        return tuple(convert(item, one) for item, one in zip(items, arguments, strict=True))
    element = arguments[0] if arguments else Any
    converted = [convert(item, element) for item in items]
    return converted if origin is list else tuple(converted)


def _split_items(text: str) -> list[str]:
    """Splits "[1, [2, 3]]", "(1, 2)" or "1, 2" at the commas of the outermost level."""
    text = text.strip()
    if text[:1] in "[(" and text[-1:] in "])":
        text = text[1:-1]
    items, depth, start = [], 0, 0
    for position, character in enumerate(text + ","):
        depth += (character in "[(") - (character in "])")
        if character == "," and depth == 0:
            items.append(text[start:position].strip())
            start = position + 1
    return items if items[-1] else items[:-1]


def _one_of(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"one of {', '.join(names)}"


def _describe(member: Any) -> str:
    origin = typing.get_origin(member) or member
    if origin is Literal:
        return _one_of([str(choice) for choice in typing.get_args(member)])
    if origin in _SEQUENCES:
        inner = [one for one in typing.get_args(member) if one is not Ellipsis]
        of = f", each {_describe(inner[0])}" if inner and not _members(inner[0])[1:] else ""
        return f"a list such as 1,2{of}"
    if isinstance(member, type) and issubclass(member, enum.Enum):
        return _one_of([choice.name for choice in member])
    names: dict[Any, str] = {
        type(None): "none",
        bool: "true or false",
        int: "an integer",
        float: "a number",
        str: "a text",
        collections.abc.Callable: "a function",
    }
    return names[origin] if origin in names else f"a {getattr(origin, '__name__', origin)}"
