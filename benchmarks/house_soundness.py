"""Whether generated houses can be lived in: `python -m benchmarks.house_soundness --help`.

Houses of every style are drawn and checked by `envs_jax.houses.validity`, which shares no code with
what makes them, for a body as wide and as tall as any platform's. Then episodes of every navigation
id are drawn, and it is checked that starts and goals are where the body fits and that a way leads
from one to the other. Prints a line of JSON for each style and each id; exits with 1 if anything is
unsound.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import tyro

import envs_jax
from benchmarks.env_lines import Line, print_lines
from envs_jax.houses import categories, validity
from envs_jax.houses.catalogue import PLATFORMS
from envs_jax.houses.collision import clearance, obstacles
from envs_jax.houses.generator import APARTMENT, FLOOR, ROOM, SPLITS, Style, generate, scene_key
from envs_jax.houses.object_nav import ObjectNav
from envs_jax.houses.point_nav import PointNav
from envs_jax.houses.samplers import TargetBank
from envs_jax.houses.state import Body
from jaxact.errors import JaxactError, unknown

PROGRAM = "benchmarks.house_soundness"
KINDS = {f"room-{name}": replace(ROOM, kind=name) for name in categories.ROOMS[1:]}
STYLES: dict[str, Style] = {**KINDS, "apartment": APARTMENT, "floor": FLOOR}
TITLES = {platform.title for platform in PLATFORMS.values()}
IDS = tuple(name for name in envs_jax.ids() if name.split("-")[0] in TITLES)
# As wide and tall as any platform's body, with the lowest camera and the shortest sight.
WIDEST = Body(radius=0.2, height=1.8, camera_height=0.87)
WITHIN = 1.0
_BATCH = 250
_ROUNDING = 1e-4


@dataclass(frozen=True)
class Arguments:
    """Checks generated houses and drawn episodes and prints lines of JSON."""

    styles: tuple[str, ...] = tuple(STYLES)
    """Styles of houses."""
    houses: int = 1667
    """Houses of each style; of all six that makes 10,002."""
    first: int = 0
    """Number of the first house of the split."""
    split: str = "train"
    """Split of the generator that houses come from."""
    ids: tuple[str, ...] = IDS
    """Ids to draw episodes of; none with --ids and nothing after it."""
    episodes: int = 2000
    """Episodes of each id, in the houses that it trains in."""
    output: Path | None = None
    """File for the lines, too, each as soon as it is there."""


def main() -> None:
    """Runs the command line."""
    arguments = tyro.cli(Arguments, prog=f"python -m {PROGRAM}")
    try:
        check(arguments)
    except JaxactError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        sys.exit(2)
    faults = Counter[str]()

    def lines() -> Iterator[Line]:
        for line in measure(arguments):
            faults.update(line["unsound"])
            yield line

    print_lines(lines(), arguments.output)
    sys.exit(1 if faults.total() else 0)


def check(arguments: Arguments) -> None:
    """Checks names and numbers.

    Raises:
      JaxactError: a style, a split or an id that there is not, or a number that cannot be.
    """
    for name in arguments.styles:
        if name not in STYLES:
            raise unknown("style of houses", name, STYLES)
    for name in arguments.ids:
        if name not in IDS:
            raise unknown("id of navigation in houses", name, IDS)
    if arguments.split not in SPLITS:
        raise unknown("split", arguments.split, SPLITS)
    for name in ("houses", "episodes"):
        if getattr(arguments, name) < 1:
            raise JaxactError(f"--{name} must be at least 1; got {getattr(arguments, name)}")


def measure(arguments: Arguments) -> Iterator[Line]:
    """Yields a line for each style and each id."""
    for name in arguments.styles:
        yield check_style(name, arguments.split, arguments.first, arguments.houses)
    for name in arguments.ids:
        yield check_episodes(name, arguments.episodes)


def check_style(name: str, split: str, first: int, count: int) -> Line:
    """Draws and checks houses of one style.

    Returns:
      How many houses are unsound for each reason, the first few of those with what is said of them,
      houses drawn a second, the seconds of a processor that compiling and checking took, and means
      over the houses.
    """
    style, batch = STYLES[name], min(count, _BATCH)
    draw = jax.vmap(lambda index: generate(scene_key(split, index), style))
    began = time.process_time()
    program = jax.jit(draw).lower(jnp.arange(batch, dtype=jnp.int32)).compile()
    compiled = time.process_time() - began
    drawing = checking = 0.0
    reasons, said = Counter[str](), list[str]()
    rooms = area = things = 0.0
    for start in range(first, first + count, batch):
        began = time.perf_counter()
        scenes = jax.device_get(program(jnp.arange(start, start + batch, dtype=jnp.int32)))
        drawing += time.perf_counter() - began
        began = time.process_time()
        for i in range(min(batch, first + count - start)):
            scene = jax.tree.map(lambda leaf, i=i: leaf[i], scenes)
            found = validity.problems(scene, WIDEST, WITHIN)
            reasons.update({problem.reason for problem in found})
            said += [f"house {start + i}: {problem}" for problem in found]
            sides = scene.rooms[:, 2:] - scene.rooms[:, :2]
            rooms += np.count_nonzero(sides[:, 0])
            area += float(np.sum(sides[:, 0] * sides[:, 1]))
            things += np.count_nonzero(scene.category >= len(categories.STRUCTURE))
        checking += time.process_time() - began
    return {
        "style": name,
        "split": split,
        "first": first,
        "houses": count,
        "unsound": dict(reasons),
        "said": said[:5],
        "houses_per_second": round(-(-count // batch) * batch / drawing),
        "compile_cpu_seconds": round(compiled, 1),
        "check_cpu_seconds": round(checking, 1),
        "rooms": round(rooms / count, 2),
        "square_metres": round(area / count, 1),
        "things": round(things / count, 1),
    }


def check_episodes(name: str, count: int) -> Line:
    """Draws and checks episodes of one id.

    Returns:
      How many are unsound for each reason: "unreachable", no way leads to a goal; "blocked_start"
      and "blocked_goal", the body does not fit there; "absent_target", there is none in the house.
      And the mean metres of the ways, and of ObjectNav the share of the targets that are in the
      houses which can be found ("findable").
    """
    pomdp = envs_jax.make(name, observation=())
    task = pomdp.task
    assert isinstance(task, PointNav | ObjectNav)
    body = task.house.body
    began = time.process_time()
    bank = jax.block_until_ready(jax.jit(pomdp.sampler.init)(jax.random.key(0)))

    def draw(key: jax.Array) -> dict[str, jax.Array]:
        episode = pomdp.sampler.sample(key, bank)
        state, progress = episode.environment, episode.task
        boxes = obstacles(state.scene.boxes, body)

        def blocked(plan: jax.Array) -> jax.Array:
            return jnp.min(clearance(boxes, plan)[0]) < body.radius - _ROUNDING

        metres = progress.journey.start_distance
        drawn = {
            "metres": metres,
            "unreachable": ~jnp.isfinite(metres),
            "blocked_start": blocked(state.position),
        }
        if isinstance(task, PointNav):
            return {**drawn, "blocked_goal": blocked(progress.goal)}
        return {**drawn, "absent_target": ~jnp.any(state.scene.category == progress.category)}

    program = jax.jit(lambda keys: jax.lax.map(draw, keys, batch_size=_BATCH))
    drawn = jax.device_get(program(jax.random.split(jax.random.key(1), count)))
    metres = drawn.pop("metres")
    line: Line = {
        "id": name,
        "episodes": count,
        "unsound": {reason: int(wrong.sum()) for reason, wrong in drawn.items() if wrong.any()},
        "metres": round(float(np.mean(metres)), 2),
    }
    if isinstance(bank, TargetBank):
        wanted = np.array([categories.index(target) for target in pomdp.sampler.targets])
        there = np.any(np.asarray(bank.bank.scenes.category)[:, :, None] == wanted, axis=1)
        line["findable"] = round(float(np.asarray(bank.findable)[there].mean()), 4)
    return {**line, "cpu_seconds": round(time.process_time() - began, 1)}


if __name__ == "__main__":
    main()
