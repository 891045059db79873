"""Simulated drives of a filter: errors of one source, slip, all sensors at once, and contradicting fixes."""

import heapq
import math
from itertools import count

import numpy as np
from filter_runs import (
    R_FIX,
    SEPARATION,
    Robot,
    build_motion,
    fix,
    measured,
    options,
    reading,
    started,
    winding,
    wrapped,
)

from diffbot_control.filter import ekf, noise
from diffbot_control.filter.config import FilterConfig, LocalizationConfig, PoseSources
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurement import GyroSample, heading, landmark, pose_fix
from diffbot_control.filter.models import LANDMARK, TurnRate
from diffbot_control.filter.odometry import OdometryStep
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance

DT = 0.2
"""[s] from measurement to measurement of a Run"""
CORNERS = tuple(Point(*one) for one in ((4.0, 4.0), (-4.0, 4.0), (-4.0, -4.0), (4.0, -4.0), (0.0, 7.0)))
SEEN = np.array((0.06, 0.03))


def markov(rng, c, shape):
    """Yield errors of a first-order Markov process with variance 1 and correlation c of neighbours."""
    errors = rng.normal(size=shape)
    while True:
        yield errors
        errors = c * errors + math.sqrt(1.0 - c * c) * rng.normal(size=shape)


class Run:
    """40 s of odometry at 10 Hz and measurements of one source at 5 Hz: the filter, and its errors after 13 s."""

    def __init__(self, kind, c, seed, scales=(1.0, 1.0), odometry_noise=0.06, **values):
        rng = np.random.default_rng([seed, 7])
        places = CORNERS if kind == "landmarks" else ()
        robot, self.options = Robot(rng, noise=odometry_noise), options(places, **{"filter": "ekf", **values})
        self.found, self.nees, self.squares = started(self.options, landmarks=len(places)), [], []
        self.row, roots = self.found.noise[2 if places else 0], np.sqrt(scales)
        errors = markov(rng, c, (len(CORNERS), 2) if places else 3)
        # The filter starts at its first fix, which also has an error.
        robot.truth = np.sqrt(R_FIX.diagonal()) * rng.normal(size=3) * roots[[0, 0, 1]]
        for step in range(400):
            arc = (0.5, 0.3) if places else (0.5 + 0.2 * math.sin(0.05 * step), 0.4 * math.sin(0.03 * step + 0.01))
            ekf.predict(self.found, self.options, robot.move(*arc))
            if step % 2 == 0:
                self._measure(robot.truth, next(errors), roots, 0.1 * step, places)
            if step > 130:
                e = robot.error(self.found.x)
                self.nees.append(e @ np.linalg.solve(self.found.P[:3, :3], e))
                self.squares.append(e[0] ** 2 + e[1] ** 2)

    def _measure(self, truth, errors, roots, time, places):
        if not places:
            x, y, theta = truth + np.sqrt(R_FIX.diagonal()) * errors * roots[[0, 0, 1]]
            ekf.take(self.found, self.options, fix(x, y, wrapped(theta), time=time))
        for place, (point, error) in enumerate(zip(places, errors, strict=False)):
            z = measured(LANDMARK, [*truth, *[0.0] * 7], point) + SEEN * error * roots
            z[1] = wrapped(z[1])
            ekf.take(self.found, self.options, reading(LANDMARK, z, np.diag(SEEN**2), time, point, 3 + place))

    def correlation(self):
        """Return the correlation of neighbouring errors by the filter."""
        return noise.assumed_correlation(self.row, 0.0)

    def scales(self):
        return np.array([noise.scale_of(self.row, False), noise.scale_of(self.row, True)])


SIGMA, GYRO_BIAS = 0.005, 0.02
"""[rad/s] white error of the gyro, and its bias"""
SHARE = 0.05 / math.sqrt(3.0)
"""Deviation of a wheel's speed over the speed."""


