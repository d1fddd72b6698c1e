"""Worlds behind Brax's interface, for its own trainers, such as `brax.training.agents.ppo`.

    from brax.training.agents.ppo import train as ppo
    restore_device_put_replicated()
    ppo.train(to_brax(pomdp), wrap_env_fn=wrap, episode_length=100, …)

Its trainers' wrappers do not sample episodes: `AutoResetWrapper` keeps each lane's first state
and begins every episode there again, until the trainer itself resets (`num_resets_per_eval` of its
PPO). So a lane plays one episode's beginning over and over, with new chance in its steps.
`jaxact.rollout` plays a fresh episode each time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import Env, State
from brax.envs.wrappers.training import AutoResetWrapper, EpisodeWrapper, VmapWrapper
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxact.errors import JaxactError, check_at_least
from jaxact.gymnax_spaces import flattened
from jaxact.pomdp import POMDP, PyTree
from jaxact.spaces import Box


def to_brax(pomdp: POMDP) -> BraxEnvironment:
    """Makes an environment with the methods of `brax.envs.Env` of a world.

    Raises:
      JaxactError: the world is one of several agents or outside of JAX, or its actions are not a
        box of floats: the policies of Brax's trainers are normal distributions.
    """
    if not isinstance(pomdp, POMDP):
        raise JaxactError(f"to_brax needs a POMDP, as of envs_jax.make, but it was given {pomdp!r}")
    pomdp.check_in_jax("Brax's environments are")
    pomdp.check_single_agent("Brax's environments are")
    space = pomdp.action_space
    if not isinstance(space, Box) or not jnp.issubdtype(jnp.dtype(space.dtype), jnp.floating):
        raise JaxactError(
            f"Brax's trainers act with numbers from −1 to 1, and this world takes {space}; "
            "to_gymnax is for libraries with discrete actions, as PureJaxRL and Rejax"
        )
    return BraxEnvironment(pomdp, space)


class BraxEnvironment(Env):  # type: ignore[misc, unused-ignore]
    """A world with the methods of `brax.envs.Env`; see `to_brax`.

    An observation is one vector, float32 [n], of the sensors' readings in the order of their
    names, one-hot where they are discrete. Actions are float32 [m] from −1 to 1, spread over a box
    that has bounds; where it has none on a side they are taken as they are. What Brax calls the
    pipeline's state is the whole `jaxact.pomdp.State`.

    `done` is set by termination and by the world's horizon, and `info["time_out"]` tells that it
    was the horizon alone. Trainers know of it by `wrap`, or with `bootstrap_on_timeout` of Brax's
    PPO; otherwise they take the end for a termination. `info["key"]` is of the chance in steps to
    come.

    Metrics are what `Step.info` has, as float32. Brax's evaluation sums them over an episode, so
    "success" and "task/…" are zero before its last step.
    """

    def __init__(self, pomdp: POMDP, space: Box) -> None:
        self.pomdp = pomdp
        self._space = space
        bounded = math.isfinite(space.low) and math.isfinite(space.high)
        self._middle = (space.high + space.low) / 2 if bounded else 0.0
        self._reach = (space.high - space.low) / 2 if bounded else 1.0

    def reset(self, rng: jax.Array) -> State:
        """Returns the first state of an episode."""
        reset_key, key = jax.random.split(rng)
        state, observation = self.pomdp.reset(reset_key)
        action = self._space.structure
        _, step = jax.eval_shape(self.pomdp.step, key, state, action)
        zero = jnp.zeros((), jnp.float32)
        return State(
            pipeline_state=state,
            obs=self._observed(observation),
            reward=zero,
            done=zero,
            metrics={name: zero for name in step.info},
            info={"key": key, "time_out": zero},
        )

    def step(self, state: State, action: jax.Array) -> State:
        """Takes a step; never resets."""
        step_key, key = jax.random.split(state.info["key"])
        action = jnp.asarray(action, self._space.dtype)
        if action.size != self.action_size:
            raise JaxactError(
                f"an action is of {self.action_size} numbers, but it has the shape {action.shape}"
            )
        action = action.reshape(self._space.shape)
        action = self._middle + self._reach * action
        after, step = self.pomdp.step(step_key, state.pipeline_state, action)
        last = step.finished.astype(jnp.float32)
        metrics = {
            name: jnp.asarray(value, jnp.float32) * (1.0 if name.startswith("reward/") else last)
            for name, value in step.info.items()
        }
        time_out = (step.truncated & ~step.terminated).astype(jnp.float32)
        return state.replace(
            pipeline_state=after,
            obs=self._observed(step.observation),
            reward=step.reward,
            done=last,
            metrics={**state.metrics, **metrics},
            info={**state.info, "key": key, "time_out": time_out},
        )

    @property
    def observation_size(self) -> int:
        """The length n of an observation."""
        space = self.pomdp.observation_space
        return int(jax.eval_shape(lambda: flattened(space, space.zeros())).size)

    @property
    def action_size(self) -> int:
        """The length m of an action."""
        return math.prod(self._space.shape)

    @property
    def backend(self) -> str:
        """The name that Brax asks for the physics: none of its own."""
        return "jaxact"

    def _observed(self, observation: PyTree) -> jax.Array:
        return flattened(self.pomdp.observation_space, observation)


def wrap(
    env: Env,
    episode_length: int,
    action_repeat: int = 1,
    randomization_fn: Callable[..., Any] | None = None,
) -> Env:
    """Wraps a `BraxEnvironment` as Brax's trainers wrap theirs, but for the world's own horizon.

    For their argument `wrap_env_fn`. An episode that reaches its horizon, or else
    `episode_length`, is truncated, and the trainers bootstrap from there.

    Args:
      env: from `to_brax`.
      episode_length: the most steps of an episode.
      action_repeat: steps with each action.
      randomization_fn: must be None; what differs between episodes is the sampler's business.

    Raises:
      JaxactError: it is not from `to_brax`, there is a `randomization_fn`, or a number below 1.
    """
    if not isinstance(env, BraxEnvironment):
        raise JaxactError(
            f"wrap needs an environment from to_brax, not yet wrapped, but got {env!r}"
        )
    check_at_least(1, "wrap", episode_length=episode_length, action_repeat=action_repeat)
    if randomization_fn is not None:
        raise JaxactError(
            "randomization_fn changes a system of Brax's, which this world has none of; vary its "
            "episodes with its task sampler"
        )
    return AutoResetWrapper(_OwnHorizons(VmapWrapper(env), episode_length, action_repeat))


def restore_device_put_replicated() -> None:
    """Gives JAX back `jax.device_put_replicated` for this process, if it has none.

    Brax 0.14.2's trainers begin with a call of it, and JAX 0.10 has removed it.
    """
    if hasattr(jax, "device_put_replicated"):
        return

    def device_put_replicated(tree: PyTree, devices: Sequence[Any]) -> PyTree:
        """Returns a tree with a copy of each array for every device, on an axis in front."""
        spread = NamedSharding(Mesh(np.asarray(devices), ("devices",)), PartitionSpec("devices"))
        copies = jax.tree.map(lambda x: jnp.stack([jnp.asarray(x)] * len(devices)), tree)
        return jax.device_put(copies, spread)

    setattr(jax, "device_put_replicated", device_put_replicated)  # noqa: B010


class _OwnHorizons(EpisodeWrapper):  # type: ignore[misc, unused-ignore]
    """Counts a world's own horizon as a truncation, besides the trainer's episode length."""

    def step(self, state: State, action: jax.Array) -> State:
        after = super().step(state, action)
        truncation = jnp.maximum(after.info["truncation"], after.info["time_out"])
        return after.replace(info={**after.info, "truncation": truncation})
