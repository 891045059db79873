"""Landmarks and a gyro from the plant to the estimate, which stays while that of the wheels is lost."""

import numpy as np
import one_process
from filter_input import START, fix, odometry, timed
from geometry_msgs.msg import PoseWithCovarianceStamped
from inside import inside
from nav_msgs.msg import Odometry
from robot import DEEP, distance, initialpose, planar, stamp
from sensor_msgs.msg import Imu

from diffbot_control.ekf_node import EkfNode
from diffbot_core.geometry import Pose, out_of_frame

MAP = {"landmark_ids": [1, 2, 3], "landmark_x": [5.0, 5.0, -5.0], "landmark_y": [5.0, -5.0, 0.0]}
BEGIN = Pose(-2.0, -1.0, 0.3)
PLANT = {"initial_pose.x": BEGIN.x, "initial_pose.y": BEGIN.y, "initial_pose.yaw": BEGIN.theta, "fix_rate": 0.0}
PLANT |= {"slip_right": 0.6, "slip_start": 2.0, "slip_duration": 3.0, "gyro_rate": 10.0, "gyro_bias": 0.03}
PLANT |= {"landmark_rate": 10.0}
STEPS = 200
"""20 s"""


def test_landmarks_and_a_gyro_keep_the_estimate_while_a_wheel_slips_and_find_the_bias():
    with inside({**PLANT, **MAP}, {**MAP, "use_gyro": True}) as robot:
        measured = robot.peer.subscribe(Odometry, "odom", DEEP)
        poses = robot.peer.publisher(PoseWithCovarianceStamped, "initialpose")
        robot.peer.wait_for_subscribers(poses)
        poses.publish(initialpose(*BEGIN))
        robot.send_goal(3.0, 2.0, 0.5)
        robot.run(lambda: len(robot.poses) > STEPS, "the drive")
        report = robot.diagnosis("ekf")
        truths = {stamp(one): planar(one.pose.pose) for one in robot.truths}
        known = [one for one in robot.poses if stamp(one) in truths]
        errors = [distance(planar(one.pose.pose), truths[stamp(one)]) for one in known]
        driven = {stamp(one): out_of_frame(Pose(*planar(one.pose.pose)), BEGIN) for one in measured}
        lost = [distance(pose, truths[when]) for when, pose in driven.items() if when in truths]
    assert len(errors) > 0.9 * STEPS
    assert np.mean(errors) < 0.05
    assert np.mean(lost) > 3.0 * np.mean(errors)
    assert int(report["landmarks received"]) > 0.9 * STEPS
    assert int(report["imu received"]) > 0.9 * STEPS
    bias, deviation = (float(one) for one in report["gyro bias"].split(" +- "))
    assert abs(bias - 0.03) < 4.0 * deviation < 0.03
    assert int(report["odometry steps against the gyro"]) > 5


def imu(time, rate):
    message = timed(Imu(), time)
    message.angular_velocity.z = rate
    message.angular_velocity_covariance[8] = 2.5e-5
    return message


def test_a_silent_gyro_and_one_that_contradicts_the_wheels_are_reported(nodes):
    fed = one_process.Fed(nodes, EkfNode, {"use_gyro": True, "sensor_timeout": 600.0, "reliable_inputs": True})

    def drive(first, last, rate=None):
        for step in range(first, last):
            if rate is not None:
                fed.send("imu", imu(START + 0.1 * step, rate))
            fed.send("odom", odometry(START + 0.1 * step, omega=0.1))
        fed.node._check_and_report()  # its timer may not have expired since the last message
        return fed.node.health_level()

    fed.send("global_pose", fix())
    level, text = drive(1, 4)
    assert level == 1
    assert "no turn rate on imu" in text
    assert drive(4, 30, 0.1)[0] == 0
    level, text = drive(30, 70, 2.0)
    assert level == 1
    assert "wheels and gyro contradict each other" in text
    assert drive(70, 110, 0.1)[0] == 0
