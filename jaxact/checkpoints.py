"""Saving a whole run, and taking it up again exactly where it was.

A checkpoint is a directory named by its step. It holds the arrays of one pytree, written by Orbax,
and `checkpoint.json`: metadata, score, the name, shape and dtype of every leaf, and the size and
CRC-32 of every file. It is written aside and renamed when complete, so what bears a step's name is
whole unless the disk has damaged it, and the CRCs tell.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
import shutil
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.experimental import multihost_utils

from jaxact.errors import JaxactError

PyTree = Any

_MANIFEST = "checkpoint.json"
_ARRAYS = "arrays"
_PARTIAL = ".partial-"

logger = logging.getLogger(__name__)


class Restored(NamedTuple):
    """A checkpoint that was read.

    Attributes:
      step: the step it was saved at.
      state: the pytree.
      metadata: what was saved with it.
    """

    step: int
    state: PyTree
    metadata: dict[str, Any]


class _Damaged(Exception):
    """The checkpoint's files are not what was written."""


class Checkpoints:
    """The checkpoints of one run, in one directory.

    Args:
      directory: where they are; created by the first save.
      keep_last: how many of the newest are kept, at least 1.
      keep_best: how many of those with the highest scores are kept besides.
    """

    def __init__(self, directory: str | Path, keep_last: int = 3, keep_best: int = 1) -> None:
        if keep_last < 1 or keep_best < 0:
            raise JaxactError(
                "checkpoints: keep_last must be at least 1 and keep_best at least 0, "
                f"but they are {keep_last} and {keep_best}"
            )
        self._directory = Path(directory).absolute()
        self._keep_last = keep_last
        self._keep_best = keep_best

    def save(
        self, step: int, state: PyTree, *, metadata: dict[str, Any], score: float | None = None
    ) -> None:
        """Writes a checkpoint and returns when it is on disk; then drops those not to be kept.

        A checkpoint of the same step is replaced. On several hosts every process calls this, and
        all see the same directory.

        Args:
          step: the number of environment steps so far, not negative.
          state: a pytree of arrays of any dtype, typed PRNG keys among them.
          metadata: values that JSON can hold. By `"name"` and `"fingerprint"` `restore` tells whose
            checkpoint it is.
          score: the higher the better; NaN counts as none.
        """
        partial = self._directory / f"{_PARTIAL}{step}"
        if jax.process_index() == 0:
            self._directory.mkdir(parents=True, exist_ok=True)
            for stale in self._directory.glob(f"{_PARTIAL}*"):
                shutil.rmtree(stale)
            partial.mkdir()
        _wait_for_all("jaxact: begin checkpoint")
        _write_arrays(partial / _ARRAYS, state)
        if jax.process_index() == 0:
            manifest = {
                "step": step,
                "score": None if score is None or math.isnan(score) else float(score),
                "metadata": metadata,
                "leaves": _describe(state),
                "files": _checksums(partial),
            }
            _write_synced(partial / _MANIFEST, json.dumps(manifest, indent=1))
            self._remove(step)
            partial.rename(self._path(step))
            self._drop_old()
        _wait_for_all("jaxact: end checkpoint")

    def steps(self) -> list[int]:
        """Returns the steps of the checkpoints there are, ascending."""
        found = self._directory.glob(f"*/{_MANIFEST}")
        return sorted(int(path.parent.name) for path in found if path.parent.name.isdigit())

    def best(self) -> int | None:
        """Returns the step with the highest score, the newest of several; None without scores."""
        ranked = self._ranked()
        return ranked[0] if ranked else None

    def metadata(self, step: int) -> dict[str, Any]:
        """Returns what was saved as metadata.

        Raises:
          JaxactError: there is no such checkpoint, or it is damaged.
        """
        try:
            return self._manifest(step)["metadata"]
        except _Damaged as damage:
            raise self._unreadable(step, damage) from None

    def restore(
        self,
        step: int | None,
        like: PyTree,
        *,
        name: str | None = None,
        fingerprint: str | None = None,
    ) -> Restored:
        """Reads a checkpoint, bit for bit.

        Args:
          step: which one; None means the newest that can be read, with a logged warning for
            each newer one that cannot.
          like: a pytree of the same structure, shapes and dtypes. Where its leaves are arrays
            placed on devices, the restored ones are placed alike; `jax.ShapeDtypeStruct` will do.
          name: the experiment's name, for the message.
          fingerprint: if given, it has to be that in the checkpoint's metadata.

        Raises:
          JaxactError: there is no checkpoint that can be read, it belongs to another experiment, or
            the structure is not that of `like`. Nothing is compiled before these checks.
        """

        def read(manifest: dict[str, Any]) -> Restored:
            self._check_owner(manifest, name, fingerprint)
            self._check_structure(manifest, manifest["leaves"], like)
            return self._read(manifest, like, range(len(manifest["leaves"])))

        return self._first_readable(step, read)

    def restore_part(self, step: int | None, part: str, like: PyTree) -> Restored:
        """Reads one attribute of the saved tree, such as its parameters, whatever the rest is.

        Args:
          step: which one; None means the newest that can be read.
          part: the attribute's name.
          like: as for `restore`, of the part alone.

        Raises:
          JaxactError: as for `restore`.
        """

        def read(manifest: dict[str, Any]) -> Restored:
            prefix = f".{part}"
            leaves = {
                i: {**leaf, "path": leaf["path"].removeprefix(prefix)}
                for i, leaf in enumerate(manifest["leaves"])
                if leaf["path"] == prefix or leaf["path"].startswith((f"{prefix}[", f"{prefix}."))
            }
            self._check_structure(manifest, list(leaves.values()), like)
            return self._read(manifest, like, leaves)

        return self._first_readable(step, read)

    def _first_readable(
        self, step: int | None, read: Callable[[dict[str, Any]], Restored]
    ) -> Restored:
        """Reads the given checkpoint, or the newest that is not damaged."""
        candidates = self.steps()[::-1] if step is None else [step]
        if not candidates:
            raise JaxactError(f"there are no checkpoints in {self._directory}")
        for candidate in candidates:
            try:
                return read(self._manifest(candidate))
            except _Damaged as damage:
                if candidate == candidates[-1]:
                    raise self._unreadable(candidate, damage) from None
                logger.warning("%s; trying the one before", self._unreadable(candidate, damage))
        raise AssertionError("unreachable")

    def _path(self, step: int) -> Path:
        return self._directory / f"{step:012d}"

    def _manifest(self, step: int) -> dict[str, Any]:
        path = self._path(step)
        if not path.is_dir():
            steps = ", ".join(map(str, self.steps())) or "none"
            raise JaxactError(f"there is no checkpoint of step {step}; there are: {steps}")
        try:
            manifest = json.loads((path / _MANIFEST).read_text())
        except (OSError, ValueError):
            raise _Damaged(f"{_MANIFEST} cannot be read") from None
        expected = {"step", "score", "metadata", "leaves", "files"}
        if not isinstance(manifest, dict) or not expected <= manifest.keys():
            raise _Damaged(f"{_MANIFEST} is not what was written")
        return manifest

    def _check_owner(
        self, manifest: dict[str, Any], name: str | None, fingerprint: str | None
    ) -> None:
        saved = manifest["metadata"]
        if fingerprint is not None and saved.get("fingerprint") != fingerprint:
            raise JaxactError(
                f"the checkpoint of step {manifest['step']} belongs to another experiment: it was "
                f"saved by {_owner(saved.get('name'), saved.get('fingerprint'))}, but this is "
                f"{_owner(name, fingerprint)}"
            )

    def _check_structure(
        self, manifest: dict[str, Any], saved: list[dict[str, Any]], like: PyTree
    ) -> None:
        expected = _describe(like)
        for one, other in zip(saved, expected, strict=False):
            if one != other:
                raise JaxactError(
                    f"the checkpoint of step {manifest['step']} has another structure: first, it "
                    f"has {_leaf_text(one)} where {_leaf_text(other)} is expected"
                )
        if len(saved) != len(expected):
            longer = max(saved, expected, key=len)
            extra = _leaf_text(longer[min(len(saved), len(expected))])
            which = "has" if longer is saved else "lacks"
            raise JaxactError(
                f"the checkpoint of step {manifest['step']} has another structure: it {which} "
                f"{extra}"
            )

    def _read(self, manifest: dict[str, Any], like: PyTree, indices: Iterable[int]) -> Restored:
        path = self._path(manifest["step"])
        for name, (size, crc) in manifest["files"].items():
            if not (path / name).is_file():
                raise _Damaged(f"{name} is missing")
            if [size, crc] != _checksum(path / name):
                raise _Damaged(f"{name} is not what was written")
        state = _read_arrays(path / _ARRAYS, like, indices)
        return Restored(manifest["step"], state, manifest["metadata"])

    def _unreadable(self, step: int, damage: _Damaged) -> JaxactError:
        return JaxactError(f"the checkpoint of step {step} cannot be restored: {damage}")

    def _ranked(self) -> list[int]:
        """Returns the steps that have a score, the best first."""
        scores = {}
        for step in self.steps():
            with contextlib.suppress(_Damaged):
                scores[step] = self._manifest(step)["score"]
        scored = [step for step, score in scores.items() if score is not None]
        return sorted(scored, key=lambda step: (scores[step], step), reverse=True)

    def _drop_old(self) -> None:
        steps = self.steps()
        kept = {*steps[-self._keep_last :], *self._ranked()[: self._keep_best]}
        for step in set(steps) - kept:
            self._remove(step)

    def _remove(self, step: int) -> None:
        """Removes a checkpoint, if there is one; never leaves half of it under its name."""
        if self._path(step).exists():
            aside = self._directory / f"{_PARTIAL}removed-{step}"
            self._path(step).rename(aside)
            shutil.rmtree(aside)


