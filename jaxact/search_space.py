"""Where a random search draws an experiment's numbers from.

A range maps a uniform number in [0, 1) to a value. A search space gives ranges to numbers of an
experiment by their dotted paths. A draw is a pure function of a seed, the draw's index and the
paths: a search of fifty draws begins with the ten of a shorter one, and what is drawn for one
number does not depend on which others are drawn.
"""

from __future__ import annotations

import difflib
import math
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from jaxact.errors import JaxactError, unknown
from jaxact.overrides import leaves, numbers


@dataclass(frozen=True)
class Range:
    """Where one number comes from: `uniform`, `log_uniform`, `normal`, `choice` or `in_order`.

    Attributes:
      kind: which of these.
      arguments: its arguments.
    """

    kind: str
    arguments: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.kind not in _QUANTILES:
            raise unknown("range", self.kind, _QUANTILES)
        if not all(map(math.isfinite, self.arguments)):
            raise JaxactError(f"{self}: expected finite numbers")
        if self.kind in ("choice", "in_order"):
            if not self.arguments:
                raise JaxactError(f"{self.kind}() needs at least one value")
        elif len(self.arguments) != 2:
            raise JaxactError(f"{self}: expected two numbers, got {len(self.arguments)}")
        elif self.kind == "normal":
            if self.arguments[1] <= 0:
                raise JaxactError(f"{self}: the deviation must be positive")
        elif not self.arguments[0] < self.arguments[1]:
            raise JaxactError(f"{self}: the lower end must be below the upper one")
        elif self.kind == "log_uniform" and self.arguments[0] <= 0:
            raise JaxactError(f"{self}: the lower end must be positive")

    def __str__(self) -> str:
        return f"{self.kind}({', '.join(map(repr, self.arguments))})"

    def at(self, quantile: float) -> float:
        """Returns the value below which this share, in (0, 1), of all draws lie."""
        return float(_QUANTILES[self.kind](quantile, *self.arguments))


def uniform(low: float, high: float) -> Range:
    """Equally likely everywhere between two ends."""
    return Range("uniform", (float(low), float(high)))


def log_uniform(low: float, high: float) -> Range:
    """Its logarithm is uniform: each order of magnitude between two ends is equally likely."""
    return Range("log_uniform", (float(low), float(high)))


def normal(mean: float, deviation: float) -> Range:
    """Gaussian, with a mean and a standard deviation."""
    return Range("normal", (float(mean), float(deviation)))


def choice(*values: float) -> Range:
    """One of some values, each equally likely."""
    return Range("choice", tuple(map(float, values)))


def in_order(*values: float) -> Range:
    """Not at random: the first draw takes the first value, and after the last they begin again."""
    return Range("in_order", tuple(map(float, values)))


def _chosen(quantile: float, *values: float) -> float:
    return values[int(quantile * len(values))]


_QUANTILES: dict[str, Callable[..., float]] = {
    "uniform": lambda quantile, low, high: low + quantile * (high - low),
    "log_uniform": lambda quantile, low, high: low * (high / low) ** quantile,
    "normal": lambda quantile, mean, deviation: mean + deviation * special.ndtri(quantile),
    "choice": _chosen,
    "in_order": _chosen,
}