class Straight:
    """A robot that drives straight at 0.6 m/s with 50 Hz; the noise of the wheels is proportional to their speed."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.options = options(use_gyro=True)
        self.found = started(self.options)
        self.lost = np.zeros(2)
        """share of its motion that each wheel loses"""
        self.noise = ((rng.normal(0.0, SHARE, 2), rng.normal(0.0, SIGMA)) for _ in count())

    def drive(self, steps, speed=0.6):
        """Return the deviation of the difference of the radius errors after each step."""
        found = []
        for _, (rim_noise, rate_noise) in zip(range(steps), self.noise, strict=False):
            rims, real = speed * (1.0 + rim_noise), speed * (1.0 - self.lost)
            a, b = (SHARE * rims) ** 2 + 1e-8
            twist = rims.mean(), (rims[1] - rims[0]) / SEPARATION
            rate = TurnRate((real[1] - real[0]) / SEPARATION + GYRO_BIAS + rate_noise, SIGMA**2)
            variances = 0.25 * (a + b), 0.5 * (b - a) / SEPARATION, (a + b) / SEPARATION**2
            motion = build_motion(*twist, 0.02, *variances, rate=rate)
            ekf.take_rate(self.found, self.options, motion)
            ekf.predict(self.found, self.options, motion)
            P = self.found.P
            found.append(math.sqrt(P[3, 3] - 2.0 * P[3, 4] + P[4, 4]))
        return np.array(found)


PLACES = [Point(8.0, 6.0), Point(-6.0, 9.0), Point(20.0, -5.0), Point(35.0, 10.0)]
TRUE = {"left": -0.02, "right": 0.015, "bias": 0.03, "range": 0.04}
"""Relative errors of the radii, bias of the gyro [rad/s], offset of all ranges [m]."""


def all_sensors(seed, seconds):
    """Drive with late and wrong measurements of all sensors; yield filter, estimate and robot at each odometry."""
    rng = np.random.default_rng([seed, 11])
    robot = Robot(rng, (TRUE["left"], TRUE["right"]), noise=0.02)
    config = LocalizationConfig(
        1.0, FilterConfig(use_gyro=True, wheels_as_configured=0.0), sources=PoseSources(("gps",))
    )
    found, waiting, gps = Localization(config, SEPARATION, landmarks=PLACES), [], rng.normal(0.0, 0.3, 3)
    found.initialise(Pose(0.0, 0.0, 0.0), R_FIX, 0)
    for step in range(1, round(10 * seconds)):
        stamp, before = step * 10**8, robot.truth
        motion = robot.move(*winding(step))
        turn = wrapped(robot.truth[2] - before[2]) / 0.1
        made = [GyroSample(stamp, turn + TRUE["bias"] + rng.normal(0.0, 0.005), 2.5e-5)]
        gps = 0.9 * gps + 0.13 * rng.normal(size=3)
        noisy = [robot.truth + np.sqrt(R_FIX.diagonal()) * rng.normal(size=3), robot.truth + gps * (1.0, 1.0, 0.2)]
        noisy[0][:2] += 20.0 * rng.normal(size=2) * (rng.random() < 0.05)
        poses = [Pose(x, y, wrapped(theta)) for x, y, theta in noisy]
        if step % 5 == 0:
            made.append(pose_fix(stamp, poses[0], R_FIX))
        if step % 3 == 0:
            made += [
                pose_fix(stamp, poses[1], np.diag([0.09, 0.09, 0.0036]), "fixes of gps"),
                heading(stamp, poses[0].theta, R_FIX[2:, 2:]),
            ]
            for point in PLACES:
                z = measured(LANDMARK, [*robot.truth, *[0.0] * 4, TRUE["range"], 0.0, 0.0], point)
                z += rng.normal(0.0, (0.05, 0.02))
                z[0] += 5.0 * (rng.random() < 0.05)
                made.append(landmark(stamp, z[0], wrapped(z[1]), np.diag([0.0025, 0.0004]), point))
        for one in made:
            heapq.heappush(waiting, (stamp + round(rng.uniform(0.0, 6e8)), rng.random(), one))
        while waiting and waiting[0][0] <= stamp:
            *_, one = heapq.heappop(waiting)
            (found.on_gyro if isinstance(one, GyroSample) else found.on_measurement)(one)
        yield found, found.on_odometry(OdometryStep(stamp, motion.twist, motion.covariance)), robot


SIGMAS = np.array([0.1, 0.1, 0.05])
FAULTS = {
    "turned by pi": lambda x, y, theta, _: (x, y, theta + math.pi),
    "mirrored": lambda x, y, theta, _: (x, -y, -theta),
    "swapped": lambda x, y, theta, _: (y, x, theta),
    "frozen": lambda *_: (0.0, 0.0, 0.0),
}


def with_fault(seconds, fault, outliers=0.0, rest_after=math.inf, every=2):
    """Drive a winding path at 0.5 m/s with 20 Hz and a fix every ``every`` steps; yield time and filter."""
    rng, made, pose = np.random.default_rng(3), Localization(LocalizationConfig()), np.array([0.0, 0.0, 0.3])
    for n in range(round(20 * seconds)):
        time, stamp = n / 20, n * 50_000_000
        twist = Twist(0.5, 0.3 * math.sin(time / 3)) if 1.0 < time < rest_after else Twist(0.0, 0.0)
        pose = pose + np.array([twist.v * math.cos(pose[2]), twist.v * math.sin(pose[2]), twist.omega]) / 20
        if n % every == 0:
            z = np.array(fault(*pose, time))
            if fault is not FAULTS["frozen"]:
                z += rng.normal(0.0, SIGMAS) + (rng.random() < outliers) * rng.normal(0.0, 3.0, 3)
            made.on_measurement(pose_fix(stamp, Pose(z[0], z[1], wrapped(z[2])), np.diag(SIGMAS**2)))
        if n % 10 == 9:
            made.check_innovations()
        made.on_odometry(OdometryStep(stamp, twist, TwistCovariance(1e-4, 0.0, 1e-4)))
        yield time, made
