"""The gyro from the plant to the estimate: its bias is found, and the heading stays where wheels that slip lose it."""

import math

import numpy as np
import one_process
from filter_input import START, fix, odometry, timed
from inside import inside
from nav_msgs.msg import Odometry
from robot import DEEP, planar, stamp
from sensor_msgs.msg import Imu

from diffbot_control.ekf_node import EkfNode

PLANT = {"initial_pose.x": 0.0, "initial_pose.y": 0.0, "initial_pose.yaw": 0.0, "fix_rate": 1.0}
PLANT |= {"slip_left": 0.6, "slip_start": 12.0, "slip_duration": 3.0, "gyro_rate": 10.0, "gyro_bias": 0.03}
STEPS = 170


def test_the_heading_is_kept_while_a_wheel_slips():
    with inside(PLANT, {"use_gyro": True}) as robot:
        measured = robot.peer.subscribe(Odometry, "odom", DEEP)
        robot.send_goal(9.0, 6.0, 0.5)
        robot.run(lambda: len(robot.poses) > STEPS, "the drive")
        report = robot.diagnosis("ekf")
        truths = headings(robot.truths)
        start = min(truths)

        def errors(messages):
            """Errors of the heading [rad] while the wheel slips."""
            slip = {t: one for t, one in headings(messages).items() if t in truths and 12.0 < t - start < 16.0}
            return np.array([math.remainder(one - truths[t], math.tau) for t, one in slip.items()])

        found, lost = errors(robot.poses), errors(measured)
    assert len(found) > 30
    assert np.abs(found).max() < 0.15
    # What the slip alone adds to the heading of the wheels.
    assert np.ptp(lost) > 2.0 * np.abs(found).max()
    assert int(report["imu received"]) > 0.9 * STEPS
    bias, deviation = (float(one) for one in report["gyro bias"].split(" +- "))
    assert abs(bias - 0.03) < 4.0 * deviation < 0.03
    assert int(report["odometry steps against the gyro"]) > 5


def headings(messages):
    """Headings by time [s]."""
    return {stamp(one) * 1e-9: planar(one.pose.pose)[2] for one in messages}


def imu(time, rate):
    message = timed(Imu(), time)
    message.angular_velocity.z = rate
    message.angular_velocity_covariance[8] = 2.5e-5
    return message


def test_a_silent_gyro_and_one_that_contradicts_the_wheels_are_reported():
    with one_process.nodes() as nodes:
        fed = one_process.Fed(nodes, EkfNode, {"use_gyro": True, "sensor_timeout": 600.0, "reliable_inputs": True})

        def drive(first, last, rate=None):
            for step in range(first, last):
                if rate is not None:
                    fed.send("imu", imu(START + 0.1 * step, rate))
                fed.send("odom", odometry(START + 0.1 * step, omega=0.1))
            return fed.node.health_level()

        fed.send("global_pose", fix())
        level, text = drive(1, 4)
        assert level == 1
        assert "no turn rate on imu" in text
        assert drive(4, 30, 0.1)[0] == 0
        level, text = drive(30, 70, 2.0)
        assert level == 1
        assert "wheels and gyro contradict each other" in text
        assert drive(70, 75, 0.1)[0] == 0
