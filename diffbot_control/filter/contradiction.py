"""Detection of fixes that contradict the odometry, so that no estimate made of both drives a robot.

A robot that was carried away relocates the filter once. Fixes with a turned heading or with swapped or mirrored axes
never agree with the odometry. They relocate the filter again and again while the robot drives. If they are so frequent
that the estimate just lags behind them, their innovations are far too large and all alike. Fixes of a source that hangs
repeat one value while the odometry moves. A robot at rest shows no signs, so a contradiction lasts for QUIET_TIME after
its last sign, which is long enough for a goal to end (``pose_lost_timeout``). A pose set by hand ends it at once.

Pure functions of their memory; times are stamps [ns].
"""

from __future__ import annotations

from typing import NamedTuple

MAX_RELOCATIONS = 3
"""This many relocations within WINDOW are a contradiction."""
WINDOW = 10 * 10**9
"""[ns]"""
QUIET_TIME = 60 * 10**9
"""[ns] A contradiction without new signs ends after this time."""
FROZEN_FIXES = 5
"""This many fixes in a row that are equal to the last bit are a contradiction ..."""
FROZEN_DISTANCE = 0.5
"""[m] ... if the odometry has moved by this distance meanwhile."""
MAX_NIS_RATIO, MAX_CORRELATION = 10.0, 0.8
"""Mean NIS over its alarm bound, and correlation of innovations in a row, that are a contradiction if both are
exceeded. Outliers are also large, but not alike."""
RELOCATING, FROZEN = "fixes contradict the odometry", "fixes stand still while the odometry moves"


class Contradiction(NamedTuple):
    """Memory of the signs."""

    relocations: tuple[int, ...] = ()
    """[ns] stamps of the newest relocations, at most MAX_RELOCATIONS"""
    fix: tuple[float, ...] = ()
    """numbers of the newest fix of global_pose"""
    repetitions: int = 1
    """number of fixes in a row with these numbers"""
    distance: float = 0.0
    """[m] that the odometry has moved since the first of them"""
    cause: str = ""
    """RELOCATING or FROZEN; empty: there is no contradiction"""
    since: int = 0
    """[ns] stamp of its newest sign"""


NONE = Contradiction()


def with_relocation(memory: Contradiction, stamp: int) -> Contradiction:
    """Add a relocation at ``stamp``."""
    # Sorted, since a late measurement may also relocate.
    newest = tuple(sorted((*memory.relocations, stamp)))[-MAX_RELOCATIONS:]
    memory = memory._replace(relocations=newest)
    if len(newest) == MAX_RELOCATIONS and newest[-1] - newest[0] <= WINDOW:
        return memory._replace(cause=RELOCATING, since=newest[-1])
    return memory._replace(since=max(stamp, memory.since)) if memory.cause else memory


def with_fix(memory: Contradiction, stamp: int, fix: tuple[float, ...]) -> Contradiction:
    """Add the numbers of a fix of global_pose."""
    if fix != memory.fix:
        return memory._replace(fix=fix, repetitions=1, distance=0.0)
    memory = memory._replace(repetitions=memory.repetitions + 1)
    if memory.repetitions >= FROZEN_FIXES and memory.distance >= FROZEN_DISTANCE:
        return memory._replace(cause=FROZEN, since=stamp)
    return memory


def with_innovations(memory: Contradiction, stamp: int, nis_ratio: float, correlation: float) -> Contradiction:
    """Add the mean NIS over its alarm bound and the correlation of the newest innovations of fixes."""
    if nis_ratio > MAX_NIS_RATIO and correlation > MAX_CORRELATION:
        return memory._replace(cause=RELOCATING, since=stamp)
    return memory


def with_motion(memory: Contradiction, stamp: int, distance: float) -> Contradiction:
    """Add a motion of the odometry by ``distance`` [m] up to ``stamp``; a contradiction without new signs ends."""
    memory = memory._replace(distance=memory.distance + distance)
    if memory.cause and stamp - memory.since > QUIET_TIME:
        return memory._replace(cause="", relocations=())
    return memory
