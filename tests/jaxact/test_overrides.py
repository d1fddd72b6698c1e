from __future__ import annotations

import dataclasses
import enum
import functools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.errors import JaxactError
from jaxact.frozen import FrozenMapping
from jaxact.overrides import fingerprint, leaves, numbers, override, to_json, with_numbers


class Mode(enum.Enum):
    SUM = 1
    MEAN = 2


@dataclass(frozen=True)
class Linear:
    start: float
    end: float = 0.0


@dataclass(frozen=True)
class PPO:
    clip: float | Linear = 0.2
    epochs: int = 4
    normalize: bool = True
    value: Literal["clipped", "plain"] = "clipped"
    mode: Mode = Mode.SUM

    def __post_init__(self) -> None:
        if isinstance(self.epochs, int) and self.epochs < 1:
            raise JaxactError("epochs must be at least 1")
        if isinstance(self.clip, float) and self.clip <= 0:
            raise JaxactError("clip must be positive")


@dataclass(frozen=True)
class Stage:
    losses: Mapping[str, PPO]
    steps: int = 100
    name: str = "first"
    limit: float | None = None
    weights: tuple[float, ...] = (1.0, 0.5)
    size: tuple[int, int] = (3, 4)
    optimizer: Callable[..., Any] | None = None
    seeds: Sequence[int] = (1,)


class Net(nn.Module):
    hidden: tuple[int, ...] = (64, 64)
    scale: float = 1.0
    head: nn.Module | None = None


@dataclass(frozen=True)
class Experiment:
    stages: tuple[Stage, ...]
    model: nn.Module
    table: jax.Array = field(default_factory=lambda: jnp.arange(3))
    extra: Mapping[str, float] = field(default_factory=dict)


@pytest.fixture
def experiment() -> Experiment:
    stage = Stage(FrozenMapping({"ppo": PPO(), "aux": PPO(clip=Linear(0.3))}))
    return Experiment((stage, dataclasses.replace(stage, name="second")), Net(head=Net()))


@pytest.mark.parametrize(
    ("assignment", "expected"),
    [
        ("stages.0.losses.ppo.clip=0.1", 0.1),
        ("stages.0.losses.ppo.clip=1", 1.0),
        ("stages.1.losses.aux.clip=0.5", 0.5),
        ("stages.0.losses.aux.clip.end=1e-3", 1e-3),
        ("stages.0.losses.ppo.normalize=false", False),
        ("stages.0.losses.ppo.value=plain", "plain"),
        ("stages.0.losses.ppo.mode=MEAN", Mode.MEAN),
        ("stages.0.steps=1e6", 1_000_000),
        ("stages.0.steps=1_000", 1000),
        ("stages.0.name=a=b", "a=b"),
        ("stages.0.limit=0.9", 0.9),
        ("stages.0.limit=none", None),
        ("stages.0.weights=[1, 2,3]", (1.0, 2.0, 3.0)),
        ("stages.0.weights=", ()),
        ("stages.0.weights.1=7", 7.0),
        ("stages.0.size=5,6", (5, 6)),
        ("stages.0.seeds=(1,2)", (1, 2)),
        ("model.hidden=128", (128,)),
        ("model.head.scale=2", 2.0),
    ],
)
def test_override_sets_one_leaf_and_nothing_else(
    experiment: Experiment, assignment: str, expected: object
) -> None:
    path = assignment.partition("=")[0]
    changed = override(experiment, [assignment])
    value: Any = changed
    for name in path.split("."):
        if isinstance(value, tuple):
            value = value[int(name)]
        else:
            value = value[name] if isinstance(value, Mapping) else getattr(value, name)
    assert value == expected
    assert type(value) is type(expected)
    before, after = leaves(experiment), leaves(changed)
    kept = [key for key in before if not f"{path}.".startswith(key) and not key.startswith(path)]
    assert all(before[key] is after[key] for key in kept)
    assert type(changed.stages[0].losses) is FrozenMapping


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("stages.0.stepz=1", "stages.0 (Stage): unknown field 'stepz'; the nearest is 'steps'"),
        ("stagez=1", "Experiment: unknown field 'stagez'; the nearest is 'stages'"),
        ("stages.0.losses.pp.clip=1", "unknown key 'pp'; the nearest is 'ppo' (valid: aux, ppo)"),
        ("stages.2.steps=1", "stages (tuple) has no item '2'; expected 0 to 1"),
        ("stages.0.steps=1.5", "stages.0.steps: expected an integer, but got '1.5'"),
        ("stages.0.steps=ten", "stages.0.steps: expected an integer, but got 'ten'"),
        ("stages.0.losses.ppo.clip=big", "clip: expected a number or a Linear, but got 'big'"),
        ("stages.0.losses.ppo.normalize=1", "normalize: expected true or false, but got '1'"),
        ("stages.0.losses.ppo.value=plane", "one of clipped, plain (the nearest is 'plain')"),
        ("stages.0.losses.ppo.epochs=0", "epochs must be at least 1"),
        ("stages.0.steps.x=1", "stages.0.steps (int) has no parts"),
        ("stages.0.size=1,2,3", "stages.0.size: expected a list of 2"),
        ("stages.0.optimizer=adam", "stages.0.optimizer: expected none or a function"),
        ("stages.0.steps", "expected path=value"),
        ("stages.0=hello", "stages.0 is a whole part (Stage) and cannot be given as text; set one"),
        ("model=hello", "for example model.hidden=..."),
    ],
)
def test_override_refuses_with_one_sentence(
    experiment: Experiment, assignment: str, message: str
) -> None:
    with pytest.raises(JaxactError) as raised:
        override(experiment, [assignment])
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_override_takes_values_and_sets_all_at_once(experiment: Experiment) -> None:
    changed = override(experiment, {"stages.0.steps": 5, "stages.0.losses.ppo": PPO(epochs=2)})
    assert changed.stages[0].steps == 5
    assert changed.stages[0].losses["ppo"].epochs == 2
    with pytest.raises(JaxactError, match=r"expected an integer, but got True \(bool\)"):
        override(experiment, {"stages.0.steps": True})
    with pytest.raises(JaxactError, match="as a whole and in part"):
        override(experiment, {"stages.0.weights": (1.0,), "stages.0.weights.0": 2.0})
    assert override(experiment, ["stages.0.steps=1", "stages.0.steps=2"]).stages[0].steps == 2


