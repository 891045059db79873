"""Finds in the curves why a goal was missed: a gap in a topic, a wheel that did not turn or slipped, wrong fixes."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees, hypot, nan

import numpy as np

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_core.kinematics import WheelGeometry
from diffbot_tools.filter_statistics import MAX_VAR_THETA
from diffbot_tools.view.columns import Array, Columns
from diffbot_tools.view.texts import ERROR, WARNING

_NEEDED = {
    "odometry": "odometry",
    "fixes": "fix",
    "estimate": "pose from the filter",
    "docking": "detected dock",
    "command": "command",
}
"""Curves that have rows continuously while the robot drives, and the name of a row in words."""
_SILENCE, _SILENT_PERIODS = 2.0, 10.0
"""A gap of a curve is reported if it is longer than _SILENCE [s] and longer than _SILENT_PERIODS periods."""
_LAST, _STANDING = 5.0, 0.1
"""A wheel did not turn if its mean speed in the last _LAST [s] of the goal was below _STANDING times the commanded
speed."""
_SLIP, _GRIP, _TURNING = 1.0, 0.7, 0.2
"""A wheel slips while the true speed of its rim is below _GRIP times the measured speed, and the measured speed is
above _TURNING times its maximum. A slip of more than _SLIP [s] is reported."""
_MIN_FIXES, _CHANCE = 10, 4.0
"""Smallest number of fixes for a mean error, and number of standard deviations of the mean that may be chance."""


def causes(
    curves: Mapping[str, Columns], begin: float, end: float, config: SwitchingConfig, wheels: WheelGeometry | None
) -> list[tuple[int, str]]:
    """Return level and text of each cause between two times [s]. Without ``wheels``, wheels are not examined."""
    part = {
        role: {name: values[(columns["t"] >= begin) & (columns["t"] <= end)] for name, values in columns.items()}
        for role, columns in curves.items()
        if "t" in columns
    }
    lines = []
    for role, word in _NEEDED.items():
        if role not in part or len(curves[role]["t"]) < 2:
            continue
        silence = float(np.diff([begin, *np.sort(part[role]["t"]), end]).max())
        if silence > max(_SILENCE, _SILENT_PERIODS * float(np.median(np.abs(np.diff(curves[role]["t"]))))):
            lines.append((WARNING, f"No {word} for {silence:.1f} s"))
    if wheels is not None:
        for side, sign in (("left", -0.5), ("right", 0.5)):
            lines += _wheel(part, side, sign * wheels.wheel_separation, end - _LAST)
    return lines + _fixes(part, config)


def _wheel(part: Mapping[str, Columns], side: str, offset: float, late: float) -> list[tuple[int, str]]:
    """Return lines if a wheel, ``offset`` [m] to the right of the middle, slipped or stood still after ``late`` [s]."""
    rims = {
        role: (columns["t"], np.abs(columns["v"] + offset * columns["omega"]))
        for role in ("command", "odometry", "truth")
        if "v" in (columns := part.get(role, {})) and len(columns["t"]) > 1
    }
    if "odometry" not in rims:
        return []
    lines = []
    times, measured = rims["odometry"]
    if "command" in rims:
        commanded, turned = (_mean(speeds[t > late]) for t, speeds in (rims["command"], rims["odometry"]))
        if turned < _STANDING * commanded:
            lines.append(f"The {side} wheel did not turn: {commanded:.2f} m/s commanded, {turned:.2f} measured")
    if "truth" in rims:
        slips = (np.interp(times, *rims["truth"]) < _GRIP * measured) & (measured > _TURNING * measured.max())
        if (duration := float(slips.mean() * (times[-1] - times[0]))) > _SLIP:
            lines.append(f"The {side} wheel slipped for {duration:.1f} s")
    return [(ERROR, line) for line in lines]


def _mean(values: Array) -> float:
    return float(values.mean()) if len(values) else nan


def _fixes(part: Mapping[str, Columns], config: SwitchingConfig) -> list[tuple[int, str]]:
    """Return a line if the mean error of the fixes is above the tolerances and not explained by chance."""
    fixes, truth = part.get("fixes"), part.get("truth")
    if fixes is None or truth is None or len(fixes["t"]) < _MIN_FIXES or len(truth["t"]) < 2:
        return []
    x, y = (fixes[name] - np.interp(fixes["t"], truth["t"], truth[name]) for name in ("x", "y"))
    heading = np.where(truth.get("tt", np.zeros(1)) > MAX_VAR_THETA, nan, np.unwrap(truth["theta"]))
    turns = np.exp(1j * (fixes["theta"] - np.interp(fixes["t"], truth["t"], heading)))
    turns = turns[np.isfinite(turns)]
    distance, spread = hypot(float(x.mean()), float(y.mean())), hypot(float(x.std()), float(y.std()))
    turn = turn_spread = 0.0
    if len(turns):
        mean = turns.mean()
        # The mean of random headings is short, so its direction is chance.
        turn, turn_spread = abs(float(np.angle(mean))), float(np.angle(turns / mean).std() / abs(mean))
    chance, tolerance = _CHANCE / len(x) ** 0.5, config.tolerance
    is_off = distance > max(tolerance.xy_goal_tolerance, chance * spread)
    if is_off or turn > max(tolerance.yaw_goal_tolerance, chance * turn_spread):
        angle = f" and {degrees(turn):.0f} deg" if len(turns) else ""
        return [(ERROR, f"The fixes were {distance:.2f} m{angle} off the truth")]
    return []
