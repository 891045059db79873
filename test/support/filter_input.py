"""Valid messages for the filter: fixes, headings, odometry and wheel speeds."""

import math

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from robot import pose_stamped
from sensor_msgs.msg import Imu, JointState

START = 1000.0
VARIANCES = 1e-3, 1e-5, 2e-3
R_FIX = np.diag([0.03, 0.03, 0.01])


def timed(message, time):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(time * 1e9), 10**9)
    return message


def fix(time=START, x=1.0, y=2.0, theta=0.5):
    message = timed(PoseWithCovarianceStamped(), time)
    message.header.frame_id = "map"
    message.pose.pose = pose_stamped(x, y, theta).pose
    message.pose.covariance[[0, 7, 35]] = R_FIX.diagonal()
    return message


def heading(time=START, theta=0.6):
    message = timed(Imu(), time)
    message.header.frame_id = "base_link"
    message.orientation = pose_stamped(0, 0, theta).pose.orientation
    message.orientation_covariance[8] = 0.01
    return message


def odometry(time, v=0.4, omega=0.1, pose=None):
    """Return an odometry message; by default with the pose of a robot that has driven with this twist since START."""
    message = timed(Odometry(), time)
    message.header.frame_id, message.child_frame_id = "odom", "base_link"
    theta = omega * (time - START)
    chord = v * (time - START) * np.sinc(0.5 * theta / math.pi)
    x, y = chord * math.cos(0.5 * theta), chord * math.sin(0.5 * theta)
    message.pose.pose = pose_stamped(*(pose or (x, y, math.remainder(theta, math.tau)))).pose
    message.twist.twist.linear.x, message.twist.twist.angular.z = v, omega
    message.twist.covariance[[0, 5, 30, 35]] = VARIANCES[0], VARIANCES[1], VARIANCES[1], VARIANCES[2]
    return message


def joint_state(time, left=5.0, right=6.0):
    message = timed(JointState(), time)
    message.name = ["caster_joint", "right_wheel_joint", "left_wheel_joint"]
    message.position = [0.0, 0.0, 0.0]
    message.velocity = [math.nan, right, left]
    return message
