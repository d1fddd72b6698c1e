"""End-to-end training speed of GoToLocal PPO, and where its time goes.

Run `python -m benchmarks.train_throughput`; it prints JSON lines:

* the machine;
* training, on one device and on one for each core: environment steps a second over whole updates,
  the shares of time spent in the worlds (stepping, observing, turnover), in acting (the policy,
  sampling) and in updating (advantages and gradient steps), and the model's FLOP/s as a fraction of
  those of a large matrix product, timed in turn with it;
* with `--startup`: seconds from the start of the process to the end of the first update, without
  and with the persistent compilation cache.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import tyro

# Side of the square float32 matrices whose product is the measure.
MATMUL_SIZE = 4096
# The passes over each batch that PPO made when speed was first measured.
PASSES = ("pipeline.epochs=2", "pipeline.minibatches=4")


@dataclass(frozen=True)
class Arguments:
    """Measures training speed."""

    experiment: str = "babyai_gotolocal_ppo"
    """As `python -m jaxact.train` takes it; its first stage is measured."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = PASSES
    """PATH=VALUE overrides of the experiment; those by default are there for comparisons with older
    figures."""
    updates: int = 10
    """Updates in one timed call."""
    repeats: int = 8
    """Timed calls."""
    devices: tuple[int, ...] = tuple(sorted({1, os.cpu_count() or 1}))
    """Numbers of devices to shard the lanes over; on a CPU they are simulated."""
    startup: bool = False
    """Measure the time from the start of a process to its first update, too."""


def main() -> None:
    """Parses the command line and prints the figures."""
    import jax

    arguments = tyro.cli(Arguments)
    jax.config.update("jax_num_cpu_devices", max(arguments.devices))
    _print_machine()
    for devices in arguments.devices:
        print(json.dumps(_measure(arguments, devices)), flush=True)
    if arguments.startup:
        _measure_startup(arguments)


def _print_machine() -> None:
    import jax
    import jaxlib

    machine = {
        "system": "machine",
        "cores": os.cpu_count(),
        "device": str(jax.devices()[0]),
        "jax": jax.__version__,
        "jaxlib": jaxlib.__version__,
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
    }
    print(json.dumps(machine), flush=True)


def _measure(arguments: Arguments, devices: int) -> dict[str, Any]:
    import jax
    import jax.numpy as jnp
    import numpy as np

    from jaxact.describe import update_flops
    from jaxact.loading import load_experiment
    from jaxact.overrides import override
    from jaxact.program import Program, choose_devices
    from jaxact.train_state import make_key

    experiment = override(load_experiment(arguments.experiment)[0], arguments.set)
    program = Program(experiment, choose_devices(devices))
    numbers, state = program.numbers(), program.start(make_key(0))
    count = np.int32(arguments.updates)
    began = time.perf_counter()
    stage = program.compile_stage(0, arguments.updates)
    compile_seconds = time.perf_counter() - began

    square = jnp.full((MATMUL_SIZE, MATMUL_SIZE), 0.5, jnp.float32)
    product = jax.jit(lambda x: x @ x)
    product(square).block_until_ready()
    state, _ = stage(state, numbers, count, program.data)
    seconds, matmul_seconds = [], []
    for _ in range(arguments.repeats):
        began = time.perf_counter()
        product(square).block_until_ready()
        matmul_seconds.append(time.perf_counter() - began)
        began = time.perf_counter()
        state, _ = jax.block_until_ready(stage(state, numbers, count, program.data))
        seconds.append((time.perf_counter() - began) / arguments.updates)
    worlds, rollout = _rollout_seconds(experiment, state, arguments.repeats)

    steps = experiment.pipeline.steps_per_update(experiment.pipeline.stages[0])
    whole = min(seconds)
    flops = update_flops(experiment, 0)
    peak = 2.0 * MATMUL_SIZE**3 / min(matmul_seconds)
    ratios = [b / a for a, b in zip(seconds, matmul_seconds, strict=True)]
    return {
        "id": arguments.experiment,
        "set": arguments.set,
        "system": "jaxact",
        "devices": devices,
        "lanes": experiment.pipeline.lanes,
        "steps_per_second": round(steps / whole),
        "steps_per_second_median": round(steps / statistics.median(seconds)),
        "share_environment": round(worlds / whole, 3),
        "share_acting": round((rollout - worlds) / whole, 3),
        "share_update": round(1 - rollout / whole, 3),
        "flops_per_step": round(flops),
        "gflops": round(flops * steps / whole / 1e9, 1),
        "matmul_gflops": round(peak / 1e9, 1),
        "fraction_of_matmul": round(flops * steps / whole / peak, 3),
        "fraction_of_matmul_median": round(
            flops * steps / (2.0 * MATMUL_SIZE**3) * statistics.median(ratios), 3
        ),
        "compile_seconds": round(compile_seconds, 1),
        "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }


def _rollout_seconds(experiment: Any, state: Any, repeats: int) -> tuple[float, float]:
    """Times the rollout of an update with a policy that costs nothing, and with the model."""
    import jax
    import jax.numpy as jnp

    from jaxact.distributions import Categorical
    from jaxact.models.output import ActorCriticOutput
    from jaxact.rollout import rollout

    pomdp = experiment.pomdp
    length = experiment.pipeline.at(experiment.pipeline.stages[0]).rollout_length

    def idle(observation: Any, memory: Any, action: Any, is_first: Any) -> Any:
        # Every reading is used, so that no sensor is left out of the compiled program.
        seen = sum(
            jnp.sum(x.reshape(x.shape[0], -1).astype(jnp.float32), axis=1)
            for x in jax.tree.leaves(observation)
        )
        logits = jnp.zeros((seen.shape[0], pomdp.action_space.n)) + 1e-9 * seen[:, None]
        return ActorCriticOutput(Categorical(logits), jnp.zeros_like(seen)), memory

    def run(state: Any, policy: Any) -> Any:
        return rollout(pomdp, policy, state.sampler, state.lanes, length)

    def model(state: Any) -> Any:
        return run(state, lambda *inputs: experiment.model.apply(state.params, *inputs))

    worlds = _seconds(jax.jit(lambda state: run(state, idle)), state, repeats=repeats)
    return worlds, _seconds(jax.jit(model), state, repeats=repeats)


def _seconds(function: Callable[..., Any], *inputs: Any, repeats: int) -> float:
    """Returns the least time of a call, compilation apart."""
    import jax

    jax.block_until_ready(function(*inputs))
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(function(*inputs))
        times.append(time.perf_counter() - began)
    return min(times)


def _measure_startup(arguments: Arguments) -> None:
    """Times processes that do one update: with nothing cached, filling the cache, and from it."""
    with tempfile.TemporaryDirectory() as directory:
        for name, cached in (("none", False), ("filled", True), ("used", True)):
            command = [sys.executable, "-m", "jaxact.train", arguments.experiment]
            command += ["--output", directory, "--total-steps", "1", "--log-every", "1"]
            command += ["--evaluation-episodes", "0"]
            command += ["--compilation-cache"] if cached else []
            environment = {**os.environ, "XDG_CACHE_HOME": directory}
            began = time.perf_counter()
            process = subprocess.Popen(
                command,
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
            assert process.stdout is not None
            first = None
            for line in process.stdout:
                if first is None and line.startswith("stage 0"):
                    first = time.perf_counter() - began
            process.wait()
            line = {"id": arguments.experiment, "system": "jaxact", "compilation_cache": name}
            line["seconds_to_first_update"] = None if first is None else round(first, 1)
            print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
