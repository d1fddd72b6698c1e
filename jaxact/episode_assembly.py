"""From what lanes did side by side to whole episodes, one after the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jaxact.errors import JaxactError


@dataclass(frozen=True)
class Assembled:
    """Whole episodes in the order of their numbers.

    Attributes:
      arrays: by field name, with "first_step".
      played: number of the first episode that is still to come.
    """

    arrays: dict[str, np.ndarray]
    played: int


class EpisodeAssembly:
    """Gathers rows of steps until the episodes of a shard are whole.

    What is in a shard depends on the episodes and their numbers alone, never on when they ended: it
    is cut after the first episode with which all so far, kept or not, have `shard_steps` steps.

    Args:
      first: number of the first episode.
      wanted: how many are to be kept.
      shard_steps: size of a shard.
      successful_only: whether episodes without success are left out.
    """

    def __init__(self, first: int, wanted: int, shard_steps: int, successful_only: bool) -> None:
        self.first = first
        self._left = wanted
        self._shard_steps = shard_steps
        self._successful_only = successful_only
        self._rows: list[dict[str, np.ndarray]] = []
        # Of the episodes from the first on: steps, 0 for as long as it has not ended; success.
        self._length = np.zeros(0, np.int64)
        self._success = np.zeros(0, bool)
        # Sums over all episodes that have ended: how many, with success, steps.
        self._sums = np.zeros(3, np.int64)

    @property
    def oldest(self) -> int:
        """Number of the first episode that has not ended."""
        return self.first + self._whole()

    @property
    def kept(self) -> int:
        """How many of the whole episodes waiting here will be kept, at most as many as wanted."""
        return min(int(self._is_kept(self._whole()).sum()), self._left)

    @property
    def metrics(self) -> dict[str, float]:
        """Means over the episodes that have ended, as training logs them."""
        count, success, steps = map(float, self._sums)
        count = max(count, 1.0)
        return {"train/success": success / count, "train/length": steps / count}

    @property
    def done(self) -> bool:
        """Whether all that were wanted have been taken."""
        return self._left == 0

    def add(self, rows: Mapping[str, np.ndarray]) -> None:
        """Adds what `EpisodeStream.play` returned."""
        active = rows["active"]
        names = [name for name in rows if name != "active"]
        flat = {name: rows[name][active] for name in names}
        self._rows.append(flat)
        ends = flat["terminated"] | flat["truncated"]
        index = flat["number"][ends].astype(np.int64) - self.first
        if index.size and index.max() >= len(self._length):
            more = int(index.max()) + 1 - len(self._length)
            self._length = np.pad(self._length, (0, more))
            self._success = np.pad(self._success, (0, more))
        length, success = flat["step"][ends] + 1, flat["success"][ends]
        self._length[index], self._success[index] = length, success
        self._sums += [len(index), success.sum(), length.sum()]

    def take(self) -> Assembled | None:
        """Returns the next shard if its episodes are whole; none when all wanted are taken.

        Raises:
          JaxactError: none of as many episodes as go into a shard is to be kept.
        """
        whole = self._whole()
        kept = self._is_kept(whole)
        steps, count = np.cumsum(self._length[:whole]), np.cumsum(kept)
        full = (steps >= self._shard_steps) | (count >= self._left)
        if self.done or not full.any():
            return None
        cut = int(np.argmax(full)) + 1
        kept = kept[:cut]
        if not kept.any():
            raise JaxactError(f"none of {cut:,} episodes in a row succeeded: nothing to record")
        assembled = Assembled(self._ordered(kept), self.first + cut)
        self._drop(cut)
        self._left -= int(kept.sum())
        return assembled

    def _whole(self) -> int:
        """How many episodes from the first on have ended, without a gap."""
        ended = self._length > 0
        return len(ended) if ended.all() else int(np.argmin(ended))

    def _is_kept(self, count: int) -> np.ndarray:
        return self._success[:count] if self._successful_only else np.ones(count, bool)

    def _ordered(self, kept: np.ndarray) -> dict[str, np.ndarray]:
        """Returns the rows of the kept ones of the first episodes, sorted by episode and step."""
        chosen = []
        for rows in self._rows:
            index = rows["number"].astype(np.int64) - self.first
            chosen.append((index < len(kept)) & kept[np.minimum(index, len(kept) - 1)])

        def joined(name: str) -> np.ndarray:
            return np.concatenate([x[name][y] for x, y in zip(self._rows, chosen, strict=True)])

        step = joined("step")
        order = np.lexsort((step, joined("number")))
        first_step = np.flatnonzero(step[order] == 0)
        last_step = np.append(first_step[1:], len(step)) - 1
        arrays = {"first_step": first_step.astype(np.int64)}
        for name in self._rows[0].keys() - {"number", "step"}:
            final = name.startswith("final_")
            arrays[name] = joined(name)[order[last_step] if final else order]
        return arrays

    def _drop(self, cut: int) -> None:
        """Forgets the first episodes."""
        self.first += cut
        self._length, self._success = self._length[cut:], self._success[cut:]
        left = []
        for rows in self._rows:
            late = rows["number"] >= self.first
            if late.any():
                left.append({name: values[late] for name, values in rows.items()})
        self._rows = left
