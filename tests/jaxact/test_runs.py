import json
import subprocess
from pathlib import Path

import pytest

from jaxact import runs
from jaxact.errors import JaxactError


def make_repository(directory: Path) -> Path:
    file = directory / "experiment.py"
    file.write_text("a = 1\n")
    identity = ["-c", "user.name=someone", "-c", "user.email=someone@example.org"]
    for command in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "first"]):
        subprocess.run(["git", "-C", directory, *identity, *command], check=True)
    return file


def test_a_new_run_describes_itself(tmp_path: Path) -> None:
    (tmp_path / "code").mkdir()
    file = make_repository(tmp_path / "code")
    file.write_text("a = 2\n")
    config = {"seed": 3, "overrides": ["a=2"], "experiment": {"type": "x.Y", "a": 2}}
    path = runs.create_run(tmp_path / "out", "ppo", config, file)
    assert path.parent == tmp_path / "out" / "ppo"
    assert json.loads((path / "config.json").read_text()) == config
    assert runs.read_config(path) == config
    versions = json.loads((path / "versions.json").read_text())
    assert {"python", "platform", "jax", "jaxlib", "flax", "optax", "jaxact"} <= versions.keys()
    assert (path / "source" / "experiment.py").read_text() == "a = 2\n"
    assert len((path / "source" / "commit.txt").read_text().strip()) == 40
    assert "+a = 2" in (path / "source" / "changes.diff").read_text()
    assert not list(path.rglob(".*"))
    assert runs.open_run(str(path)) == path


def test_runs_do_without_git(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "experiment.py"
    file.write_text("a = 1\n")
    monkeypatch.setenv("PATH", "")
    path = runs.create_run(tmp_path, "ppo", {}, file)
    assert [one.name for one in (path / "source").iterdir()] == ["experiment.py"]


def test_every_run_gets_a_directory_of_its_own(tmp_path: Path) -> None:
    paths = {runs.create_run(tmp_path, "ppo", {}) for _ in range(3)}
    assert len(paths) == 3
    assert runs.create_run(tmp_path, "ppo", {}, run_id="mine").name == "mine"
    with pytest.raises(JaxactError, match="mine is there already"):
        runs.create_run(tmp_path, "ppo", {}, run_id="mine")
    (tmp_path / "file").touch()
    with pytest.raises(JaxactError, match="cannot create a run"):
        runs.create_run(tmp_path / "file", "ppo", {})


def test_opening_what_is_no_run(tmp_path: Path) -> None:
    runs.create_run(tmp_path, "ppo", {}, run_id="first")
    with pytest.raises(JaxactError, match="does not exist: unknown run 'frst'; the nearest is 'fi"):
        runs.open_run(tmp_path / "ppo" / "frst")
    with pytest.raises(JaxactError, match="there are no runs beside it"):
        runs.open_run(tmp_path / "nowhere" / "x")
    with pytest.raises(JaxactError, match=r"it has no config.json; did you mean .*ppo/first\?"):
        runs.open_run(tmp_path / "ppo")
    with pytest.raises(JaxactError, match="is not a directory"):
        runs.open_run(tmp_path / "ppo" / "first" / "config.json")
    (tmp_path / "ppo" / "first" / "config.json").write_text("{")
    with pytest.raises(JaxactError, match="is not valid JSON"):
        runs.read_config(tmp_path / "ppo" / "first")
