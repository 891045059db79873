"""Makes the report of a bag: the thinned and packed data of the page, and CSV and TUM files beside the page."""

from __future__ import annotations

import base64
import io
import math
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diffbot_bag.info import TopicInfo
from diffbot_core.errors import DiffbotError
from diffbot_core.files import write_text
from diffbot_core.geometry import quaternion_of_yaw
from diffbot_tools.view.bag_source import BagRobot, BagRun
from diffbot_tools.view.columns import Array, Columns
from diffbot_tools.view.constants import constants_of
from diffbot_tools.view.events import Event
from diffbot_tools.view.results import cards_of, health_lines, result_line

MAX_ROWS = 40_000
"""Rows of a curve in the page. Curves of 13 minutes at 50 Hz are not thinned."""
MAX_LISTED, MAX_TOPICS = 2000, 500
"""Largest number of events of a robot, and of topics, that the page lists."""
UNIT, TIME_UNIT = 1e-5, 1e-4
"""Units of the integers in a packed column, in [m], [rad], [m/s] ... and, for times, in [s]; finer than any sensor."""
MISSING = -(2**31)
"""The integer for NaN and infinite values."""
_LARGEST = 2.0**30
"""Largest integer. For larger values, the unit is enlarged."""
_UNSEEN = {"estimate": {"xt", "yt"}, "truth": {"tt"}}
"""Columns that the page does not show."""
_TABLE, _PATHS = ("estimate", "truth", "odometry", "error", "command", "law"), ("truth", "estimate", "odometry")
"""Curves in the CSV table, and trajectories in TUM files."""


@np.errstate(all="ignore")
def page_data(run: BagRun, *others: BagRun) -> dict[str, Any]:
    """Return the data of the page, for one run or for several runs that the page lays over each other."""
    packer, runs = Packer(), (run, *others)
    return {
        "kind": "report",
        "isComparison": bool(others),
        "title": " against ".join(one.title for one in runs),
        "origin": run.origin // 10**6,
        "span": _span([robot for one in runs for robot in one.robots]),
        "messages": sum(one.messages for one in runs),
        "malformed": sum(one.malformed for one in runs),
        "robots": [
            _robot_data(robot, _name(robot, one, number) if others else robot.name, one, packer)
            for number, one in enumerate(runs, 1)
            for robot in one.robots
        ],
        "topics": [topic_figures(topic) for topic in ([] if others else run.topics[:MAX_TOPICS])],
        "packed": packer.text(),
    }


def _robot_data(robot: BagRobot, name: str, run: BagRun, packer: Packer) -> dict[str, Any]:
    cards = cards_of(robot.outcomes, robot.curves, robot.config, robot.wheels, robot.docking_outcomes)
    curves = {curve: packer.table(_thinned(curve, columns)) for curve, columns in robot.curves.items()}
    return {
        "name": name,
        "curves": curves | {"plan": packer.table(robot.plan)},
        "landmarks": robot.landmarks(),
        "dock": robot.dock,
        "goals": [
            [goal.time, *goal.pose, None if math.isnan(goal.ended) else goal.ended] for goal in robot.model.goals.goals
        ],
        "events": _listed(robot.all_events),
        "cards": cards,
        "result": result_line(cards),
        "health": health_lines(robot.curves, robot.all_events, run.lost, run.is_cut_off),
        "states": robot.states,
        "constants": constants_of(robot.config, robot.wheels),
    }


def _listed(events: list[Event]) -> list[Event]:
    """Return at most MAX_LISTED events. If there are more, drop switches first, then rejections, then the latest."""
    for details in ((), ("switch",), ("switch", "rejection")):
        kept = [event for event in events if event.kind not in details]
        if len(kept) <= MAX_LISTED:
            break
    return kept[:MAX_LISTED]


def _name(robot: BagRobot, run: BagRun, number: int) -> str:
    return f"{number}: {run.title}" + (f" {robot.name}" if len(run.robots) > 1 else "")


def _thinned(curve: str, columns: Columns) -> Columns:
    kept = {name: values for name, values in columns.items() if name not in _UNSEEN.get(curve, ())}
    rows = kept_rows(np.column_stack([values for name, values in kept.items() if name != "t"]), MAX_ROWS)
    return {name: values[rows] for name, values in kept.items() if np.isfinite(values).any()}


