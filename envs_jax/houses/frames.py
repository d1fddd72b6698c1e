"""Poses in other simulators' frames.

Ours is AI2-THOR's (Unity's): left-handed, z forward at yaw 0, yaw clockwise seen from above.
Habitat's is right-handed: x right, y up, −z forward at no rotation, turned counter-clockwise by
quaternions (x, y, z, w). The two are mirror images, so nothing looks mirrored in either. These are
for files: NumPy, float64.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def to_habitat(position: npt.ArrayLike, yaw: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Returns positions [..., 3] and unit quaternions [..., 4], (x, y, z, w) with w ≥ 0.

    Args:
      position: [..., 3] in our frame.
      yaw: [...], degrees clockwise.
    """
    place = np.asarray(position, np.float64) * (1, 1, -1)
    # Half the turn within (−90°, 90°], where the cosine is not negative.
    turn = -np.radians((np.asarray(yaw, np.float64) + 180) % 360 - 180) / 2
    zero = np.zeros_like(turn)
    return place, np.stack([zero, np.sin(turn), zero, np.cos(turn)], axis=-1)


def from_habitat(position: npt.ArrayLike, rotation: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Returns positions [..., 3] in our frame and yaws [...] in [0, 360).

    Args:
      position: [..., 3] in Habitat's frame.
      rotation: [..., 4], quaternions (x, y, z, w) of any length; only where they turn the forward
        axis to, seen from above, counts.
    """
    place = np.asarray(position, np.float64) * (1, 1, -1)
    x, y, z, w = np.moveaxis(np.asarray(rotation, np.float64), -1, 0)
    # Habitat's forward axis (0, 0, −1), rotated: its x, and minus its z.
    to_the_right = -2 * (x * z + w * y)
    ahead = w * w + z * z - x * x - y * y
    yaw = np.degrees(np.arctan2(to_the_right, ahead)) % 360
    # Tiny negative angles become 360.
    return place, np.where(yaw == 360, 0, yaw)
