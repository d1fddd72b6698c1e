"""Small experiments in the corridor, for the tests of training, and the programs they share.

Compiling takes nearly all of these tests' time, so experiments differ in numbers rather than in
structure.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO, Imitation
from jaxact.models import GRU, ActorCritic, Concatenated, Vector
from jaxact.pomdp import POMDP, Task
from jaxact.program import Program, choose_devices
from jaxact.samplers import LadderSampler, PrioritizedLevelReplay, RepeatFailed
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


class Plain(nn.Module):
    """An encoder of one layer; orthogonal initialisers take seconds to compile."""

    @nn.compact
    def __call__(self, vector: jax.Array) -> jax.Array:
        """Maps vectors [..., D] to features [..., 16]."""
        return nn.tanh(nn.Dense(16)(vector))


@dataclasses.dataclass(frozen=True)
class Undemonstrated(Task):
    """The corridor's task without its expert."""

    step_penalty: float = -0.01

    step = ReachEnd.step


def experiment(pomdp: POMDP | None = None, name: str = "corridor", **settings: Any) -> Experiment:
    """Four updates of DAgger, then four of PPO; without arguments, always the same object."""
    plain = pomdp is None and name == "corridor" and not settings
    return _plain() if plain else _experiment(pomdp or corridor(), name, settings)


@functools.cache
def _plain() -> Experiment:
    return _experiment(corridor(), "corridor", {})


def _experiment(pomdp: POMDP, name: str, settings: dict[str, Any]) -> Experiment:
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


class SharedProgram(Program):
    """Keeps its compiled stages for the next training."""

    __eq__, __hash__ = object.__eq__, object.__hash__
    compile_stage = functools.cache(Program.compile_stage)


@functools.cache
def _plain_program() -> SharedProgram:
    return SharedProgram(_plain(), choose_devices(1))


def program_of(experiment: Experiment, devices: tuple[Any, ...]) -> Program:
    """In the place of `Program`: trainings of `experiment()` share what they trace and compile."""
    shared = experiment == _plain() and devices == choose_devices(1)
    return _plain_program() if shared else Program(experiment, devices)


def curriculum() -> POMDP:
    """The corridor with samplers that learn, one made of others: a ladder of known levels."""
    rungs = {
        "long": PrioritizedLevelReplay(RandomStart(horizon=10), size=16),
        "short": RepeatFailed(RandomStart(horizon=5), min_steps=20.0, size=16),
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
