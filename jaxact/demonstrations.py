"""Recorded demonstrations: a directory of plain `.npy` files that NumPy can map into memory.

`docs/demonstrations.md` describes the format; this module reads it, `demonstration_writer` writes
it.
"""

from __future__ import annotations

import json
import math
import warnings
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import quote

import jax
import numpy as np

from jaxact.demonstration_spaces import dict_from_json, space_from_json, space_to_json
from jaxact.demonstration_windows import DemonstrationData
from jaxact.errors import JaxactError, unknown
from jaxact.overrides import fingerprint
from jaxact.pomdp import POMDP, PyTree
from jaxact.spaces import Dict, Discrete, Space

FORMAT = 2
# Without components of the reward and policies of experts.
_FIRST_FORMAT = 1
MANIFEST = "demonstrations.json"
PER_STEP, PER_EPISODE = "step", "episode"

_READ_AT_ONCE = 1 << 24
_MANIFEST_KEYS = {
    "format", "complete", "world", "actor", "seed", "settings", "action_space",
    "observation_space", "final_observations", "reward_terms", "expert_policy", "episodes", "steps",
    "played", "shards",
}  # fmt: skip


@dataclass(frozen=True)
class Field:
    """One array of a shard.

    Attributes:
      per: "step" or "episode", what its first axis counts.
      shape: of one entry.
      dtype: its name.
    """

    per: str
    shape: tuple[int, ...]
    dtype: str

    @property
    def bytes(self) -> int:
        """Size of one entry."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


@dataclass(frozen=True)
class Description:
    """What a set of demonstrations is of.

    Attributes:
      world: its name.
      actor: who acted: "kind" is "expert", "policy" or "minari", the rest says which.
      seed: of the episodes, None where there is none.
      action_space: of the world.
      observation_space: of the world; a space by name.
      final_observations: whether the last observation of each episode is kept.
      reward_terms: names of the reward's components that are kept.
      expert_policy: whether the expert's probabilities of its n discrete actions are kept.
      settings: what else the set was made with, as JSON holds it.
    """

    world: str
    actor: Mapping[str, Any]
    seed: int | None
    action_space: Space
    observation_space: Dict
    final_observations: bool = False
    reward_terms: tuple[str, ...] = ()
    expert_policy: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)

    def fields(self) -> dict[str, Field]:
        """Returns the arrays of every shard by name.

        Raises:
          JaxactError: a dtype that `.npy` files cannot hold, or an expert's policy where actions
            are not discrete.
        """
        observation = named_leaves("observation", self.observation_space.structure)
        steps = {**observation, **named_leaves("action", self.action_space.structure)}
        flags = dict.fromkeys(("valid", "terminated", "truncated", "success"), np.dtype(bool))
        scalars = {"reward": np.dtype(np.float32), **flags}
        scalars |= {f"reward_terms.{name}": np.dtype(np.float32) for name in self.reward_terms}
        found = {n: Field(PER_STEP, tuple(x.shape), str(x.dtype)) for n, x in steps.items()}
        found |= {n: Field(PER_STEP, (), str(dtype)) for n, dtype in scalars.items()}
        if self.expert_policy:
            if not isinstance(self.action_space, Discrete):
                raise JaxactError(
                    f"an expert's policy is of discrete actions, not of {self.action_space}"
                )
            found["policy"] = Field(PER_STEP, (self.action_space.n,), "float32")
        found["first_step"] = Field(PER_EPISODE, (), "int64")
        if self.final_observations:
            for name, x in observation.items():
                found[f"final_{name}"] = Field(PER_EPISODE, tuple(x.shape), str(x.dtype))
        for name, one in found.items():
            if np.dtype(one.dtype).kind not in "biufc":
                raise JaxactError(f"{name} has dtype {one.dtype}, which .npy files cannot hold")
        return found

    def to_json(self) -> dict[str, Any]:
        """Describes it in JSON's types."""
        return {
            "world": self.world,
            "actor": dict(self.actor),
            "seed": self.seed,
            "settings": dict(self.settings),
            "action_space": space_to_json(self.action_space),
            "observation_space": space_to_json(self.observation_space),
            "final_observations": self.final_observations,
            "reward_terms": list(self.reward_terms),
            "expert_policy": self.expert_policy,
        }


