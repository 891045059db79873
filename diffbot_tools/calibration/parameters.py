"""Convert the result of a calibration to parameters of the node ``ekf`` and to rows of a table."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.config import CALIBRATING, FNN, FNN_CALIBRATING
from diffbot_control.filter.models import WHEELS, is_angle, size_of
from diffbot_control.filter.odometry import MOTION, Densities
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.schema import parameters_of, to_dict
from diffbot_tools.calibration.calibrate import Calibration
from diffbot_tools.calibration.events import (
    FIX_SENSOR,
    FURTHER_SENSORS,
    HEADING_SENSOR,
    LANDMARK_SENSOR,
    RESET,
    UNKNOWN_RATE,
    Array,
    Events,
)
from diffbot_tools.calibration.kernel import settings_of
from diffbot_tools.calibration.quantities import CONSTANTS

UNDETERMINED = 0.7
"""A number is not determined if its standard deviation exceeds this share of its prior standard deviation."""
_DOUBLE, _DIFFERENT = math.log(2.0), 2.0
"""A noise of the motion whose logarithm has a larger standard deviation than this is not determined either, unless the
given value is more than this many standard deviations away."""
_ROUGH = "only its order of magnitude is determined"
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
_FACTORS = ("factors", "gyro_factor")
_GYRO: tuple[int, ...] = ()
_DEVIATIONS: dict[tuple[int, ...], str] = {
    (HEADING_SENSOR, 1): "heading_sigma",
    (LANDMARK_SENSOR, 0): "landmark_range_sigma",
    (LANDMARK_SENSOR, 1): "landmark_bearing_sigma",
    (FIX_SENSOR, 0): "global_pose_sigma_xy",
    (FIX_SENSOR, 1): "global_pose_sigma_yaw",
    _GYRO: "gyro_sigma",
}
"""Parameters that are standard deviations, by the index of the factor on them."""
_FLOOR = 1e-4
"""[m], [rad] smallest standard deviation that the filter allows"""


class Row(NamedTuple):
    """One number of the table."""

    name: str
    before: float
    after: float
    deviation: str
    note: str


class CalibrationResult(NamedTuple):
    """Parameters to write, and the content of the table."""

    parameters: dict[str, Any]
    rows: list[Row]
    undetermined: list[tuple[str, str]]
    """name of each number that is not determined, and a manoeuvre that determines it"""


def result_of(calibration: Calibration, config: EkfNodeConfig) -> CalibrationResult:
    """Return the changed parameters of the node ``ekf``; numbers that the drives do not determine keep their values."""
    given, found = to_dict(config), CalibrationResult({}, [], [])
    factors: dict[tuple[int, ...], float] = {}
    times = settings_of(config).times.tolist()
    fit, parameters = calibration.found, found.parameters
    deviations = np.sqrt(np.diag(fit.covariance)).tolist()
    for one, value, sigma, bounded in zip(
        calibration.quantities, fit.values.tolist(), deviations, fit.at_bound, strict=True
    ):
        rough = one.field in Densities._fields and sigma > _DOUBLE
        known = bounded or sigma <= UNDETERMINED * one.spread
        if rough and not bounded and abs(value - one.start) <= _DIFFERENT * sigma:
            known = False
        if not known:
            found.undetermined.append((one.name, MANOEUVRES.get(one.name, MORE)))
        note = "at its bound" if bounded else "not determined" if not known else _ROUGH if rough else ""
        before, after = 1.0, value if known else one.start
        after = math.exp(after) if one.logarithmic else after
        if one.field.endswith(_FACTORS):
            # Constant errors of the map make a landmark sensor look more accurate than it is.
            lower = one.place[:1] == (LANDMARK_SENSOR,) and after < 1.0
            factors[one.place], note = (1.0, "not lowered in the file") if lower else (after, note)
        elif one.field == "times":
            before = times[one.place[0]]
            times[one.place[0]] = after = after if known else before
        else:
            before = given[one.name]
            parameters[one.name] = after = before * after if one.logarithmic else after
        deviation = f"{100.0 * math.expm1(min(sigma, 10.0)):.0f} %" if one.logarithmic else f"{sigma:.2g}"
        found.rows.append(Row(one.name, before, after, deviation, note))
    if "alpha1" in parameters:
        parameters["odometry_noise"] = MOTION
    _add_constants(calibration, given, found)
    parameters |= _measurement_noise(calibration.drives, config, factors)
    if calibration.biases:
        # The bias changes from drive to drive, so a small bias of one drive does not lower the prior.
        own = math.sqrt(sum(bias**2 + sigma**2 for bias, sigma in calibration.biases) / len(calibration.biases))
        before = given["gyro_bias_sigma"]
        parameters["gyro_bias_sigma"] = after = max(before, own)
        text = ", ".join(f"{bias:.3g} +- {sigma:.1g}" for bias, sigma in calibration.biases)
        found.rows.append(Row("gyro_bias_sigma", before, after, "", f"bias {text} rad/s"))
    if any(times):
        parameters["correlation_times"] = times
    if given["filter"] in (FNN, FNN_CALIBRATING) and times[FIX_SENSOR]:
        parameters["filter"] = CALIBRATING  # the fuzzy rules underestimate correlated errors
    return found._replace(parameters=_bounded(parameters))


def _add_constants(calibration: Calibration, given: dict[str, Any], found: CalibrationResult) -> None:
    sigmas = np.sqrt(np.diag(calibration.constants_covariance)).tolist()
    variances = calibration.settings.options.variances
    for (name, state), value, sigma in zip(CONSTANTS.items(), calibration.constants.tolist(), sigmas, strict=True):
        prior = math.sqrt(variances[state - WHEELS])
        if prior == 0.0 or name not in given:
            continue
        known = sigma <= UNDETERMINED * prior
        if not known:
            found.undetermined.append((name, MANOEUVRES[name]))
        found.parameters[name] = after = value if known else given[name]
        found.rows.append(Row(name, given[name], after, f"{sigma:.2g}", "" if known else "not determined"))
    if "calibrating" not in given["filter"]:
        found.parameters["filter"] = CALIBRATING
    # The wheels wear and the load changes, so the filter continues to estimate the errors from these values.
    wheels = 0.5 * math.sqrt(variances[0])
    found.parameters.update(wheel_radius_sigma=wheels, wheel_separation_sigma=wheels)


def _measurement_noise(
    drives: list[Events], config: EkfNodeConfig, factors: dict[tuple[int, ...], float]
) -> dict[str, Any]:
    """Return the standard deviations of the sensors.

    If a factor changes the noise of messages that contain covariances, the parameters override these covariances.
    """
    if all(abs(factor - 1.0) <= 1e-3 for factor in factors.values()):
        return {}
    given = _given_deviations(config)
    used = {index: _used_deviations(drives, index) for index in factors}
    overriding = any(not np.allclose(used[index], given[index], rtol=1e-6, atol=0.0) for index in factors)
    found: dict[tuple[int, ...], float] = {}
    for index, factor in factors.items():
        usual = math.sqrt(float(np.square(used[index]).mean()))
        found[index] = max((usual if overriding or index[0] != LANDMARK_SENSOR else given[index]) * factor, _FLOOR)
    noise: dict[str, Any] = {name: found[index] for index, name in _DEVIATIONS.items() if index in found}
    for column, name in enumerate(("pose_source_sigma_xy", "pose_source_sigma_yaw")):
        if any(index[0] >= FURTHER_SENSORS for index in found if index != _GYRO):
            count = len(config.localization.sources.pose_sources)
            indices = [(sensor, column) for sensor in range(FURTHER_SENSORS, FURTHER_SENSORS + count)]
            noise[name] = [found.get(index, given[index]) for index in indices]
    return noise | ({"override_covariance": True} if overriding else {})


def _given_deviations(config: EkfNodeConfig) -> dict[tuple[int, ...], float]:
    """Return the standard deviations of messages without covariances, by the index of their factor."""
    found = {index: float(getattr(config.noise, name)) for index, name in _DEVIATIONS.items()}
    for sensor, one in enumerate(config.localization.sources.settings(), FURTHER_SENSORS):
        found[sensor, 0], found[sensor, 1] = one.sigma_xy, one.sigma_yaw
    return found


def _used_deviations(drives: list[Events], index: tuple[int, ...]) -> Array:
    """Return the standard deviations of the measurements that a factor applies to."""
    if index == _GYRO:
        used = [np.sqrt(np.diff(one.rates.variance)) / np.diff(one.rates.time) for one in drives]
        deviations = np.concatenate(used)
        return deviations[deviations < UNKNOWN_RATE]
    sensor, angle = index
    found = []
    for measured in (one.measurements for one in drives):
        for kind in set(measured.kind.tolist()) - {RESET}:
            use = (measured.sensor == sensor) & (measured.kind == kind)
            found += [np.sqrt(measured.R[use, i, i]) for i in range(size_of(kind)) if is_angle(kind, i) == angle]
    return np.concatenate(found)


def _bounded(parameters: dict[str, Any]) -> dict[str, Any]:
    """Round numbers to four digits and clip them to the range of their parameter."""
    specs = {one.name: one.spec for one in parameters_of(EkfNodeConfig)}

    def bounded(name: str, value: Any) -> Any:
        if isinstance(value, list):
            return [bounded(name, one) for one in value]
        if not isinstance(value, float):
            return value
        return min(max(float(f"{value:.4g}"), specs[name].minimum), specs[name].maximum)

    return {name: bounded(name, value) for name, value in parameters.items()}
