from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jaxact.checkpoints import Checkpoints
from jaxact.errors import JaxactError


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Counters:
    steps: Any
    done: jax.Array


def make_state(value: float = 1.0) -> dict[str, Any]:
    parameters = {"w/0": jnp.full((3, 4), value), "b": jnp.full((4,), value, jnp.bfloat16)}
    return {
        "parameters": parameters,
        "optimizer": optax.adam(1e-3).init(parameters),
        "counters": Counters(jnp.int32(value), jnp.array([True, False])),
        "keys": (jax.random.key(7), jax.random.split(jax.random.key(1, impl="rbg"), 3)),
        "pixels": jnp.arange(24, dtype=jnp.uint8).reshape(2, 3, 4),
        "nothing": (jnp.zeros((0, 5)), jax.random.split(jax.random.key(0), 0), None, ()),
        "host": (np.arange(3, dtype=np.int64), 0.5, 3),
    }


def assert_same(one: Any, other: Any) -> None:
    def raw(leaf: Any) -> np.ndarray:
        is_key = jax.dtypes.issubdtype(getattr(leaf, "dtype", None), jax.dtypes.prng_key)
        return np.asarray(jax.random.key_data(leaf) if is_key else leaf)

    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert type(a) is type(b)
        assert getattr(a, "dtype", None) == getattr(b, "dtype", None)
        assert raw(a).tobytes() == raw(b).tobytes()
        assert raw(a).shape == raw(b).shape


def test_round_trip_is_bit_for_bit(tmp_path: Path) -> None:
    state = make_state(np.pi)
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(10, state, metadata={"name": "a"}, score=0.5)
    restored = checkpoints.restore(None, make_state(0.0))
    assert restored.step == 10
    assert restored.metadata == checkpoints.metadata(10) == {"name": "a"}
    assert_same(restored.state, state)
    draws = [jax.random.normal(key, (4,)) for key in (state["keys"][0], restored.state["keys"][0])]
    assert np.array_equal(*draws)


def test_restores_from_an_abstract_state(tmp_path: Path) -> None:
    state = {"key": jax.random.key(3, impl="rbg"), "x": jnp.arange(3.0)}
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(1, state, metadata={})
    assert_same(checkpoints.restore(1, jax.eval_shape(lambda: state)).state, state)
    checkpoints.save(2, (), metadata={})
    assert checkpoints.restore(2, ()).state == ()


def test_a_part_is_restored_whatever_the_rest_is(tmp_path: Path) -> None:
    checkpoints = Checkpoints(tmp_path)
    saved = Counters(steps={"a": jnp.arange(3), "b": jax.random.key(1)}, done=jnp.array(True))
    checkpoints.save(1, saved, metadata={})
    like = jax.eval_shape(lambda: saved.steps)
    assert_same(checkpoints.restore_part(None, "steps", like).state, saved.steps)
    assert_same(checkpoints.restore_part(1, "done", jnp.array(False)).state, saved.done)
    with pytest.raises(JaxactError, match=r"it lacks \['c'\]"):
        checkpoints.restore_part(1, "steps", {**like, "c": jnp.zeros(1)})


def test_keeps_the_last_and_the_best(tmp_path: Path) -> None:
    checkpoints = Checkpoints(tmp_path, keep_last=2, keep_best=1)
    assert checkpoints.steps() == []
    assert checkpoints.best() is None
    for step, score in enumerate([0.1, 0.9, 0.3, None, float("nan"), 0.2]):
        checkpoints.save(step, {"x": jnp.float32(step)}, metadata={}, score=score)
    assert checkpoints.steps() == [1, 4, 5]
    assert checkpoints.best() == 1
    assert float(checkpoints.restore(checkpoints.best(), {"x": jnp.float32(0)}).state["x"]) == 1
    checkpoints.save(5, {"x": jnp.float32(-5)}, metadata={})
    assert checkpoints.steps() == [1, 4, 5]
    assert float(checkpoints.restore(5, {"x": jnp.float32(0)}).state["x"]) == -5


def test_refusals(tmp_path: Path) -> None:
    checkpoints = Checkpoints(tmp_path)
    with pytest.raises(JaxactError, match="no checkpoints in"):
        checkpoints.restore(None, {})
    state = {"a": jnp.zeros(3), "b": jnp.zeros(2)}
    checkpoints.save(3, state, metadata={"name": "old", "fingerprint": "f" * 64})
    with pytest.raises(JaxactError, match="no checkpoint of step 4; there are: 3"):
        checkpoints.restore(4, state)
    with pytest.raises(JaxactError, match=r"another experiment.*'old' .f{12}., but this is 'new'"):
        checkpoints.restore(3, state, name="new", fingerprint="e" * 64)
    with pytest.raises(JaxactError, match=r"has \['b'\] \(float32\[2\]\) where \['b'\] .int32"):
        checkpoints.restore(None, {"a": jnp.zeros(3), "b": jnp.zeros(2, jnp.int32)})
    with pytest.raises(JaxactError, match=r"it lacks \['c'\]"):
        checkpoints.restore(3, {**state, "c": jnp.zeros(1)})
    with pytest.raises(JaxactError, match=r"it has \['b'\]"):
        checkpoints.restore(3, {"a": jnp.zeros(3)})
    with pytest.raises(JaxactError, match="keep_last must be at least 1"):
        Checkpoints(tmp_path, keep_last=0)
    assert checkpoints.restore(3, state, fingerprint="f" * 64).step == 3


