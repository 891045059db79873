"""Poses over time, and the poses between them. Imports numpy alone: the live page needs it at its start."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MAX_GAP = 500_000_000
"""[ns] between two poses; in a longer gap there is no pose"""


class Trajectory(NamedTuple):
    """Poses in the order of their stamps."""

    stamps: NDArray[np.int64]
    """(n,) [ns], increasing"""
    poses: Array
    """(n, 3) [m, m, rad], the heading without jumps; nan if it is not known"""


def poses_at(stamps: NDArray[np.int64], trajectory: Trajectory) -> Array:
    """Return the poses (n, 3) at these times [ns], interpolated linearly between neighbours.

    They are nan before and after the trajectory, and in gaps longer than MAX_GAP.
    """
    times, poses = trajectory
    found = np.full((len(stamps), 3), np.nan)
    if len(times) < 2:
        return found
    after = np.clip(np.searchsorted(times, stamps), 1, len(times) - 1)
    before = after - 1
    gap = times[after] - times[before]
    use = (stamps >= times[0]) & (stamps <= times[-1]) & (gap <= MAX_GAP)
    share = ((stamps - times[before]) / gap)[use, None]
    found[use] = (1.0 - share) * poses[before[use]] + share * poses[after[use]]
    return found
