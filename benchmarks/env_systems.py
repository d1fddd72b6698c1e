"""The systems whose worlds are timed: jaxact's own, and its peers, each run as well as it can be.

`build` starts one of them; what it returns runs repeats and says what was seen. A peer that is not
installed, or that lacks an id, raises `Unsupported`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

PyTree = Any
Facts = dict[str, Any]

# Each JAX system draws from the generator that it is fastest with: NAVIX's levels come from
# categorical draws, which philox makes slower.
PHILOX, THREEFRY = "philox2x32", "threefry2x32"
# MiniGrid's worlds are Python objects: more of them are not stepped any faster.
PYTHON_LANES = 8
# EnvPool's worlds must be stepped to grow old, which in long episodes would take minutes.
ENVPOOL_AGES = 128


class Unsupported(Exception):
    """A peer cannot run this; the message says why."""


class Running(Protocol):
    """A system under way."""

    compile_seconds: float

    def run(self) -> float:
        """Runs one repeat; returns the seconds it took."""
        ...

    def tallies(self) -> dict[str, float]:
        """Returns `checksum`, `reward` and `finished` so far."""
        ...


@dataclass(frozen=True)
class Job:
    """What one process measures.

    Attributes:
      id: Farama's id of the world.
      system: a key of `SYSTEMS`.
      lanes: worlds side by side.
      steps: of every lane in one repeat.
      seed: of everything random.
      devices: the lanes are sharded over so many (JAX systems).
      variant: a choice from `SYSTEMS[system].variants`.
      horizon: steps that peers give an episode.
    """

    id: str
    system: str
    lanes: int
    steps: int
    seed: int
    devices: int
    variant: str
    horizon: int = 0


@dataclass(frozen=True)
class System:
    """One system.

    Attributes:
      build: starts it, compiled and warm; its facts have the number of lanes and, of jaxact's
        worlds, the horizon.
      observation: what is consumed at every step.
      turnover: what happens when an episode ends.
      variants: ways to run it; all are tried, the fastest is reported. For JAX systems these are
        XLA_FLAGS.
      prng: the generator of its JAX keys; None if it is no JAX system.
      share: of the steps asked for; slow systems need fewer for a repeat as long.
    """

    build: Callable[[Job], tuple[Running, Facts]]
    observation: str
    turnover: str
    variants: tuple[str, ...]
    prng: str | None = None
    share: float = 1.0

    @property
    def is_jax(self) -> bool:
        """Whether it runs in the common loop, on JAX devices."""
        return self.prng is not None


def require(package: str) -> None:
    """Raises `Unsupported` if a package is not installed."""
    if find_spec(package) is None:
        raise Unsupported(
            f"{package} is not installed: run pip install -e '.[bench]', or leave it out of --peers"
        )


def _compile(world: Any, job: Job) -> tuple[Any, Facts]:
    from benchmarks.jax_loop import compile_loop

    prng = SYSTEMS[job.system].prng
    loop = compile_loop(world, job.seed, prng, job.lanes, job.steps, job.devices)
    return loop, {"lanes": job.lanes}


def _jaxact(job: Job) -> tuple[Running, Facts]:
    import envs_jax

    pomdp = envs_jax.make(job.id)
    loop, facts = _compile(JaxactWorld(pomdp, job.devices), job)
    # It may depend on the level.
    facts |= {"horizon": int(np.median(loop.carry.state[0].horizon))}
    return loop, facts | _of_agents(pomdp)


def _of_agents(pomdp: Any) -> Facts:
    """Returns what the line of a world of several agents says beside those of others."""
    from jaxact.spaces import Agents

    if not isinstance(pomdp.action_space, Agents):
        return {}
    readings = {n: x.structure for n, x in pomdp.observation_space.spaces.items()}
    seen = [f"{name} {'×'.join(map(str, x.shape[1:]))}" for name, x in readings.items()]
    return {"agents": pomdp.num_agents, "observation": f"{', '.join(seen)} of each agent"}


class JaxactWorld:
    """jaxact's worlds with the episode queues that its training uses."""

    def __init__(self, pomdp: Any, devices: int) -> None:
        self.pomdp, self.devices = pomdp, devices
        self.action_space = pomdp.action_space

    def begin(self, key: Any, lanes: int) -> tuple[PyTree, PyTree]:
        """See `benchmarks.jax_loop.World`."""
        import jax
        import jax.numpy as jnp

        from jaxact.rollout import QUEUE_LENGTH, start_lanes

        sampler_key, lanes_key = jax.random.split(key)
        sampler_state = self.pomdp.sampler.init(sampler_key)
        no_model = SimpleNamespace(initial_memory=lambda lanes: ())
        keys = jax.random.split(lanes_key, lanes)
        # Their horizon being zero, all of them turn over in the first step.
        waiting = start_lanes(self.pomdp, sampler_state, no_model, keys, QUEUE_LENGTH)
        # One copy of the sampler's state a device: its first axis is sharded as the lanes' are.
        sampler_states = jax.tree.map(
            lambda x: jnp.broadcast_to(x, (self.devices, *x.shape)), sampler_state
        )
        return (waiting.state, waiting.queue, sampler_states), waiting.observation

    def age(self, state: PyTree, share: Any) -> PyTree:
        """See `benchmarks.jax_loop.World`."""
        from dataclasses import replace

        worlds, queue, sampler_states = state
        steps = (share * worlds.horizon.astype(share.dtype)).astype(worlds.steps.dtype)
        return replace(worlds, steps=steps), queue, sampler_states

    def step(self, key: Any, state: PyTree, action: Any) -> tuple[PyTree, PyTree, Any, Any]:
        """See `benchmarks.jax_loop.World`."""
        import jax

        from jaxact.rollout import turn_over

        worlds, queue, sampler_states = state
        keys = jax.random.split(key, worlds.steps.shape[0])
        worlds, step = jax.vmap(self.pomdp.step)(keys, worlds, action)
        sampler_state = jax.tree.map(lambda x: x[0], sampler_states)
        queue, worlds, observation = turn_over(
            self.pomdp, sampler_state, queue, step.finished, worlds, step.observation
        )
        return (worlds, queue, sampler_states), observation, step.reward, step.finished