def _owner(name: str | None, fingerprint: str | None) -> str:
    return f"{name or 'an unnamed experiment'!r} ({(fingerprint or 'no fingerprint')[:12]})"


def _is_key(leaf: Any) -> bool:
    return jax.dtypes.issubdtype(getattr(leaf, "dtype", None), jax.dtypes.prng_key)


def _describe(state: PyTree) -> list[dict[str, Any]]:
    """Lists path, shape and dtype of every leaf; needs no concrete arrays."""
    described = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(state):
        if not hasattr(leaf, "dtype"):
            leaf = np.asarray(leaf)
        shape, dtype = list(leaf.shape), str(leaf.dtype)
        described.append({"path": jax.tree_util.keystr(path), "shape": shape, "dtype": dtype})
    return described


def _leaf_text(leaf: dict[str, Any]) -> str:
    return f"{leaf['path']} ({leaf['dtype']}{leaf['shape']})"


def _write_arrays(path: Path, state: PyTree) -> None:
    leaves = [jax.random.key_data(x) if _is_key(x) else x for x in jax.tree.leaves(state)]
    arrays = {str(i): x if hasattr(x, "dtype") else np.asarray(x) for i, x in enumerate(leaves)}
    stored = {name: array for name, array in arrays.items() if array.size}  # Orbax takes no others
    if stored:
        with _checkpointer() as (ocp, checkpointer):
            checkpointer.save(path, args=ocp.args.PyTreeSave(stored))


