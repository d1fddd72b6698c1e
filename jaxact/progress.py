"""What a person sees of a run: a live display on a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping
from types import TracebackType

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, Progress, ProgressColumn, TaskProgressColumn, TextColumn
from rich.progress import Task as RichTask
from rich.table import Table
from rich.text import Text

_SHOWN = ("train/success", "train/return", "train/length", "train/forced")


class ProgressDisplay:
    """Shows stage, bar, steps a second, time left, success, return and losses.

    On a terminal the display is redrawn in place; elsewhere (a file, a notebook, CI) one plain line
    is printed at most every `interval` seconds.

    Args:
      total_steps: environment steps of the whole run.
      enabled: whether anything is shown.
      interval: seconds between plain lines.
      unit: what is counted, if not steps.
    """

    def __init__(
        self,
        total_steps: int,
        enabled: bool = True,
        interval: float = 10.0,
        unit: str = "steps",
    ) -> None:
        self._total = total_steps
        self._unit = unit
        self._enabled = enabled
        self._interval = interval
        self._console = Console()
        self._rate = _Rate(unit)
        self._last_line = -math.inf
        self._live: Live | None = None
        self._bar = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=None),
            TaskProgressColumn(),
            TextColumn(f"{{task.completed:,.0f}} / {{task.total:,.0f}} {unit}"),
            _RateColumn(self._rate),
            expand=True,
        )
        self._task = self._bar.add_task("compiling", total=total_steps)

    def __enter__(self) -> ProgressDisplay:
        if self._enabled and self._console.is_terminal:
            self._live = Live(self._bar, console=self._console, refresh_per_second=4)
            self._live.start()
        elif self._enabled:
            self._print("compiling")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def update(self, stage: str, steps: int, metrics: Mapping[str, float]) -> None:
        """Shows where the run is.

        Args:
          stage: what is being trained.
          steps: environment steps so far.
          metrics: by tag, as they are logged.
        """
        if not self._enabled:
            return
        self._rate.add(steps)
        if self._live is not None:
            self._bar.update(self._task, description=stage, completed=steps)
            self._live.update(Group(self._bar, _table(metrics)))
        elif time.monotonic() - self._last_line >= self._interval or steps >= self._total:
            self._last_line = time.monotonic()
            shown = "  ".join(f"{_label(n)} {x:.3f}" for n, x in _chosen(metrics).items())
            done = f"{steps:,}/{self._total:,} {self._unit}"
            self._print(f"{stage}  {done}  {self._rate.text(self._total)}  {shown}")

    def message(self, text: str) -> None:
        """Prints a line that stays."""
        if self._enabled:
            self._print(text)

    def _print(self, text: str) -> None:
        if self._live is not None:
            self._live.console.print(text, markup=False, highlight=False)
        else:
            print(text, file=sys.stdout, flush=True)


class _Rate:
    """Steps a second over the last updates; the first, which compiles, does not count."""

    def __init__(self, unit: str) -> None:
        self._unit = unit
        self._seen: list[tuple[float, int]] = []

    def add(self, steps: int) -> None:
        self._seen = [*self._seen[-19:], (time.monotonic(), steps)]

    def per_second(self) -> float:
        if len(self._seen) < 2:
            return 0.0
        (then, before), (now, steps) = self._seen[0], self._seen[-1]
        return (steps - before) / max(now - then, 1e-9)

    def text(self, total: int) -> str:
        rate = self.per_second()
        if not rate:
            return f"- {self._unit}/s"
        left = max(total - self._seen[-1][1], 0) / rate
        minutes, seconds = divmod(round(left), 60)
        return f"{rate:,.0f} {self._unit}/s  {minutes}:{seconds:02d} left"


class _RateColumn(ProgressColumn):
    def __init__(self, rate: _Rate) -> None:
        self._rate = rate
        super().__init__()

    def render(self, task: RichTask) -> Text:
        return Text(self._rate.text(int(task.total or 0)))


def _chosen(metrics: Mapping[str, float]) -> dict[str, float]:
    losses = [n for n in sorted(metrics) if n.startswith("losses/") and not n.endswith("/weight")]
    return {n: metrics[n] for n in (*_SHOWN, *losses) if n in metrics}


def _label(name: str) -> str:
    return name.removeprefix("train/").removeprefix("losses/")


def _table(metrics: Mapping[str, float]) -> Table:
    table = Table(box=None, pad_edge=False, show_header=True, header_style="dim")
    chosen = list(_chosen(metrics).items())[:8]
    for name, _ in chosen:
        table.add_column(_label(name), justify="right")
    table.add_row(*[f"{value:.3f}" for _, value in chosen])
    return table
