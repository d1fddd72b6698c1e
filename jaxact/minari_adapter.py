"""Demonstrations from and for Minari, the Farama Foundation's collection of offline data sets.

Minari keeps data sets in a directory of its own, by id; `minari download ID` fetches a published
one. It holds T + 1 observations of an episode of T steps, so only demonstrations recorded with
their final observations can be exported.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxact.demonstration_writer import DemonstrationWriter
from jaxact.demonstrations import Demonstrations, Description, named_leaves
from jaxact.errors import JaxactError, unknown
from jaxact.pomdp import POMDP
from jaxact.spaces import Box, Dict, Discrete, Space, Tuple

try:
    import gymnasium
    import minari
    from minari.data_collector import EpisodeBuffer

    from jaxact.gymnasium_spaces import from_space, to_numpy, to_space
except ImportError as error:
    raise JaxactError(
        f"Minari's data sets need the package minari: pip install 'jaxact[minari]' ({error})"
    ) from None

# Episodes handed to Minari at once.
_AT_ONCE = 1000
_INFOS = {"success": "success", "expert_valid": "valid"}


def from_minari(
    dataset_id: str,
    output: str | Path,
    *,
    pomdp: POMDP | None = None,
    encode: Mapping[str, Callable[[str], np.ndarray]] | None = None,
) -> Demonstrations:
    """Imports a local Minari data set, or goes on with importing it.

    Observations are named as in its space, those within others with dots, and "observation" where
    it has no names. Wider numbers become float32 and int32. An episode that was cut off without a
    flag is truncated. Steps have success where its infos have "success", and are valid unless they
    have "expert_valid" and that is false.

    Args:
      dataset_id: Minari's name of it, such as "D4RL/pointmaze/umaze-v2".
      output: the directory to write.
      pomdp: a world to import it for: its sensors alone are taken, and its spaces put in place of
        the data set's, whose values must lie in them.
      encode: for observations that are texts, by name, what makes an array of one; for grid worlds
        {"mission": envs_jax.minigrid.missions.encode_mission}. They need a `pomdp`.

    Raises:
      JaxactError: there is no such data set, or something in it that cannot be taken over.
    """
    try:
        dataset = minari.load_dataset(dataset_id)
    except (FileNotFoundError, ValueError) as error:
        raise JaxactError(f"Minari cannot load {dataset_id!r}: {error}") from None
    encode = dict(encode or {})
    given = _named(dataset.observation_space, dataset.observation_space)
    if pomdp is None:
        observations = {name: from_space(space) for name, space in given.items()}
        action_space = from_space(dataset.action_space)
    else:
        observations = dict(pomdp.observation_space.spaces)
        action_space = pomdp.action_space
    for name in (*observations, *encode):
        if name not in given:
            raise unknown(f"observation in {dataset_id}", name, given)
    description = Description(
        world=dataset_id if dataset.env_spec is None else dataset.env_spec.id,
        actor={"kind": "minari", "dataset": dataset_id},
        seed=None,
        action_space=action_space,
        observation_space=Dict(observations),
        final_observations=True,
    )
    writer = DemonstrationWriter(Path(output), description)
    if writer.complete:
        return Demonstrations(output)
    episodes: list[dict[str, np.ndarray]] = []
    steps = 0
    for episode in dataset.iterate_episodes(dataset.episode_indices[writer.played :]):
        seen = _named(dataset.observation_space, episode.observations)
        episodes.append(_imported(episode, seen, description, encode))
        steps += len(episodes[-1]["reward"])
        if steps >= writer.shard_steps:
            writer.write(_joined(episodes), writer.played + len(episodes))
            episodes, steps = [], 0
    if episodes:
        writer.write(_joined(episodes), writer.played + len(episodes))
    return writer.finish()


def to_minari(
    demonstrations: Demonstrations, dataset_id: str, *, author: str | None = None
) -> minari.MinariDataset:
    """Exports demonstrations as a new local Minari data set: all but policies and reward terms.

    Args:
      demonstrations: with their final observations.
      dataset_id: Minari's name for it, such as "babyai/gotolocal-expert-v0".
      author: kept with it.

    Raises:
      JaxactError: the final observations were not recorded, or there is such a data set already.
    """
    of = demonstrations.description
    if not of.final_observations:
        raise JaxactError(
            f"{demonstrations.path} has no final observations, which Minari wants: record it with "
            "--final-observations"
        )
    buffers = (_exported(episode, of) for episode in demonstrations)
    try:
        # Minari warns of every piece of information that a published data set should have.
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            dataset = minari.create_dataset_from_buffers(
                dataset_id,
                list(islice(buffers, _AT_ONCE)),
                action_space=to_space(of.action_space),
                observation_space=to_space(of.observation_space),
                algorithm_name=str(of.actor.get("run", of.actor["kind"])),
                author=author,
                description=f"{of.world}, recorded by jaxact ({dict(of.actor)}, seed {of.seed})",
                jpeg_encoding=False,
            )
    except ValueError as error:
        raise JaxactError(f"Minari cannot create {dataset_id!r}: {error}") from None
    while some := list(islice(buffers, _AT_ONCE)):
        dataset.update_dataset_from_buffer(some)
    return dataset


def _named(space: gymnasium.Space[Any], values: Any, name: str = "") -> dict[str, Any]:
    """Returns values of a space, which may be of spaces within it, by dotted names."""
    match space:
        case gymnasium.spaces.Dict():
            parts: list[Any] = list(space.spaces)
        case gymnasium.spaces.Tuple():
            parts = list(range(len(space.spaces)))
        case _:
            return {name or "observation": values}
    return {
        key: leaf
        for part in parts
        for key, leaf in _named(
            space[part], values[part], f"{name}.{part}" if name else str(part)
        ).items()
    }


def _imported(
    episode: minari.EpisodeData,
    observations: Mapping[str, Any],
    description: Description,
    encode: Mapping[str, Callable[[str], np.ndarray]],
) -> dict[str, np.ndarray]:
    """Returns an episode's arrays by field name, without "first_step"."""
    arrays = {}
    for name, space in description.observation_space.spaces.items():
        values = observations[name]
        if name in encode:
            values = [encode[name](text) for text in values]
        seen = _conforming(f"observation {name!r}", space, values)
        arrays[f"observation.{name}"] = seen[:-1]
        arrays[f"final_observation.{name}"] = seen[-1:]
    spaces = _leaf_spaces(description.action_space)
    for (name, values), space in zip(
        named_leaves("action", episode.actions).items(), spaces, strict=True
    ):
        arrays[name] = _conforming(name, space, values)
    arrays["reward"] = np.asarray(episode.rewards, np.float32)
    steps = len(arrays["reward"])
    arrays["terminated"] = np.asarray(episode.terminations, bool)
    arrays["truncated"] = np.array(episode.truncations, bool)
    arrays["truncated"][-1] |= not arrays["terminated"][-1]
    infos = episode.infos or {}
    for info, name in _INFOS.items():
        # The first of T + 1 infos is that of the reset.
        arrays[name] = np.asarray(infos.get(info, np.full(steps, info != "success")), bool)[-steps:]
    return arrays


