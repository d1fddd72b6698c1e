"""Files that may be missing, cut off or of another format: one sentence about what is wrong."""

from __future__ import annotations

import gzip
import json
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxact.errors import JaxactError

# Metres and degrees that are larger are mistakes; half as far as what is nowhere.
LARGEST = 5000.0


def read_json(path: str | Path) -> Any:
    """Reads a JSON file, compressed by gzip or not, whatever its name.

    Raises:
      JaxactError: it cannot be read, or is not (all of) such a file.
    """
    try:
        data = Path(path).read_bytes()
        if data[:2] == b"\x1f\x8b":
            data = gzip.decompress(data)
        return json.loads(data)
    except OSError as error:
        if isinstance(error, gzip.BadGzipFile):
            raise JaxactError(f"{path} is not a sound gzip file: {error}") from None
        raise JaxactError(f"cannot read {path}: {error.strerror}") from None
    except (EOFError, zlib.error) as error:
        raise JaxactError(f"{path} is a gzip file that is cut off or damaged: {error}") from None
    except (ValueError, RecursionError) as error:
        raise JaxactError(f"{path} is no JSON: {error}") from None


def read_array(path: str | Path) -> np.ndarray:
    """Reads a NumPy file without running anything that may be in it.

    Raises:
      JaxactError: it cannot be read, or is not (all of) such a file.
    """
    try:
        # Opened here, so that it is closed whatever is in it.
        with Path(path).open("rb") as file:
            array = np.load(file, allow_pickle=False)
    except OSError as error:
        raise JaxactError(f"cannot read {path}: {error.strerror or error}") from None
    except (ValueError, EOFError, MemoryError, zipfile.BadZipFile) as error:
        raise JaxactError(f"{path} is no NumPy array: {error}") from None
    if not isinstance(array, np.ndarray):
        raise JaxactError(f"{path} must hold one NumPy array, not an archive of several")
    return array


def field(source: str | Path, where: str, record: Any, name: str, kind: type) -> Any:
    """Returns a field of a JSON object.

    Args:
      source: the file, for the message.
      where: which object it is, for the message.
      record: the object.
      name: of the field.
      kind: what it must be; `float` for any number, which is returned as such.

    Raises:
      JaxactError: there is no such field, or it is of another kind.
    """
    if not isinstance(record, Mapping):
        raise JaxactError(f"{source}: {where} must be an object, not {record!r:.40}")
    if name not in record:
        raise JaxactError(f"{source}: {where} has no {name!r}")
    value = record[name]
    if kind is float:
        return _number(source, f"{name!r} of {where}", value)
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise JaxactError(
            f"{source}: {name!r} of {where} must be {_KINDS.get(kind, kind.__name__)}, "
            f"not {value!r:.40}"
        )
    return value


_KINDS = {
    list: "a list",
    dict: "an object",
    str: "a string",
    bool: "true or false",
    int: "a whole number",
}


def optional(
    source: str | Path, where: str, record: Any, name: str, kind: type, default: Any
) -> Any:
    """Returns a field like `field`, or `default` where there is none or it is null.

    Raises:
      JaxactError: it is of another kind.
    """
    if isinstance(record, Mapping) and record.get(name) is None:
        return default
    return field(source, where, record, name, kind)


def vector(source: str | Path, where: str, record: Any, names: str = "xyz") -> list[float]:
    """Returns the numbers of an object such as {"x": 1, "y": 0, "z": 2}, in the order of `names`.

    Raises:
      JaxactError: one of them is missing or no number.
    """
    return [field(source, where, record, name, float) for name in names]


def numbers(source: str | Path, where: str, record: Any, name: str, count: int) -> list[float]:
    """Returns a field that is a list of so many numbers, such as [1, 0, 2].

    Raises:
      JaxactError: there is no such field, or it is no such list.
    """
    values = field(source, where, record, name, list)
    if len(values) != count:
        raise JaxactError(
            f"{source}: {name!r} of {where} must have {count} numbers, not {len(values)}"
        )
    return [_number(source, f"{name!r} of {where}", value) for value in values]


def _number(source: str | Path, what: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise JaxactError(f"{source}: {what} must be a finite number, not {value!r:.40}")
    # NaN is not less than anything either.
    if not abs(value) <= LARGEST:
        raise JaxactError(
            f"{source}: {what} must be a finite number of at most {LARGEST:.0f}, not {value!r:.40}"
        )
    return float(value)