class Demonstrations:
    """A complete set of demonstrations; its arrays stay on the disk until they are looked at.

    Attributes:
      path: the directory.
      description: what it is of.
      episodes: how many there are.
      steps: of all of them together.
      played: episodes that were played for it; more than `episodes` where only some were kept.
      shards: arrays by field name, mapped into memory, for each shard.
    """

    def __init__(self, path: str | Path) -> None:
        """Opens a set; looks at the sizes and headers of all files, not at what is in them.

        Raises:
          JaxactError: there is none, it is not complete, or a file is missing or not as written.
        """
        self.path = Path(path)
        manifest = read_manifest(self.path)
        if not manifest["complete"]:
            raise JaxactError(
                f"{path} is not complete: it has {manifest['episodes']:,} episodes so far; the "
                "command that began it goes on with it"
            )
        self.description = Description(
            world=manifest["world"],
            actor=manifest["actor"],
            seed=manifest["seed"],
            action_space=space_from_json(manifest["action_space"]),
            observation_space=dict_from_json(manifest["observation_space"]),
            final_observations=manifest["final_observations"],
            reward_terms=tuple(manifest["reward_terms"]),
            expert_policy=manifest["expert_policy"],
            settings=manifest["settings"],
        )
        self.episodes: int = manifest["episodes"]
        self.steps: int = manifest["steps"]
        self.played: int = manifest["played"]
        self._entries: list[dict[str, Any]] = manifest["shards"]
        fields = self.description.fields()
        self.shards = [open_shard(self.path, fields, entry) for entry in self._entries]

    def verify(self) -> None:
        """Reads everything there is and compares it with the checksums.

        Raises:
          JaxactError: a file is not what was written, or its episodes make no sense.
        """
        for entry, shard in zip(self._entries, self.shards, strict=True):
            verify_shard(self.path, entry)
            first = np.append(shard["first_step"], entry["steps"])
            ends = np.flatnonzero(shard["terminated"] | shard["truncated"])
            if first[0] != 0 or not np.array_equal(ends, first[1:] - 1):
                raise JaxactError(
                    f"{self.path / entry['name']} is not consistent: its episodes do not end where "
                    "terminated or truncated say so"
                )

    def check(self, pomdp: POMDP) -> None:
        """Makes sure that what was recorded is what a world's models see and do.

        Observations that the world has not are no harm, nor is another sampler. Where environment,
        task (and with it the expert) or a sensor are others than those of the recording, there is a
        warning, if the recording says what they were.

        Raises:
          JaxactError: another action space, or an observation that is missing or of another space.
        """
        recorded = self.description
        if recorded.action_space != pomdp.action_space:
            raise JaxactError(
                f"{self.path} was recorded in {recorded.world} with actions "
                f"{recorded.action_space}, but this world takes {pomdp.action_space}"
            )
        for name, space in pomdp.observation_space.spaces.items():
            if name not in recorded.observation_space.spaces:
                raise unknown(
                    f"observation in {self.path}", name, recorded.observation_space.spaces
                )
            if recorded.observation_space.spaces[name] != space:
                raise JaxactError(
                    f"{self.path} was recorded in {recorded.world} with the observation {name!r} "
                    f"of {recorded.observation_space.spaces[name]}, but this world's is of {space}"
                )

        then, now = recorded.settings.get("world_parts", {}), world_parts(pomdp)
        others = [
            f"{name} ({then[name]['type']}, here {part['type']})"
            if part["type"] != then[name]["type"]
            else f"{name} ({part['type']} with other settings)"
            for name, part in now.items()
            if name in then and part != then[name]
        ]
        if others:
            warnings.warn(
                f"{self.path} was recorded in another world than this one, with another "
                f"{', '.join(others)}: what was right there may be wrong here",
                stacklevel=2,
            )

    def load(self, pomdp: POMDP | None = None) -> DemonstrationData:
        """Reads all steps into memory, as `demonstration_windows` streams through them, and makes
        sure that they are what was written.

        Args:
          pomdp: a world they have to suit; observations that it has not are left out.

        Returns:
          NumPy arrays; `jax.device_put` brings them to a device.

        Raises:
          JaxactError: they do not suit the world, were altered, or are more than int32 can count.
        """
        if self.steps >= 2**31:
            raise JaxactError(f"{self.path} has {self.steps:,} steps; at most 2^31 - 1 can be used")
        if pomdp is not None:
            self.check(pomdp)
        self.verify()
        names = (pomdp.observation_space if pomdp else self.description.observation_space).spaces

        def joined(name: str) -> Any:
            return np.concatenate([shard[name] for shard in self.shards])

        firsts: list[Any] = []
        before = 0
        for entry, shard in zip(self._entries, self.shards, strict=True):
            firsts.append(shard["first_step"] + before)
            before += entry["steps"]
        first_step: Any = np.concatenate([*firsts, [before]]).astype(np.int32)
        final = None
        if self.description.final_observations:
            final = {name: joined(f"final_observation.{name}") for name in names}
        return DemonstrationData(
            first_step=first_step,
            observation={name: joined(f"observation.{name}") for name in names},
            action=_tree(self.description.action_space, joined),
            valid=joined("valid"),
            reward=joined("reward"),
            terminated=joined("terminated"),
            truncated=joined("truncated"),
            final_observation=final,
            reward_terms={n: joined(f"reward_terms.{n}") for n in self.description.reward_terms},
            policy=joined("policy") if self.description.expert_policy else None,
        )

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """Yields the arrays of one episode after the other, by field name, mapped into memory."""
        fields = self.description.fields()
        for entry, shard in zip(self._entries, self.shards, strict=True):
            first = np.append(shard["first_step"], entry["steps"])
            for number, (begin, end) in enumerate(pairwise(first)):
                yield {
                    name: shard[name][begin:end] if one.per == PER_STEP else shard[name][number]
                    for name, one in fields.items()
                    if name != "first_step"
                }


