"""Beams from the plant to the estimate: a robot that is told where it stands, and then sees walls only."""

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from inside import inside
from nav_msgs.msg import Odometry
from robot import DEEP, distance, initialpose, planar, stamp

from diffbot_core.geometry import Pose, out_of_frame

ROOM = {"wall_x1": [-5.0, -5.0, 5.0, -5.0], "wall_y1": [-5.0, 5.0, 5.0, -5.0]}
ROOM |= {"wall_x2": [5.0, 5.0, 5.0, -5.0], "wall_y2": [-5.0, 5.0, -5.0, 5.0]}
ROOM |= {"beam_topics": ["range/front", "range/left"]}
ROOM |= {"beam_x": [0.2, 0.0], "beam_y": [0.0, 0.1], "beam_yaw": [0.0, 1.5]}
PLANT = {"initial_pose.x": -2.0, "initial_pose.y": -1.0, "initial_pose.yaw": 0.3, "fix_rate": 0.0, "encoder_noise": 0.3}
START = Pose(-2.0, -1.0, 0.3)
STEPS = 200
"""20 s"""


def test_walls_keep_the_estimate_that_the_odometry_alone_loses():
    with inside({**PLANT, **ROOM, "beam_max_range": 15.0}, ROOM) as robot:
        measured = robot.peer.subscribe(Odometry, "odom", DEEP)
        poses = robot.peer.publisher(PoseWithCovarianceStamped, "initialpose")
        robot.peer.wait_for_subscribers(poses)
        poses.publish(initialpose(*START))
        robot.send_goal(3.0, 2.0, 0.5)
        robot.run(lambda: len(robot.poses) > STEPS, "the drive")
        truths = {stamp(one): planar(one.pose.pose) for one in robot.truths}
        known = [one for one in robot.poses if stamp(one) in truths]
        errors = [distance(planar(one.pose.pose), truths[stamp(one)]) for one in known]
        assert len(errors) > 0.9 * STEPS
        assert np.mean(errors) < 0.05
        driven = {stamp(one): out_of_frame(Pose(*planar(one.pose.pose)), START) for one in measured}
        lost = [distance(pose, truths[when]) for when, pose in driven.items() if when in truths]
        assert np.mean(lost) > 3.0 * np.mean(errors)
        assert int(robot.diagnosis("ekf")["range/front received"]) > 0.9 * STEPS