@dataclass(frozen=True)
class SearchSpace:
    """Ranges of numbers of an experiment.

    Attributes:
      ranges: by the dotted paths that share one draw, mostly a single one.
    """

    ranges: Mapping[tuple[str, ...], Range]

    @classmethod
    def of(cls, space: Mapping[str | tuple[str, ...], Range]) -> SearchSpace:
        """Makes a space of ranges by path, or by a tuple of paths which then share one draw.

        Raises:
          JaxactError: nothing is drawn, a path is named twice, or what it is given is no range.
        """
        ranges = {(key,) if isinstance(key, str) else tuple(key): x for key, x in space.items()}
        if not ranges:
            raise JaxactError("a search needs at least one number to draw, by its dotted path")
        seen: set[str] = set()
        for paths, value in ranges.items():
            if not isinstance(value, Range):
                raise JaxactError(
                    f"{', '.join(paths)}: expected a range such as log_uniform(1e-4, 0.5), but got "
                    f"{value!r}"
                )
            for path in paths:
                if path in seen:
                    raise JaxactError(f"{path} is drawn twice; keep one of the two")
                seen.add(path)
        return cls(ranges)

    @classmethod
    def parse(cls, texts: Iterable[str]) -> SearchSpace:
        """Reads texts `"path=log_uniform(1e-4, 0.5)"`; commas join paths that share a draw.

        Raises:
          JaxactError: a text is not of this form, and as for `of`.
        """
        space: dict[str | tuple[str, ...], Range] = {}
        for text in texts:
            names, equals, described = text.partition("=")
            paths = tuple(name.strip() for name in names.split(","))
            if not equals or not all(paths):
                raise JaxactError(
                    "expected path=range, for example "
                    f"pipeline.learning_rate=log_uniform(1e-4,0.5), but got {text!r}"
                )
            if paths in space:
                raise JaxactError(f"{names.strip()} is drawn twice; keep one of the two")
            space[paths] = _parse_range(described, names.strip())
        return cls.of(space)

    def to_texts(self) -> dict[str, str]:
        """Returns the ranges as text by paths, as `parse` reads them and JSON can hold them."""
        return {",".join(paths): str(value) for paths, value in self.ranges.items()}

    @property
    def paths(self) -> tuple[str, ...]:
        """All paths that are drawn."""
        return tuple(path for paths in self.ranges for path in paths)

    def check(self, experiment: Any) -> None:
        """Finds paths that are no numbers of the experiment.

        Raises:
          JaxactError: there is one; the nearest numbers are named.
        """
        valid, values = numbers(experiment), leaves(experiment)
        for path in self.paths:
            if path not in valid:
                inside = [name for name in valid if name.startswith(f"{path}.")]
                if inside:
                    shown = ", ".join(inside[:4])
                    raise JaxactError(f"{path} is a whole part; draw a number of it: {shown}")
                if path in values:
                    (nearest,) = difflib.get_close_matches(path, valid, n=1, cutoff=0.0)
                    raise JaxactError(
                        f"{path} is {values[path]!r}, and only floats outside of the model can be "
                        f"drawn, for all else is structure; the nearest is {nearest!r}"
                    )
                raise unknown("number", path, valid)

    def draw(self, seed: int, index: int) -> dict[str, float]:
        """Returns the numbers of one draw by path.

        Args:
          seed: of the search.
          index: of the draw, from 0.
        """
        drawn: dict[str, float] = {}
        for paths, value in self.ranges.items():
            if value.kind == "in_order":
                count = len(value.arguments)
                quantile = (index % count + 0.5) / count
            else:
                entropy = (seed, index, zlib.crc32(",".join(paths).encode()))
                bits = int(np.random.SeedSequence(entropy).generate_state(1, np.uint64)[0] >> 12)
                # Halfway between multiples of 2⁻⁵², so that neither 0 nor 1 is drawn.
                quantile = (bits + 0.5) / 2**52
            drawn |= dict.fromkeys(paths, value.at(quantile))
        return drawn


def _parse_range(text: str, path: str) -> Range:
    kind, parenthesis, rest = text.strip().partition("(")
    if not parenthesis or not rest.endswith(")"):
        raise JaxactError(
            f"{path}: expected a range such as log_uniform(1e-4,0.5) or choice(4,8,16), "
            f"but got {text!r}"
        )
    try:
        arguments = tuple(float(x) for x in rest[:-1].split(",") if x.strip())
    except ValueError:
        raise JaxactError(f"{path}: expected numbers in {text.strip()}") from None
    return Range(kind.strip(), arguments)
