"""Cases of the filter's benchmark: rates, wrong models, faults, further sensors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_sim.compiled.late_fusion import example_for
from diffbot_sim.compiled.open_loop import OpenLoopCase
from diffbot_sim.compiled.sensing import Robot
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

Array = NDArray[np.float64]

DURATION = 60.0
"""[s] of a run"""
SKIPPED = 10.0
"""[s] at the start of a run that are not evaluated"""
RATES = ((10, 1), (10, 5), (50, 10))
"""[Hz] of odometry and fixes"""
SLIP_START, SLIP_DURATION = 20.0, 3.0
"""[s]"""
LANDMARKS: Array = np.array(((-5.0, 5.0), (5.0, 5.0)))
"""[m] in the order in which the node's filter applies them"""
NO_LANDMARKS: Array = np.empty((0, 2))


class Scenario(NamedTuple):
    """One deviation from the nominal case, at several rates."""

    name: str
    section: str
    text: str
    plant: PlantConfig = PlantConfig()
    sensors: SensorConfig = SensorConfig()
    landmarks: Array = NO_LANDMARKS
    rates: tuple[tuple[int, int], ...] = RATES


_NOMINAL, _MESSAGES = "Right model", "Rates of the odometry"
_MODEL, _FAULTS, _KIDNAPPED, _SENSORS = "Wrong model", "Outliers and slip", "Kidnapped robot", "Further sensors"
_RADIUS_ERROR = 0.02
_OUTLIERS = SensorConfig(fix_outlier=0.05, fix_outlier_distance=3.0)
_SLIP = PlantConfig(slip_right=0.6, slip_start=SLIP_START, slip_duration=SLIP_DURATION)


def _kidnapped(plant: PlantConfig, time: float) -> PlantConfig:
    return plant._replace(kidnap_time=time, kidnap_x=3.6, kidnap_yaw=1.0)


SCENARIOS = (
    Scenario("nominal", _NOMINAL, "noise as the filter assumes it"),
    Scenario(
        "rates",
        _MESSAGES,
        "noise as the filter assumes it, odometry at 10, 50 and 100 Hz",
        rates=((10, 5), (50, 5), (100, 5)),
    ),
    Scenario("radius", _MODEL, "right wheel's radius 2 % too large", PlantConfig(right_radius_error=_RADIUS_ERROR)),
    Scenario("r_10", _MODEL, "R claimed 10 times as large", sensors=SensorConfig(fix_covariance_scale=10.0)),
    Scenario("r_01", _MODEL, "R claimed a tenth as large", sensors=SensorConfig(fix_covariance_scale=0.1)),
    Scenario("outliers", _FAULTS, "5 % of the fixes are 3 m off", sensors=_OUTLIERS),
    Scenario("slip", _FAULTS, "right wheel slips by 60 % from 20 s to 23 s", _SLIP),
    Scenario(
        "kidnapped", _KIDNAPPED, "carried 3.6 m away and turned by 1 rad at 20 s", _kidnapped(PlantConfig(), 20.0)
    ),
    Scenario(
        "all",
        _KIDNAPPED,
        "outliers, slip, 2 % radius error, and carried away at 40 s",
        _kidnapped(_SLIP._replace(right_radius_error=_RADIUS_ERROR), 40.0),
        _OUTLIERS,
    ),
    Scenario(
        "compass",
        _SENSORS,
        "compass of +-5 deg at 10 Hz",
        sensors=SensorConfig(heading_rate=10.0, heading_error_max=math.radians(5.0)),
        rates=RATES[:1],
    ),
    Scenario(
        "landmarks",
        _SENSORS,
        "two landmarks 10 m apart at the start, measured from anywhere, at 5 Hz",
        sensors=SensorConfig(landmark_rate=5.0, landmark_range=100.0),
        landmarks=LANDMARKS,
        rates=RATES[:1],
    ),
)


def name_of(scenario: str, odometry_rate: int, fix_rate: int) -> str:
    """Return the name of a case in results.json."""
    return f"{scenario}_{odometry_rate}_{fix_rate}"


def drive_of(scenario: Scenario, odometry_rate: int, fix_rate: int, filter_name: str) -> OpenLoopCase:
    """Return what all runs of a scenario, at rates [Hz], with one of FILTERS share."""
    plant = scenario.plant._replace(sampling_time=1.0 / odometry_rate)
    sensors = scenario.sensors._replace(fix_rate=float(fix_rate))
    options = options_of(FilterConfig(filter=filter_name), landmarks=len(scenario.landmarks) > 0)
    kidnapped = round(plant.kidnap_time * odometry_rate) if plant.kidnap_time > 0.0 else -1
    return OpenLoopCase(
        Robot(plant, sensors, options, scenario.landmarks),
        round(DURATION * odometry_rate),
        round(SKIPPED * odometry_rate),
        kidnapped,
        example_for(scenario.landmarks, options),
    )
