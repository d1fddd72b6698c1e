"""Worlds of physics for `benchmarks.jax_loop`: jaxact's, and the simulators that they are made of.

Each kind of turnover has a pair: "none", where lanes go on through ends, so that only steps are
compared; and "own", where either side begins new episodes as its training does.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.env_systems import JaxactWorld

PyTree = Any


class Unending:
    """A POMDP's lanes, which go on through the ends of episodes."""

    def __init__(self, pomdp: Any) -> None:
        self.pomdp, self.action_space = pomdp, pomdp.action_space

    def begin(self, key: Any, lanes: int) -> tuple[PyTree, PyTree]:
        """See `benchmarks.jax_loop.World`."""
        return jax.vmap(self.pomdp.reset)(jax.random.split(key, lanes))

    def age(self, state: PyTree, share: Any) -> PyTree:
        """See `benchmarks.jax_loop.World`; there are no ends to be apart."""
        del share
        return state

    def step(self, key: Any, state: PyTree, action: Any) -> tuple[PyTree, PyTree, Any, Any]:
        """See `benchmarks.jax_loop.World`."""
        keys = jax.random.split(key, action.shape[0])
        state, step = jax.vmap(self.pomdp.step)(keys, state, action)
        return state, step.observation, step.reward, step.finished


class Brax:
    """Brax's environment by itself, with or without the wrappers that its trainers put round it."""

    def __init__(self, pomdp: Any, wrapped: bool) -> None:
        from brax.envs.wrappers.training import VmapWrapper, wrap

        theirs = pomdp.environment.theirs
        self.env = wrap(theirs, pomdp.sampler.horizon) if wrapped else VmapWrapper(theirs)
        self.wrapped, self.horizon = wrapped, pomdp.sampler.horizon
        self.action_space = pomdp.action_space

    def begin(self, key: Any, lanes: int) -> tuple[PyTree, PyTree]:
        """See `benchmarks.jax_loop.World`."""
        # Their wrappers know keys of the old kind alone.
        seed = jax.random.bits(key, (), jnp.uint32)
        state = self.env.reset(jax.random.split(jax.random.PRNGKey(seed), lanes))
        state = jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(x)), state)
        return state, state.obs

    def age(self, state: PyTree, share: Any) -> PyTree:
        """See `benchmarks.jax_loop.World`."""
        if not self.wrapped:
            return state
        return state.replace(info={**state.info, "steps": jnp.floor(share * self.horizon)})

    def step(self, key: Any, state: PyTree, action: Any) -> tuple[PyTree, PyTree, Any, Any]:
        """See `benchmarks.jax_loop.World`."""
        del key
        after = jax.tree.map(
            lambda x, y: jnp.broadcast_to(jnp.asarray(x, y.dtype), y.shape),
            self.env.step(jax.tree.map(lambda x: x, state), action),
            state,
        )
        return after, after.obs, after.reward, after.done > 0


class MJX:
    """`mjx.step`, and nothing round it: actions are controls, joints are what is seen."""

    def __init__(self, pomdp: Any) -> None:
        from envs_jax.physics.models import device_model, mjx

        self.pomdp, self.action_space = pomdp, pomdp.action_space
        self.mjx, self._host = mjx(), device_model(pomdp.environment.source)

    @property
    def model(self) -> Any:
        """Their model, its arrays constants of what is traced."""
        return jax.tree.map(jnp.asarray, self._host)

    def begin(self, key: Any, lanes: int) -> tuple[PyTree, PyTree]:
        """See `benchmarks.jax_loop.World`."""
        state, _ = jax.vmap(self.pomdp.reset)(jax.random.split(key, lanes))
        first = state.environment

        def start(position: Any, velocity: Any) -> Any:
            data = self.mjx.make_data(self.model)
            data = data.replace(qpos=position, qvel=velocity)
            return self.mjx.forward(self.model, data)

        data = jax.vmap(start)(first.position, first.velocity)
        return jax.tree.map(lambda x: jnp.asarray(x, x.dtype), data), (data.qpos, data.qvel)

    def age(self, state: PyTree, share: Any) -> PyTree:
        """See `benchmarks.jax_loop.World`; there are no ends to be apart."""
        del share
        return state

    def step(self, key: Any, state: PyTree, action: Any) -> tuple[PyTree, PyTree, Any, Any]:
        """See `benchmarks.jax_loop.World`."""
        del key

        def advance(data: Any, control: Any) -> Any:
            def substep(data: Any, _: None) -> tuple[Any, None]:
                return self.mjx.step(self.model, data), None

            substeps = self.pomdp.environment.substeps
            return jax.lax.scan(substep, data.replace(ctrl=control), None, substeps)[0]

        data = jax.vmap(advance)(state, action)
        nothing = jnp.zeros(action.shape[0], jnp.float32)
        return data, (data.qpos, data.qvel), nothing, nothing > 0


def systems_of(pomdp: Any) -> dict[str, dict[str, Any]]:
    """Returns the worlds to time, by turnover and system, jaxact's first."""
    none = {"jaxact": Unending(pomdp)}
    if hasattr(pomdp.environment, "source"):
        return {"none": {**none, "mjx": MJX(pomdp)}}
    own = {"jaxact": JaxactWorld(pomdp, 1), "brax": Brax(pomdp, wrapped=True)}
    return {"none": {**none, "brax": Brax(pomdp, wrapped=False)}, "own": own}
