"""Convolutions forward and backward inside a scan: `python -m benchmarks.convolution_gradients`.

All of training happens in loops, in which XLA:CPU's own gradients of convolutions leave its fast
path. For each shape, `jaxact.models.convolution` and XLA's gradients of the same convolution are
compiled, warmed up, and timed in turns in the same process. Prints a line of JSON for the machine,
one for each shape and system, and one of their ratio.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import jax
import tyro

from benchmarks.env_lines import Line, print_lines
from benchmarks.env_worker import machine
from jaxact.errors import JaxactError
from jaxact.models.convolution import convolve

PROGRAM = "benchmarks.convolution_gradients"


class Shape(NamedTuple):
    """A convolution of square images without padding.

    Attributes:
      pixels: side of the images.
      channels: of the images.
      size: side of the kernel.
      stride: step of the window.
      features: channels of the result.
    """

    pixels: int
    channels: int
    size: int
    stride: int
    features: int


# What networks for pictures of 32×32 and 64×64 are made of, those without strides last.
SHAPES = (
    Shape(32, 1, 5, 2, 16),
    Shape(14, 16, 3, 2, 32),
    Shape(64, 16, 3, 2, 32),
    Shape(14, 16, 3, 1, 32),
    Shape(28, 32, 3, 1, 32),
)


@dataclass(frozen=True)
class Arguments:
    """Times gradients of convolutions and prints lines of JSON."""

    images: int = 256
    """Of a batch."""
    steps: int = 4
    """Of the scan, each forward and backward once, by kernel and by image."""
    repeats: int = 5
    """Calls of the scan, in turns; the fastest and the median are reported."""


def main() -> None:
    """Runs the command line."""
    arguments = tyro.cli(Arguments, prog=f"python -m {PROGRAM}")
    try:
        lines = measure(arguments)
    except JaxactError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        sys.exit(2)
    print_lines(lines, None)


def measure(arguments: Arguments) -> Iterator[Line]:
    """Returns the machine's line and, as they are measured, those of each shape.

    Raises:
      JaxactError: a number that cannot be.
    """
    for name in ("images", "steps", "repeats"):
        if getattr(arguments, name) < 1:
            raise JaxactError(f"--{name} must be at least 1; got {getattr(arguments, name)}")

    def lines() -> Iterator[Line]:
        yield machine()
        for shape in SHAPES:
            yield from measure_shape(shape, arguments)

    return lines()


def measure_shape(shape: Shape, arguments: Arguments) -> Iterator[Line]:
    """Yields the lines of one shape."""
    image_key, kernel_key = jax.random.split(jax.random.key(0))
    image = (arguments.images, shape.pixels, shape.pixels, shape.channels)
    kernel = (shape.size, shape.size, shape.channels, shape.features)
    inputs = (
        jax.random.normal(image_key, image),
        jax.random.normal(kernel_key, kernel),
    )
    systems = {"jaxact": convolve, "xla": _convolve_by_xla}
    programs, compiled = {}, {}
    seconds: dict[str, list[float]] = {system: [] for system in systems}
    for system, convolution in systems.items():
        began = time.perf_counter()
        scan = _scan(convolution, shape.stride, arguments.steps)
        programs[system] = jax.jit(scan).lower(*inputs).compile()
        compiled[system] = time.perf_counter() - began
        jax.block_until_ready(programs[system](*inputs))
    for _ in range(arguments.repeats):
        for system, program in programs.items():
            began = time.perf_counter()
            jax.block_until_ready(program(*inputs))
            seconds[system].append(time.perf_counter() - began)
    images = arguments.images * arguments.steps
    for system, took in seconds.items():
        yield {
            **shape._asdict(),
            "system": system,
            "microseconds_per_image": round(1e6 * min(took) / images, 2),
            "microseconds_per_image_median": round(1e6 * statistics.median(took) / images, 2),
            "compile_seconds": round(compiled[system], 2),
            "images": arguments.images,
            "steps": arguments.steps,
            "repeats": arguments.repeats,
        }
    best = {system: min(took) for system, took in seconds.items()}
    yield {**shape._asdict(), "ratio_to": "xla", "ratio": round(best["xla"] / best["jaxact"], 2)}


def _convolve_by_xla(x: jax.Array, kernel: jax.Array, stride: int) -> jax.Array:
    layout = ("NHWC", "HWIO", "NHWC")
    return jax.lax.conv_general_dilated(
        x, kernel, (stride, stride), "VALID", dimension_numbers=layout
    )


def _scan(
    convolution: Callable[[jax.Array, jax.Array, int], jax.Array], stride: int, steps: int
) -> Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
    def step(
        carry: tuple[jax.Array, jax.Array], _: None
    ) -> tuple[tuple[jax.Array, jax.Array], None]:
        result, gradients = jax.vjp(lambda x, k: convolution(x, k, stride), *carry)
        # Each step needs the one before, so that none can be computed once for all.
        moved = [x - 1e-6 * g for x, g in zip(carry, gradients(result), strict=True)]
        return (moved[0], moved[1]), None

    def scan(image: jax.Array, kernel: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.lax.scan(step, (image, kernel), None, steps)[0]

    return scan


if __name__ == "__main__":
    main()
