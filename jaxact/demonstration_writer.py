"""Writing demonstrations shard by shard, so that a kill loses no shard that was finished."""

from __future__ import annotations

import os
import shutil
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxact.demonstrations import (
    FORMAT,
    MANIFEST,
    PER_STEP,
    Demonstrations,
    Description,
    file_name,
    open_shard,
    read_manifest,
    verify_shard,
)
from jaxact.errors import JaxactError
from jaxact.runs import write_json

# Of all files of a shard together; large enough that files are few, small enough to be held in
# memory a few times over.
SHARD_BYTES = 1 << 27

_SHARD = "shard-"
_PARTIAL = ".partial-"


class DemonstrationWriter:
    """A set of demonstrations in the making; begins one, or goes on with one that was begun.

    A shard is written aside, renamed, and then named in the manifest, which is replaced as a whole.
    What is not in the manifest was not finished, and is removed.

    Attributes:
      episodes: episodes written so far.
      steps: of them.
      played: episodes of the stream that were gone through for them.
      complete: whether the set was finished before; nothing can be added to it.
    """

    def __init__(self, path: Path, description: Description) -> None:
        """Opens the directory, and makes it if there is none.

        Raises:
          JaxactError: there is something else in it, or another set, or a shard is damaged.
        """
        self.path = path
        self._description = description
        self._fields = description.fields()
        self._shards: list[dict[str, Any]] = []
        self.episodes = self.steps = self.played = 0
        self.complete = False
        if (path / MANIFEST).exists():
            self._go_on()
        else:
            try:
                path.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise JaxactError(f"cannot write to {path}: {error.strerror}") from None
            if any(not inside.name.startswith(".") for inside in path.iterdir()):
                raise JaxactError(f"{path} is not empty, and holds no demonstrations to go on with")
            self._write_manifest()

    @property
    def shard_steps(self) -> int:
        """Steps after which a shard has its size."""
        row = sum(one.bytes for one in self._fields.values() if one.per == PER_STEP)
        return max(1, SHARD_BYTES // row)

    def write(self, arrays: Mapping[str, np.ndarray], played: int) -> None:
        """Writes the next shard.

        Args:
          arrays: whole episodes, by field name; "first_step" counts from the shard's first.
          played: episodes of the stream that have been gone through, with these.
        """
        name = f"{_SHARD}{len(self._shards):05d}"
        aside = self.path / f"{_PARTIAL}{name}"
        aside.mkdir()
        files = {}
        for field_name, one in self._fields.items():
            array = np.ascontiguousarray(arrays[field_name], one.dtype)
            files[file_name(field_name)] = _write_array(aside / file_name(field_name), array)
        aside.rename(self.path / name)
        episodes, steps = len(arrays["first_step"]), len(arrays["reward"])
        self._shards.append({"name": name, "episodes": episodes, "steps": steps, "files": files})
        self.episodes += episodes
        self.steps += steps
        self.played = played
        self._write_manifest()

    def finish(self) -> Demonstrations:
        """Declares the set complete, and opens it.

        Raises:
          JaxactError: there is nothing in it.
        """
        if not self._shards:
            raise JaxactError(f"{self.path} would be empty: no episode was recorded")
        self.complete = True
        self._write_manifest()
        return Demonstrations(self.path)

    def _go_on(self) -> None:
        manifest = read_manifest(self.path)
        wanted = {"format": FORMAT, **self._description.to_json()}
        for name, value in wanted.items():
            found = manifest[name]
            if found != value:
                if isinstance(value, dict):
                    others = {key for key in found | value if found.get(key) != value.get(key)}
                    found, value = (
                        {key: x for key, x in of.items() if key in others} for of in (found, value)
                    )
                raise JaxactError(
                    f"{self.path} holds other demonstrations: its {name.replace('_', ' ')} is "
                    f"{found}, but {value} was asked for; choose another directory"
                )
        self._shards = manifest["shards"]
        self.episodes, self.steps = manifest["episodes"], manifest["steps"]
        self.played, self.complete = manifest["played"], manifest["complete"]
        for entry in self._shards:
            open_shard(self.path, self._fields, entry)
            verify_shard(self.path, entry)
        finished = {entry["name"] for entry in self._shards}
        for path in self.path.iterdir():
            if path.name.startswith((_SHARD, _PARTIAL)) and path.name not in finished:
                shutil.rmtree(path)

    def _write_manifest(self) -> None:
        manifest = {
            "format": FORMAT,
            "complete": self.complete,
            **self._description.to_json(),
            "fields": {
                name: {"per": one.per, "shape": list(one.shape), "dtype": one.dtype}
                for name, one in self._fields.items()
            },
            "episodes": self.episodes,
            "steps": self.steps,
            "played": self.played,
            "shards": self._shards,
        }
        write_json(self.path / MANIFEST, manifest)


class _Checksummed:
    """A file that remembers size and CRC-32 of what is written to it."""

    def __init__(self, file: Any) -> None:
        self._file = file
        self.size = self.checksum = 0

    def write(self, data: Any) -> None:
        self._file.write(data)
        self.size += memoryview(data).nbytes
        self.checksum = zlib.crc32(data, self.checksum)


def _write_array(path: Path, array: np.ndarray) -> list[int]:
    """Writes a contiguous array as `.npy`; returns size and checksum of the file."""
    with path.open("wb") as file:
        checksummed = _Checksummed(file)
        np.lib.format.write_array_header_1_0(
            checksummed, np.lib.format.header_data_from_array_1_0(array)
        )
        checksummed.write(array.reshape(-1).view(np.uint8))
        file.flush()
        os.fsync(file.fileno())
    return [checksummed.size, checksummed.checksum]