def _read_arrays(path: Path, like: PyTree, indices: Iterable[int]) -> PyTree:
    """Reads the stored arrays of these indices, one for each leaf of `like`."""
    leaves, structure = jax.tree.flatten(like)
    named = {str(i): leaf for i, leaf in zip(indices, leaves, strict=True)}
    stored = {name: leaf for name, leaf in named.items() if math.prod(np.shape(leaf))}
    arrays = {}
    if stored:
        with _checkpointer() as (ocp, checkpointer):
            how = {
                name: ocp.ArrayRestoreArgs(sharding=leaf.sharding)
                if _is_placed(leaf) and not _is_key(leaf)
                else ocp.RestoreArgs(restore_type=np.ndarray)
                for name, leaf in stored.items()
            }
            try:
                like_stored = dict.fromkeys(stored, 0)
                arrays = checkpointer.restore(
                    path,
                    args=ocp.args.PyTreeRestore(
                        item=like_stored, restore_args=how, partial_restore=True
                    ),
                )
            except (ValueError, KeyError, OSError) as error:
                raise _Damaged(str(error).partition("\n")[0]) from None
    restored = [
        _as_leaf(arrays[name] if name in arrays else _empty(leaf), leaf)
        for name, leaf in named.items()
    ]
    return jax.tree.unflatten(structure, restored)


def _empty(like: Any) -> np.ndarray:
    raw = jax.eval_shape(jax.random.key_data, like) if _is_key(like) else like
    return np.zeros(raw.shape, raw.dtype)


def _is_placed(leaf: Any) -> bool:
    """Whether the leaf says on which devices it has to be; an uncommitted array does not."""
    if isinstance(leaf, jax.Array):
        return leaf.committed
    return getattr(leaf, "sharding", None) is not None


def _as_leaf(array: Any, like: Any) -> Any:
    """Gives a restored array the type and the place of the leaf it stands for."""
    if _is_key(like):
        wrap = partial(jax.random.wrap_key_data, impl=_key_implementation(like))
        # Keys cannot be put onto the devices of other processes, but they can be computed there.
        return (jax.jit(wrap, out_shardings=like.sharding) if _is_placed(like) else wrap)(array)
    if isinstance(like, jax.Array | jax.ShapeDtypeStruct):
        if isinstance(array, jax.Array):
            return array
        return jax.device_put(array, like.sharding) if _is_placed(like) else jax.numpy.array(array)
    return array if isinstance(like, np.ndarray) else type(like)(array[()])


def _key_implementation(like: Any) -> str:
    """Returns the name of a key's generator; the key may be abstract."""
    names = []
    jax.eval_shape(lambda key: names.append(str(jax.random.key_impl(key))), like)
    return names[0]


def _checksum(path: Path) -> list[int]:
    data = path.read_bytes()
    return [len(data), zlib.crc32(data)]


def _checksums(directory: Path) -> dict[str, list[int]]:
    files = sorted(path for path in directory.rglob("*") if path.is_file())
    return {path.relative_to(directory).as_posix(): _checksum(path) for path in files}


def _write_synced(path: Path, text: str) -> None:
    with path.open("w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def _wait_for_all(name: str) -> None:
    if jax.process_count() > 1:
        multihost_utils.sync_global_devices(name)


@contextlib.contextmanager
def _checkpointer() -> Iterator[tuple[Any, Any]]:
    """Imports Orbax, which is slow, when it is needed, and keeps it from chatting."""
    from absl import logging as absl_logging

    verbosity = absl_logging.get_verbosity()
    absl_logging.set_verbosity(absl_logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import orbax.checkpoint as ocp

            with ocp.Checkpointer(ocp.PyTreeCheckpointHandler()) as checkpointer:
                yield ocp, checkpointer
    finally:
        absl_logging.set_verbosity(verbosity)
