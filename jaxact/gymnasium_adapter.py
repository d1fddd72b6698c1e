"""Worlds as Gymnasium environments, for libraries that step them from Python.

The world itself is compiled; what each step costs besides is the way from Python to the device and
back, which training with jaxact has not.

Which chance an episode has is told in `jaxact.played_episodes`. Lane i of a vector has the episodes
of an environment with the seed s + i.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from jaxact.compaction import for_each_chosen, put_rows
from jaxact.errors import JaxactError
from jaxact.gymnasium_spaces import to_jax, to_numpy, to_space
from jaxact.played_episodes import (
    RENDER_MODES,
    Lane,
    begin_episode,
    check_render_mode,
    programs,
    seed_word,
    step_episode,
)
from jaxact.pomdp import POMDP, PyTree, Step
from jaxact.recording import side_by_side
from jaxact.simulators import explained

_METADATA: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 8}


def to_gymnasium(
    pomdp: POMDP, *, seed: int = 0, render_mode: str | None = None, flatten: bool = False
) -> gymnasium.Env[Any, Any]:
    """Makes a Gymnasium environment of a world.

    Observations are dicts with one array for each sensor. `info` has what `Step.info` has, and
    "is_success", which Stable-Baselines3 logs. `render` shows the pictured sensors side by side.

    Args:
      pomdp: the world.
      seed: of the episodes until `reset` is given another.
      render_mode: "rgb_array" or None.
      flatten: make every box of the observation a vector. Stable-Baselines3's `MultiInputPolicy`
        takes all uint8 [H, W, 3] for pictures, and cannot do with small ones as MiniGrid's view.

    Raises:
      JaxactError: no such mode, or no sensor can be pictured.
    """
    pomdp.check_single_agent("Gymnasium environments are")
    env = _POMDPEnv(pomdp, seed, render_mode, flatten)
    make = functools.partial(to_gymnasium, pomdp)
    kwargs = {"seed": seed, "render_mode": render_mode, "flatten": flatten}
    env.spec = EnvSpec("jaxact/POMDP-v0", entry_point=make, kwargs=kwargs)
    return env


def to_gymnasium_vector(
    pomdp: POMDP,
    num_envs: int,
    *,
    seed: int = 0,
    autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    render_mode: str | None = None,
    flatten: bool = False,
) -> gymnasium.vector.VectorEnv[Any, Any, Any]:
    """Makes a Gymnasium vector environment of a world: one compiled step for all lanes.

    It gives what `SyncVectorEnv` gives with `num_envs` environments of `to_gymnasium`.

    Args:
      pomdp: the world.
      num_envs: number of lanes.
      seed: of the episodes, i more for lane i, until `reset` is given another.
      autoreset_mode: when a lane that has finished begins anew. `NEXT_STEP`: its next step ignores
        the action and returns the first observation, no reward and no info. `SAME_STEP`: the step
        that finishes returns the next episode's first observation, and the last one of the old
        episode with its info in `info["final_obs"]` and `info["final_info"]`.
      render_mode: as for `to_gymnasium`.
      flatten: as for `to_gymnasium`.

    Raises:
      JaxactError: as for `to_gymnasium`, or the lanes are none or never reset.
    """
    pomdp.check_single_agent("Gymnasium environments are")
    return _POMDPVectorEnv(pomdp, num_envs, seed, autoreset_mode, render_mode, flatten)


class _POMDPEnv(gymnasium.Env[Any, Any]):
    metadata = _METADATA

    def __init__(self, pomdp: POMDP, seed: int, render_mode: str | None, flatten: bool) -> None:
        check_render_mode(pomdp, render_mode)
        self._pomdp, self._flatten, self.render_mode = pomdp, flatten, render_mode
        self._seed, self._episode = seed, -1
        self._lane: Lane | None = None
        self.observation_space = to_space(pomdp.observation_space, flatten)
        self.action_space = to_space(pomdp.action_space)

    @explained()
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        if seed is not None:
            self._seed, self._episode = seed, -1
        self._episode += 1
        begin, _, _ = programs(self._pomdp)
        self._lane, observation = begin(seed_word(self._seed), np.int32(self._episode))
        return self._numpy(observation), {}

    @explained()
    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        action = to_jax(self._pomdp.action_space, action, ())
        _, step, _ = programs(self._pomdp)
        self._lane, result = step(self._playing(), action)
        result, info = jax.device_get((result, result.info))
        info = {name: value.item() for name, value in info.items()}
        return (
            self._numpy(result.observation),
            float(result.reward),
            bool(result.terminated),
            bool(result.truncated),
            info | {"is_success": info["success"]},
        )

    def render(self) -> Any:
        if self.render_mode is None:
            return None
        _, _, pictures = programs(self._pomdp)
        shown = jax.device_get(pictures(self._playing().state))
        return side_by_side(list(shown.values()))

    def _playing(self) -> Lane:
        if self._lane is None:
            raise ResetNeeded("no episode has begun: call reset() first")
        return self._lane

    def _numpy(self, observation: PyTree) -> Any:
        return to_numpy(self._pomdp.observation_space, observation, self._flatten)


@functools.lru_cache(16)
def _vector_programs(pomdp: POMDP, autoreset_mode: AutoresetMode) -> tuple[Any, Any, Any]:
    """Compiles the same for lanes [N], with their resets."""
    begin = jax.vmap(functools.partial(begin_episode, pomdp))

    def renew(lanes: Lane, observation: PyTree, due: jax.Array) -> tuple[Lane, PyTree]:
        """Begins the next episode of those lanes that are due, some at a time.

        Under vmap a reset within each step would sample an episode for every lane every time.
        """

        def begin_some(
            places: jax.Array, rows: jax.Array, now: tuple[Lane, PyTree]
        ) -> tuple[jax.Array, tuple[Lane, PyTree]]:
            lanes, _ = now
            fresh = begin(lanes.seed[rows], lanes.episode[rows] + 1)
            return jnp.zeros_like(places, bool), put_rows(now, places, fresh)

        return for_each_chosen(due, (lanes, observation), begin_some, share=16)

    def step(lanes: Lane, due: jax.Array, action: PyTree) -> tuple[Lane, PyTree, Step]:
        lanes, result = jax.vmap(functools.partial(step_episode, pomdp))(lanes, action)
        if autoreset_mode is AutoresetMode.NEXT_STEP:
            result = replace(
                result,
                reward=jnp.where(due, jnp.float32(0), result.reward),
                terminated=result.terminated & ~due,
                truncated=result.truncated & ~due,
            )
        else:
            due = result.finished
        lanes, observation = renew(lanes, result.observation, due)
        return lanes, observation, result

    return jax.jit(begin), jax.jit(step), jax.jit(jax.vmap(pomdp.pictures))


class _POMDPVectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    def __init__(
        self,
        pomdp: POMDP,
        num_envs: int,
        seed: int,
        autoreset_mode: AutoresetMode,
        render_mode: str | None,
        flatten: bool,
    ) -> None:
        check_render_mode(pomdp, render_mode)
        if num_envs < 1:
            raise JaxactError(f"num_envs must be at least 1, got {num_envs}")
        if num_envs > pomdp.lanes_at_once(num_envs):
            raise JaxactError(
                f"num_envs is {num_envs}, but the world can be simulated "
                f"{pomdp.environment.max_lanes} times at once"
            )
        if autoreset_mode is AutoresetMode.DISABLED:
            raise JaxactError("lanes reset themselves: autoreset_mode is NEXT_STEP or SAME_STEP")
        self._pomdp, self._flatten, self.render_mode = pomdp, flatten, render_mode
        self._begin, self._step, self._pictures = _vector_programs(pomdp, autoreset_mode)
        self._same_step = autoreset_mode is AutoresetMode.SAME_STEP
        self._lanes: Lane | None = None
        self._seeds = [seed + i for i in range(num_envs)]
        self._due = np.zeros(num_envs, bool)
        self.num_envs = num_envs
        self.metadata = {**_METADATA, "autoreset_mode": autoreset_mode}
        self.single_observation_space = to_space(pomdp.observation_space, flatten)
        self.single_action_space = to_space(pomdp.action_space)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    @explained()
    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        if options and "reset_mask" in options:
            raise JaxactError("lanes reset themselves: there is no reset_mask among the options")
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
        if seeds is not None and len(seeds) != self.num_envs:
            raise JaxactError(f"expected {self.num_envs} seeds, but got {len(seeds)}")
        super().reset(seed=seed if isinstance(seed, int) else None)
        last = np.full(self.num_envs, -1) if self._lanes is None else self._lanes.episode
        episodes = np.asarray(last, np.int32) + 1
        for lane, given in enumerate(seeds or ()):
            if given is not None:
                self._seeds[lane], episodes[lane] = given, 0
        words = np.array([seed_word(seed) for seed in self._seeds])
        self._lanes, observation = self._begin(words, episodes)
        self._due = np.zeros(self.num_envs, bool)
        return self._numpy(observation), {}

    @explained()
    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        action = to_jax(self._pomdp.action_space, actions, (self.num_envs,))
        self._lanes, observation, result = self._step(self._playing(), self._due, action)
        result, measured = jax.device_get((result, result.info))
        terminated, truncated = np.array(result.terminated), np.array(result.truncated)
        finished = terminated | truncated
        begun = finished if self._same_step else self._due
        self._due = finished
        measured = measured | {"is_success": measured["success"]}
        info = _masked(measured, ~begun)
        if self._same_step and begun.any():
            final = np.full(self.num_envs, None, object)
            for lane in np.flatnonzero(begun):
                last = jax.tree.map(lambda x, lane=lane: x[lane], result.observation)
                final[lane] = self._numpy(last)
            info |= {"final_obs": final, "_final_obs": begun.copy()}
            info |= {"final_info": _masked(measured, begun), "_final_info": begun.copy()}
        reward = np.array(result.reward, np.float64)
        return self._numpy(observation), reward, terminated, truncated, info

    def render(self) -> tuple[Any, ...] | None:
        if self.render_mode is None:
            return None
        shown = jax.device_get(self._pictures(self._playing().state))
        return tuple(
            side_by_side([picture[lane] for picture in shown.values()])
            for lane in range(self.num_envs)
        )

    def _playing(self) -> Lane:
        if self._lanes is None:
            raise ResetNeeded("no episode has begun: call reset() first")
        return self._lanes

    def _numpy(self, observation: PyTree) -> Any:
        return to_numpy(self._pomdp.observation_space, observation, self._flatten)


def _masked(values: dict[str, np.ndarray], mask: np.ndarray) -> dict[str, Any]:
    """Returns values [N] where the mask holds, and the mask for each, as Gymnasium has infos."""
    if not mask.any():
        return {}
    info = {}
    for name, value in values.items():
        chosen = np.where(mask, value, 0)
        info[name] = chosen.astype(bool if value.dtype == bool else np.float64)
        info[f"_{name}"] = mask.copy()
    return info
