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
      JaxactError: there is no such id, or a space that jaxact does not have.
    """
    make, spec = _maker(environment, options)
    probe = make()
    seen = _parts(from_space(probe.observation_space))
    actions = from_space(probe.action_space)
    threshold = success_return
    if threshold is None:
        threshold = getattr(spec or probe.spec, "reward_threshold", None)
    simulator = functools.partial(
        GymnasiumSimulator, observations=tuple(seen), actions=actions, metrics=tuple(metrics)
    )
    world = Simulated(
        make=functools.partial(_make, simulator, make),
        actions=actions,
        observations=seen,
        metrics=tuple(metrics),
        simulators=simulators,
        threads=threads,
        processes=processes,
        timeout=timeout,
        kind=_kind(probe),
        names=tuple(action_names),
        make_held_out=None if held_out is None else functools.partial(_make, simulator, held_out),
    )
    world.pool(held_out=False).adopt(simulator(probe))
    # What cannot be sent to a process is refused here.
    world.pool(held_out=True)
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
        parts = _parts(from_space(self.environment.observation_space))
        self._dtypes = {name: space.structure.dtype for name, space in parts.items()}
        for name, had, has in (
            ("observations", self.observations, tuple(parts)),
            ("actions", self.actions, from_space(self.environment.action_space)),
        ):
            if had != has:
                raise JaxactError(f"all simulators' {name} are {had}, but this one's are {has}")
        self._structure = jax.tree.structure(self.actions.structure)
        self._known = dict.fromkeys(self.metrics, 0.0)

    def reset(self, seed: int) -> Reading:
        """Begins the episode of a seed."""
        observation, info = self.environment.reset(seed=seed)
        self._known = dict.fromkeys(self.metrics, 0.0)
        return self._reading(observation, 0.0, False, False, info)

    def step(self, action: tuple[np.ndarray, ...]) -> Reading:
        """Takes one step."""
        value = to_numpy(self.actions, jax.tree.unflatten(self._structure, action), flatten=False)
        return self._reading(*self.environment.step(_clipped(self.environment.action_space, value)))

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
                self._known[name] = float(info[name])
            elif terminated or truncated:
                raise unknown("metric in `info` at the episode's end", name, info)
        flags = (float(terminated), float(truncated), success)
        numbers = np.asarray([reward, *flags, *self._known.values()], np.float32)
        values = observation if isinstance(observation, Mapping) else {OBSERVATION: observation}
        return Reading(
            tuple(np.asarray(values[name], dtype) for name, dtype in self._dtypes.items()), numbers
        )


def _maker(
    environment: str | Callable[[], gymnasium.Env[Any, Any]], options: Mapping[str, Any]
) -> tuple[Callable[[], gymnasium.Env[Any, Any]], Any]:
    """Returns what makes one, and what is registered of it."""
    if not isinstance(environment, str):
        if options:
            raise JaxactError(
                f"{', '.join(options)} can be given with an id alone; give the environment its "
                "arguments with functools.partial"
            )
        return environment, None
    try:
        spec = gymnasium.spec(environment)
    except gymnasium.error.Error:
        raise unknown("Gymnasium environment", environment, gymnasium.registry) from None
    # What it would check, shapes above all, is checked here at every step.
    return functools.partial(gymnasium.make, spec, disable_env_checker=True, **options), spec


def _make(
    simulator: Callable[..., GymnasiumSimulator], make: Callable[[], gymnasium.Env[Any, Any]]
) -> GymnasiumSimulator:
    return simulator(make())


def _parts(space: spaces.Space) -> dict[str, spaces.Space]:
    """Returns the named parts of observations, each an array.

    Raises:
      JaxactError: a part is none.
    """
    parts = dict(space.spaces) if isinstance(space, spaces.Dict) else {OBSERVATION: space}
    for name, part in parts.items():
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
