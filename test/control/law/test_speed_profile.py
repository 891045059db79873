"""Braking profiles, against the way that braking takes, and the gains that follow from a data sheet."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law.speed_profile import (
    ProfileGains,
    approach_speed,
    auto_gains,
    braking,
    signed_braking,
    vagueness_of,
)
from diffbot_core.data_sheet import DataSheet

CHECK = settings(max_examples=100)
DISTANCES = st.floats(1e-6, 1e4)
BRAKES = st.floats(0.01, 100.0)
REACTS = st.floats(0.01, 10.0)


@CHECK
@given(st.floats(-10.0, 10.0), BRAKES, REACTS, st.floats(0.1, 5.0))
def test_the_signed_profile_is_odd_and_bounded(error, brake, react, largest):
    found = signed_braking(error, brake, react, largest)
    assert abs(found) == min(largest, braking(abs(error), brake, react))
    assert found * error >= 0.0
    assert signed_braking(-error, brake, react, largest) == -found


def test_a_position_that_is_not_known_well_is_approached_with_a_longer_reaction():
    gains = ProfileGains(brake=2.0, react=0.5, sigma_known=0.05)
    known = approach_speed(0.4, 1.0, gains, 10.0)
    # s^2 / (2 brake) + s react = 0.4 with 0.5 s: s^2 / 4 + s / 2 - 0.4 = 0.
    assert known == pytest.approx(-1.0 + math.sqrt(1.0 + 1.6))
    # Twice the deviation to arrive with: 0.5 s times 2^2 = 2 s. That is 0.05 m, or 0.3 of a wide tolerance.
    assert vagueness_of(0.1, gains, 0.1) == pytest.approx(2.0)
    assert vagueness_of(0.18, gains, 0.3) == pytest.approx(2.0)
    assert approach_speed(0.4, 2.0, gains, 10.0) == pytest.approx(-4.0 + math.sqrt(16.0 + 1.6))
    assert approach_speed(0.4, 0.0, gains, 10.0) == known
    assert approach_speed(100.0, 0.0, gains, 1.3) == 1.3
    assert approach_speed(0.0, 2.0, gains, 1.3) == 0.0


def test_automatic_gains_are_the_defaults_at_the_papers_period_and_follow_the_data_sheet():
    assert auto_gains(DataSheet(), 0.1) == pytest.approx(ProfileGains())
    slow = auto_gains(DataSheet(a_max=0.5, omega_dot_max=1.5, command_latency=0.2, drive_time_constant=0.1), 0.2)
    assert (slow.brake, slow.turn_brake, slow.hold_brake) == pytest.approx((0.43, 0.975, 0.975))
    # Half a period, 0.2 s of unknown latency and a tenth of what is known.
    assert (slow.react, slow.turn_react, slow.hold_react) == pytest.approx((0.66, 0.594, 0.528))
