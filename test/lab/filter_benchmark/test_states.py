"""The benchmark of estimated errors: its sensor of landmarks, and which figures stand where."""

import pytest

from diffbot_control.filter.landmark_calibration import NO_ERRORS, LandmarkErrors
from diffbot_control.filter.measurements import LandmarkMeasurement
from diffbot_lab.filter_benchmark import peer_drives, states
from diffbot_lab.filter_benchmark.peer import Errors


def test_the_sensor_of_the_landmarks_is_wrong_as_the_case_says():
    case = states.OPTIONS[2].cases[1]
    assert case.landmark_errors == NO_ERRORS
    wrong = case._replace(landmark_errors=LandmarkErrors(0.1, 0.02, 0.03))
    right, found = ([one.content for one in peer_drives.record_drive(one, 3, 2.0).events] for one in (case, wrong))
    pairs = [(a, b) for a, b in zip(right, found, strict=True) if isinstance(a, LandmarkMeasurement)]
    assert len(pairs) == 11 * 5
    for a, b in pairs:
        assert b.range == pytest.approx(1.02 * a.range + 0.1)
        assert b.bearing == pytest.approx(a.bearing + 0.03, abs=1e-9) or abs(a.bearing) > 3.1


def test_costs_are_above_one_and_gains_below():
    """Twice the position error, half the heading error with the states, on both drives."""
    drives = [[Errors(0.2 * n, 0.01 * n, 3.0, 0.0), Errors(0.1 * n, 0.02 * n, 9.0, 0.0)] for n in (1.0, 3.0)]
    found = states.figures_of(drives)
    assert found["with"]["position"][0] == pytest.approx(0.4)
    assert found["without"]["nees"][0] == 9.0
    assert found["ratio"]["position"] == pytest.approx([2.0, 2.0, 2.0])
    assert found["ratio"]["heading"][0] == pytest.approx(0.5)
    results = {"cases": [{"option": "o", "text": "t", **found}]}
    row = states.table(results).splitlines()[2]
    assert row == "| o | t | 0.200; 0.040; 9.0 | 0.400; 0.020; 3.0 | 2.00 [2.00, 2.00] | 0.50 [0.50, 0.50] |"
