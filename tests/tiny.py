"""Small experiments in the corridor, for the tests of training, and the programs they share.

Compiling takes nearly all of these tests' time, so programs are kept in JAX's compilation cache
for as long as the tests run, and experiments differ in numbers rather than in structure.
"""

from __future__ import annotations

import atexit
import dataclasses
import shutil
import tempfile
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, Imitation
from jaxact.models import GRU, ActorCritic, Concatenated, Vector
from jaxact.pomdp import POMDP, Task
from jaxact.samplers import LadderSampler, PrioritizedLevelReplay
from jaxact.schedules import Linear
from tests.corridor import RandomStart, ReachEnd, corridor

# Environment steps of one update of `experiment()`.
UPDATE = 64
# Logs, evaluates and saves more than once in such a run.
OPTIONS: dict[str, Any] = {
    "log_every": 2 * UPDATE,
    "evaluate_every": 4 * UPDATE,
    "checkpoint_every": 2 * UPDATE,
    "evaluation_episodes": 40,
    "keep_last": 10,
    "progress": False,
}


@dataclasses.dataclass(frozen=True)
class Undemonstrated(Task):
    """The corridor's task without its expert."""

    step_penalty: float = -0.01

    step = ReachEnd.step


def use_compilation_cache() -> None:
    """Keeps programs between tests and in the processes they start, unless JAX already does."""
    if jax.config.jax_compilation_cache_dir is None:
        directory = tempfile.mkdtemp(prefix="jaxact-tests-")
        atexit.register(shutil.rmtree, directory, ignore_errors=True)
        jax.config.update("jax_compilation_cache_dir", directory)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def cache_environment() -> dict[str, str]:
    """Environment variables with which another process shares the programs."""
    return {
        "JAX_COMPILATION_CACHE_DIR": str(jax.config.jax_compilation_cache_dir),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "0",
    }


def experiment(pomdp: POMDP | None = None, name: str = "corridor", **settings: Any) -> Experiment:
    """Four updates of DAgger, then four of PPO."""
    pomdp = pomdp or corridor()
    stages = (
        Stage(
            losses={"imitation": Imitation()},
            steps=4 * UPDATE,
            teacher_forcing=Linear(1.0, 0.0, 4.0 * UPDATE),
            overrides={"learning_rate": Linear(2e-2, 1e-2, 4.0 * UPDATE)},
        ),
        Stage(losses={"ppo": PPO()}, steps=4 * UPDATE),
    )
    model = ActorCritic(pomdp.action_space, Concatenated({"vector": Vector((16,))}), GRU(8))
    defaults = {
        "stages": stages,
        "lanes": 8,
        "rollout_length": 8,
        "minibatches": 2,
        "epochs": 2,
        "learning_rate": Linear(1e-2, 0.0, 8.0 * UPDATE),
    }
    return Experiment(name, pomdp, model, TrainingPipeline(**defaults | settings))


def curriculum() -> POMDP:
    """The corridor with samplers that learn, one made of others: a ladder of levels replayed."""
    rungs = {
        name: PrioritizedLevelReplay(RandomStart(horizon=horizon), size=16)
        for name, horizon in (("long", 10), ("short", 5))
    }
    ladder = LadderSampler(rungs, promote_at=0.1, episodes=8, rehearsal=0.5)
    return dataclasses.replace(corridor(), sampler=ladder)


def raw(leaf: Any) -> np.ndarray:
    """An array's numbers; of PRNG keys, their words."""
    is_key = jnp.issubdtype(getattr(leaf, "dtype", np.float32), jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(leaf) if is_key else leaf)


def assert_same(one: Any, other: Any) -> None:
    """Two trees are equal bit for bit."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for (path, a), b in zip(
        jax.tree_util.tree_leaves_with_path(one), jax.tree.leaves(other), strict=True
    ):
        a, b = raw(a), raw(b)
        assert (a.shape, a.dtype) == (b.shape, b.dtype), jax.tree_util.keystr(path)
        assert a.tobytes() == b.tobytes(), f"{jax.tree_util.keystr(path)} differs"


use_compilation_cache()