def world_parts(pomdp: POMDP) -> dict[str, dict[str, str]]:
    """Returns name of the class and fingerprint of every part of a world but its sampler: two
    worlds may well differ in which episodes they begin with.
    """
    sensors = {f"sensor {name}": sensor for name, sensor in pomdp.sensors.items()}
    parts = {"environment": pomdp.environment, "task": pomdp.task, **sensors}
    return {
        name: {"type": type(part).__name__, "fingerprint": fingerprint(part)}
        for name, part in parts.items()
    }


def named_leaves(prefix: str, tree: PyTree) -> dict[str, Any]:
    """Returns the leaves of a tree by dotted names, in the order of `jax.tree.leaves`."""
    named = {}
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        keys = [str(getattr(key, "key", getattr(key, "idx", key))) for key in path]
        named[".".join([prefix, *keys])] = leaf
    return named


def _tree(space: Space, leaf: Any) -> PyTree:
    """Builds the action's tree of the fields it was taken apart into."""
    names = named_leaves("action", space.structure)
    return jax.tree.unflatten(jax.tree.structure(space.structure), [leaf(name) for name in names])


def file_name(field_name: str) -> str:
    """Returns the name of a field's file; a sensor's name may have any characters in it."""
    return f"{quote(field_name, safe=' ')}.npy"


def read_manifest(path: Path) -> dict[str, Any]:
    """Reads a set's `demonstrations.json`.

    Raises:
      JaxactError: there is none, it is damaged, or of another version of the format.
    """
    file = path / MANIFEST
    if not file.is_file():
        raise JaxactError(f"{path} holds no demonstrations: it has no {MANIFEST}")
    try:
        manifest = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise JaxactError(f"{file} cannot be read: {error}") from None
    version = manifest.get("format") if isinstance(manifest, dict) else None
    if version == _FIRST_FORMAT:
        manifest = {"reward_terms": [], "expert_policy": False} | manifest
    elif version != FORMAT:
        raise JaxactError(
            f"{file} is of format {version}; this version of jaxact reads {_FIRST_FORMAT} and "
            f"{FORMAT}"
        )
    missing = _MANIFEST_KEYS - manifest.keys()
    if missing:
        raise JaxactError(f"{file} is not what was written: it lacks {', '.join(sorted(missing))}")
    return manifest


def open_shard(path: Path, fields: Mapping[str, Field], entry: Mapping[str, Any]) -> dict[str, Any]:
    """Maps the files of a shard into memory, after a look at their sizes and headers.

    Raises:
      JaxactError: one is missing or not as written.
    """
    arrays = {}
    for name, one in fields.items():
        file = path / entry["name"] / file_name(name)
        if not file.is_file():
            raise JaxactError(f"{file} is missing")
        size = entry["files"].get(file.name, [None])[0]
        if file.stat().st_size != size:
            raise JaxactError(
                f"{file} has {file.stat().st_size:,} bytes, but {size:,} were written"
            )
        try:
            array = np.load(file, mmap_mode="r")
        except ValueError as error:
            raise JaxactError(f"{file} is not a .npy file any more: {error}") from None
        shape = (entry["steps" if one.per == PER_STEP else "episodes"], *one.shape)
        if (array.shape, array.dtype) != (shape, np.dtype(one.dtype)):
            raise JaxactError(
                f"{file} was altered: it has {array.dtype}{list(array.shape)} where "
                f"{one.dtype}{list(shape)} were written"
            )
        arrays[name] = array
    return arrays


def verify_shard(path: Path, entry: Mapping[str, Any]) -> None:
    """Reads the files of a shard and compares them with their checksums.

    Raises:
      JaxactError: one is not what was written.
    """
    for name, (_, expected) in entry["files"].items():
        file = path / entry["name"] / name
        if _checksum(file) != expected:
            raise JaxactError(f"{file} was altered: its checksum is not that in {MANIFEST}")


def _checksum(path: Path) -> int:
    checksum = 0
    with path.open("rb") as file:
        while data := file.read(_READ_AT_ONCE):
            checksum = zlib.crc32(data, checksum)
    return checksum
