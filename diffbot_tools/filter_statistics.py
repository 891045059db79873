"""Statistics of a run of the filter: errors and NEES against true poses, NIS and whiteness of the innovations."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_bag.bag import BagReader
from diffbot_control.ros.messages.fields import pose_of, stamp_ns
from diffbot_core.errors import BadMessageError, DiffbotError, shown
from diffbot_core.geometry import TWO_PI
from diffbot_core.stamps import S_PER_NS

Array = NDArray[np.float64]

MAX_GAP = 500_000_000
"""[ns] longest gap between two true poses that is interpolated"""
MAX_VAR_THETA = math.pi**2
"""[rad^2] largest variance of a true heading that is used"""
NIS_TOPIC, NIS_LABELS = "/ekf/nis", ("nis", "numbers", "accepted")
"""Topic of a refiltered bag. It is a Float64MultiArray with these labels: the NIS of a measurement, the number of
measured quantities, and 1 if the measurement was accepted."""


class Trajectory(NamedTuple):
    """Poses in the order of their stamps."""

    stamps: NDArray[np.int64]
    """(n,) [ns], increasing"""
    poses: Array
    """(n, 3) [m, m, rad], the heading unwrapped; nan for an unknown heading"""


class Errors(NamedTuple):
    """Errors of the estimates at the stamps with a true pose."""

    time: Array
    """(n,) [s] since the first estimate"""
    truth: Array
    """(n, 3) true poses [m, m, rad]"""
    error: Array
    """(n, 3) estimate minus truth [m, m, rad]"""
    P: Array
    """(n, 3, 3) covariances of the estimates"""


class Innovation(NamedTuple):
    """The innovation of one measurement."""

    stamp: int
    """[ns]"""
    source: Any
    """name of the source, and the position of the landmark for a landmark measurement"""
    y: Array
    """(m,) innovation"""
    S: Array
    """(m, m) covariance of the innovation"""
    nis: float
    accepted: bool


class Consistency(NamedTuple):
    """Consistency of whitened innovations."""

    nis: float
    """mean NIS per measured quantity; 1 if the covariances are right"""
    correlation: float
    """correlation of consecutive innovations of one source; 0 if they are white"""
    bound: float
    """95 % of the correlations of white innovations are within +- ``bound``"""


def poses_at(stamps: NDArray[np.int64], trajectory: Trajectory) -> Array:
    """Return the poses (n, 3) of a trajectory at ``stamps`` [ns], by linear interpolation.

    A pose is nan before and after the trajectory, and in a gap longer than MAX_GAP.
    """
    times, poses = trajectory
    found = np.full((len(stamps), 3), np.nan)
    if len(times) < 2:
        return found
    after = np.clip(np.searchsorted(times, stamps), 1, len(times) - 1)
    gap = times[after] - times[after - 1]
    use = (stamps >= times[0]) & (stamps <= times[-1]) & (gap <= MAX_GAP)
    share = ((stamps - times[after - 1]) / gap)[use, None]
    found[use] = (1.0 - share) * poses[after - 1][use] + share * poses[after][use]
    return found


def read_truth(reader: BagReader, topic: str) -> Trajectory:
    """Read true poses from a topic of type Odometry, PoseWithCovarianceStamped or PoseStamped.

    Raises:
        DiffbotError: if the topic is missing in the bag, or contains fewer than two poses.
    """
    if topic not in reader.topics:
        names = shown(", ".join(sorted(reader.topics)))
        raise DiffbotError(f"{shown(reader.path)} has no topic {topic}, only {names}")
    found: dict[int, tuple[float, float, float]] = {}
    for message in reader.decoded((topic,)):
        try:
            pose = message.content.pose
            covariance = getattr(pose, "covariance", None)
            x, y, theta = pose_of(pose if covariance is None else pose.pose)
            known = covariance is None or covariance[35] <= MAX_VAR_THETA
            found[stamp_ns(message.content.header.stamp)] = (x, y, theta if known else math.nan)
        except (AttributeError, BadMessageError) as error:
            raise DiffbotError(f"the message of {topic} at {message.log_time} ns is not a pose: {error}") from error
    if len(found) < 2:
        raise DiffbotError(f"{shown(reader.path)}: {topic} has fewer than two poses")
    stamps = np.array(sorted(found), dtype=np.int64)
    poses = np.array([found[stamp] for stamp in stamps.tolist()])
    poses[:, 2] = np.unwrap(poses[:, 2])
    return Trajectory(stamps, poses)


def errors_at(stamps: NDArray[np.int64], poses: Array, P: Array, truth: Trajectory) -> Errors:
    """Return the errors of estimates; true poses are interpolated to the stamps of the estimates.

    Args:
        stamps: (n,) [ns] stamps of the estimates, increasing.
        poses: (n, 3) [m, m, rad] estimates.
        P: (n, 3, 3) covariances of the estimates.
        truth: at least two true poses.

    Raises:
        DiffbotError: if no estimate has a stamp with a true pose.
    """
    expected = poses_at(stamps, truth)
    use = np.isfinite(expected[:, :2]).all(axis=1)
    if not use.any():
        raise DiffbotError(
            f"no estimate has a stamp between two true poses that are at most {MAX_GAP * S_PER_NS:g} s apart"
        )
    error = poses[use] - expected[use]
    error[:, 2] -= TWO_PI * np.round(error[:, 2] / TWO_PI)
    return Errors((stamps[use] - stamps[0]) * S_PER_NS, expected[use], error, P[use])


def nees_of(error: Array, P: Array) -> Array:
    """Return e' P^-1 e for each error e (n, k) with covariance P (n, k, k)."""
    nees: Array = np.einsum("ni,ni->n", error, np.linalg.solve(P, error[:, :, None])[:, :, 0])
    return nees


