"""Houses: sound by construction, pure, and as varied as their style says."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import house_soundness
from envs_jax.houses import categories, generator, validity
from envs_jax.houses.scene import Scene
from envs_jax.houses.state import Body
from jaxact.errors import JaxactError

LOCOBOT = Body(0.175, 0.9, 0.87)
WIDEST = Body(0.2, 0.9, 0.87)


def houses(style: generator.Style, split: str, first: int, count: int) -> list[Scene]:
    keys = jax.vmap(lambda i: generator.scene_key(split, i))(jnp.arange(first, first + count))
    drawn = jax.device_get(_generate(keys, style))
    return [jax.tree.map(lambda x, i=i: x[i], drawn) for i in range(count)]


_generate = jax.jit(
    lambda keys, style: jax.vmap(lambda key: generator.generate(key, style))(keys),
    static_argnums=1,
)


@pytest.mark.slow
def test_apartments_are_sound() -> None:
    drawn = houses(generator.APARTMENT, "train", 0, 8)
    for i, scene in enumerate(drawn):
        assert validity.problems(scene, WIDEST, resolution=0.1) == [], i
        assert scene.boxes.shape == (64, 8)
        assert scene.boxes.dtype == np.float32
        present = np.asarray(scene.present)
        np.testing.assert_array_equal(present, scene.category > 0)
        assert not np.any(scene.portable & ~present)
        same = np.all(scene.other_boxes == scene.boxes, axis=1)
        np.testing.assert_array_equal(same, ~scene.openable)
        assert scene.openable.sum() == 3
        assert not scene.opened.any()
    found = {name for scene in drawn for name in np.asarray(categories.NAMES)[scene.category]}
    assert found >= set(categories.ROBOTHOR_TARGETS)
    # Drawn one by one or together, now or later, a scene is the same.
    again = houses(generator.APARTMENT, "train", 0, 8)
    for one, other in zip(drawn, again, strict=True):
        jax.tree.map(np.testing.assert_array_equal, one, other)
    assert len({scene.boxes.tobytes() for scene in drawn}) == 8


def test_splits_have_keys_of_their_own() -> None:
    keys = {
        jax.random.key_data(generator.scene_key(split, i)).tobytes()
        for split in generator.SPLITS
        for i in range(20)
    }
    assert len(keys) == 60
    with pytest.raises(JaxactError, match="unknown split 'valid'; the nearest is 'val'"):
        generator.scene_key("valid", 0)


def test_validity_finds_what_is_wrong() -> None:
    scene = houses(generator.APARTMENT, "train", 0, 8)[0]
    room = scene.rooms[0]
    # A wall across everything cuts the free space; what is on a wall that high is out of sight.
    across = np.array([(room[0] + room[2]) / 2, 1, 0, 0.05, 1, 20, 1, 0], np.float32)
    row = int(np.nonzero(scene.category == categories.index("Apple"))[0][0])
    boxes = scene.boxes.copy()
    boxes[row, 1] += 1.9
    boxes[-1] = across
    lid = boxes[row].copy()
    lid[1] -= 0.2
    lid[3:6] = (0.5, 0.05, 0.5)
    boxes[-2] = lid
    broken = dataclasses.replace(scene, boxes=boxes, openable=np.zeros(64, bool))
    said = validity.problems(broken, LOCOBOT, resolution=0.1)
    assert "parts" in str(said[0])
    assert f"the Apple of row {row} cannot be seen" in map(str, said)
    assert {problem.reason for problem in said} == {
        *("divided", "hidden", "overlapping", "floating")
    }


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rooms": (0, 2)}, "rooms must be"),
        ({"boxes": 20}, "need"),
        ({"kind": "Cellar"}, "unknown kind of room"),
        ({"short_side": (1.0, 2.0)}, "sides must be"),
        ({"on_floor": ("Elephant",)}, "unknown category"),
        ({"furniture": 99}, "furniture must be"),
    ],
)
def test_styles_are_checked(changes: dict, said: str) -> None:
    with pytest.raises(JaxactError, match=said):
        dataclasses.replace(generator.APARTMENT, **changes)


@pytest.mark.slow
@pytest.mark.parametrize("name", house_soundness.STYLES)
def test_houses_never_drawn_before_are_sound(name: str) -> None:
    """As the benchmark checks 10,000 of the training split."""
    line = house_soundness.check_style(name, "test", 0, 250)
    assert line["unsound"] == {}, line["said"]
