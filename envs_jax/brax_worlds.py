"""Brax's environments, and MuJoCo Playground's, as POMDPs: `make("Brax-ant-v0", backend="mjx")`.

Brax: C. D. Freeman et al., "Brax: A Differentiable Physics Engine for Large Scale Rigid Body
Simulation", 2021 (https://arxiv.org/abs/2106.13281). MuJoCo Playground: K. Zakka et al., 2025
(https://arxiv.org/abs/2502.08844).

The simulators are imported when a world is made, not before: that takes seconds. What they do in a
step, reward and end included, is one function of theirs; the task here reads from the state that
it leaves. An episode begins with a reset of theirs, and after `horizon` steps it is truncated, as
by Brax's `EpisodeWrapper`.
"""

from __future__ import annotations

import contextlib
import inspect
import math
import sys
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from envs_jax.registry import register
from jaxact.errors import JaxactError, check_at_least, unknown
from jaxact.frozen import FrozenMapping
from jaxact.pomdp import POMDP, Environment, Episode, Outcome, PyTree, Sensor, Task, TaskSampler
from jaxact.spaces import Box

# Of `brax.envs`; they are not asked for, so that the ids are there without importing Brax.
NAMES = (
    "ant",
    "fast",
    "halfcheetah",
    "hopper",
    "humanoid",
    "humanoidstandup",
    "inverted_double_pendulum",
    "inverted_pendulum",
    "pusher",
    "reacher",
    "swimmer",
    "walker2d",
)
BACKENDS = ("generalized", "mjx", "positional", "spring")
HORIZON = 1000

# Which of Brax's metrics the reward is a weighted sum of.
_WEIGHTS: dict[str, dict[str, float]] = {
    "ant": {
        "reward_forward": 1.0,
        "reward_survive": 1.0,
        "reward_ctrl": 1.0,
        "reward_contact": 1.0,
    },
    "halfcheetah": {"reward_run": 1.0, "reward_ctrl": 1.0},
    "hopper": {"reward_forward": 1.0, "reward_healthy": 1.0, "reward_ctrl": 1.0},
    "humanoid": {"reward_linvel": 1.0, "reward_alive": 1.0, "reward_quadctrl": 1.0},
    "humanoidstandup": {"reward_linup": 1.0, "reward_quadctrl": 1.0},
    "pusher": {"reward_dist": 1.0, "reward_ctrl": 0.1, "reward_near": 0.5},
    "reacher": {"reward_dist": 1.0, "reward_ctrl": 1.0},
    "swimmer": {"reward_fwd": 1.0, "reward_ctrl": 1.0},
    "walker2d": {"reward_forward": 1.0, "reward_healthy": 1.0, "reward_ctrl": 1.0},
}
# What the reward has besides, at every step, without a metric of it.
_BONUS = {"humanoidstandup": 1.0}

# Returns from which Gymnasium holds the MuJoCo environment that Brax's is made after to be solved
# (`reward_threshold` of its registry), of those whose episodes are of as many steps.
_THRESHOLDS = {
    "ant": 6000.0,
    "halfcheetah": 4800.0,
    "hopper": 3800.0,
    "inverted_double_pendulum": 9100.0,
    "inverted_pendulum": 950.0,
    "swimmer": 360.0,
}


@dataclass(frozen=True)
class Simulator(Environment):
    """One of their environments, and its state theirs: `obs`, `reward`, `done`, `metrics`, …

    Attributes:
      suite: "brax" or "playground".
      name: in their registry.
      options: for its constructor (Brax: `backend`, `ctrl_cost_weight`, …), or replacing parts of
        its configuration (Playground).
    """

    # They compute with the options before anything is compiled.
    numbers_are_structure: ClassVar[bool] = True

    suite: str
    name: str
    options: Mapping[str, Any] = FrozenMapping()

    def __post_init__(self) -> None:
        object.__setattr__(self, "options", FrozenMapping(self.options))

    @property
    def theirs(self) -> Any:
        """Their object; made once in a process.

        Raises:
          JaxactError: the suite is not installed, or there is no such environment or option.
        """
        return _load(self)

    @property
    def action_space(self) -> Box:
        """Each entry between −1 and 1, as their own policies act; scaled by the environment."""
        return Box(-1.0, 1.0, (int(self.theirs.action_size),))

    def reset(self, key: jax.Array) -> PyTree:
        """Returns the first state of an episode."""
        theirs = self.theirs
        with _in_their_manner():
            return jax.tree.map(_strong, theirs.reset(key))

    def step(self, key: jax.Array, state: PyTree, action: jax.Array) -> PyTree:
        """Takes a step; their environments draw at random from the state alone, if at all."""
        del key
        theirs = self.theirs
        if jnp.shape(action) != self.action_space.shape:
            raise JaxactError(
                f"an action of {self.suite}'s {self.name!r} has the shape "
                f"{self.action_space.shape}, not {jnp.shape(action)}"
            )
        # A step of theirs writes into the dicts of the state that it is given.
        copied = jax.tree.map(lambda x: x, state)
        with _in_their_manner():
            return jax.tree.map(_like, theirs.step(copied, action), state)