def _xminigrid(job: Job) -> tuple[Running, Facts]:
    require("xminigrid")
    import xminigrid

    name = job.id.removesuffix("-v0").replace("Empty-Random-", "EmptyRandom-")
    name = name.replace("UnlockPickup", "UnlockPickUp")
    if name not in xminigrid.registered_environments():
        raise Unsupported("xminigrid has no such world")
    return _compile(XMiniGridWorld(name, job.horizon), job)


class XMiniGridWorld:
    """XLand-MiniGrid's worlds with its own wrapper for turnover."""

    def __init__(self, name: str, max_steps: int) -> None:
        import xminigrid
        from xminigrid.wrappers import GymAutoResetWrapper

        from jaxact.spaces import Discrete

        env, params = xminigrid.make(name)
        self.env, self.params = GymAutoResetWrapper(env), params.replace(max_steps=max_steps)
        self.action_space = Discrete(env.num_actions(params))

    def begin(self, key: Any, lanes: int) -> tuple[PyTree, PyTree]:
        """See `benchmarks.jax_loop.World`."""
        import jax

        reset = jax.vmap(self.env.reset, in_axes=(None, 0))
        timestep = reset(self.params, jax.random.split(key, lanes))
        return timestep, timestep.observation

    def age(self, state: PyTree, share: Any) -> PyTree:
        """See `benchmarks.jax_loop.World`."""
        steps = (share * self.params.max_steps).astype(state.state.step_num.dtype)
        return state.replace(state=state.state.replace(step_num=steps))

    def step(self, key: Any, state: PyTree, action: Any) -> tuple[PyTree, PyTree, Any, Any]:
        """See `benchmarks.jax_loop.World`."""
        import jax

        del key
        step = jax.vmap(self.env.step, in_axes=(None, 0, 0))
        timestep = step(self.params, state, action)
        return timestep, timestep.observation, timestep.reward, timestep.last()


def _navix(job: Job) -> tuple[Running, Facts]:
    require("navix")
    import navix

    name = job.id.replace("MiniGrid-", "Navix-")
    if name not in navix.registry():
        raise Unsupported("navix has no such world")
    return _compile(NavixWorld(name, job.horizon), job)


