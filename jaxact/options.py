"""How a training run is watched and kept, and how a random search is done."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from jaxact.errors import JaxactError


@dataclass(frozen=True)
class Options:
    """How a run is watched and kept; none of it changes what is learnt.

    Intervals are in environment steps and are kept to the nearest chunk of updates.
    """

    output: Path | None = None
    """Directory for runs: the run goes to OUTPUT/<experiment>/<time of day>; None keeps nothing."""

    resume: Path | None = None
    """A run's directory: go on with it exactly where its newest checkpoint is."""

    initial_weights: Path | None = None
    """A run's directory: begin with the weights of its newest checkpoint and nothing else."""

    devices: int | None = None
    """How many devices share the lanes (default: all; on a CPU, JAX_NUM_CPU_DEVICES=N simulates
    N)."""

    total_steps: int | None = None
    """Stop after so many environment steps; schedules are as if the run went on."""

    log_every: int | None = None
    """Environment steps between lines of metrics (default: a hundredth of the run)."""

    evaluate_every: int | None = None
    """Environment steps between evaluations (default: a fifth of the run; 0: only at the end)."""

    evaluation_episodes: int = 1000
    """Held-out episodes of each evaluation (0: none)."""

    greedy: bool = False
    """Evaluate the most likely actions instead of samples."""

    checkpoint_every: int | None = None
    """Environment steps between checkpoints (default: a tenth of the run; 0: only at the end)."""

    keep_last: int = 3
    """How many of the newest checkpoints are kept; the best is kept besides."""

    video_every: int = 0
    """Environment steps between films of the first held-out episode (0: only at the end)."""

    progress: bool = True
    """Show progress."""

    def check(self) -> None:
        """Finds numbers that mean nothing.

        Raises:
          JaxactError: one is too small.
        """
        least = {"devices": 1, "total_steps": 1, "log_every": 1, "keep_last": 1}
        zero = ("evaluate_every", "evaluation_episodes", "checkpoint_every", "video_every")
        for name, low in {**least, **dict.fromkeys(zero, 0)}.items():
            given = getattr(self, name)
            if given is not None and given < low:
                raise JaxactError(f"{name} must be at least {low}, got {given}")


@dataclass(frozen=True)
class SweepOptions:
    """How a random search is done, watched and kept.

    A resumed sweep keeps its own seeds, evaluations, number of draws and chunk; the last two may be
    given anew, and more draws extend it.
    """

    draws: int | None = None
    """How many times the numbers are drawn (default: 50)."""

    seeds: tuple[int, ...] = (0,)
    """Each draw is trained once with each of these seeds."""

    draw_seed: int = 0
    """Of the numbers drawn."""

    evaluations: int = 4
    """Evenly spaced points of training at which policies are evaluated, the last at the end."""

    evaluation_episodes: int = 1000
    """Held-out episodes of each evaluation, the same for all."""

    greedy: bool = False
    """Evaluate the most likely actions instead of samples."""

    chunk: int | None = None
    """Runs trained side by side (default: as many as fit into memory)."""

    memory_gb: float | None = None
    """Memory that training may take (default: 60 % of what is free)."""

    devices: int | None = None
    """How many devices share the runs of a chunk (default: all; on a CPU, JAX_NUM_CPU_DEVICES=N
    simulates N)."""

    output: Path | None = None
    """Directory for sweeps: it goes to OUTPUT/<experiment>/<time of day>; None keeps nothing."""

    resume: Path | None = None
    """A sweep's directory: do what it lacks."""

    progress: bool = True
    """Show progress."""

    def check(self) -> None:
        """Finds numbers that mean nothing.

        Raises:
          JaxactError: one is too small, or a seed is there twice.
        """
        for name in ("draws", "evaluations", "evaluation_episodes", "chunk", "devices"):
            given = getattr(self, name)
            if given is not None and given < 1:
                raise JaxactError(f"{name} must be at least 1, got {given}")
        if self.draw_seed < 0:
            raise JaxactError(f"draw_seed must be at least 0, got {self.draw_seed}")
        if self.memory_gb is not None and self.memory_gb <= 0:
            raise JaxactError(f"memory_gb must be positive, got {self.memory_gb}")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            raise JaxactError(f"seeds must be one or more different numbers, got {self.seeds}")