def _joined(episodes: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Returns the arrays of a shard."""
    arrays = {name: np.concatenate([one[name] for one in episodes]) for name in episodes[0]}
    ends = np.cumsum([len(one["reward"]) for one in episodes])
    return {"first_step": np.concatenate([[0], ends[:-1]]), **arrays}


def _exported(episode: Mapping[str, np.ndarray], description: Description) -> EpisodeBuffer:
    observation = {
        name: np.concatenate(
            [episode[f"observation.{name}"], episode[f"final_observation.{name}"][None]]
        )
        for name in description.observation_space.spaces
    }
    space = description.action_space
    names = named_leaves("action", space.structure)
    action = jax.tree.unflatten(
        jax.tree.structure(space.structure), [episode[name] for name in names]
    )
    return EpisodeBuffer(
        observations=to_numpy(description.observation_space, observation, flatten=False),
        actions=to_numpy(space, action, flatten=False),
        rewards=episode["reward"].tolist(),
        terminations=episode["terminated"].tolist(),
        truncations=episode["truncated"].tolist(),
        infos={
            info: np.concatenate([[info != "success"], episode[name]])
            for info, name in _INFOS.items()
        },
    )


def _leaf_spaces(space: Space) -> list[Space]:
    """Returns the spaces of the leaves, in the order of `jax.tree.leaves`."""
    match space:
        case Tuple(parts):
            return [leaf for part in parts for leaf in _leaf_spaces(part)]
        case Dict(named):
            return [leaf for part in named.values() for leaf in _leaf_spaces(part)]
    return [space]


def _conforming(what: str, space: Space, values: Any) -> np.ndarray:
    """Returns values as a space has them.

    Raises:
      JaxactError: they are not of its shape, or lie outside of its bounds.
    """
    structure, array = space.structure, np.asarray(values)
    low, high = (0, space.n - 1) if isinstance(space, Discrete) else (-np.inf, np.inf)
    if isinstance(space, Box):
        low, high = space.low, space.high
    if array.shape[1:] != structure.shape or array.dtype.kind not in "biuf":
        raise JaxactError(
            f"the {what} of the data set is {array.dtype}{list(array.shape[1:])}, but it should be "
            f"{structure.dtype}{list(structure.shape)}"
        )
    if array.size and not (low <= array.min() and array.max() <= high):
        raise JaxactError(
            f"the {what} of the data set has values from {array.min()} to {array.max()}, which are "
            f"not all in {space}"
        )
    return array.astype(structure.dtype)