@dataclass(frozen=True)
class Resets(TaskSampler):
    """Episodes that begin as the simulator resets.

    Attributes:
      simulator: the world's environment.
      horizon: steps after which an episode is truncated.
    """

    simulator: Simulator
    horizon: int = HORIZON

    def __post_init__(self) -> None:
        check_at_least(1, "a simulator's episodes", horizon=self.horizon)

    def sample(self, key: jax.Array, sampler_state: PyTree) -> Episode:
        """Draws one episode; the task's state is the return so far."""
        del sampler_state
        return Episode(self.simulator.reset(key), jnp.float32(0), jnp.int32(self.horizon))

    def check(self, pomdp: POMDP) -> None:
        """Raises JaxactError if the world is of another simulator."""
        if pomdp.environment != self.simulator:
            raise JaxactError(
                f"the sampler's episodes are of {self.simulator}, not of {pomdp.environment}"
            )


@dataclass(frozen=True)
class SimulatorReward(Task):
    """The simulator's own reward and end. State: float32, the return so far.

    Attributes:
      weights: of the metrics that make up the reward, whose components are called what they are
        called without "reward_"; if there are none, the reward has one component, "reward".
      bonus: a component "bonus" of every step; None for no such component.
      threshold: an episode succeeds with a return of at least this; None if none ever does.
    """

    weights: Mapping[str, float] = FrozenMapping()
    bonus: float | None = None
    threshold: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", FrozenMapping(self.weights))

    def step(
        self, task_state: jax.Array, before: PyTree, action: PyTree, after: PyTree
    ) -> tuple[jax.Array, Outcome]:
        """Reads reward, end and metrics out of the state stepped to."""
        del before, action
        metrics = {name: x.astype(jnp.float32) for name, x in after.metrics.items()}
        reward = {
            name.removeprefix("reward_"): weight * metrics.pop(name)
            for name, weight in self.weights.items()
        }
        if not self.weights:
            reward = {"reward": after.reward.astype(jnp.float32)}
        if self.bonus is not None:
            reward["bonus"] = jnp.asarray(self.bonus, jnp.float32)
        total = task_state + sum(reward.values(), start=jnp.float32(0))
        solved = jnp.bool_(False) if self.threshold is None else total >= self.threshold
        return total, Outcome(reward, {"threshold": solved}, after.done > 0, metrics)


@dataclass(frozen=True)
class Reading(Sensor):
    """What the simulator observes, or one part of it by name.

    Attributes:
      shape: of the reading, float32.
      part: key of it where they observe a dict; None where they observe an array.
    """

    shape: tuple[int, ...]
    part: str | None = None

    @property
    def space(self) -> Box:
        """Without bounds."""
        return Box(-math.inf, math.inf, self.shape)

    def observe(self, state: PyTree, task_state: PyTree) -> jax.Array:
        """Returns the reading that came with the state."""
        del task_state
        seen = state.obs if self.part is None else state.obs[self.part]
        return seen.astype(jnp.float32)


def brax_world(
    name: str, *, backend: str = "generalized", horizon: int = HORIZON, **options: Any
) -> POMDP:
    """Builds a POMDP of an environment in Brax's registry, your own ones there among them.

    Sensors: "observation", or the parts of an observation that is a dict. The components of the
    reward are the metrics that it is a sum of; where Brax has no such metrics (`fast`, the
    pendulums, environments of your own) there is one, "reward". The other metrics are task metrics.
    An episode is a success if its return reaches Gymnasium's threshold for the MuJoCo environment
    that Brax's is made after: "ant", "halfcheetah", "hopper", "swimmer" and the pendulums, with the
    ordinary horizon and options; the others have none.

    Args:
      name: as in `brax.envs.get_environment`.
      backend: one of `BACKENDS`; "swimmer" is for the first only, and to "fast" all are one.
      horizon: steps after which an episode is truncated.
      **options: of the environment's constructor.

    Raises:
      JaxactError: no such environment, backend or option.
    """
    if backend not in BACKENDS:
        raise unknown("backend of Brax", backend, BACKENDS)
    simulator = Simulator("brax", name, {"backend": backend, **options})
    known = name in NAMES
    usual = horizon == HORIZON and not options
    task = SimulatorReward(
        _WEIGHTS.get(name, {}) if known else {},
        _BONUS.get(name),
        _THRESHOLDS.get(name) if usual else None,
    )
    return _pomdp(simulator, task, horizon)


