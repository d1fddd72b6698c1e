"""The gallery shows the worlds that it is asked for, and explains what cannot be."""

import numpy as np
import pytest

from envs_jax.gallery import Arguments, exhibit, select, sheet, write
from jaxact.errors import JaxactError


def test_frame_and_mission_are_those_of_the_world():
    shown = exhibit("MiniGrid-Empty-5x5-v0", seed=0)
    assert shown.mission == "get to the green goal square"
    assert shown.frame.shape == (160, 160, 3)
    assert shown.frame[16 + 3 * 32, 16 + 3 * 32].tolist() == [76, 255, 76]  # The goal, in sight.
    one, two = sheet([shown], 8), sheet([shown] * 3, 2)
    assert (two.width, two.height) == (2 * one.width, 2 * one.height)
    images = np.asarray(one), shown.frame
    green = [np.all(image == np.uint8([76, 255, 76]), 2).sum() for image in images]
    assert green[0] == green[1] > 0


def test_there_is_a_sheet_for_each_family_and_a_page(tmp_path):
    worlds = ("MiniGrid-Empty-5x5-v0", "Advisor-LavaCrossingS15")
    *sheets, page = write(Arguments(worlds, output=tmp_path / "new"))
    assert [path.name for path in sheets] == ["advisor.png", "minigrid.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in sheets)
    text = page.read_text(encoding="utf-8")
    assert "| `MiniGrid-Empty-5x5-v0` | get to the green goal square |" in text
    assert "| `Advisor-LavaCrossingS15N7-v0` | avoid the lava" in text
    assert "![Advisor](advisor.png)" in text


def test_worlds_are_chosen_by_how_their_ids_begin():
    assert select(["BabyAI-GoToLocalS8N2-v0"]) == ["BabyAI-GoToLocalS8N2-v0"]
    assert all(name.startswith("MiniGrid-WFC-") for name in select(["MiniGrid-WFC-"]))
    assert len(select([])) > 180


def test_bad_input_is_explained_in_a_sentence(tmp_path):
    with pytest.raises(JaxactError, match="unknown environment id 'MiniGrid-Emty'; the nearest is"):
        write(Arguments(("MiniGrid-Emty",), output=tmp_path))
    with pytest.raises(JaxactError, match="--columns must be at least 1; got 0"):
        write(Arguments(columns=0, output=tmp_path))
