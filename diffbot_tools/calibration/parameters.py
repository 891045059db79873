"""What a calibration found as parameters of the nodes, and as rows of a table."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import yaml

from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.schema import parameters_of, to_dict
from diffbot_tools.calibration.calibrate import Calibration
from diffbot_tools.calibration.events import FIX, HEADING, LANDMARK, Array, Events
from diffbot_tools.calibration.latency import Latency, limits_of
from diffbot_tools.calibration.quantities import CONSTANTS

UNDETERMINED = 0.7
"""A posterior deviation above this share of the prior's: the drive does not determine the number."""
SPOT, STRAIGHT, EIGHT, STAND, NEAR_FAR, MORE = (
    "turn on the spot, several turns each way",
    "drive straight lines of several metres, both ways",
    "drive a figure eight with changing speed",
    "stand still for a minute",
    "come near to landmarks and go far from them",
    "drive longer",
)
MANOEUVRES = {
    "odometry_delay": EIGHT, "alpha1": SPOT, "alpha2": STRAIGHT, "alpha3": STRAIGHT, "density_xy": STAND,
    "density_theta": STAND, "left_radius_error": STRAIGHT, "right_radius_error": STRAIGHT,
    "wheel_separation_error": SPOT, "landmark_range_offset": NEAR_FAR, "landmark_range_scale": NEAR_FAR,
    "landmark_bearing_offset": EIGHT, "fix_correlation_time": MORE,
}  # fmt: skip
_FLOOR = 1e-4
"""[m], [rad] smallest deviation that the filter allows"""


class Row(NamedTuple):
    """One number."""

    name: str
    before: float
    after: float
    deviation: str
    note: str


class Outcome(NamedTuple):
    """Parameters to write, and the table."""

    parameters: dict[str, Any]
    rows: list[Row]
    undetermined: list[tuple[str, str]]
    """name, and the manoeuvre that would determine it"""


def outcome_of(calibration: Calibration, config: EkfNodeConfig) -> Outcome:
    """Return the parameters of the node ``ekf`` that change; what the drive does not determine stays as given."""
    given = to_dict(config)
    rows: list[Row] = []
    undetermined: list[tuple[str, str]] = []
    factors: dict[str, float] = {}
    parameters: dict[str, Any] = {}
    deviations = np.sqrt(np.diag(calibration.found.covariance)).tolist()
    for one, value, sigma, bounded in zip(
        calibration.quantities, calibration.found.values.tolist(), deviations, calibration.found.at_bound, strict=True
    ):
        known = bounded or sigma <= UNDETERMINED * one.spread
        if not known:
            undetermined.append((one.name, MANOEUVRES.get(one.name, MORE)))
        used = value if known else one.start
        note = "at its bound" if bounded else "" if known else "not determined"
        if one.name.endswith("_factor"):
            factors[one.name] = math.exp(used)
            rows.append(Row(one.name, 1.0, math.exp(used), _relative(sigma), note))
            continue
        before = given[one.name]
        if one.name == "fix_correlation_time":
            after = math.exp(used)
        else:
            after = before * math.exp(used) if one.logarithmic else used
        parameters[one.name] = after
        rows.append(Row(one.name, before, after, _relative(sigma) if one.logarithmic else f"{sigma:.2g}", note))
    if "alpha1" in parameters:
        parameters["odometry_noise"] = "motion"
    _add_constants(calibration, given, parameters, rows, undetermined)
    parameters |= _measurement_noise(calibration.drives, config, factors)
    return Outcome(_bounded(parameters), rows, undetermined)


def _relative(sigma: float) -> str:
    return f"{100.0 * math.expm1(min(sigma, 10.0)):.0f} %"


def _add_constants(
    calibration: Calibration,
    given: dict[str, Any],
    parameters: dict[str, Any],
    rows: list[Row],
    undetermined: list[tuple[str, str]],
) -> None:
    prior, sigmas = calibration.prior.sigma, np.sqrt(np.diag(calibration.constants_covariance)).tolist()
    for index, name in enumerate(CONSTANTS):
        if prior[index] == 0.0 or name not in given:
            continue
        before, after, sigma = given[name], float(calibration.constants[index]), sigmas[index]
        known = sigma <= UNDETERMINED * prior[index]
        if not known:
            undetermined.append((name, MANOEUVRES[name]))
        rows.append(Row(name, before, after if known else before, f"{sigma:.2g}", "" if known else "not determined"))
        parameters[name] = after if known else before
    if "calibrating" not in given["filter"]:
        parameters["filter"] = "ekf_calibrating"
    # What one drive shows is not exactly what the next will: the states start from it, but are not nailed to it.
    wheels = 0.5 * float(prior[0])
    parameters |= {"wheel_radius_sigma": wheels, "wheel_separation_sigma": wheels}
    for index, name in enumerate(CONSTANTS[3:], 3):
        sigma_name = f"{name}_sigma"
        if prior[index] > 0.0 and sigma_name in given:
            parameters[sigma_name] = given[sigma_name] or 0.5 * float(prior[index])


