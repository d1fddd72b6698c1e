"""Finding experiments by file, dotted name and the name of a shipped example."""

import sys

import pytest

from jaxact import JaxactError
from jaxact.loading import load_experiment, shipped_examples

SMALL = """
from helper import NAME
from tests.tiny import experiment as make

experiment = make(name=NAME)
experiments = {"other": make(name="the other")}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "helper.py").write_text("NAME = 'from the helper'\n")
    (tmp_path / "mine.py").write_text(SMALL)
    yield tmp_path
    for name in ("helper", "mine", "typed", "package", "package.mine"):
        sys.modules.pop(name, None)


def test_a_file_may_import_its_neighbours(folder):
    path = list(sys.path)
    experiment, source = load_experiment(str(folder / "mine.py"))
    assert experiment.name == "from the helper"
    assert source == folder / "mine.py"
    assert sys.path == path


def test_a_file_may_define_dataclasses_with_annotations_that_are_strings(folder):
    part = "@dataclass(frozen=True)\nclass Part:\n    size: int = 1\n"
    header = "from __future__ import annotations\nfrom dataclasses import dataclass\n"
    (folder / "typed.py").write_text(header + part + SMALL)
    assert load_experiment(str(folder / "typed.py"))[0].name == "from the helper"


def test_one_of_several(folder):
    experiment, source = load_experiment(f"{folder / 'mine.py'}:other")
    assert experiment.name == "the other"
    assert source == folder / "mine.py"
    with pytest.raises(JaxactError, match=r"unknown entry of .* 'othr'; the nearest is 'other'"):
        load_experiment(f"{folder / 'mine.py'}:othr")


def test_a_dotted_name(folder, monkeypatch):
    (folder / "package").mkdir()
    (folder / "package" / "__init__.py").touch()
    (folder / "package" / "mine.py").write_text(SMALL)
    monkeypatch.syspath_prepend(str(folder))
    experiment, source = load_experiment("package.mine")
    assert experiment.name == "from the helper"
    assert source == folder / "package" / "mine.py"


def test_a_shipped_example():
    experiment, source = load_experiment("babyai_gotolocal")
    assert experiment.name == "babyai_gotolocal"
    assert source.name == "babyai_gotolocal.py"
    assert "babyai_gotolocal" in shipped_examples()
    assert "__init__" not in shipped_examples()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere.py", "there is no file nowhere.py; give a file, a dotted module name, or one"),
        ("babyai_gotolocl", "unknown experiment 'babyai_gotolocl'; the nearest is 'babyai_gotoloc"),
        ("no.such.module", "unknown experiment 'no.such.module'"),
        ("jaxact.errors", "must define `experiment`, .* but it has nothing of that name"),
    ],
)
def test_what_cannot_be_found(name, message):
    with pytest.raises(JaxactError, match=message):
        load_experiment(name)


def test_a_file_with_something_else_of_that_name(tmp_path):
    (tmp_path / "odd.py").write_text("experiment = 3\n")
    with pytest.raises(JaxactError, match="but it has a int"):
        load_experiment(str(tmp_path / "odd.py"))