def test_leaves_are_in_order_of_declaration(experiment: Experiment) -> None:
    found = leaves(experiment)
    first = [f"stages.0.losses.ppo.{name}" for name in ("clip", "epochs", "normalize", "value")]
    assert list(found)[:4] == first
    assert found["stages.0.losses.aux.clip.start"] == 0.3
    assert found["model.hidden"] == (64, 64)
    assert found["stages.0.optimizer"] is None
    assert not any(path.endswith(("parent", "model.name")) for path in found)


def test_numbers_are_the_floats_outside_modules(experiment: Experiment) -> None:
    assert numbers(experiment.stages[0]) == {
        "losses.ppo.clip": 0.2,
        "losses.aux.clip.start": 0.3,
        "losses.aux.clip.end": 0.0,
        "weights.0": 1.0,
        "weights.1": 0.5,
    }
    assert not any(path.startswith("model") for path in numbers(experiment))


def test_with_numbers_takes_tracers(experiment: Experiment) -> None:
    @jax.jit
    def scaled(values: dict[str, jax.Array]) -> jax.Array:
        stage = with_numbers(experiment, values).stages[0]
        assert stage.losses["ppo"].epochs == 4
        return stage.losses["ppo"].clip * stage.weights[1]

    values = numbers(experiment) | {"stages.0.losses.ppo.clip": 3.0}
    assert float(scaled(values)) == 1.5
    assert jax.vmap(scaled)({key: jnp.full(4, value) for key, value in values.items()}).shape == (
        4,
    )
    assert scaled._cache_size() == 1  # the eager call; under vmap it is traced in place
    assert with_numbers(experiment, numbers(experiment)).stages == experiment.stages
    with pytest.raises(JaxactError, match="nearest is 'steps'"):
        with_numbers(experiment, {"stages.0.step": 1.0})


def test_json_description(experiment: Experiment) -> None:
    described = to_json(experiment)
    json.dumps(described, allow_nan=False)
    ppo = described["stages"][0]["losses"]["ppo"]
    assert ppo["type"].endswith("test_overrides.PPO")
    assert ppo["clip"] == 0.2
    assert ppo["mode"].endswith("Mode.SUM")
    assert described["table"]["shape"] == [3]
    assert described["model"]["head"]["hidden"] == [64, 64]
    assert to_json(float("nan")) == "nan"
    assert to_json(jnp.tanh).endswith("tanh")
    assert to_json(np.float32) == "numpy.float32"
    assert to_json(np.int32(3)) == 3
    partial = to_json(functools.partial(max, 1, key=abs))
    assert partial["function"] == "builtins.max"
    assert partial["keywords"] == {"key": "builtins.abs"}
    assert "0x" not in json.dumps(to_json(object()))


def test_fingerprint_depends_on_content_only(experiment: Experiment) -> None:
    same = dataclasses.replace(experiment, table=jnp.arange(3))
    assert fingerprint(experiment) == fingerprint(same)
    assert len(fingerprint(experiment)) == 64
    others = [
        override(experiment, ["stages.0.losses.ppo.clip=0.3"]),
        dataclasses.replace(experiment, table=jnp.arange(3)[::-1]),
        override(experiment, ["model.hidden=8"]),
    ]
    assert len({fingerprint(one) for one in [experiment, *others]}) == 4


def test_numbers_of_structure_are_not_data():
    @dataclass(frozen=True)
    class Lens:
        """Its angle is computed with before anything is compiled."""

        numbers_are_structure: ClassVar[bool] = True

        angle: float = 60.0

    @dataclass(frozen=True)
    class Camera:
        lens: Lens
        noise: float = 0.5

    camera = Camera(Lens())
    assert numbers(camera) == {"noise": 0.5}
    # They can still be chosen, as sizes can.
    assert override(camera, {"lens.angle": "90"}).lens.angle == 90.0
