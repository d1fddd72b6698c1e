"""The loop that every JAX system is timed in: random actions, everything seen is consumed.

A system brings a `World`; the loop draws one batch of actions a step, steps the lanes, adds up what
was seen and earned, and is compiled ahead of time, its lanes sharded over the devices.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxact.errors import JaxactError
from jaxact.spaces import Agents, Discrete, Space

PyTree = Any
AXIS = "lanes"


class World(Protocol):
    """Lanes of worlds that turn over by themselves; the arrays' first axis is the lane."""

    action_space: Space

    def begin(self, key: jax.Array, lanes: int) -> tuple[PyTree, PyTree]:
        """Returns lanes, whose first episodes may begin only after the first step, and what is
        seen there."""
        ...

    def age(self, state: PyTree, share: jax.Array) -> PyTree:
        """Returns the lanes with shares, float32[lanes], of their episodes' time used up."""
        ...

    def step(
        self, key: jax.Array, state: PyTree, action: PyTree
    ) -> tuple[PyTree, PyTree, jax.Array, jax.Array]:
        """Returns the lanes' state and observation to go on with, rewards, and who finished."""
        ...


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Carry:
    """What goes round the loop; the tallies' leading axis is the device.

    Attributes:
      key: PRNG keys.
      state: of the lanes.
      observation: what a policy would look at next.
      checksum: uint32, of all that was seen.
      reward: float32, sum of rewards.
      finished: int32, how many episodes ended.
    """

    key: jax.Array
    state: PyTree
    observation: PyTree
    checksum: jax.Array
    reward: jax.Array
    finished: jax.Array


@dataclass
class Loop:
    """A compiled loop and where it stands; `run` is one repeat."""

    program: Callable[[Carry], Carry]
    carry: Carry
    compile_seconds: float

    def run(self) -> float:
        """Runs one repeat; returns the seconds it took."""
        begun = time.perf_counter()
        self.carry = jax.block_until_ready(self.program(self.carry))
        return time.perf_counter() - begun

    def tallies(self) -> dict[str, float]:
        """What the loop has seen so far."""
        carry = self.carry
        return {
            "checksum": int(np.sum(np.asarray(carry.checksum), dtype=np.uint32)),
            "reward": float(np.sum(np.asarray(carry.reward))),
            "finished": int(np.sum(np.asarray(carry.finished))),
        }


def compile_loop(world: World, seed: int, prng: str, lanes: int, steps: int, devices: int) -> Loop:
    """Starts the lanes, compiles `steps` steps of them, and runs these once.

    Then episodes are made to be of different ages.

    Raises:
      JaxactError: the lanes cannot be divided among the devices.
    """
    if lanes % devices:
        raise JaxactError(f"{lanes} lanes cannot be divided among {devices} devices")
    mesh = Mesh(np.asarray(jax.devices()[:devices]), (AXIS,))
    spread = NamedSharding(mesh, PartitionSpec(AXIS))
    key = jax.random.key(seed, impl=prng)
    start = jax.jit(partial(_start, world, lanes=lanes, devices=devices))
    carry = start(key)
    # Arrays without elements come out of the loop replicated, so that is how they go in.
    everywhere = NamedSharding(mesh, PartitionSpec())
    places = jax.tree.map(lambda x: spread if x.size else everywhere, carry)
    carry = jax.block_until_ready(jax.device_put(carry, places))

    specs = PartitionSpec(AXIS)
    go = partial(_run, world, lanes=lanes // devices, steps=steps)
    if devices > 1:
        go = jax.shard_map(go, mesh=mesh, in_specs=specs, out_specs=specs, check_vma=False)
    begun = time.perf_counter()
    program = jax.jit(go, donate_argnums=0).lower(carry).compile()
    loop = Loop(program, carry, time.perf_counter() - begun)
    loop.run()
    shares = np.random.default_rng(seed).random(lanes, np.float32)
    aged = jax.jit(world.age)(loop.carry.state, jax.device_put(shares, spread))
    loop.carry = replace(loop.carry, state=aged)
    return loop


def _start(world: World, key: jax.Array, *, lanes: int, devices: int) -> Carry:
    loop_key, world_key = jax.random.split(key)
    state, observation = world.begin(world_key, lanes)
    return Carry(
        key=jax.random.split(loop_key, devices),
        state=state,
        observation=observation,
        checksum=jnp.zeros(devices, jnp.uint32),
        reward=jnp.zeros(devices, jnp.float32),
        finished=jnp.zeros(devices, jnp.int32),
    )


def _run(world: World, carry: Carry, *, lanes: int, steps: int) -> Carry:
    """Steps the lanes of one device."""

    def step(carry: Carry, _: None) -> tuple[Carry, None]:
        key, action_key, world_key = jax.random.split(carry.key[0], 3)
        # The observation is read here, as a policy would read it, before acting.
        seen = checksum(carry.observation)
        action = draw_actions(world.action_space, action_key, lanes)
        state, observation, reward, finished = world.step(world_key, carry.state, action)
        return Carry(
            key=key[None],
            state=state,
            observation=observation,
            checksum=carry.checksum + seen,
            reward=carry.reward + jnp.sum(reward, dtype=jnp.float32),
            finished=carry.finished + jnp.sum(finished, dtype=jnp.int32),
        ), None

    return jax.lax.scan(step, carry, None, steps)[0]


def draw_actions(space: Space, key: jax.Array, lanes: int) -> PyTree:
    """Draws a uniform action for each lane, in one batch where the space is discrete."""
    if isinstance(space, Discrete):
        return jax.random.randint(key, (lanes,), 0, space.n, jnp.int32)
    if isinstance(space, Agents) and isinstance(space.space, Discrete):
        return jax.random.randint(key, (lanes, space.count), 0, space.space.n, jnp.int32)
    return jax.vmap(space.sample)(jax.random.split(key, lanes))


def checksum(observation: PyTree) -> jax.Array:
    """Returns a uint32 that depends on every element of every leaf (of floats: on their bits)."""

    def total(leaf: jax.Array) -> jax.Array:
        if jnp.issubdtype(leaf.dtype, jnp.floating):
            leaf = jax.lax.bitcast_convert_type(leaf.astype(jnp.float32), jnp.uint32)
        if leaf.dtype == jnp.bool_:
            leaf = leaf.astype(jnp.uint8)
        # Over lanes, and in the leaf's own type, wrapping round: the cheapest way to read it all.
        rows = jnp.sum(leaf.reshape(leaf.shape[0], -1), axis=0, dtype=leaf.dtype)
        return jnp.sum(rows.astype(jnp.uint32), dtype=jnp.uint32)

    return sum((total(leaf) for leaf in jax.tree.leaves(observation)), start=jnp.uint32(0))