def playground_world(name: str, *, horizon: int | None = None, **options: Any) -> POMDP:
    """Builds a POMDP of one of MuJoCo Playground's environments, such as "CartpoleBalance".

    Their reward is scaled, clipped or multiplied from what their metrics tell, differently in each
    environment, so it has one component, "reward", and no episode counts as a success.

    Args:
      name: as in `mujoco_playground.registry.ALL_ENVS`.
      horizon: steps after which an episode is truncated; None for what they say, `episode_length`.
      **options: replace entries of the environment's configuration.

    Raises:
      JaxactError: Playground is not installed, or there is no such environment or option.
    """
    simulator = Simulator("playground", name, options)
    length = int(simulator.theirs._config.episode_length)
    return _pomdp(simulator, SimulatorReward(), length if horizon is None else horizon)


def _pomdp(simulator: Simulator, task: SimulatorReward, horizon: int) -> POMDP:
    seen = jax.eval_shape(simulator.reset, jax.eval_shape(lambda: jax.random.key(0))).obs
    sensors = (
        {name: Reading(tuple(part.shape), name) for name, part in seen.items()}
        if isinstance(seen, Mapping)
        else {"observation": Reading(tuple(seen.shape))}
    )
    return POMDP(simulator, task, Resets(simulator, horizon), sensors)


@lru_cache(maxsize=64)
def _load(simulator: Simulator) -> Any:
    make, names = _brax() if simulator.suite == "brax" else _playground()
    if simulator.name not in names:
        raise unknown(f"environment of {simulator.suite}", simulator.name, names)
    options = dict(simulator.options)
    # It may be asked for first while something is traced, and is kept for good.
    with jax.ensure_compile_time_eval(), _in_their_manner():
        try:
            return make(simulator.name, options)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise JaxactError(
                f"{simulator.suite} cannot make {simulator.name!r} with {options}: {error}"
            ) from error


def _brax() -> tuple[Any, tuple[str, ...]]:
    """Returns what makes an environment by name and options, and the names there are."""
    with _in_their_manner(), contextlib.redirect_stdout(sys.stderr):
        from brax import envs, fluid
    if "a_min" not in inspect.signature(jnp.clip).parameters:
        # Brax 0.14.2 clips the inertia of bodies in fluids by a keyword that JAX has no more.
        clip = lambda x, a_min: jnp.maximum(x, a_min)  # noqa: E731
        fluid.jp = SimpleNamespace(**{**vars(jnp), "clip": clip})
    return lambda name, options: envs.get_environment(name, **options), tuple(envs._envs)


def _playground() -> tuple[Any, tuple[str, ...]]:
    try:
        with _in_their_manner(), contextlib.redirect_stdout(sys.stderr):
            from mujoco_playground import registry
    except ImportError as error:
        raise JaxactError(
            f"MuJoCo Playground's environments need it ({error}): pip install playground"
        ) from None
    return lambda name, options: registry.load(name, config_overrides=options), registry.ALL_ENVS


@contextlib.contextmanager
def _in_their_manner() -> Iterator[None]:
    """Promotes dtypes as they rely on, and keeps warnings of what they use from the user."""
    with warnings.catch_warnings(), jax.numpy_dtype_promotion("standard"):
        warnings.simplefilter("ignore", DeprecationWarning)
        warnings.filterwarnings("ignore", message="Brax System, piplines", category=UserWarning)
        yield


def _is_key(x: Any) -> bool:
    return bool(jax.dtypes.issubdtype(jnp.result_type(x), jax.dtypes.prng_key))


def _strong(x: Any) -> Any:
    """Returns an array of the dtype that it has, no more weakly typed."""
    return x if _is_key(x) else jnp.asarray(x, jnp.result_type(x))


def _like(x: Any, before: jax.Array) -> Any:
    """Returns an array of the dtype and shape it had before; theirs may be a Python number."""
    return x if _is_key(before) else jnp.broadcast_to(jnp.asarray(x, before.dtype), before.shape)


for _name in NAMES:
    register(f"Brax-{_name}-v0", partial(brax_world, _name))
