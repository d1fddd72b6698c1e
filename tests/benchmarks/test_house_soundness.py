"""The benchmark of houses' soundness says what it finds, and fails if that is anything."""

import json
import sys

import pytest

from benchmarks import house_soundness
from benchmarks.house_soundness import Arguments, check
from jaxact.errors import JaxactError


@pytest.mark.parametrize(("unsound", "code"), [({}, 0), ({"divided": 2}, 1)])
def test_it_fails_if_anything_is_unsound(unsound, code, monkeypatch, capsys):
    drawn = []

    def style(*arguments):
        drawn.append(arguments)
        return {"style": arguments[0], "unsound": unsound}

    monkeypatch.setattr(house_soundness, "check_style", style)
    command = ["house_soundness", "--styles", "floor", "--houses", "3", "--ids"]
    monkeypatch.setattr(sys, "argv", command)
    with pytest.raises(SystemExit) as end:
        house_soundness.main()
    assert end.value.code == code
    assert json.loads(capsys.readouterr().out)["unsound"] == unsound
    assert drawn == [("floor", "train", 0, 3)]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (Arguments(styles=("flor",)), "floor"),
        (Arguments(ids=("Habitat-PointNav",)), "Habitat-PointNav-v0"),
        (Arguments(split="tran"), "train"),
        (Arguments(houses=0), "--houses must be at least 1"),
    ],
)
def test_what_cannot_be_is_one_sentence(arguments, said):
    with pytest.raises(JaxactError, match=said):
        check(arguments)
