"""Stamped odometry and measurements of a robot on a circle, and a filter that starts at its pose."""

import math

import numpy as np
from filter_runs import SEPARATION, build_motion, measured, moved, wrapped

from diffbot_control.filter.config import FilterConfig, LocalizationConfig, PoseSources
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurement import FIXES, GyroSample, Measurement, heading, landmark, pose_fix
from diffbot_control.filter.models import LANDMARK
from diffbot_control.filter.odometry import OdometryConfig, OdometryStep
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance

MS = 10**6
PERIOD = 100 * MS
START = np.array([0.0, 0.0, 3.0])
P0, R = np.diag([0.02, 0.03, 0.01]), np.array([[0.03, 0.01, 0.0], [0.01, 0.03, 0.0], [0.0, 0.0, 0.01]])
CIRCLE = [Point(9.0 * math.cos(2.4 * i), 9.0 * math.sin(2.4 * i)) for i in range(50)]
PLAIN = {"filter": "ekf", "gate_probability": 1.0, "detect_correlation": False}
"""A filter of three states without a gate, as in textbooks."""
EVERYTHING = {"filter": "ekf_calibrating", "use_gyro": True, "relocation_fixes": 2, "gate_probability": 0.99}


def fresh(history=1.0, landmarks=(), delay=0.0, **values):
    sources = PoseSources(("gps",))
    config = LocalizationConfig(history, FilterConfig(**values), OdometryConfig(odometry_delay=delay), sources)
    found = Localization(config, SEPARATION, landmarks=landmarks)
    found.initialise(Pose(*START), P0, 0)
    return found


def odometry(number, v=1.2, omega=0.7):
    """Return the odometry of one period that ends at ``number`` periods."""
    return OdometryStep(number * PERIOD, Twist(v, omega), TwistCovariance(4e-3, 1e-3, 0.02))


def truth(stamp):
    """Return the true pose on a circle; after 0.8 s, the robot is moved to another place."""
    x = moved(START, build_motion(1.2, 0.7, min(stamp * 1e-9, 0.8), 0.0, 0.0, 1.0))
    if stamp <= 800 * MS:
        return x
    return moved(x + np.array([3.6, -1.0, 1.0]), build_motion(1.2, 0.7, stamp * 1e-9 - 0.8, 0.0, 0.0, 1.0))


def fix(stamp, source=FIXES, seed=0):
    z = truth(stamp) + np.random.default_rng([stamp, len(source), seed]).normal(0.0, 0.15, 3)
    return pose_fix(stamp, Pose(z[0], z[1], wrapped(z[2])), R, source)


def compass(stamp):
    theta = truth(stamp)[2] + np.random.default_rng([stamp, 2]).normal(0.0, 0.1)
    return heading(stamp, wrapped(theta), 0.01 * np.eye(1))


def sighting(stamp, place=0, misread=0.0):
    z = measured(LANDMARK, [*truth(stamp), *[0.0] * 7], CIRCLE[place])
    z += np.random.default_rng([stamp, place, 3]).normal(0.0, 0.02, 2)
    return landmark(stamp, z[0] + misread, wrapped(z[1]), np.diag([4e-4, 4e-4]), CIRCLE[place])


MAKERS = {
    "fix": fix,
    "gps": lambda stamp: fix(stamp, "fixes of gps"),
    "compass": compass,
    "landmark": sighting,
    "landmark 1": lambda stamp: sighting(stamp, 1, 3.0 * (stamp % 3 == 0)),
    "gyro": lambda stamp: GyroSample(stamp, 0.7 + 0.3 * (stamp // MS % 7 == 0), 1e-4),
}


def deliver(found, arrivals):
    """Give the filter all messages and the odometry of 2.5 s, sorted by the time and rank of their arrival."""
    whole = [*arrivals, *((n * PERIOD, 0.5, odometry(n)) for n in range(1, 26))]
    for _, _, one in sorted(whole, key=lambda one: one[:2]):
        if isinstance(one, Measurement):
            found.on_measurement(one)
        else:
            (found.on_gyro if isinstance(one, GyroSample) else found.on_odometry)(one)
    return found