@pytest.mark.parametrize("damage", ["truncate", "remove", "manifest", "flip"])
def test_a_damaged_newest_falls_back(
    tmp_path: Path, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    checkpoints = Checkpoints(tmp_path)
    state = {"x": jnp.asarray(np.random.default_rng(0).normal(size=1000))}
    for step in (1, 2):
        checkpoints.save(step, state, metadata={})
    files = [path for path in (tmp_path / "000000000002").rglob("*") if path.is_file()]
    largest = max((f for f in files if f.suffix != ".json"), key=lambda f: f.stat().st_size)
    if damage == "truncate":
        os.truncate(largest, largest.stat().st_size // 2)
    elif damage == "remove":
        largest.unlink()
    elif damage == "flip":
        data = bytearray(largest.read_bytes())
        data[len(data) // 2] ^= 1
        largest.write_bytes(data)
    else:
        os.truncate(tmp_path / "000000000002" / "checkpoint.json", 20)
    with caplog.at_level(logging.WARNING):
        assert checkpoints.restore(None, state).step == 1
    assert "checkpoint of step 2 cannot be restored" in caplog.text
    with pytest.raises(JaxactError, match="checkpoint of step 2 cannot be restored"):
        checkpoints.restore(2, state)
    checkpoints.save(3, state, metadata={})
    assert checkpoints.restore(None, state).step == 3


SAVER = """
import sys, jax, jax.numpy as jnp
from jaxact.checkpoints import Checkpoints
checkpoints = Checkpoints(sys.argv[1], keep_last=2)
for step in range(1, 10_000):
    state = {"x": jnp.full((200_000,), step), "key": jax.random.key(step)}
    checkpoints.save(step, state, metadata={"name": "killed"})
    print(step, flush=True)
"""


def test_a_kill_in_the_middle_of_saving_loses_nothing(tmp_path: Path) -> None:
    like = {"x": jnp.zeros((200_000,), jnp.int32), "key": jax.random.key(0)}
    for attempt in range(3):
        directory = tmp_path / str(attempt)
        child = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(SAVER), str(directory)], stdout=subprocess.PIPE
        )
        assert child.stdout is not None
        with child.stdout as printed:
            lines = [printed.readline() for _ in range(2)]
            while not list(directory.glob(".partial-*/arrays*")):
                time.sleep(0.001)
            time.sleep(0.01 * attempt)
            child.send_signal(signal.SIGKILL)
            lines += printed.readlines()
        assert child.wait() == -signal.SIGKILL
        checkpoints = Checkpoints(directory)
        restored = checkpoints.restore(None, like)
        assert restored.step >= int(lines[-1])
        expected = {"x": jnp.full((200_000,), restored.step), "key": jax.random.key(restored.step)}
        assert_same(restored.state, expected)
        checkpoints.save(restored.step + 1, like, metadata={})
        assert not list(directory.glob(".partial-*"))


SHARDED = """
import sys, logging
logging.basicConfig(level=logging.INFO)
import jax, numpy as np, jax.numpy as jnp
from jax.sharding import NamedSharding, PartitionSpec
from jaxact.checkpoints import Checkpoints
assert not any(name.startswith("orbax") for name in sys.modules)
mesh = jax.make_mesh((4,), ("lanes",), axis_types=(jax.sharding.AxisType.Auto,))
lanes, whole = (NamedSharding(mesh, PartitionSpec(*names)) for names in (("lanes",), ()))
state = {
    "x": jax.device_put(jnp.arange(16.0).reshape(8, 2), lanes),
    "keys": jax.device_put(jax.random.split(jax.random.key(0), 8), lanes),
    "w": jax.device_put(jnp.ones(3), whole),
    "empty": jax.device_put(jnp.zeros((0, 3)), whole),
    "free": jnp.int32(3),
}
checkpoints = Checkpoints(sys.argv[1])
checkpoints.save(1, state, metadata={})
like = jax.tree.map(lambda x: x if x.ndim == 0 else jax.device_put(x[::-1], x.sharding), state)
restored = checkpoints.restore(1, like).state
for name in state:
    assert restored[name].sharding == state[name].sharding, name
    assert restored[name].committed == state[name].committed, name
    assert bool(jnp.all(restored[name] == state[name])), name
single = jax.tree.map(lambda x: jax.device_put(x, jax.devices()[0]), state)
assert len(checkpoints.restore(1, single).state["x"].devices()) == 1
"""


def test_sharded_arrays_come_back_where_they_were(tmp_path: Path) -> None:
    """Also, Orbax is imported late and says nothing."""
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=4", "JAX_PLATFORMS": "cpu"}
    finished = subprocess.run(
        [sys.executable, "-W", "error", "-c", SHARDED, str(tmp_path)],
        env={**os.environ, **flags},
        capture_output=True,
        text=True,
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    assert finished.stdout + finished.stderr == ""