def kept_rows(columns: Array, max_rows: int) -> NDArray[np.int64]:
    """Return the indices of the rows to keep, in order: the lowest and the highest value of each column per bucket.

    Args:
        columns: (n, k) values; NaN is ignored.
        max_rows: largest number of rows, approximately; at least 4 k. A table with fewer rows is kept whole.
    """
    n, k = columns.shape
    if n <= max_rows:
        return np.arange(n)
    buckets = max((max_rows - 2) // (2 * k), 1)
    width = -(-n // buckets)
    padded = np.full((buckets * width, k), np.nan)
    padded[:n] = columns
    blocks = padded.reshape(buckets, width, k)
    first = np.arange(buckets)[:, None] * width
    low = first + np.argmin(np.where(np.isnan(blocks), np.inf, blocks), axis=1)
    high = first + np.argmax(np.where(np.isnan(blocks), -np.inf, blocks), axis=1)
    kept: NDArray[np.int64] = np.unique(np.concatenate((low.ravel(), high.ravel(), [0, n - 1])))
    inside: NDArray[np.int64] = kept[kept < n]
    return inside


def _span(robots: list[BagRobot]) -> list[float]:
    times = [columns["t"] for robot in robots for columns in robot.curves.values()]
    # Rounded outwards to milliseconds, so that the slider reaches the last row.
    begin, end = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
    return [math.floor(1000.0 * begin + 0.01) / 1000.0, math.ceil(1000.0 * end + 0.1) / 1000.0]


def topic_figures(topic: TopicInfo) -> dict[str, Any]:
    """Return number of messages, rate, largest gap and delays of a topic."""
    row: dict[str, Any] = {"name": topic.name, "type": topic.type, "count": topic.message_count}
    if topic.figures is not None:
        row |= {"rate": topic.figures.rate, "gap": topic.figures.gap}
        if (latency := topic.figures.latency) is not None:
            row |= {"delay": latency.median, "delay99": latency.p99}
    return row


class Packer:
    """Packs columns as differences of integers, compressed (zlib), as base64; page/store.js unpacks them.

    Neighbouring values differ little, so a difference needs one or two bytes instead of the eight of a float64.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._parts: list[bytes] = []
        self._size = 0

    def table(self, columns: Mapping[str, Array]) -> dict[str, Any]:
        """Add columns (n,) of equal length; return their description for the page."""
        described = {}
        for name, values in columns.items():
            unit, data = pack(values, TIME_UNIT if name == "t" else UNIT)
            described[name] = {"unit": unit, "at": self._size}
            self._parts.append(data)
            self._size += len(data)
        return {"rows": len(columns["t"]), "columns": described}

    def text(self) -> str:
        """Return all columns as text."""
        return base64.b64encode(zlib.compress(b"".join(self._parts), 6)).decode("ascii")


def pack(values: Array, unit: float) -> tuple[float, bytes]:
    """Return the unit of the integers, and the bytes of their differences: the lowest bytes of all, then the next."""
    finite = np.isfinite(values)
    largest = float(np.abs(values[finite]).max()) if finite.any() else 0.0
    unit = max(unit, largest / _LARGEST)
    whole = np.full(len(values), MISSING, np.int64)
    whole[finite] = np.round(values[finite] / unit).astype(np.int64)
    # The page sums the differences modulo 2^32.
    differences = np.diff(whole, prepend=0).astype(np.uint32)
    return unit, differences.astype("<u4").view(np.uint8).reshape(-1, 4).T.tobytes()


def export(run: BagRun, report: Path, csv: bool, tum: bool) -> list[Path]:
    """Write CSV and TUM files beside ``report``, with names that begin with its name; return the files.

    Raises:
        DiffbotError: if the files of two robots would have the same name. In this case no file is written.
        OSError: if a file cannot be written.
    """
    texts: list[tuple[Path, str]] = []
    for robot in run.robots:
        name = "".join(letter if letter.isalnum() else "_" for letter in robot.name)[:80]
        stem = f"{report.stem}_{name}" if len(run.robots) > 1 else report.stem
        if csv:
            texts.append((report.with_name(f"{stem}.csv"), csv_text(robot)))
        for curve in _PATHS if tum else ():
            if curve in robot.curves:
                path = report.with_name(f"{stem}_{curve}.tum")
                texts.append((path, tum_text(robot.curves[curve], run.origin)))
    files = [path for path, _ in texts]
    if len(set(files)) < len(files):
        raise DiffbotError("two robots of the bag would write files of the same name: rename a namespace")
    for path, text in texts:
        write_text(path, text)
    return files


def csv_text(robot: BagRobot) -> str:
    """Return a table with a row for each estimate; without estimates, for each odometry or true pose.

    A row contains the newest values of the other curves at its time. Cells before the first value are empty.
    """
    base = next(robot.curves[name] for name in ("estimate", "odometry", "truth") if name in robot.curves)
    times = base["t"]
    names, columns = ["t"], [times]
    for curve in _TABLE:
        if curve not in robot.curves:
            continue
        source = robot.curves[curve]
        held = np.searchsorted(source["t"], times + 1e-6, "right") - 1
        for name, values in source.items():
            if name != "t" and name not in _UNSEEN.get(curve, ()):
                names.append(f"{curve}.{name}")
                columns.append(np.where(held >= 0, values[np.maximum(held, 0)], np.nan))
    text = io.StringIO()
    np.savetxt(text, np.column_stack(columns), fmt="%.9g", delimiter=",", header=",".join(names), comments="")
    return text.getvalue().replace("nan", "")


def tum_text(path: Columns, origin: int) -> str:
    """Return a path in TUM format, lines ``stamp x y z qx qy qz qw``; ``origin`` is the stamp of t = 0 [ns]."""
    lines = []
    for t, x, y, theta in zip(*(path[name].tolist() for name in ("t", "x", "y", "theta")), strict=True):
        seconds, nanoseconds = divmod(origin + round(t * 1e9), 10**9)
        z, w = quaternion_of_yaw(theta)
        lines.append(f"{seconds}.{nanoseconds:09d} {x:.9g} {y:.9g} 0 0 0 {z:.9g} {w:.9g}")
    return "\n".join(lines) + "\n"
