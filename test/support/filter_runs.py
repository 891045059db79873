"""An independent model of robot and sensors for the tests of the filter, and a textbook Kalman update."""

import math

import numpy as np

from diffbot_control.filter import state
from diffbot_control.filter.config import FilterConfig, LocalizationConfig, options_of
from diffbot_control.filter.models import (
    BEARING,
    HEADING,
    LANDMARK,
    NO_RATE,
    POSE_FIX,
    POSITION_FIX,
    RANGE,
    Motion,
    Reading,
)
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance

SEPARATION = 0.6
R_FIX = np.diag([0.03, 0.03, 0.01])
ROWS = {POSE_FIX: [0, 1, 2], POSITION_FIX: [0, 1], HEADING: [2], LANDMARK: [0, 1], RANGE: [0], BEARING: [1]}
"""Measured rows of the pose, or of range and bearing, by kind of measurement."""


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


def build_motion(v, omega, dt, var_v, cov_v_omega, var_omega, *, rate=NO_RATE, lateral=0.0):
    return Motion(Twist(v, omega), dt, TwistCovariance(var_v, cov_v_omega, var_omega), rate, lateral)


def options(landmarks=(), **values):
    """Return the options of a filter with these values of its configuration."""
    return options_of(LocalizationConfig(filter=FilterConfig(**values)), SEPARATION, landmarks)


def started(numbers, pose=(0.0, 0.0, 0.0), P=R_FIX, landmarks=0):
    """Return a filter that starts at a pose."""
    found = state.new_filter(numbers, landmarks)
    state.start(found, Pose(*pose), P)
    return found


def reading(kind, z, R, time=0.0, at=(0.0, 0.0), place=None):
    """Return a measurement with the source of its kind; landmarks are the third source."""
    source = {POSE_FIX: 0, POSITION_FIX: 0, HEADING: 1}.get(kind, 2)
    return Reading(kind, source, source if place is None else place, time, np.array(z, float), R, Point(*at))


def fix(x, y=0.0, theta=0.0, R=R_FIX, time=0.0):
    return reading(POSE_FIX, [x, y, theta], R, time)


def body_twist(x, motion):
    """Return the twist and its covariance, with the wheel errors of the state and corrected by the gyro's turn rate."""
    left, right, separation = [*x[3:6], 0.0, 0.0, 0.0][:3]
    v, omega = motion.twist
    rims = (v - 0.5 * omega * SEPARATION) * (1.0 + left), (v + 0.5 * omega * SEPARATION) * (1.0 + right)
    twist = np.array([0.5 * sum(rims), (rims[1] - rims[0]) / (SEPARATION * (1.0 + separation))])
    var_v, cov, var_omega = motion.covariance
    M = np.array([[var_v, cov], [cov, var_omega]])
    if math.isfinite(motion.rate.variance):
        K = M[:, 1] / (M[1, 1] + motion.rate.variance)
        twist = twist + K * (motion.rate.value - (x[6] if len(x) > 6 else 0.0) - twist[1])
        M = M - np.outer(K, M[1])
    return twist, M


def midpoint(pose, twist, dt):
    """Move along the heading halfway."""
    way = twist[0] * dt * np.exp(1j * (pose[2] + 0.5 * twist[1] * dt))
    return np.array([pose[0] + way.real, pose[1] + way.imag, pose[2] + twist[1] * dt])


def moved(x, motion):
    """Return the whole state after a motion; the heading is not wrapped."""
    return np.array([*midpoint(x[:3], body_twist(x, motion)[0], motion.dt), *x[3:]])


def process_noise(x, motion):
    """Return the covariance (n, n) that a motion adds, by differences, without the random walks of the errors."""
    twist, M = body_twist(x, motion)
    G = jacobian(lambda u: midpoint(x[:3], u, motion.dt), twist)
    middle = x[2] + 0.5 * twist[1] * motion.dt
    across = np.array([-math.sin(middle), math.cos(middle), 0.0])
    Q = np.zeros((len(x), len(x)))
    Q[:3, :3] = G @ M @ G.T + motion.lateral * np.outer(across, across)
    return Q


def measured(kind, x, point=(0.0, 0.0)):
    """Return the values of a measurement without errors; angles are not wrapped."""
    if kind in (POSE_FIX, POSITION_FIX, HEADING):
        return np.array(x)[ROWS[kind]]
    offset, scale, turned = x[7:10]
    seen = complex(point[0] - x[0], point[1] - x[1]) * np.exp(-1j * x[2])
    return np.array([(1.0 + scale) * abs(seen) + offset, np.angle(seen) + turned])[ROWS[kind]]


def textbook(x, P, y, H, R):
    """Return mean and covariance after an innovation ``y``, by the textbook Kalman update, and the NIS."""
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    return x + K @ y, P - K @ S @ K.T, y @ np.linalg.solve(S, y)


def assert_state(found, x, P, tolerance=1e-9):
    away = found.x - x
    away[2] = wrapped(away[2])
    np.testing.assert_allclose(away, 0.0, atol=tolerance)
    assert -math.pi < found.x[2] <= math.pi
    np.testing.assert_allclose(found.P, P, rtol=1e-7, atol=tolerance)


class Robot:
    """Drives along arcs with wheels whose radii differ from the radii of the odometry; the noise is gaussian."""

    def __init__(self, rng, errors=(0.0, 0.0), noise=0.03, dt=0.1):
        self.rng, self.errors, self.noise, self.dt = rng, errors, noise, dt
        self.truth = np.zeros(3)

    def move(self, v, omega):
        """Drive with the nominal rim speeds of this twist; return the motion by the odometry."""
        left, right = v - 0.5 * SEPARATION * omega, v + 0.5 * SEPARATION * omega
        self._along_the_arc(left * (1.0 + self.errors[0]), right * (1.0 + self.errors[1]))
        sigmas = self.noise * abs(left) + 1e-3, self.noise * abs(right) + 1e-3
        left, right = (np.array((left, right)) + sigmas * self.rng.normal(size=2)).tolist()
        # v = (l + r) / 2, omega = (r - l) / L: their covariance from the variances of the independent wheels.
        a, b = sigmas[0] ** 2, sigmas[1] ** 2
        variances = 0.25 * (a + b), 0.5 * (b - a) / SEPARATION, (a + b) / SEPARATION**2
        return build_motion(0.5 * (left + right), (right - left) / SEPARATION, self.dt, *variances)

    def _along_the_arc(self, left, right):
        v, omega = 0.5 * (left + right), (right - left) / SEPARATION
        x, y, theta = self.truth.tolist()
        end = theta + omega * self.dt
        way = v / omega * (np.exp(1j * end) - np.exp(1j * theta)) / 1j
        self.truth = np.array([x + way.real, y + way.imag, wrapped(end)])

    def error(self, x):
        """Return the error (3,) of a state."""
        e = np.array(x[:3]) - self.truth
        e[2] = wrapped(e[2])
        return e


def winding(step):
    """Return the twist (v, omega) of a winding path at a step."""
    return 0.8 + 0.4 * math.sin(0.05 * step), 0.6 * math.sin(0.11 * step + 0.1)
