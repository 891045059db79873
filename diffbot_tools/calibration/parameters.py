"""What a calibration found as parameters of the nodes, and as rows of a table."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.options import CALIBRATING
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.schema import parameters_of, to_dict
from diffbot_tools.calibration.calibrate import Calibration
from diffbot_tools.calibration.events import FIX, HEADING, LANDMARK, RESET, UNKNOWN_RATE, Array, Events
from diffbot_tools.calibration.likelihood import settings_of
from diffbot_tools.calibration.quantities import CONSTANTS, times_of

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
_FACTORS = ("factors", "gyro_factor")
_GYRO: tuple[int, ...] = ()
_DEVIATIONS: dict[tuple[int, ...], str] = {
    (HEADING, 0): "heading_sigma",
    (LANDMARK, 0): "landmark_range_sigma",
    (LANDMARK, 1): "landmark_bearing_sigma",
    (FIX, 0): "global_pose_sigma_xy",
    (FIX, 1): "global_pose_sigma_yaw",
    _GYRO: "gyro_sigma",
}
"""Parameters of deviations by the index of the factor on them."""
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
    factors: dict[tuple[int, ...], float] = {}
    times = settings_of(config).times.tolist()
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
        before, after = 1.0, math.exp(used) if one.logarithmic else used
        if one.field.endswith(_FACTORS):
            # Errors of the map repeat, which looks like a good sensor.
            lower = one.place[:1] == (LANDMARK,) and after < 1.0
            factors[one.place], note = (1.0, "not lowered in the file") if lower else (after, note)
        elif one.field == "times":
            before = times[one.place[0]]
            times[one.place[0]] = after = after if known else before
        else:
            before = given[one.name]
            parameters[one.name] = after = before * after if one.logarithmic else after
        rows.append(Row(one.name, before, after, _relative(sigma) if one.logarithmic else f"{sigma:.2g}", note))
    if "alpha1" in parameters:
        parameters["odometry_noise"] = "motion"
    _add_constants(calibration, given, parameters, rows, undetermined)
    parameters |= _measurement_noise(calibration.drives, config, factors)
    if calibration.biases:
        # One start shows one bias: a smaller one does not make the next one smaller.
        own = math.sqrt(sum(bias**2 + sigma**2 for bias, sigma in calibration.biases) / len(calibration.biases))
        before = given["gyro_bias_sigma"]
        parameters["gyro_bias_sigma"] = after = max(before, own)
        text = ", ".join(f"{bias:.3g} +- {sigma:.1g}" for bias, sigma in calibration.biases)
        rows.append(Row("gyro_bias_sigma", before, after, "", f"bias {text} rad/s"))
    parameters |= {name: time for name, time in zip(times_of(config)[: FIX + 1], times, strict=False) if time}
    if any(times[FIX + 1 :]):
        parameters["pose_source_correlation_time"] = times[FIX + 1 :]
    if "fnn" in given["filter"] and times[FIX]:
        parameters["filter"] = CALIBRATING  # the others cannot be given a time
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
        parameters["filter"] = CALIBRATING
    # What one drive shows is not exactly what the next will: the states start from it, but are not nailed to it.
    wheels = 0.5 * float(prior[0])
    parameters |= {"wheel_radius_sigma": wheels, "wheel_separation_sigma": wheels}
    for index, name in enumerate(CONSTANTS[3:], 3):
        sigma_name = f"{name}_sigma"
        if prior[index] > 0.0 and sigma_name in given:
            parameters[sigma_name] = given[sigma_name] or 0.5 * float(prior[index])


def _measurement_noise(
    drives: list[Events], config: EkfNodeConfig, factors: dict[tuple[int, ...], float]
) -> dict[str, Any]:
    """Return the deviations of the sensors; messages with covariances are overridden if one of theirs changes."""
    if all(abs(factor - 1.0) <= 1e-3 for factor in factors.values()):
        return {}
    given, per_metre = _given_deviations(config), config.noise.landmark_range_sigma_per_metre
    used = {index: _used_deviations(drives, index) for index in factors}
    overriding = False
    for index, (deviations, ranges) in used.items():
        known = given[index] + (per_metre * ranges if index == (LANDMARK, 0) else 0.0)
        overriding |= not np.allclose(deviations, known, rtol=1e-6, atol=0.0)
    found: dict[tuple[int, ...], float] = {}
    for index, factor in factors.items():
        usual = math.sqrt(float(np.square(used[index][0]).mean()))
        found[index] = max((usual if overriding or index[0] != LANDMARK else given[index]) * factor, _FLOOR)
    noise: dict[str, Any] = {name: found[index] for index, name in _DEVIATIONS.items() if index in found}
    for column, name in enumerate(("pose_source_sigma_xy", "pose_source_sigma_yaw")):
        if any(index[0] > FIX for index in found if index != _GYRO):
            sensors = range(FIX + 1, FIX + 1 + len(config.localization.sources.pose_sources))
            noise[name] = [found.get((sensor, column), given[sensor, column]) for sensor in sensors]
    if (LANDMARK, 0) in factors:
        noise["landmark_range_sigma_per_metre"] = 0.0 if overriding else per_metre * factors[LANDMARK, 0]
    return noise | ({"override_covariance": True} if overriding else {})


def _given_deviations(config: EkfNodeConfig) -> dict[tuple[int, ...], float]:
    """Return the deviations of messages without covariances, by the index of their factor."""
    found = {index: float(getattr(config.noise, name)) for index, name in _DEVIATIONS.items()}
    for sensor, one in enumerate(config.localization.sources.settings(), FIX + 1):
        found[sensor, 0], found[sensor, 1] = one.sigma_xy, one.sigma_yaw
    return found


def _used_deviations(drives: list[Events], index: tuple[int, ...]) -> tuple[Array, Array]:
    """Return the deviations in the events for a factor, and the measured numbers: of landmarks, the ranges."""
    if index == _GYRO:
        used = [np.sqrt(np.diff(one.rates.variance)) / np.diff(one.rates.time) for one in drives]
        deviations = np.concatenate(used)
        return deviations[deviations < UNKNOWN_RATE], np.zeros(0)
    sensor, column = index
    rows = ((0, 1), (2,))[column] if sensor >= FIX else (column,)
    found = []
    for _, kind, of, _, values, R, *_ in (one.measurements for one in drives):
        use = (of == sensor) & (kind != RESET)
        found += [(np.sqrt(R[use, row, row]), values[use, 0]) for row in rows]
    deviations, numbers = (np.concatenate(column) for column in zip(*found, strict=True))
    finite = np.isfinite(deviations)
    return deviations[finite], numbers[finite]


def _bounded(parameters: dict[str, Any]) -> dict[str, Any]:
    """Keep numbers within what the node allows, with four digits."""
    specs = {one.name: one.spec for one in parameters_of(EkfNodeConfig)}
    found = {}
    for name, value in parameters.items():
        spec = specs[name]
        found[name] = value
        if isinstance(value, float):
            found[name] = min(max(float(f"{value:.4g}"), spec.minimum), spec.maximum)
        elif isinstance(value, list):
            found[name] = [min(max(float(f"{one:.4g}"), spec.minimum), spec.maximum) for one in value]
    return found
