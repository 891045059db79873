"""Detection of faults in the wiring of the inputs of the ekf."""

import pytest

from diffbot_control.filter.odometry_check import MOTION, Agreement
from diffbot_control.ros.input_watch import InputWatch

NOW = 10**18
AGREES = Agreement(agreed=MOTION)


def watch():
    return InputWatch("odom", ("left", "right"), {"detected_dock_pose": 0.3})


@pytest.mark.parametrize(
    ("ages", "is_simulated", "texts"),
    [
        ({"odom": 0.4, "global_pose": 0.0}, False, ["global_pose is stamped 0.40 s ahead of odom"]),
        ({"odom": 0.0, "global_pose": 5.0}, False, ["global_pose is stamped 5.00 s behind odom"]),
        ({"odom": 0.0, "imu": -3600.0, "global_pose": 0.05}, False, ["imu is stamped 3600.00 s ahead of odom"]),
        ({"odom": 7200.0, "global_pose": 7200.05, "imu": 7199.95}, False, []),
        ({"odom": 0.0, "detected_dock_pose": 0.35}, False, []),
        ({"odom": 0.0, "detected_dock_pose": 0.5}, False, ["detected_dock_pose is stamped 0.50 s behind odom"]),
        # Simulated time may be received late.
        ({"odom": 0.2, "global_pose": 0.0}, True, []),
    ],
)
def test_different_clocks_are_reported_with_both_topics_and_the_difference(ages, is_simulated, texts):
    subject = watch()
    for now in (NOW, NOW + 2 * 10**9):
        for topic, age in ages.items():
            subject.clocks.add(topic, now - round(age * 1e9), now)
        subject.clocks.end_window()
    found = list(subject.faults(AGREES, is_simulated=is_simulated).values())
    assert [text.split(":")[0] for text in found] == texts
    assert all("chrony" in text for text in found)


@pytest.mark.parametrize(
    ("turns", "text"),
    [
        (Agreement(opposed=MOTION), "turn rates of imu and odom have opposite signs"),
        (Agreement(only_first=MOTION), "odom shows a turn, but imu does not"),
        (Agreement(only_second=MOTION), "imu shows a turn, but odom does not"),
        (Agreement(scaled=MOTION), "factor of ten"),
        (Agreement(agreed=0.5 * MOTION, opposed=0.5 * MOTION), ""),
        (Agreement(opposed=0.9 * MOTION), ""),
    ],
)
def test_a_gyro_that_contradicts_the_wheels_is_reported(turns, text):
    found = watch().faults(turns, is_simulated=False)
    assert ([*found] == ["turn rate"]) == bool(text)
    assert text in "".join(found.values())


def test_joints_are_reported_until_a_wheel_is_received():
    subject = watch()
    subject.receive_joints(("wheel_l", "wheel_r"), has_wheels=False)
    fault = subject.faults(AGREES, is_simulated=False)["joint_states"]
    assert "neither 'left' nor 'right', but wheel_l, wheel_r" in fault
    subject.receive_joints(("left", "right"), has_wheels=True)
    subject.receive_joints(("arm",), has_wheels=False)
    assert not subject.faults(AGREES, is_simulated=False)


def test_an_odometry_in_another_frame_than_the_published_frame_is_reported_with_both():
    subject = watch()
    subject.receive_frame("wheel_odom", "")
    assert not subject.faults(AGREES, is_simulated=False)
    subject.receive_frame("wheel_odom", "odom")
    fault = subject.faults(AGREES, is_simulated=False)["frame"]
    assert "'wheel_odom', but map -> odom is published for 'odom'" in fault
    subject.receive_frame("odom", "odom")
    assert not subject.faults(AGREES, is_simulated=False)