def errors_text(errors: Errors) -> str:
    """Return duration, errors and mean NEES in lines of text.

    If a true heading is missing, the NEES is computed from the position alone.
    """
    distance = np.hypot(errors.error[:, 0], errors.error[:, 1])
    heading_rmse = float(np.sqrt(np.mean(errors.error[:, 2] ** 2)))
    numbers = 3 if np.isfinite(errors.error).all() else 2
    nees = nees_of(errors.error[:, :numbers], errors.P[:, :numbers, :numbers])
    heading = "not measured" if math.isnan(heading_rmse) else f"{heading_rmse:.4f} rad"
    return (
        f"compared              {errors.time[-1] - errors.time[0]:.1f} s\n"
        f"position, RMSE        {np.sqrt(np.mean(distance**2)):.4f} m\n"
        f"position, largest     {distance.max():.4f} m\n"
        f"heading, RMSE         {heading}\n"
        f"NEES, mean            {np.mean(nees):.3f} ({numbers} if consistent)"
    )


def consistency_of(white: Array, numbers: NDArray[Any], sources: NDArray[Any]) -> Consistency:
    """Return mean NIS and lag-1 correlation of innovations; nan without innovations.

    Args:
        white: (k, 3) innovations, each whitened by the Cholesky factor of its covariance and padded with zeros.
        numbers: (k,) number of measured quantities of each measurement.
        sources: (k,) number that identifies the source; pairs are consecutive innovations of one source.
    """
    order = np.argsort(sources, kind="stable")
    same = np.diff(sources[order]) == 0
    before, after = white[order][:-1][same], white[order][1:][same]
    pairs, squares = numbers[order][1:][same].sum(), 0.5 * (np.square(before).sum() + np.square(after).sum())
    return Consistency(
        float(np.square(white).sum() / numbers.sum()) if len(numbers) else math.nan,
        float((before * after).sum() / squares) if pairs else math.nan,
        1.96 / math.sqrt(pairs) if pairs else math.nan,
    )


def consistency_of_innovations(innovations: Iterable[Innovation]) -> Consistency:
    """Return the consistency of the accepted measurements; each landmark is a separate source."""
    accepted = [one for one in innovations if one.accepted]
    white, indices = np.zeros((len(accepted), 3)), dict[Any, int]()
    for row, one in zip(white, accepted, strict=True):
        row[: len(one.y)] = np.linalg.solve(np.linalg.cholesky(one.S), one.y)
    sources = np.array([indices.setdefault(one.source, len(indices)) for one in accepted])
    return consistency_of(white, np.array([len(one.y) for one in accepted]), sources)


def quantiles(values: Array, levels: Mapping[str, float]) -> dict[str, float | None]:
    """Return the quantile of ``values`` (n,) at each level in [0, 1], by the name of the level; None without values."""
    if len(values) == 0:
        return dict.fromkeys(levels)
    return dict(zip(levels, np.quantile(values, tuple(levels.values())).tolist(), strict=True))
