"""Recording demonstrations: `python -m jaxact.collect EXPERIMENT --output DIRECTORY`."""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxact.demonstration_writer import DemonstrationWriter
from jaxact.demonstrations import Demonstrations, Description, world_parts
from jaxact.episode_assembly import EpisodeAssembly
from jaxact.episode_stream import LANES, EpisodeStream
from jaxact.errors import JaxactError, unknown
from jaxact.evaluate import choose_checkpoints, load_policy, load_run
from jaxact.loading import load_experiment, shipped_examples
from jaxact.overrides import fingerprint, override
from jaxact.policy import Policy
from jaxact.pomdp import POMDP, ExpertAction, PyTree, Step
from jaxact.progress import ProgressDisplay
from jaxact.runs import CONFIG
from jaxact.simulators import explained

# The package whose `make(id)` builds worlds; named, for the library imports no worlds.
WORLDS = "envs_jax"
# Lanes may be so many episodes ahead of the oldest that has not ended, for these wait in memory.
_AHEAD = 16 * LANES


@explained()
def collect(
    pomdp: POMDP,
    output: str | Path,
    episodes: int,
    *,
    world: str,
    policy: Policy | None = None,
    actor: Mapping[str, Any] | None = None,
    greedy: bool = False,
    seed: int = 0,
    successful_only: bool = False,
    final_observations: bool = False,
    progress: bool = True,
) -> Demonstrations:
    """Records episodes, or goes on with recording them: the result is the same, bit for bit.

    Episode k of the seed's stream is recorded if k < `episodes`, however long it is. With
    `successful_only` the first `episodes` of those with success are.

    Args:
      pomdp: the world.
      output: the directory.
      episodes: how many.
      world: the name that is kept with them.
      policy: who acts; by default the task's expert, with a random action where it abstains.
      actor: says which policy it is, in JSON's types; a digest of its parameters is kept, too.
      greedy: whether the policy takes the most likely actions.
      seed: of the episodes.
      successful_only: leave out episodes without success.
      final_observations: keep what was seen after the last step of each episode.
      progress: whether to show it.

    Raises:
      JaxactError: there is something else in the directory, no expert, or no success.
    """
    if episodes < 1:
        raise JaxactError(f"episodes must be at least 1, got {episodes}")
    pomdp.check_single_agent("recordings are")
    if policy is None and not pomdp.has_expert:
        raise JaxactError(f"{type(pomdp.task).__name__} has no expert: give a policy to record")
    acting = {"kind": "expert"} if policy is None else {"kind": "policy", **(actor or {})}
    if policy is not None:
        acting |= {"greedy": greedy, "parameters": _digest(policy.params)}
    step, advice = jax.eval_shape(partial(_first_step, pomdp), jax.random.key(0))
    description = Description(
        world=world,
        actor=acting,
        seed=seed,
        action_space=pomdp.action_space,
        observation_space=pomdp.observation_space,
        final_observations=final_observations,
        reward_terms=tuple(step.reward_terms),
        expert_policy=policy is None and advice is not None and advice.policy is not None,
        settings={
            "episodes": episodes,
            "successful_only": successful_only,
            "world_fingerprint": fingerprint(pomdp),
            "world_parts": world_parts(pomdp),
        },
    )
    writer = DemonstrationWriter(Path(output), description)
    if writer.complete:
        return Demonstrations(output)
    stream = EpisodeStream(pomdp, policy, greedy, seed, writer.played, final_observations)
    left = episodes - writer.episodes
    assembly = EpisodeAssembly(writer.played, left, writer.shard_steps, successful_only)
    last = 2**31 if successful_only else episodes
    with ProgressDisplay(episodes, progress, unit="episodes") as display:
        coming = stream.play(min(last, assembly.oldest + _AHEAD))
        while not assembly.done:
            rows, coming = coming, stream.play(min(last, assembly.oldest + _AHEAD))
            assembly.add(jax.device_get(rows))
            recorded = writer.episodes + assembly.kept
            display.update("recording", recorded, assembly.metrics)
            while shard := assembly.take():
                writer.write(shard.arrays, shard.played)
    return writer.finish()


def collect_named(
    name: str,
    output: Path,
    episodes: int,
    *,
    overrides: Sequence[str] = (),
    checkpoint: str | None = None,
    **options: Any,
) -> Demonstrations:
    """Records episodes of a world that is given by name, and prints what there is.

    Args:
      name: an experiment as `jaxact.train` takes it, a run's directory or a world's id.
      output: the directory.
      episodes: how many.
      overrides: changes of the experiment, or of the world if it is that ("path=value").
      checkpoint: "newest", "best" or a step: of the run whose policy is to be recorded.
      **options: see `collect`.

    Raises:
      JaxactError: there is nothing of that name, or see `collect`.
    """
    is_run = (Path(name) / CONFIG).is_file()
    policy, actor = None, None
    if is_run:
        experiment = load_run(name)
        world, pomdp = experiment.name, override(experiment, overrides).pomdp
        if checkpoint is not None:
            if checkpoint == "all":
                raise JaxactError("one checkpoint at a time: newest, best or a step")
            (step,) = choose_checkpoints(Path(name), checkpoint)
            policy = load_policy(name, experiment, step)
            run = Path(name).resolve()
            actor = {"run": f"{run.parent.name}/{run.name}", "checkpoint": step}
    elif checkpoint is not None:
        raise JaxactError(f"{name} is not a run's directory, so it has no checkpoint to record")
    else:
        world, pomdp = _world(name, overrides)
    demonstrations = collect(
        pomdp, output, episodes, world=world, policy=policy, actor=actor, **options
    )
    size = sum(f.stat().st_size for f in Path(output).rglob("*") if f.is_file())
    print(
        f"{output}: {demonstrations.episodes:,} of {demonstrations.played:,} episodes played, "
        f"{demonstrations.steps:,} steps, {size / 1e6:,.1f} MB"
    )
    return demonstrations


def _first_step(pomdp: POMDP, key: jax.Array) -> tuple[Step, ExpertAction | None]:
    """Returns what a step and the expert's advice look like."""
    state, _ = pomdp.reset(key)
    _, step = pomdp.step(key, state, pomdp.action_space.zeros())
    return step, pomdp.expert(key, state) if pomdp.has_expert else None


def _digest(params: PyTree) -> str:
    """Returns what tells one policy's parameters from another's."""
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(jax.device_get(params)):
        digest.update(np.ascontiguousarray(leaf).tobytes())
    return digest.hexdigest()


def _world(name: str, overrides: Sequence[str]) -> tuple[str, POMDP]:
    """Returns name and world of an experiment, or of a world's id."""
    if name.endswith(".py") or name in shipped_examples() or "." in name:
        experiment = override(load_experiment(name)[0], overrides)
        return experiment.name, experiment.pomdp
    worlds = importlib.import_module(WORLDS)
    if name not in worlds.ids():
        raise unknown("world or experiment", name, [*worlds.ids(), *shipped_examples()])
    return name, override(worlds.make(name), overrides)


if __name__ == "__main__":
    from jaxact.command_line import run_collect

    run_collect()
