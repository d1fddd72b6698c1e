"""Gymnasium's environments as worlds, whatever simulates them: the bridge out of JAX.

Training, evaluation, losses and logging are those of any other world. Its pace is the simulators',
less what a call from the compiled program to the host costs at every step of all lanes; whoever has
the choice takes a world in JAX.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import jax
import numpy as np

from jaxact import spaces
from jaxact.errors import JaxactError, unknown
from jaxact.gymnasium_spaces import from_space, to_numpy
from jaxact.pomdp import POMDP, Task
from jaxact.simulated import (
    Simulated,
    SimulatedCamera,
    SimulatedEpisodes,
    SimulatedSensor,
    SimulatedTask,
)
from jaxact.simulator_hosts import Reading

# What the observation is called where it is one array without a name.
OBSERVATION = "observation"
# Where `info` may say that the episode is a success.
SUCCESS_NAMES = ("is_success", "success")
NEVER = 2**31 - 1


def from_gymnasium(
    environment: str | Callable[[], gymnasium.Env[Any, Any]],
    *,
    simulators: int = 8,
    threads: int = 0,
    processes: int = 0,
    timeout: float = 600.0,
    horizon: int | None = None,
    success_return: float | None = None,
    metrics: Sequence[str] = (),
    task: Task | None = None,
    action_names: Sequence[str] = (),
    held_out: Callable[[], gymnasium.Env[Any, Any]] | None = None,
    held_out_seeds: int = 0,
    **options: Any,
) -> POMDP:
    """Makes a world of a Gymnasium environment.

    Each episode begins with `reset(seed=...)` to a 31-bit seed of its own, and ends when the
    environment terminates or truncates it, or at the horizon. Of a dict of observations each is a
    sensor; other observations are one, called "observation". What leaves the bounds of a box of
    actions is clipped to them. The reward's component is "reward".

    Training resumed from a checkpoint begins new episodes in all lanes, for simulators cannot be
    saved; until then, the same seed gives the same numbers if the simulators' resets are exact.

    Args:
      environment: an id that is registered with Gymnasium, or what makes one environment.
      simulators: how many there can be, at least as many as the pipeline has lanes. As many are
        for evaluation, apart from them. They are made when they are needed.
      threads: how many simulators are stepped at once; of use where they wait for something or let
        other Python threads run. With 0 they are stepped one after the other.
      horizon: steps after which episodes are truncated; None to leave that to the environment.
      success_return: the return from which on an episode is a success, where `info` has neither
        "is_success" nor "success"; None for the threshold that is registered with the id, if any.
      metrics: names of scalars in `info` to be reported as metrics of the task. Those at an
        episode's end count and have to be there; between, what is absent is as it was, at first 0.
      task: judges in place of the environment's own reward and ends; see `SimulatedState`.
      action_names: of discrete actions.
      held_out: makes one environment to evaluate with, of the same spaces; None if evaluation is in
        the same ones.
      held_out_seeds: N, to evaluate on the episodes of the seeds 0 … N − 1, each once and in order;
        0 for seeds that are drawn from the evaluation's.
      **options: with an id, of `gymnasium.make`.

    Raises:
      JaxactError: there is no such id, the environment cannot be made, or a space is one that
        jaxact does not have.
    """
    if isinstance(metrics, str):
        raise JaxactError(f"metrics are a sequence of names, as ({metrics!r},)")
    make, spec = _maker(environment, options)
    probe = _made(make)
    seen = _parts(from_space(probe.observation_space))
    actions = from_space(probe.action_space)
    if action_names and (
        not isinstance(actions, spaces.Discrete) or len(action_names) != actions.n
    ):
        raise JaxactError(
            f"there are {len(action_names)} action_names, but the actions are {actions}"
        )
    threshold = success_return
    if threshold is None:
        threshold = getattr(spec or probe.spec, "reward_threshold", None)
    simulator = functools.partial(
        GymnasiumSimulator, observations=tuple(seen), actions=actions, metrics=tuple(metrics)
    )
    world = Simulated(
        make=functools.partial(_simulator, simulator, make),
        actions=actions,
        observations=seen,
        metrics=tuple(metrics),
        simulators=simulators,
        threads=threads,
        processes=processes,
        timeout=timeout,
        kind=_kind(probe),
        names=tuple(action_names),
        make_held_out=None
        if held_out is None
        else functools.partial(_simulator, simulator, _checked(held_out, "held_out")),
    )
    world.pool(held_out=False).adopt(simulator(probe))
    # Here and not at the first evaluation, if one cannot be made, or be sent to a process.
    evaluated = world.pool(held_out=True)
    if world.make_held_out is not None:
        evaluated.adopt(world.make_held_out())
    episodes = SimulatedEpisodes(world, NEVER if horizon is None else horizon, held_out_seeds)
    if task is None:
        task = SimulatedTask(float("inf") if threshold is None else float(threshold))
    sensors = {
        name: (SimulatedCamera if _is_image(space) else SimulatedSensor)(name, space)
        for name, space in seen.items()
    }
    return POMDP(world, task, episodes, sensors)


@dataclass
class GymnasiumSimulator:
    """A Gymnasium environment as `jaxact.simulator_hosts.Simulator`.

    Attributes:
      environment: steps and resets.
      observations: names of the parts of its observations.
      actions: the space of its actions, as jaxact has it.
      metrics: names in its `info`.
    """

    environment: gymnasium.Env[Any, Any]
    observations: tuple[str, ...]
    actions: spaces.Space
    metrics: tuple[str, ...]

    def __post_init__(self) -> None:
        self._parts = _parts(from_space(self.environment.observation_space))
        self._is_dict = isinstance(self.environment.observation_space, gymnasium.spaces.Dict)
        for name, had, has in (
            ("observations", self.observations, tuple(self._parts)),
            ("actions", self.actions, from_space(self.environment.action_space)),
        ):
            if had != has:
                raise JaxactError(f"all simulators' {name} are {had}, but this one's are {has}")
        self._structure = jax.tree.structure(self.actions.structure)
        self._known = dict.fromkeys(self.metrics, 0.0)

    def reset(self, seed: int) -> Reading:
        """Begins the episode of a seed."""
        given = self.environment.reset(seed=seed)
        if not isinstance(given, tuple) or len(given) != 2:
            raise JaxactError("its reset returned no pair of an observation and `info`")
        observation, info = given
        self._known = dict.fromkeys(self.metrics, 0.0)
        return self._reading(observation, 0.0, False, False, info)

    def step(self, action: tuple[np.ndarray, ...]) -> Reading:
        """Takes one step."""
        value = to_numpy(self.actions, jax.tree.unflatten(self._structure, action), flatten=False)
        given = self.environment.step(_clipped(self.environment.action_space, value))
        if not isinstance(given, tuple) or len(given) != 5:
            raise JaxactError(
                "its step returned no five of observation, reward, terminated, truncated and `info`"
            )
        return self._reading(*given)

    def close(self) -> None:
        """Closes the environment."""
        self.environment.close()

    def _reading(
        self,
        observation: Any,
        reward: Any,
        terminated: bool,
        truncated: bool,
        info: Mapping[str, Any],
    ) -> Reading:
        said = [bool(info[name]) for name in SUCCESS_NAMES if name in info]
        success = float(said[0]) if said else -1.0
        for name in self.metrics:
            if name in info:
                self._known[name] = _number(f"metric {name!r}", info[name])
            elif terminated or truncated:
                raise unknown("metric in `info` at the episode's end", name, info)
        flags = (float(terminated), float(truncated), success)
        earned = _number("reward", reward)
        values = observation if self._is_dict else {OBSERVATION: observation}
        return Reading(
            tuple(_array(name, space, values) for name, space in self._parts.items()),
            np.asarray([earned, *flags, *self._known.values()], np.float32),
        )


def _number(what: str, value: Any) -> float:
    """Returns a number that an environment gave.

    Raises:
      JaxactError: it is none, or not finite.
    """
    array = np.asarray(value)
    if array.size != 1 or array.dtype.kind not in "biuf" or not np.isfinite(array.item()):
        raise JaxactError(f"its {what} is {value}, where a finite number is needed")
    return float(array.item())


def _array(name: str, space: spaces.Space, values: Any) -> np.ndarray:
    """Returns a named part of an observation, of its space's dtype.

    Raises:
      JaxactError: it is not there, or not of its space; shapes are checked for all simulators.
    """
    if not isinstance(values, Mapping) or name not in values:
        found = sorted(values) if isinstance(values, Mapping) else type(values).__name__
        raise JaxactError(f"its space has {name!r}, but it observed {found}")
    dtype, given = space.structure.dtype, np.asarray(values[name])
    if given.dtype.kind not in "biuf":
        raise JaxactError(f"{name!r} of what it observed is no array of numbers")
    array = given.astype(dtype, copy=False)
    if array.dtype.kind == "f" and np.isnan(array).any():
        raise JaxactError(f"{name!r} of what it observed is not a number (NaN)")
    if array.dtype.kind in "iu" and array is not given and not np.array_equal(array, given):
        raise JaxactError(f"{name!r} of what it observed has numbers that are no {dtype}")
    if isinstance(space, spaces.Discrete) and not np.all((array >= 0) & (array < space.n)):
        raise JaxactError(f"{name!r} of what it observed is {array}, not in 0 … {space.n - 1}")
    return array


def _maker(
    environment: str | Callable[[], gymnasium.Env[Any, Any]], options: Mapping[str, Any]
) -> tuple[Callable[[], gymnasium.Env[Any, Any]], Any]:
    """Returns what makes one, and what is registered of it."""
    if not isinstance(environment, str):
        make = _checked(environment, "environment")
        if options:
            raise JaxactError(
                f"{', '.join(options)} can be given with an id alone; give the environment its "
                "arguments with functools.partial"
            )
        return make, None
    try:
        spec = gymnasium.spec(environment)
    except gymnasium.error.Error:
        raise unknown("Gymnasium environment", environment, gymnasium.registry) from None
    # What it would check, shapes above all, is checked here at every step.
    return functools.partial(gymnasium.make, spec, disable_env_checker=True, **options), spec


def _checked(make: Any, name: str) -> Callable[[], gymnasium.Env[Any, Any]]:
    """Returns what was given to make environments.

    Raises:
      JaxactError: it is something else.
    """
    if not callable(make):
        raise JaxactError(
            f"{name} has to be what makes one environment, as functools.partial(MyEnv, size=5), "
            f"but it is {make!r}"
        )
    return make


def _made(make: Callable[[], gymnasium.Env[Any, Any]]) -> gymnasium.Env[Any, Any]:
    """Makes an environment.

    Raises:
      JaxactError: it cannot be made, or is none of Gymnasium's.
    """
    try:
        environment = make()
    except JaxactError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())
        raise JaxactError(
            f"the environment cannot be made: {type(error).__name__}: {reason}"
        ) from error
    if not isinstance(environment, gymnasium.Env):
        raise JaxactError(
            "what makes an environment made no gymnasium.Env, but a "
            f"{type(environment).__module__}.{type(environment).__qualname__}"
        )
    return environment


def _simulator(
    simulator: Callable[..., GymnasiumSimulator], make: Callable[[], gymnasium.Env[Any, Any]]
) -> GymnasiumSimulator:
    return simulator(_made(make))


def _parts(space: spaces.Space) -> dict[str, spaces.Space]:
    """Returns the named parts of observations, each an array.

    Raises:
      JaxactError: a part is none.
    """
    parts = dict(space.spaces) if isinstance(space, spaces.Dict) else {OBSERVATION: space}
    if not parts:
        raise JaxactError("the environment's space of observations is an empty dict")
    for name, part in parts.items():
        if not isinstance(name, str):
            raise JaxactError(f"the parts of an observation need strings for names, not {name!r}")
        if not isinstance(part, spaces.Discrete | spaces.Box):
            raise JaxactError(
                f"an observation is an array or a dict of arrays, but {name!r} is {part}: flatten "
                "it, for example with gymnasium.wrappers.FlattenObservation"
            )
    return parts


def _kind(environment: gymnasium.Env[Any, Any]) -> str:
    """Returns what errors call an environment: its id, or the name of its class."""
    if environment.spec is not None:
        return environment.spec.id
    return type(environment.unwrapped).__name__


def _is_image(space: spaces.Space) -> bool:
    match space:
        case spaces.Box(shape=(_, _, 3), dtype="uint8"):
            return True
    return False


def _clipped(space: gymnasium.Space[Any], action: Any) -> Any:
    """Returns an action within the bounds of the boxes in it."""
    match space:
        case gymnasium.spaces.Box():
            return np.clip(action, space.low, space.high).astype(space.dtype)
        case gymnasium.spaces.Tuple():
            return tuple(_clipped(part, x) for part, x in zip(space.spaces, action, strict=True))
        case gymnasium.spaces.Dict():
            return {name: _clipped(part, action[name]) for name, part in space.spaces.items()}
    return action
