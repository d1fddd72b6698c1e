"""The directory of a run: what was run, with which versions, from which source."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import shutil
import subprocess
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from jaxact.errors import JaxactError, unknown

CONFIG = "config.json"
VERSIONS = "versions.json"
SOURCE = "source"

_PACKAGES = ("jaxact", "jax", "jaxlib", "flax", "optax", "chex", "orbax-checkpoint", "numpy")
_GIT_SECONDS = 20


def create_run(
    output: str | Path,
    name: str,
    config: Mapping[str, Any],
    source_file: str | Path | None = None,
    *,
    run_id: str | None = None,
) -> Path:
    """Creates the directory `<output>/<name>/<run_id>` and describes the run in it.

    Args:
      output: where runs go; created if need be.
      name: the experiment's name.
      config: goes into `config.json`: what JSON can hold, with seed and overrides.
      source_file: the experiment's file, copied to `source/` with the commit and the changes
        since of the git repository it lies in, if any.
      run_id: the time of day, if not given.

    Returns:
      The new directory.

    Raises:
      JaxactError: the directory cannot be created, or one named `run_id` is there already.
    """
    path = _fresh_directory(Path(output) / name, run_id)
    (path / SOURCE).mkdir()
    if source_file is not None:
        shutil.copy2(source_file, path / SOURCE)
        _save_git_state(Path(source_file).resolve().parent, path / SOURCE)
    write_json(path / VERSIONS, versions())
    write_json(path / CONFIG, config)  # last: with it the directory is a run
    return path


def open_run(path: str | Path) -> Path:
    """Returns the path of an existing run.

    Raises:
      JaxactError: it is not a run's directory; the nearest run beside it is named.
    """
    path = Path(path)
    if not path.exists():
        siblings = _runs_in(path.parent)
        if siblings:
            raise JaxactError(f"{path} does not exist: {unknown('run', path.name, siblings)}")
        raise JaxactError(f"{path} does not exist, and there are no runs beside it")
    if not path.is_dir():
        raise JaxactError(f"{path} is not a directory; a run is a directory with a {CONFIG}")
    if not (path / CONFIG).is_file():
        inside = _runs_in(path)
        hint = f"; did you mean the run {path / inside[-1]}?" if inside else ""
        raise JaxactError(f"{path} is not a run: it has no {CONFIG}{hint}")
    return path


def read_config(path: str | Path) -> dict[str, Any]:
    """Returns what `create_run` was given as config.

    Raises:
      JaxactError: it is not a run's directory, or its config is damaged.
    """
    file = open_run(path) / CONFIG
    try:
        return json.loads(file.read_text())
    except ValueError as error:
        raise JaxactError(f"{file} is not valid JSON: {error}") from None


def versions() -> dict[str, str]:
    """Returns the versions of Python, the platform and the packages results depend on."""
    found = {"python": platform.python_version(), "platform": platform.platform()}
    for package in _PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def write_json(path: Path, value: Any) -> None:
    """Writes a value as JSON, whole or not at all."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Writes a file, whole or not at all: aside, then renamed."""
    aside = path.with_name(f".{path.name}.partial")
    with aside.open("w", encoding="utf-8", newline="") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    aside.replace(path)


def _fresh_directory(parent: Path, run_id: str | None) -> Path:
    base = run_id or datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    try:
        parent.mkdir(parents=True, exist_ok=True)
        for number in range(1, 10_000):
            path = parent / (base if number == 1 else f"{base}-{number}")
            try:
                path.mkdir()
                return path
            except FileExistsError:
                if run_id is not None:
                    raise JaxactError(
                        f"the run {path} is there already; resume it or choose another name"
                    ) from None
    except OSError as error:
        raise JaxactError(f"cannot create a run in {parent}: {error.strerror}") from None
    raise JaxactError(f"cannot create a run in {parent}: too many of {base}")


def _runs_in(directory: Path) -> list[str]:
    return sorted(config.parent.name for config in directory.glob(f"*/{CONFIG}"))


def _save_git_state(directory: Path, target: Path) -> None:
    """Writes commit and uncommitted changes; nothing where there is no git or no repository."""
    commit = _git(directory, "rev-parse", "HEAD")
    if commit is None:
        return
    write_text(target / "commit.txt", commit)
    changes = _git(directory, "diff", "HEAD", "--no-color", "--no-ext-diff")
    if changes:
        write_text(target / "changes.diff", changes)


def _git(directory: Path, *arguments: str) -> str | None:
    try:
        finished = subprocess.run(
            ["git", "-C", str(directory), *arguments],
            capture_output=True,
            check=True,
            stdin=subprocess.DEVNULL,
            timeout=_GIT_SECONDS,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return finished.stdout.decode(errors="replace")
