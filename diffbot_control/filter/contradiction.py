"""Detection of fixes that contradict the odometry, so that a wrong estimate does not drive the robot.

If the robot is carried away, the fixes relocate the filter once. If the fixes have a wrong heading, or swapped or
mirrored axes, they never agree with the odometry. There are three signs of such a contradiction:

- The fixes relocate the filter repeatedly while the robot drives.
- The fixes are so frequent that the filter follows them with a lag. Their innovations are large and correlated.
- The fixes repeat one value while the odometry moves, since their source hangs.

At rest the signs do not occur. A contradiction therefore lasts for QUIET_TIME after its last sign, which is long enough
for a goal to end (``pose_lost_timeout``). A pose on ``initialpose`` ends it immediately.

All functions are pure functions of their memory. Times are stamps [ns].
"""

from __future__ import annotations

from typing import NamedTuple

MAX_RELOCATIONS = 3
"""This number of relocations within WINDOW is a contradiction."""
WINDOW = 10 * 10**9
"""[ns]"""
QUIET_TIME = 60 * 10**9
"""[ns] A contradiction without new signs ends after this time."""
FROZEN_FIXES, FROZEN_DISTANCE = 5, 0.5
"""This number of equal fixes in a row is a contradiction if the odometry moves at least this distance [m] meanwhile."""
MAX_NIS_RATIO, MAX_CORRELATION = 10.0, 0.8
"""Bounds of mean NIS / alarm bound, and of the autocorrelation of the innovations. If both are exceeded, there is a
contradiction. The innovations of outliers are also large, but not correlated."""
RELOCATING, FROZEN = "fixes contradict the odometry", "fixes stand still while the odometry moves"


class Contradiction(NamedTuple):
    """Memory of the signs of a contradiction."""

    relocations: tuple[int, ...] = ()
    """[ns] stamps of the newest relocations, at most MAX_RELOCATIONS"""
    fix: tuple[float, ...] = ()
    """measured numbers of the newest fix of global_pose"""
    repetitions: int = 1
    """number of successive fixes with these numbers"""
    distance: float = 0.0
    """[m] distance that the odometry has moved since the first of these fixes"""
    cause: str = ""
    """RELOCATING or FROZEN; empty without a contradiction"""
    since: int = 0
    """[ns] stamp of the newest sign of the contradiction"""


NONE = Contradiction()


def with_relocation(memory: Contradiction, stamp: int) -> Contradiction:
    """Add a relocation at ``stamp``."""
    # A late measurement may also relocate, so stamps may arrive out of order.
    newest = tuple(sorted((*memory.relocations, stamp)))[-MAX_RELOCATIONS:]
    memory = memory._replace(relocations=newest)
    if len(newest) == MAX_RELOCATIONS and newest[-1] - newest[0] <= WINDOW:
        return memory._replace(cause=RELOCATING, since=newest[-1])
    return memory._replace(since=max(stamp, memory.since)) if memory.cause else memory


def with_fix(memory: Contradiction, stamp: int, fix: tuple[float, ...]) -> Contradiction:
    """Add the measured numbers of a fix of global_pose."""
    if fix != memory.fix:
        return memory._replace(fix=fix, repetitions=1, distance=0.0)
    memory = memory._replace(repetitions=memory.repetitions + 1)
    if memory.repetitions >= FROZEN_FIXES and memory.distance >= FROZEN_DISTANCE:
        return memory._replace(cause=FROZEN, since=stamp)
    return memory


def with_innovations(memory: Contradiction, stamp: int, nis_ratio: float, correlation: float) -> Contradiction:
    """Add the ratio of mean NIS to its alarm bound, and the autocorrelation, of the newest innovations of fixes."""
    if nis_ratio > MAX_NIS_RATIO and correlation > MAX_CORRELATION:
        return memory._replace(cause=RELOCATING, since=stamp)
    return memory


def with_motion(memory: Contradiction, stamp: int, distance: float) -> Contradiction:
    """Add a motion of the odometry over ``distance`` [m] that ends at ``stamp``, and end an old contradiction."""
    memory = memory._replace(distance=memory.distance + distance)
    if memory.cause and stamp - memory.since > QUIET_TIME:
        return memory._replace(cause="", relocations=())
    return memory