def _measurement_noise(drives: list[Events], config: EkfNodeConfig, factors: dict[str, float]) -> dict[str, Any]:
    """Return the deviations of the sources; messages with covariances are overridden if one of theirs changes."""
    noise, found = config.noise, {}
    changed = any(abs(factor - 1.0) > 1e-3 for factor in factors.values())
    overriding = changed and _has_own_covariances(drives, config)
    for name, kind, rows, parameter in (
        ("xy_factor", FIX, (0, 1), "global_pose_sigma_xy"),
        ("yaw_factor", FIX, (2,), "global_pose_sigma_yaw"),
        ("heading_factor", HEADING, (0,), "heading_sigma"),
    ):
        if name in factors and changed:
            found[parameter] = max(_deviation(drives, kind, rows) * factors[name], _FLOOR)
    for name, row, parameter in (
        ("range_factor", 0, "landmark_range_sigma"),
        ("bearing_factor", 1, "landmark_bearing_sigma"),
    ):
        if name not in factors or not changed:
            continue
        if overriding:
            found[parameter] = max(_deviation(drives, LANDMARK, (row,)) * factors[name], _FLOOR)
        else:
            found[parameter] = getattr(noise, parameter) * factors[name]
    if "range_factor" in factors and changed:
        per_metre = 0.0 if overriding else noise.landmark_range_sigma_per_metre * factors["range_factor"]
        found["landmark_range_sigma_per_metre"] = per_metre
    if overriding:
        found["override_covariance"] = True
    return found


def _has_own_covariances(drives: list[Events], config: EkfNodeConfig) -> bool:
    """Return whether a covariance differs from what the configuration says of messages without one."""
    noise = config.noise
    for events in drives:
        _, kind, _, values, R, _ = events.measurements
        ranges, bearings = R[kind == LANDMARK, 0, 0], R[kind == LANDMARK, 1, 1]
        at = values[kind == LANDMARK, 0]
        expected = (noise.landmark_range_sigma + noise.landmark_range_sigma_per_metre * at) ** 2
        for variances, known in (
            (ranges, expected),
            (bearings, np.full(len(bearings), noise.landmark_bearing_sigma**2)),
            (R[kind == FIX, 0, 0], np.full((kind == FIX).sum(), noise.global_pose_sigma_xy**2)),
            (R[kind == HEADING, 0, 0], np.full((kind == HEADING).sum(), noise.heading_sigma**2)),
        ):
            finite = np.isfinite(variances)
            if not np.allclose(variances[finite], known[finite], rtol=1e-6, atol=0.0):
                return True
    return False


def _deviation(drives: list[Events], kind: int, rows: tuple[int, ...]) -> float:
    """Return the root mean square of the deviations in the events."""
    found: list[Array] = []
    for one in drives:
        R = one.measurements.R[one.measurements.kind == kind]
        found += [R[:, row, row] for row in rows]
    variances = np.concatenate(found)
    return math.sqrt(float(variances[np.isfinite(variances)].mean()))


def _bounded(parameters: dict[str, Any]) -> dict[str, Any]:
    """Keep numbers within what the node allows, with four digits."""
    specs = {one.name: one.spec for one in parameters_of(EkfNodeConfig)}
    found = {}
    for name, value in parameters.items():
        spec = specs[name]
        found[name] = value
        if isinstance(value, float):
            found[name] = min(max(float(f"{value:.4g}"), spec.minimum), spec.maximum)
    return found


def parameter_file(given: dict[str, Any], outcome: Outcome, latency: Latency | None, head: str) -> str:
    """Return a ROS parameter file for the nodes ``ekf`` and, with a latency, ``controller``.

    Args:
        given: parameters of the ekf before, by name.
        outcome: of the calibration.
        latency: of the commands.
        head: lines of comment.
    """
    content: dict[str, Any] = {"/**/ekf": {"ros__parameters": given | outcome.parameters}}
    if latency is not None:
        answers = {
            "command_latency": round(latency.dead_time, 3),
            "drive_time_constant": round(latency.time_constant, 3),
            **{name: float(f"{limit:.3g}") for name, limit in limits_of(latency).items()},
        }
        content["/**/controller"] = {"ros__parameters": answers}
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
    return "".join(f"# {line}\n" for line in head.splitlines()) + text


def given_parameters(config: EkfNodeConfig) -> dict[str, Any]:
    """Return the parameters of a configuration that differ from the defaults, as a file has them."""
    defaults, values = to_dict(EkfNodeConfig()), to_dict(config)
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in values.items()
        if value != defaults[name]
    }
