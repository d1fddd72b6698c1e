"""How a training run is watched and kept."""

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
