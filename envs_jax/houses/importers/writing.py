"""JSON files, written whole or not at all."""

from __future__ import annotations

import gzip
import json
import os
from pathlib import Path
from typing import Any

from jaxact.errors import JaxactError


def write_json(path: str | Path, value: Any) -> None:
    """Writes a value as JSON, aside and then renamed; the same value is the same bytes.

    Args:
      path: the file; compressed by gzip if its name ends in ".gz".
      value: of JSON's types, with finite numbers.

    Raises:
      JaxactError: there it cannot be written.
    """
    path = Path(path)
    data = json.dumps(value, allow_nan=False).encode()
    if path.name.endswith(".gz"):
        data = gzip.compress(data, mtime=0)
    aside = path.with_name(f".{path.name}.partial")
    try:
        with aside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        aside.replace(path)
    except OSError as error:
        aside.unlink(missing_ok=True)
        raise JaxactError(f"cannot write {path}: {error.strerror}") from None
