"""PPO by jaxact and by Brax, in turns: the same environment, sizes of networks and batches."""

from __future__ import annotations

import functools
import statistics
import time
from typing import Any

import flax.linen as nn
import jax
import numpy as np

import envs_jax
from jaxact import Experiment, Stage, TrainingPipeline
from jaxact.losses import PPO
from jaxact.models import ActorCriticOutput, ActorHead, NoMemory, Normalized
from jaxact.program import Program, choose_devices
from jaxact.train_state import make_key

Line = dict[str, Any]
ROLLOUT, MINIBATCHES, EPOCHS = 16, 4, 4


class _Layers(nn.Module):
    """Brax's layers: dense, swish."""

    sizes: tuple[int, ...]

    @nn.compact
    def __call__(self, observation: Any) -> jax.Array:
        x = observation["observation"]
        for size in self.sizes:
            x = nn.swish(nn.Dense(size)(x))
        return x


class _Both(nn.Module):
    """Features for the policy and for the value, of layers of their own."""

    sizes: tuple[int, ...]

    @nn.compact
    def __call__(self, observation: Any) -> tuple[jax.Array, jax.Array]:
        return _Layers(self.sizes)(observation), _Layers(self.sizes)(observation)


class Towers(nn.Module):
    """Networks of policy and value apart, as Brax's are."""

    action_space: Any
    sizes: tuple[int, ...]

    @nn.compact
    def __call__(
        self, observation: Any, memory: Any, previous_action: Any, is_first: Any
    ) -> tuple[ActorCriticOutput, Any]:
        """See `jaxact.models.ActorCritic`."""
        del previous_action, is_first
        policy, value = Normalized(_Both(self.sizes))(observation)
        distribution = ActorHead(self.action_space, squashed=True)(policy)
        return ActorCriticOutput(distribution, nn.Dense(1)(value)[..., 0]), memory

    @nn.nowrap
    def initial_memory(self, lanes: int) -> Any:
        """Returns none."""
        return NoMemory().initial(lanes)


def measure_training(
    name: str, lanes: int, updates: int, repeats: int, sizes: tuple[int, ...]
) -> list[Line]:
    """Returns a line of each system, and one of their ratio.

    Args:
      name: an id of Brax's worlds.
      lanes: worlds side by side.
      updates: in one repeat.
      repeats: of each system, taken in turns.
      sizes: of the hidden layers of either network.
    """
    from brax.training.agents.ppo import networks
    from brax.training.agents.ppo import train as ppo

    from jaxact.brax_adapter import restore_device_put_replicated

    restore_device_put_replicated()
    pomdp = envs_jax.make(name)
    ours, compile_seconds = _ours(pomdp, lanes, updates, sizes)
    seconds: dict[str, list[float]] = {"jaxact": [], "brax": []}
    steps = updates * lanes * ROLLOUT

    def turn(_: int, metrics: dict[str, Any]) -> None:
        """Brax has done a repeat: the first of them compiled."""
        seconds["jaxact"].append(ours())
        if "training/sps" in metrics:
            seconds["brax"].append(steps / float(metrics["training/sps"]))

    factory = functools.partial(
        networks.make_ppo_networks,
        policy_hidden_layer_sizes=sizes,
        value_hidden_layer_sizes=sizes,
    )
    ppo.train(
        environment=pomdp.environment.theirs,
        num_timesteps=(repeats + 1) * steps,
        max_devices_per_host=1,
        num_envs=lanes,
        episode_length=pomdp.sampler.horizon,
        unroll_length=ROLLOUT,
        batch_size=lanes // MINIBATCHES,
        num_minibatches=MINIBATCHES,
        num_updates_per_batch=EPOCHS,
        normalize_observations=True,
        learning_rate=3e-4,
        discounting=0.99,
        # One more than there are repeats: the first is of the policy at the beginning.
        num_evals=repeats + 2,
        run_evals=False,
        network_factory=factory,
        progress_fn=turn,
    )
    # What Brax's first repeat took is compiling.
    taken = {"jaxact": seconds["jaxact"][-repeats:], "brax": seconds["brax"][-repeats:]}
    head = {"id": name, "training": "ppo", "lanes": lanes}
    lines: list[Line] = [
        {
            **head,
            "system": system,
            "steps_per_second": round(steps / min(times), 1),
            "steps_per_second_median": round(steps / statistics.median(times), 1),
            "rollout_length": ROLLOUT,
            "minibatches": MINIBATCHES,
            "epochs": EPOCHS,
            "layers": list(sizes),
            "updates": updates,
            "repeats": len(times),
        }
        for system, times in taken.items()
    ]
    lines[0]["compile_seconds"] = round(compile_seconds, 2)
    rates = [line["steps_per_second"] for line in lines]
    pairs = zip(taken["jaxact"], taken["brax"], strict=True)
    ratio = {
        **head,
        "ratio_to": "brax",
        "ratio": round(rates[0] / rates[1], 3),
        # Of each turn by itself: what else the machine does falls on both.
        "ratio_median": round(statistics.median(b / a for a, b in pairs), 3),
    }
    return [*lines, ratio]


def _ours(pomdp: Any, lanes: int, updates: int, sizes: tuple[int, ...]) -> tuple[Any, float]:
    """Returns what trains for a repeat and tells its seconds, and the seconds of compiling."""
    experiment = Experiment(
        name="physics_training",
        pomdp=pomdp,
        model=Towers(pomdp.action_space, sizes),
        pipeline=TrainingPipeline(
            stages=(Stage({"ppo": PPO()}, steps=10**9),),
            lanes=lanes,
            rollout_length=ROLLOUT,
            minibatches=MINIBATCHES,
            epochs=EPOCHS,
            learning_rate=3e-4,
        ),
    )
    program = Program(experiment, choose_devices(1))
    numbers = program.numbers()
    begun = time.perf_counter()
    stage = program.compile_stage(0, updates)
    compile_seconds = time.perf_counter() - begun
    state = program.start(make_key(0))

    def repeat() -> float:
        nonlocal state
        begun = time.perf_counter()
        state, _ = jax.block_until_ready(stage(state, numbers, np.int32(updates), program.data))
        return time.perf_counter() - begun

    return repeat, compile_seconds
