"""The data sheet: its names, its bounds, and what it refuses."""

import math

import pytest

from diffbot_core.data_sheet import UNLIMITED, DataSheet, rim_speed
from diffbot_core.errors import InvalidValueError
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import build


def test_a_dead_band_above_the_limit_is_refused():
    with pytest.raises(InvalidValueError, match="min_velocity"):
        build(DataSheet, {"linear.x.max_velocity": 0.1, "min_velocity": 0.2})
    with pytest.raises(InvalidValueError, match="min_rotation"):
        build(DataSheet, {"min_rotation": 2.7})


def test_the_rims_of_the_default_robot_are_as_fast_as_itself():
    # 1.3 m/s straight on, and 2.6 rad/s on the spot with wheels 0.6 m apart: each is within 1.3 m/s.
    assert rim_speed(DataSheet()) == pytest.approx(DataSheet().v_max)
    assert rim_speed(DataSheet()) >= DataSheet().omega_max * 0.3
    assert rim_speed(DataSheet(wheel_max=10.0, wheels=WheelGeometry(0.1, 0.5))) == 1.0
    assert rim_speed(UNLIMITED) == math.inf
