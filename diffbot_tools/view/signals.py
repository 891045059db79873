"""The curves of one robot: what the page draws over time, from the tables of a bag."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from diffbot_bag.bag.number_rows import LABELLED
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import MAX_COORDINATE, Pose, origin_of_frame
from diffbot_core.units import S_PER_NS
from diffbot_tools.refilter.comparison import MAX_VAR_THETA, Errors, errors_at, nees_of
from diffbot_tools.trajectory import Trajectory
from diffbot_tools.view.bag_tables import LAW_COLUMNS, QUATERNION, RobotTables, Table, Timed
from diffbot_tools.view.clock import Array, Clock, Columns
from diffbot_tools.view.texts import FILTER_COLUMNS, filter_numbers

NEES_BOUNDS = tuple(float(chdtri(3, tail)) for tail in (0.975, 0.025))
"""95 % of the NEES of a consistent estimate of three numbers are between these"""
_LATEST = 2.0**31
"""[s] of the stamps of messages"""
_FOREIGN_CLOCK = 1.0
"""[s] stamps that differ by more from the log times are of another clock"""


def clock_of(robots: list[RobotTables]) -> Clock:
    """Return the clock of a bag, by the poses in it."""
    tables = [
        robot.tables[role] for robot in robots for role in ("truth", "estimate", "odometry") if role in robot.tables
    ]
    tables = [table for table in tables if len(table.stamps)]
    if not tables:
        paths = [robot.transforms[0] for robot in robots if len(robot.transforms[0])]
        return Clock(min(int(stamps[0]) for stamps in paths), 0) if paths else Clock(0, 0)
    offset = int(np.median(tables[0].log_times - tables[0].stamps))
    origin = min(int(table.stamps[0]) for table in tables)
    return Clock(origin, offset if abs(offset) * S_PER_NS > _FOREIGN_CLOCK else 0)


def curves_of(robot: RobotTables, clock: Clock) -> dict[str, Columns]:
    """Return the curves of a robot by name: columns of equal length, of which ``t`` [s] is the time."""
    tables = {role: _checked(table) for role, table in robot.tables.items()}
    curves: dict[str, Columns] = {}
    for role in ("truth", "estimate", "odometry", "fixes"):
        if role in tables and len(tables[role].stamps):
            curves[role] = _pose_columns(tables[role], clock)
    stamps, path = robot.transforms
    if "estimate" not in curves and len(stamps):
        curves["estimate"] = {"t": clock.of_stamps(stamps), "x": path[:, 0], "y": path[:, 1], "theta": path[:, 2]}
    if (command := tables.get("command")) is not None and len(command.stamps):
        shift = 0 if command.type.endswith("Stamped") else clock.offset
        v, omega = command.of("v", "omega").T
        curves["command"] = {"t": clock.of_stamps(command.stamps - shift), "v": v, "omega": omega}
    if (law := tables.get("law")) is not None and len(law.stamps):
        curves["law"] = _law_columns(law, clock)
    if (errors := _errors(tables)) is not None:
        curves["error"] = _error_columns(errors, (int(tables["estimate"].stamps[0]) - clock.origin) * S_PER_NS)
    if len((consistency := _filter_columns(robot.texts.get("filter", []), clock))["t"]):
        curves["filter"] = consistency
    if "odometry" in curves:
        _align(curves["odometry"], curves.get("truth", curves.get("estimate")))
    return curves


def _checked(table: Table) -> Table:
    """Leave out rows beyond MAX_COORDINATE and, of the law, rows at an impossible time."""
    with np.errstate(invalid="ignore"):
        limits = (_LATEST, MAX_COORDINATE) if table.type == LABELLED else (MAX_COORDINATE, MAX_COORDINATE)
        good = (np.abs(table.numbers[:, :2]) <= limits).all(axis=1)
        if "qx" in table.names:
            good &= np.isfinite(table.of(*QUATERNION)).all(axis=1)
    return (
        table
        if good.all()
        else table._replace(stamps=table.stamps[good], log_times=table.log_times[good], numbers=table.numbers[good])
    )


def yaw_of(quaternions: Array) -> Array:
    """Vectorised :func:`diffbot_core.geometry.yaw_of_quaternion`."""
    x, y, z, w = quaternions.T
    yaw: Array = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return yaw


def _pose_columns(table: Table, clock: Clock) -> Columns:
    x, y = table.of("x", "y").T
    columns = {"t": clock.of_stamps(table.stamps), "x": x, "y": y, "theta": yaw_of(table.of(*QUATERNION))}
    # All zero: unknown.
    if "xx" in table.names and np.any(table.of("xx")):
        columns |= {name: table.of(name)[:, 0] for name in ("xx", "xy", "yy", "tt")}
    if "v" in table.names:
        columns |= {name: table.of(name)[:, 0] for name in ("v", "omega")}
    return columns


def _law_columns(table: Table, clock: Clock) -> Columns:
    named = dict(zip(LAW_COLUMNS, table.numbers.T, strict=True))
    columns = {name: named[name] for name in ("rho", "alpha", "beta", "eps_P", "region", "V")}
    return {"t": named["stamp"] - clock.origin * S_PER_NS, **columns}


def _errors(tables: dict[str, Table]) -> Errors | None:
    truth, estimate = tables.get("truth"), tables.get("estimate")
    if truth is None or estimate is None or not len(estimate.stamps):
        return None
    stamps, first = np.unique(truth.stamps, return_index=True)
    if len(stamps) < 2:
        return None
    poses = np.column_stack((truth.of("x", "y")[first], np.unwrap(yaw_of(truth.of(*QUATERNION)[first]))))
    if "tt" in truth.names:
        poses[truth.of("tt")[first, 0] > MAX_VAR_THETA, 2] = np.nan
    estimates = np.column_stack((estimate.of("x", "y"), yaw_of(estimate.of(*QUATERNION))))
    P = estimate.of("xx", "xy", "xt", "xy", "yy", "yt", "xt", "yt", "tt").reshape(-1, 3, 3)
    try:
        return errors_at(estimate.stamps, estimates, P, Trajectory(stamps, poses))
    except DiffbotError:
        return None


def _error_columns(errors: Errors, start: float) -> Columns:
    columns = {"t": errors.time + start, "x": errors.error[:, 0], "y": errors.error[:, 1], "theta": errors.error[:, 2]}
    variances = np.diagonal(errors.P, axis1=1, axis2=2)
    sigmas = np.sqrt(np.where(variances > 0.0, variances, np.nan))
    nees = np.full(len(errors.time), np.nan)
    regular = np.isfinite(np.column_stack((errors.error, sigmas))).all(axis=1)
    regular[regular] &= np.linalg.det(errors.P[regular]) > 0.0
    if regular.any():
        nees[regular] = nees_of(errors.error[regular], errors.P[regular])
    names = ("three_sigma_x", "three_sigma_y", "three_sigma_theta")
    return columns | {name: 3.0 * sigma for name, sigma in zip(names, sigmas.T, strict=True)} | {"nees": nees}


def _filter_columns(statuses: list[Timed], clock: Clock) -> Columns:
    """Return NIS with its bounds, whiteness of the fixes, and the errors of the wheels, as ekf/status has them."""
    rows = [
        (clock.of_log_time(log_time), *filter_numbers(status.values))
        for log_time, status in statuses
        if "NIS per number" in status.values
    ]
    table = np.array(rows).reshape(-1, 1 + len(FILTER_COLUMNS))
    return dict(zip(("t", *FILTER_COLUMNS), table.T, strict=True))


def _align(odometry: Columns, reference: Columns | None) -> None:
    """Move the odometry rigidly so that it starts at the first pose of the reference after its start."""
    if reference is None:
        return
    index = min(int(np.searchsorted(reference["t"], odometry["t"][0])), len(reference["t"]) - 1)
    start = Pose(*(float(reference[name][index]) for name in ("x", "y", "theta")))
    at = min(int(np.searchsorted(odometry["t"], reference["t"][index])), len(odometry["t"]) - 1)
    first = Pose(*(float(odometry[name][at]) for name in ("x", "y", "theta")))
    origin = origin_of_frame(first, start)
    c, s = np.cos(origin.theta), np.sin(origin.theta)
    x, y = odometry["x"], odometry["y"]
    odometry["x"], odometry["y"] = origin.x + c * x - s * y, origin.y + s * x + c * y
    turned = odometry["theta"] + origin.theta
    odometry["theta"] = np.arctan2(np.sin(turned), np.cos(turned))
