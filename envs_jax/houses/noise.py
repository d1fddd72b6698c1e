"""How robots miss: noise of moves and turns, as measured numbers.

Sources: `ai2thor_locobot`, AI2-THOR's `LocobotAgent`: a forward move errs by N(0.001, 0.005) m, any
forward move, even one that is blocked, jolts the heading by N(0, 0.25)°, and a turn errs by
N(0, 0.5)°. `pyrobot_…`: habitat-sim's `pyrobot_noisy_controls.py`, measured by PyRobot; all draws
are cut off at three standard deviations, and what errs along the command by more than 95 % of it
backwards. Its second column serves as variance, though it is as large as the first (a LoCoBot under
ILQR strays 7.7 cm in a step of 25): this is kept, so that numbers compare; see `Noise.multiplier`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.errors import unknown

# Draws beyond this many deviations are no draws.
_CUT = 3.0
_LEAST = 0.95


@dataclass(frozen=True)
class Spread:
    """A normal distribution."""

    mean: float = 0.0
    deviation: float = 0.0


@dataclass(frozen=True)
class Drift:
    """What one kind of action adds: metres forward and to the right, degrees clockwise.

    For a command backwards or to the left the signs are the other way round where they belong to
    the command.
    """

    forward: Spread = Spread()
    right: Spread = Spread()
    turn: Spread = Spread()


@dataclass(frozen=True)
class Noise:
    """The noise of moves and of turns.

    Attributes:
      move: what a move adds.
      turn: what a turn adds.
      truncated: whether draws are cut off as habitat-sim does.
      multiplier: of every draw.
    """

    move: Drift
    turn: Drift
    truncated: bool = False
    multiplier: float = 1.0

    def sample(self, key: jax.Array, step: jax.Array, angle: jax.Array) -> jax.Array:
        """Draws what is added to a command.

        Args:
          key: a PRNG key.
          step: float32 scalar, metres forward, negative backwards; zero for a turn.
          angle: float32 scalar, degrees clockwise, negative to the left; zero for a move.

        Returns:
          float32 [3]: metres forward, metres to the right and degrees clockwise; zeros if nothing
          is commanded.
        """
        moves, turns = step != 0, angle != 0
        command = jnp.stack([jnp.abs(step), jnp.float32(0), jnp.abs(angle)])
        mean, deviation = (
            jnp.where(moves, _row(self.move, name), _row(self.turn, name))
            for name in ("mean", "deviation")
        )
        if self.truncated:
            least = (-_LEAST * command - mean) / jnp.maximum(deviation, 1e-9)
            least = jnp.where(command > 0, jnp.maximum(least, -_CUT), -_CUT)
            unit = jax.random.truncated_normal(key, least, _CUT, (3,), jnp.float32)
        else:
            unit = jax.random.normal(key, (3,), jnp.float32)
        drawn = jnp.asarray(self.multiplier, jnp.float32) * (mean + deviation * unit)
        # Means are of a forward move and, but for AI2-THOR's, which are zero, of a turn to the
        # left: habitat-sim turns a move's heading to the left as well.
        along = jnp.where(step < 0, -1, 1)
        spin = jnp.where(angle > 0, 1, -1)
        signs = jnp.stack([along, along, spin]).astype(jnp.float32)
        return jnp.where(moves | turns, signs * drawn, 0)


def _row(drift: Drift, name: str) -> jax.Array:
    spreads = (drift.forward, drift.right, drift.turn)
    return jnp.array([getattr(spread, name) for spread in spreads], jnp.float32)


def _pyrobot(
    move: tuple[float, ...], move_variance: tuple[float, ...], *turn: tuple[float, ...]
) -> Noise:
    """Makes a noise of habitat-sim's means and variances: forward, right, radians."""

    def drift(means: tuple[float, ...], variances: tuple[float, ...]) -> Drift:
        forward, right, angle = (
            Spread(mean, math.sqrt(variance))
            for mean, variance in zip(means, variances, strict=True)
        )
        degrees = Spread(math.degrees(angle.mean), math.degrees(angle.deviation))
        return Drift(forward, right, degrees)

    return Noise(drift(move, move_variance), drift(*turn), truncated=True)


PRESETS = {
    "ai2thor_locobot": Noise(
        move=Drift(forward=Spread(0.001, 0.005), turn=Spread(0.0, 0.25)),
        turn=Drift(turn=Spread(0.0, 0.5)),
    ),
    "pyrobot_locobot_ilqr": _pyrobot(
        (0.014, 0.009, 0.008), (0.006, 0.005, 0.004), (0.003, 0.003, 0.023), (0.002, 0.003, 0.012)
    ),
    "pyrobot_locobot_proportional": _pyrobot(
        (0.017, 0.042, 0.031), (0.007, 0.023, 0.026), (0.001, 0.005, 0.043), (0.001, 0.004, 0.017)
    ),
    "pyrobot_locobot_movebase": _pyrobot(
        (0.074, 0.036, 0.189), (0.019, 0.033, 0.038), (0.002, 0.003, 0.219), (0.0, 0.002, 0.019)
    ),
    "pyrobot_lite_ilqr": _pyrobot(
        (0.142, 0.023, 0.031), (0.008, 0.008, 0.028), (0.002, 0.002, 0.122), (0.001, 0.002, 0.03)
    ),
    "pyrobot_lite_proportional": _pyrobot(
        (0.135, 0.043, 0.049), (0.007, 0.009, 0.009), (0.002, 0.002, 0.054), (0.002, 0.001, 0.061)
    ),
    "pyrobot_lite_movebase": _pyrobot(
        (0.192, 0.117, 0.128), (0.055, 0.144, 0.143), (0.002, 0.001, 0.173), (0.001, 0.001, 0.025)
    ),
}


def preset(name: str) -> Noise:
    """Returns the noise of that name.

    Raises:
      JaxactError: there is no such noise; the message names the nearest.
    """
    if name not in PRESETS:
        raise unknown("noise", name, PRESETS)
    return PRESETS[name]
