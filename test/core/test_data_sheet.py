"""The data sheet: its names, its bounds, and what it refuses."""

import math

import pytest

from diffbot_core.data_sheet import PAPER_DATA_SHEET, UNLIMITED, DataSheet, rim_speed
from diffbot_core.errors import InvalidValueError
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import build, parameters_of

NAMES = {
    "linear.x.max_velocity": 1000.0,
    "angular.z.max_velocity": 1000.0,
    "wheel.max_velocity": 1e6,
    "linear.x.max_acceleration": 1000.0,
    "angular.z.max_acceleration": 1e4,
}


def test_the_parameters_have_the_names_of_diff_drive_controller():
    assert [parameter.name for parameter in parameters_of(DataSheet)] == [
        *NAMES,
        "wheel_radius",
        "wheel_separation",
        "command_latency",
        "drive_time_constant",
        "min_velocity",
        "min_rotation",
    ]


@pytest.mark.parametrize(("name", "largest"), NAMES.items())
def test_a_limit_is_positive_and_may_be_absent(name, largest):
    for value in (1e-3, largest, math.inf):
        build(DataSheet, {name: value})
    for value in (0.0, -1.0, 1.001 * largest, math.nan):
        with pytest.raises(InvalidValueError, match=name):
            build(DataSheet, {name: value})


@pytest.mark.parametrize(
    ("name", "largest"),
    [("command_latency", 5.0), ("drive_time_constant", 5.0), ("min_velocity", 1.0), ("min_rotation", 2.6)],
)
def test_what_lies_between_command_and_motion_is_bounded(name, largest):
    for value in (0.0, largest):
        build(DataSheet, {name: value})
    for value in (-0.001, 10.001, math.inf, math.nan):
        with pytest.raises(InvalidValueError, match=name):
            build(DataSheet, {name: value})


def test_a_dead_band_above_the_limit_is_refused():
    with pytest.raises(InvalidValueError, match="min_velocity"):
        build(DataSheet, {"linear.x.max_velocity": 0.1, "min_velocity": 0.2})
    with pytest.raises(InvalidValueError, match="min_rotation"):
        build(DataSheet, {"min_rotation": 2.7})


def test_the_default_robot_has_rims_as_fast_as_itself_and_the_papers_has_only_its_speed():
    assert rim_speed(DataSheet()) == pytest.approx(1.3)
    assert DataSheet()[:5] == (1.3, 2.6, 26.0, math.inf, math.inf)
    assert PAPER_DATA_SHEET[:5] == (1.3, math.inf, math.inf, math.inf, math.inf)
    assert UNLIMITED[:5] == (math.inf,) * 5
    assert rim_speed(DataSheet(wheel_max=10.0, wheels=WheelGeometry(0.1, 0.5))) == 1.0
    assert rim_speed(UNLIMITED) == math.inf
