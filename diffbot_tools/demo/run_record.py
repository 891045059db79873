"""A run as recorded in a bag: paths, goals, and the evaluation of each goal."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_bag.bag.reader import BagReader
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose, origin_of_frame, out_of_frame, yaw_of_quaternion
from diffbot_tools.metrics import GoalMetrics, goal_metrics

Array = NDArray[np.float64]

TRUTH, ESTIMATE, ODOMETRY, FIXES, GOALS = (
    "/ground_truth",
    "/pose",
    "/odom",
    "/global_pose",
    "/goal_pose",
)


class RunRecord(NamedTuple):
    """Paths of one run, (n, 4) each: stamp [s] since the first true pose, x, y [m], theta [rad]."""

    truth: Array
    estimate: Array
    odometry: Array
    """in ``map``, moved so that it starts at the true pose"""
    fixes: Array
    goals: list[tuple[float, Pose]]
    """time of sending [s] since the first true pose, and goal"""
    messages: int
    """messages in the bag"""
    lost: int
    """messages that the recorder reports as missed"""


class GoalResult(NamedTuple):
    """One goal of a run."""

    goal: Pose
    metrics: GoalMetrics
    estimation_error: float
    """[m] distance between the last estimate and the last true pose"""


def read_run(bag: Path, namespace: str = "") -> RunRecord:
    """Read the run in ``bag``.

    Raises:
        DiffbotError: if the bag cannot be read or holds no ground truth.
    """
    rows, received, messages, lost = _read_rows(bag, namespace)
    if not rows[TRUTH]:
        raise DiffbotError(f"{bag}: no {namespace}{TRUTH} in it")
    origin, last = rows[TRUTH][0][0], rows[TRUTH][-1][0]
    # A goal from a command line has no stamp, and another machine's is of another clock: use the time of reception.
    rows[GOALS] = [
        row if origin <= row[0] <= last else (log_time, *row[1:])
        for row, log_time in zip(rows[GOALS], received, strict=True)
    ]
    paths = {
        name: np.array([((row[0] - origin) * 1e-9, *row[1:]) for row in found]).reshape(-1, 4)
        for name, found in rows.items()
    }
    odometry = _aligned(paths[TRUTH], paths[ODOMETRY])
    goals = [(row[0], Pose(*row[1:])) for row in paths[GOALS].tolist()]
    return RunRecord(paths[TRUTH], paths[ESTIMATE], odometry, paths[FIXES], goals, messages, lost)


def _read_rows(bag: Path, namespace: str) -> tuple[dict[str, list[tuple[float, ...]]], list[int], int, int]:
    """Return rows (stamp [ns], x, y, theta) by topic, reception times of the goals [ns], messages, lost messages."""
    names = {namespace + name: name for name in (TRUTH, ESTIMATE, ODOMETRY, FIXES, GOALS)}
    rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in names.values()}
    received: list[int] = []
    with BagReader(bag) as reader:
        for message in reader.decoded(tuple(names)):
            name = names[message.topic]
            content = message.content
            stamp = content.header.stamp.sec * 10**9 + content.header.stamp.nanosec
            if name == GOALS:
                received.append(message.log_time)
            pose = content.pose if name == GOALS else content.pose.pose
            rows[name].append((stamp, *_pose(pose)))
        lost = int(reader.metadata.custom_data.get("lost_messages", 0)) if reader.metadata else 0
        return rows, received, reader.message_count, lost


def _aligned(truth: Array, odometry: Array) -> Array:
    """Move the odometry rigidly so that its first pose coincides with the true pose at that time."""
    if len(odometry) == 0:
        return odometry
    known = truth[truth[:, 0] <= odometry[0, 0] + 1e-6]
    start = Pose(*(known[-1] if len(known) else truth[0])[1:].tolist())
    first = Pose(*odometry[0, 1:].tolist())
    origin = origin_of_frame(first, start)
    moved = [out_of_frame(Pose(*row), origin) for row in odometry[:, 1:].tolist()]
    return np.column_stack((odometry[:, 0], np.array(moved)))


def _pose(message: Any) -> Pose:
    q = message.orientation
    return Pose(message.position.x, message.position.y, yaw_of_quaternion(q.x, q.y, q.z, q.w))


def evaluate(record: RunRecord, xy_tolerance: float, yaw_tolerance: float) -> list[GoalResult]:
    """Evaluate each goal over the time until the next one, from the true poses."""
    results = []
    for index, (start, goal) in enumerate(record.goals):
        end = record.goals[index + 1][0] if index + 1 < len(record.goals) else np.inf
        time = record.truth[:, 0]
        # The first goal is sent before the first step; the pose at a goal's time belongs to both intervals.
        part = record.truth[(time >= start) & (time <= end)]
        if len(part) == 0:
            continue
        metrics = goal_metrics(part[:, 0], part[:, 1:], goal, xy_tolerance, yaw_tolerance)
        results.append(GoalResult(goal, metrics, _estimation_error(record.estimate, part[-1])))
    return results


def _estimation_error(estimate: Array, truth: Array) -> float:
    known = estimate[estimate[:, 0] <= truth[0] + 1e-6]
    if len(known) == 0:
        return float("nan")
    return float(np.hypot(known[-1, 1] - truth[1], known[-1, 2] - truth[2]))