class NavixWorld:
    """NAVIX's worlds; turnover is in its own `step`, which resets at the step after the end."""

    def __init__(self, name: str, max_steps: int) -> None:
        import navix

        from jaxact.spaces import Discrete

        view = navix.observations.symbolic_first_person
        self.env = navix.make(name, max_steps=max_steps, observation_fn=view)
        self.max_steps = max_steps
        self.action_space = Discrete(len(self.env.action_set))

    def begin(self, key: Any, lanes: int) -> tuple[PyTree, PyTree]:
        """See `benchmarks.jax_loop.World`."""
        import jax
        import jax.numpy as jnp
        from navix.rendering.cache import RenderingCache

        # Symbolic views need no sprites: without this each lane would carry a picture of its grid.
        no_sprites = RenderingCache(patches=jnp.zeros(1, jnp.uint8))
        reset = jax.vmap(self.env.reset, in_axes=(0, None))
        timestep = reset(jax.random.split(key, lanes), no_sprites)
        return timestep, timestep.observation

    def age(self, state: PyTree, share: Any) -> PyTree:
        """See `benchmarks.jax_loop.World`."""
        return state.replace(t=(share * self.max_steps).astype(state.t.dtype))

    def step(self, key: Any, state: PyTree, action: Any) -> tuple[PyTree, PyTree, Any, Any]:
        """See `benchmarks.jax_loop.World`."""
        import jax

        del key
        timestep = jax.vmap(self.env.step)(state, action)
        return timestep, timestep.observation, timestep.reward, timestep.step_type > 0


