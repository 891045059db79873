"""Docking by a detector in the compiled loop: what plain Python does, and it docks."""

import numpy as np
import pytest

from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_control.law.configuration import ControllerConfig
from diffbot_control.law.docking import Docking, DockingConfig
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, out_of_frame
from diffbot_sim.compiled.batch import FEEDBACK_CODES, Starts, run_histories
from diffbot_sim.compiled.closed_loop import Case, buffers_for, make_loop, prepared
from diffbot_sim.model.detector import DetectorConfig, dock_of
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

PLANT = PlantConfig(sampling_time=0.05, drive_noise=0.02, encoder_noise=0.02)
LAW = DockingConfig(drive=ControllerConfig(data_sheet=DataSheet(0.5, 1.5, 15.0, 0.5, 2.0)))
DETECTOR = DetectorConfig(detection_rate=10.0, detection_sigma=0.004, detection_yaw_sigma=0.01, detection_delay=0.0)
CONTACT, OUT, START = Pose(0.0, 0.0, 0.0), Pose(-0.7, 0.0, 0.0), Pose(-1.5, 0.3, 0.2)


def case_of(detector=DETECTOR, law=LAW, goal=CONTACT, feedback="ekf", steps=400):
    case = Case(
        PLANT,
        SensorConfig(fix_rate=0.0, detector=detector),
        law,
        goal,
        FEEDBACK_CODES[feedback],
        False,
        steps,
        0.05,
        0.05,
    )
    return case._replace(filter=options_of(FilterConfig()))


CASES = {
    "it sees the dock": (case_of(), START),
    "late, with outliers": (case_of(DETECTOR._replace(detection_delay=0.12, detection_outlier=0.1)), START),
    "newest detection, backwards": (
        case_of(DETECTOR._replace(detection_sigma=0.0), LAW._replace(dock_backward=True), feedback="raw"),
        Pose(1.5, -0.3, 0.2),
    ),
    "dead time": (
        case_of(
            law=LAW._replace(
                drive=LAW.drive._replace(
                    data_sheet=LAW.data_sheet._replace(command_latency=0.2, drive_time_constant=0.1)
                )
            ),
        ),
        START,
    ),
    "it undocks": (case_of(DETECTOR._replace(detection_nearest=0.0), goal=OUT, steps=200), Pose(0.0, 0.01, 0.02)),
    "too uncertain": (case_of(DETECTOR._replace(detection_yaw_sigma=0.5), steps=600), START),
}


@pytest.mark.parametrize("name", CASES)
def test_compiled_it_is_plain_python(name):
    case, start = CASES[name]
    start = out_of_frame(start, dock_of(case.sensors.detector))
    found = run_histories(case, Starts(np.array([start])), 7, 3, 1, 1, Docking)[0]
    plain, expected = prepared(case), np.empty_like(found)
    make_loop(Docking)(plain, buffers_for(plain), 7, 3, start, expected)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-7)
    assert np.ptp(found[:, 0]) > 0.5
