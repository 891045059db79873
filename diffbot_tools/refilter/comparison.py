"""Figures of a filter's run: errors and NEES against recorded true poses, NIS and whiteness of its innovations."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_bag.bag.reader import BagReader
from diffbot_control.filter.localization import FilterEstimate
from diffbot_control.ros.messages.fields import pose_of, stamp_ns
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.foreign_files import shown
from diffbot_core.geometry import TWO_PI
from diffbot_core.units import S_PER_NS
from diffbot_tools.refilter.filter_run import Innovation
from diffbot_tools.trajectory import Trajectory, poses_at

Array = NDArray[np.float64]

MAX_VAR_THETA = math.pi**2
"""[rad^2] a true heading with a larger variance is not one"""


class Errors(NamedTuple):
    """Estimates against true poses, at the stamps where a true pose is known."""

    time: Array
    """(n,) [s] since the first estimate"""
    truth: Array
    """(n, 3) true poses [m, m, rad]"""
    error: Array
    """(n, 3) estimate minus truth [m, m, rad]"""
    P: Array
    """(n, 3, 3) covariances of the estimates"""


class Figures(NamedTuple):
    """What :func:`figures_of` computes; nan where nothing was measured."""

    seconds: float
    """duration of the estimates that could be compared"""
    rmse: float
    """[m] of the position"""
    largest: float
    """[m] of the position"""
    heading_rmse: float
    """[rad]"""
    nees: float
    """mean; its expectation is :attr:`nees_numbers`"""
    nees_numbers: int
    """3, or 2 without a true heading"""


class Consistency(NamedTuple):
    """Innovations of the accepted measurements."""

    accepted: int
    rejected: int
    nis: float
    """mean per number measured; 1 if the covariances are right"""
    correlation: float
    """of neighbouring innovations of one source: 0 if they are white"""
    bound: float
    """95 % of the correlations of white innovations are within +- this"""


def read_truth(reader: BagReader, topic: str) -> Trajectory:
    """Read true poses: Odometry, PoseWithCovarianceStamped or PoseStamped.

    Raises:
        DiffbotError: if the bag has no such topic, or no pose in it.
    """
    if topic not in reader.topics:
        names = shown(", ".join(sorted(reader.topics)))
        raise DiffbotError(f"{shown(reader.path)} has no topic {topic}: it has {names}")
    found: dict[int, tuple[float, float, float]] = {}
    for message in reader.decoded((topic,)):
        try:
            stamp, pose = _true_pose(message.content)
        except (AttributeError, BadMessageError) as error:
            raise DiffbotError(f"{topic} at {message.log_time} ns: not a pose: {error}") from error
        found[stamp] = pose
    if len(found) < 2:
        raise DiffbotError(f"{reader.path}: fewer than two poses in {topic}")
    stamps = np.array(sorted(found), dtype=np.int64)
    poses = np.array([found[stamp] for stamp in stamps.tolist()])
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Trajectory(stamps, poses)


def _true_pose(message: Any) -> tuple[int, tuple[float, float, float]]:
    covariance = getattr(message.pose, "covariance", None)
    x, y, theta = pose_of(message.pose if covariance is None else message.pose.pose)
    unknown = covariance is not None and covariance[35] > MAX_VAR_THETA
    return stamp_ns(message.header.stamp), (x, y, math.nan if unknown else theta)


def errors_of(estimates: list[FilterEstimate], truth: Trajectory) -> Errors:
    """Compare estimates with the true poses, which are interpolated linearly between neighbours.

    Raises:
        DiffbotError: if no estimate has a true pose at its time.
    """
    stamps = np.array([one.stamp for one in estimates], dtype=np.int64)
    return errors_at(stamps, np.array([one.pose for one in estimates]), np.array([one.P for one in estimates]), truth)


def errors_at(stamps: NDArray[np.int64], poses: Array, P: Array, truth: Trajectory) -> Errors:
    """Compare columns of estimates with the true poses, as :func:`errors_of` does.

    Args:
        stamps: (n,) [ns] of the estimates, in order.
        poses: (n, 3) [m, m, rad].
        P: (n, 3, 3) covariances.
        truth: at least two true poses.

    Raises:
        DiffbotError: if no estimate has a true pose at its time.
    """
    expected = poses_at(stamps, truth)
    use = np.isfinite(expected[:, :2]).all(axis=1)
    if not use.any():
        raise DiffbotError("no estimate at a time with a true pose")
    expected = expected[use]
    error = poses[use] - expected
    error[:, 2] -= TWO_PI * np.round(error[:, 2] / TWO_PI)
    time = (stamps[use] - stamps[0]) * S_PER_NS
    return Errors(time, expected, error, P[use])


def nees_of(error: Array, P: Array) -> Array:
    """Return e' P^-1 e for each row of ``error`` (n, k), with its covariance ``P`` (n, k, k)."""
    nees: Array = np.einsum("ni,ni->n", error, np.linalg.solve(P, error[:, :, None])[:, :, 0])
    return nees


def figures_of(errors: Errors) -> Figures:
    """Return the figures of a drive; without true headings, those of the position alone."""
    distance = np.hypot(errors.error[:, 0], errors.error[:, 1])
    numbers = 3 if np.isfinite(errors.error).all() else 2
    e, P = errors.error[:, :numbers], errors.P[:, :numbers, :numbers]
    return Figures(
        float(errors.time[-1] - errors.time[0]),
        float(np.sqrt(np.mean(distance**2))),
        float(distance.max()),
        float(np.sqrt(np.mean(errors.error[:, 2] ** 2))),
        float(np.mean(nees_of(e, P))),
        numbers,
    )


def consistency_of(innovations: list[Innovation]) -> Consistency:
    """Return mean NIS and lag-1 correlation of the accepted measurements.

    An innovation is whitened by the Cholesky factor of its S, and paired with the one before of the same source: the
    same landmark, or the same type of measurement.
    """
    accepted = [one for one in innovations if one.accepted]
    last: dict[Any, Array] = {}
    products = squares = 0.0
    numbers = pairs = 0
    for one in accepted:
        white = np.linalg.solve(np.linalg.cholesky(one.S), one.y)
        numbers += len(white)
        before = last.get(one.source)
        if before is not None:
            pairs += len(white)
            products += float(white @ before)
            squares += 0.5 * float(white @ white + before @ before)
        last[one.source] = white
    return Consistency(
        len(accepted),
        len(innovations) - len(accepted),
        sum(one.nis for one in accepted) / numbers if numbers else math.nan,
        products / squares if squares else math.nan,
        1.96 / math.sqrt(pairs) if pairs else math.nan,
    )


def describe_figures(figures: Figures) -> str:
    """Return the figures as lines of text."""
    heading = "not measured" if math.isnan(figures.heading_rmse) else f"{figures.heading_rmse:.4f} rad"
    return "\n".join(
        (
            f"compared              {figures.seconds:.1f} s",
            f"position, RMSE        {figures.rmse:.4f} m",
            f"position, largest     {figures.largest:.4f} m",
            f"heading, RMSE         {heading}",
            f"NEES, mean            {figures.nees:.3f} ({figures.nees_numbers} if consistent)",
        )
    )


def describe_consistency(consistency: Consistency) -> str:
    """Return the consistency as lines of text."""
    accepted, rejected, nis, correlation, bound = consistency
    return "\n".join(
        (
            f"measurements          {accepted} accepted, {rejected} rejected",
            f"NIS per number, mean  {nis:.3f} (1 if consistent)",
            f"whiteness, lag 1      {correlation:+.3f} (white: within +-{bound:.3f})",
        )
    )