class Host:
    """Loops over worlds that live outside of JAX: what they share."""

    compile_seconds = 0.0

    def __init__(self) -> None:
        self.checksum, self.reward, self.finished = 0, 0.0, 0

    def tallies(self) -> dict[str, float]:
        """What the loop has seen so far."""
        checksum = self.checksum % 2**32
        return {"checksum": checksum, "reward": self.reward, "finished": self.finished}

    def consume(self, observation: dict[str, Any], reward: Any, finished: Any) -> None:
        """Adds up what was seen and earned."""
        for value in observation.values():
            if isinstance(value, str):
                self.checksum += len(value)
            elif np.ndim(value) == 0:
                self.checksum += int(value)
            else:
                flat = np.ascontiguousarray(value).reshape(-1).view(np.uint8)
                # Eight bytes at a time: NumPy sums wide words much faster than bytes.
                words = flat[: flat.size // 8 * 8].view(np.uint64)
                self.checksum += int(words.sum()) + int(flat[words.size * 8 :].sum())
        self.reward += float(np.sum(reward))
        self.finished += int(np.sum(finished))


def _envpool(job: Job) -> tuple[Running, Facts]:
    require("envpool")
    import envpool

    if job.id not in envpool.list_all_envs():
        raise Unsupported("envpool has no such world")
    return EnvPoolLoop(job), {"lanes": job.lanes}


class EnvPoolLoop(Host):
    """EnvPool's C++ worlds, a thread for each core; all lanes step together."""

    def __init__(self, job: Job) -> None:
        import envpool

        super().__init__()
        self.lanes, self.steps = job.lanes, job.steps
        self.env = envpool.make_gymnasium(
            job.id,
            num_envs=job.lanes,
            num_threads=os.cpu_count() or 1,
            seed=job.seed,
            max_episode_steps=job.horizon,
        )
        self.actions = int(self.env.action_space.n)
        self.random = np.random.default_rng(job.seed)
        self._start(min(job.horizon, ENVPOOL_AGES))
        self.run()

    def _start(self, oldest: int) -> None:
        self.env.reset()
        # Sixteen groups begin one after the other, so that episodes are of different ages.
        for group in np.array_split(np.arange(self.lanes, dtype=np.int32), 16):
            for _ in range(oldest // 16):
                self.env.step(self._draw())
            self.env.reset(group)

    def _draw(self) -> np.ndarray:
        return self.random.integers(0, self.actions, self.lanes, np.int32)

    def run(self) -> float:
        """Runs one repeat; returns the seconds it took."""
        begun = time.perf_counter()
        for _ in range(self.steps):
            observation, reward, ended, cut, _ = self.env.step(self._draw())
            self.consume(observation, reward, ended | cut)
        return time.perf_counter() - begun


def _minigrid(job: Job) -> tuple[Running, Facts]:
    require("minigrid")
    lanes = min(job.lanes, PYTHON_LANES)
    return MiniGridLoop(job, lanes), {"lanes": lanes}


class MiniGridLoop(Host):
    """MiniGrid itself: a plain loop over a few worlds in one process."""

    def __init__(self, job: Job, lanes: int) -> None:
        import gymnasium
        import minigrid  # noqa: F401 (registers the ids)

        super().__init__()
        try:
            make = gymnasium.make
            self.envs = [make(job.id, disable_env_checker=True).unwrapped for _ in range(lanes)]
        except gymnasium.error.Error as error:
            raise Unsupported("minigrid has no such world") from error
        self.random = np.random.default_rng(job.seed)
        self.steps = job.steps
        for lane, env in enumerate(self.envs):
            env.reset(seed=job.seed + lane)
            env.step_count = int(self.random.integers(env.max_steps))
        self.run()

    def run(self) -> float:
        """Runs one repeat; returns the seconds it took."""
        begun = time.perf_counter()
        for _ in range(self.steps):
            actions = self.random.integers(0, 7, len(self.envs))
            for env, action in zip(self.envs, actions, strict=True):
                observation, reward, ended, cut, _ = env.step(int(action))
                if ended or cut:
                    observation, _ = env.reset()
                self.consume(observation, reward, ended or cut)
        return time.perf_counter() - begun


def _jaxmarl(name: str) -> Callable[[Job], tuple[Running, Facts]]:
    def build(job: Job) -> tuple[Running, Facts]:
        require("jaxmarl")
        import envs_jax
        from benchmarks.jaxmarl_worlds import JaxMARLWorld

        if not _of_agents(envs_jax.make(job.id)):
            raise Unsupported("JaxMARL's worlds are set beside those of several agents only")
        world = JaxMARLWorld(name, job.horizon)
        loop, facts = _compile(world, job)
        return loop, facts | {"agents": world.env.num_agents}

    return build


FUSION_EMITTERS_OFF = "--xla_cpu_use_fusion_emitters=false"

SYSTEMS = {
    "jaxact": System(
        build=_jaxact,
        observation="image 7×7×3 with occlusion, direction, mission tokens",
        turnover="next episode from the lane's queue, at the same step",
        variants=("", FUSION_EMITTERS_OFF),
        prng=PHILOX,
    ),
    "xminigrid": System(
        build=_xminigrid,
        observation="view 7×7×2 without occlusion",
        turnover="GymAutoResetWrapper: at the same step; its cond under vmap resets at every step",
        variants=("", FUSION_EMITTERS_OFF),
        prng=PHILOX,
        share=1 / 32,
    ),
    "navix": System(
        build=_navix,
        observation="symbolic_first_person 7×7×3 without occlusion",
        turnover="its own: at the next step; its cond under vmap resets at every step",
        # With fusion emitters it is several times slower and takes minutes.
        variants=(FUSION_EMITTERS_OFF,),
        prng=THREEFRY,
        share=1 / 64,
    ),
    "envpool": System(
        build=_envpool,
        observation="image 7×7×3 with occlusion, direction, mission text",
        turnover="its own: at the next step",
        variants=("synchronous",),
        share=1 / 32,
    ),
    "minigrid": System(
        build=_minigrid,
        observation="image 7×7×3 with occlusion, direction, mission text",
        turnover="reset, at the same step; one process",
        variants=("plain loop",),
        share=1 / 4,
    ),
}
# Of worlds of one agent: each has the same worlds.
PEERS = tuple(name for name in SYSTEMS if name != "jaxact")
# Of worlds of several agents: one world each, which is not the same but of like size.
PEERS_OF_AGENTS = {
    "jaxmarl-coin": "3×3×4 of each of two agents",
    "jaxmarl-storm": "view 5×5×10 and inventory of each of two agents, on a grid of 8×8",
    "jaxmarl-overcooked": "4×5×26 of each of two agents",
}
SYSTEMS |= {
    name: System(
        build=_jaxmarl(name),
        observation=observation,
        turnover="its own: at the same step; its select under vmap resets at every step",
        variants=("", FUSION_EMITTERS_OFF),
        prng=PHILOX,
        share=1 / 8,
    )
    for name, observation in PEERS_OF_AGENTS.items()
}


def build(job: Job) -> tuple[Running, Facts]:
    """Starts a system; returns it and facts about it, see `System`.

    Raises:
      Unsupported: the peer is not installed, or lacks the id.
    """
    return SYSTEMS[job.system].build(job)
