"""The Python code of the README and of the pages beside it runs, block after block."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from jaxact.loading import load_experiment

REPOSITORY = Path(__file__).resolve().parent.parent
README = REPOSITORY / "README.md"
ADAPTERS = REPOSITORY / "docs" / "adapters.md"
# Training takes too long for every day: the same code with fewer steps and episodes.
SHORTER = {
    "steps=16_000": "steps=1_024",
    "steps=8_000": "steps=1_024",
    "evaluation_episodes=200": "evaluation_episodes=50",
}


def code_of(text):
    """Returns the Python blocks as one program with the page's own line numbers."""
    lines, inside = [], False
    for line in text.splitlines():
        if line.startswith("```"):
            inside = line == "```python"
            line = ""
        lines.append(line if inside else "")
    return "\n".join(lines)


@pytest.mark.parametrize("shortened", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_code_of_the_readme_and_of_the_page_on_adapters_runs(shortened, tmp_path):
    text, page = (path.read_text(encoding="utf-8") for path in (README, ADAPTERS))
    assert len(re.findall(r"^```python$", text, re.M)) == 9
    assert len(re.findall(r"^```python$", page, re.M)) == 6
    # The page begins with all that it goes on from, so that it may follow in the same process.
    code, flags = code_of(text) + "\n" + code_of(page), {}
    if shortened:
        for long, short in SHORTER.items():
            assert long in code
            code = code.replace(long, short)
    else:
        # Without the tests' own, which make training crawl.
        flags = {"XLA_FLAGS": ""}
    program = tmp_path / "README.py"
    program.write_text(code, encoding="utf-8")
    finished = subprocess.run(
        [sys.executable, str(program)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)} | flags,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    *_, success, action, position, sweep, search, pole = finished.stdout.splitlines()
    assert pole == "1.0 False False"
    mean = float(re.search(r"'mean': ([\d.]+)", success)[1])
    assert shortened or mean > 0.5
    assert action in ("left", "right", "forward", "pickup", "drop", "toggle", "done")
    assert position.startswith("[")
    assert sweep == "(2, 3)"
    rates = [float(x) for x in search.strip("[]").split(", ")]
    assert len(rates) == 4
    assert all(0 <= rate <= 1 for rate in rates)


def test_the_warm_start_is_a_patch_of_the_example(tmp_path):
    """Applied as it stands to the example as it stands, it gives an experiment that can work."""
    (patch,) = re.findall(r"^```diff\n(.*?)^```$", README.read_text(encoding="utf-8"), re.M | re.S)
    (name,) = re.findall(r"^--- a/(\S+)$", patch, re.M)
    (tmp_path / "examples").mkdir()
    shutil.copy(REPOSITORY / name, tmp_path / name)
    before, _ = load_experiment(str(tmp_path / name))
    subprocess.run(
        ["git", "apply", "--verbose", "-"],
        cwd=tmp_path,
        # Else git, inside of a repository, would take the paths for that one's.
        env=os.environ | {"GIT_CEILING_DIRECTORIES": str(tmp_path.parent)},
        input=patch,
        text=True,
        capture_output=True,
        check=True,
    )
    after, _ = load_experiment(str(tmp_path / name))
    after.check()
    assert [list(stage.losses) for stage in before.pipeline.stages] == [["ppo"]]
    assert [list(stage.losses) for stage in after.pipeline.stages] == [["imitation"], ["ppo"]]
    assert sum(stage.steps for stage in after.pipeline.stages) == before.pipeline.stages[0].steps


def code_of_page_runs(page, directory):
    """Runs a page's code in a directory and returns what it printed."""
    code = code_of((REPOSITORY / "docs" / page).read_text(encoding="utf-8"))
    finished = subprocess.run(
        [sys.executable, "-c", code],
        cwd=directory,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    return finished.stdout


@pytest.mark.slow
def test_code_of_the_page_on_houses_runs(tmp_path):
    printed = code_of_page_runs("houses.md", tmp_path)
    assert float(re.search(r"'mean': ([\d.]+)", printed)[1]) > 0.95
    assert {path.name for path in tmp_path.iterdir()} == {"episodes.json.gz", "scenes.json.gz"}


@pytest.mark.slow
def test_code_of_the_page_on_worlds_runs(tmp_path):
    printed = code_of_page_runs("worlds.md", tmp_path)
    assert re.search(r"'mean': -?[\d.]+", printed.splitlines()[-1])
