"""A robot of its own for the tests of the filter: truth, wheel speeds and fixes, without the simulator's code."""

import math

import numpy as np

from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.measurements import Heading, LandmarkMeasurement, PoseFix
from diffbot_control.filter.models import Motion
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance

SEPARATION = 0.6
R_FIX = np.diag([0.03, 0.03, 0.01])


def wrapped(angle):
    return math.remainder(angle, 2.0 * math.pi)


def jacobian(function, at, step=1e-6):
    """Central differences, one column per argument."""
    at = np.array(at, float)
    columns = [(function(at + h) - function(at - h)) / (2.0 * step) for h in step * np.eye(len(at))]
    return np.column_stack(columns)


def covariance(rng, size, low=0.1, high=1.0):
    """Return a random covariance whose eigenvalues are the squares of numbers from low to high."""
    axes, _ = np.linalg.qr(rng.normal(size=(size, size)))
    found = axes @ np.diag(np.exp(rng.uniform(math.log(low), math.log(high), size)) ** 2) @ axes.T
    return 0.5 * (found + found.T)


def build_motion(v, omega, dt, var_v, cov_v_omega, var_omega):
    return Motion(Twist(v, omega), dt, TwistCovariance(var_v, cov_v_omega, var_omega))


def odometry_step(stamp, twist, var_v, cov_v_omega, var_omega):
    return OdometryStep(stamp, twist, TwistCovariance(var_v, cov_v_omega, var_omega))


def build_measurement(stamp, z, R, landmark=None):
    """Return the measurement of an array: (3,) a fix, (1,) a heading, (2,) range and bearing of a landmark."""
    numbers = [float(one) for one in z]
    if landmark is not None:
        return LandmarkMeasurement(stamp, *numbers, R, Point(*landmark))
    return PoseFix(stamp, Pose(*numbers), R) if len(numbers) == 3 else Heading(stamp, *numbers, R)


def numbers_of(measured):
    """Return the measured numbers as an array: (3,), (1,) or (2,)."""
    if isinstance(measured, LandmarkMeasurement):
        return np.array([measured.range, measured.bearing])
    return np.array(measured.pose if isinstance(measured, PoseFix) else [measured.theta])


def gated_filter(variant, pose=(0.0, 0.0, 0.0), P=R_FIX, **options):
    """Return a filter of a variant that starts at a pose."""
    found = GatedFilter(options_of(FilterConfig(filter=variant, **options)), SEPARATION)
    found.reset_to(Pose(*pose), P)
    return found


def fix(x, y=0.0, theta=0.0, R=R_FIX):
    return build_measurement(0, [x, y, theta], R)


def heading(theta, variance=0.01):
    return build_measurement(0, [theta], np.array([[variance]]))


def landmark(pose, point, R):
    """Return range and bearing as they are without an error."""
    dx, dy = point[0] - pose[0], point[1] - pose[1]
    return build_measurement(0, [math.hypot(dx, dy), wrapped(math.atan2(dy, dx) - pose[2])], R, point)


def straight(v=0.0, dt=0.1, variance=1e-4):
    return build_motion(v, 0.0, dt, variance, 0.0, variance)


class Robot:
    """Drives along arcs with wheels whose radii differ from those that the odometry assumes; its noise is gaussian."""

    def __init__(self, rng, errors=(0.0, 0.0), noise=0.03, dt=0.1):
        self.rng, self.errors, self.noise, self.dt = rng, errors, noise, dt
        self.truth = np.zeros(3)

    def move(self, v, omega):
        """Drive with nominal rim speeds of this twist; return the motion that the odometry reports."""
        left, right = v - 0.5 * SEPARATION * omega, v + 0.5 * SEPARATION * omega
        self._along_the_arc(left * (1.0 + self.errors[0]), right * (1.0 + self.errors[1]))
        sigmas = self.noise * abs(left) + 1e-3, self.noise * abs(right) + 1e-3
        left, right = (np.array((left, right)) + sigmas * self.rng.normal(size=2)).tolist()
        # v = (l + r) / 2, omega = (r - l) / L: their covariance from that of the independent wheels.
        a, b = sigmas[0] ** 2, sigmas[1] ** 2
        variances = 0.25 * (a + b), 0.5 * (b - a) / SEPARATION, (a + b) / SEPARATION**2
        return build_motion(0.5 * (left + right), (right - left) / SEPARATION, self.dt, *variances)

    def _along_the_arc(self, left, right):
        v, omega = 0.5 * (left + right), (right - left) / SEPARATION
        x, y, theta = self.truth.tolist()
        end = theta + omega * self.dt
        radius = v / omega
        turned = radius * (math.sin(end) - math.sin(theta)), radius * (math.cos(theta) - math.cos(end))
        self.truth = np.array([x + turned[0], y + turned[1], wrapped(end)])

    def fix(self, factor=1.0, offset=(0.0, 0.0, 0.0)):
        """Measure the pose with errors of covariance R_FIX; it claims ``factor`` times that."""
        z = self.truth + np.sqrt(R_FIX.diagonal()) * self.rng.normal(size=3) + offset
        z[2] = wrapped(z[2])
        return build_measurement(0, z, factor * R_FIX)


def winding(step):
    """Return a twist that never goes straight for long."""
    return 0.8 + 0.4 * math.sin(0.05 * step), 0.6 * math.sin(0.11 * step + 0.1)
