"""The laws (13) and (17), against numbers worked out by hand, closed forms and the robot's real motion."""

import math
from fractions import Fraction

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from diffbot_control.law.lyapunov_law import Gains, global_law, global_lyapunov, local_law, local_lyapunov, sinc, tanhc
from diffbot_control.law.polar_coordinates import Navigation

CHECK = settings(max_examples=150)
GAINS = st.builds(Gains, st.floats(0.1, 5.0), st.floats(0.1, 10.0), st.floats(0.01, 10.0), st.floats(0.1, 10.0))
STEP = 1e-5


@CHECK
@given(st.floats(1e-8, 1e-2))
def test_sinc_and_tanhc_against_exact_series(x):
    # Taylor series in exact fractions; the rest is below x^8 = 1e-16 of the value.
    square = Fraction(x) ** 2
    sine = 1 - square / 6 + square**2 / 120 - square**3 / 5040
    tangent = 1 - square / 3 + 2 * square**2 / 15 - 17 * square**3 / 315
    assert sinc(x) == pytest.approx(float(sine), rel=3e-16)
    assert tanhc(x) == pytest.approx(float(tangent), rel=3e-16)
    assert sinc(-x) == sinc(x)
    assert tanhc(-x) == tanhc(x)
    assert sinc(0.0) == tanhc(0.0) == 1.0


def variables(x, y, theta):
    """Eq. (2), written anew for this test; angles unwrapped by the caller's care."""
    beta = math.atan2(-y, -x)
    return math.hypot(x, y), math.remainder(beta - theta, 2.0 * math.pi), beta


def drift(lyapunov, pose, v, omega):
    """Derivative of a function of the pose along the real motion (1), by central differences."""
    x, y, theta = pose

    def at(time):
        # Second order along the arc is enough: the difference cancels even powers of the time.
        middle = theta + 0.5 * omega * time
        return lyapunov(x + v * time * math.cos(middle), y + v * time * math.sin(middle), theta + omega * time)

    return (at(STEP) - at(-STEP)) / (2.0 * STEP)


POSITIONS = st.tuples(st.floats(-15.0, 15.0), st.floats(-15.0, 15.0), st.floats(-3.14, 3.14))


@CHECK
@given(POSITIONS, GAINS)
def test_v_of_eq_8_never_grows_under_law_13(pose, gains):
    # Front and rear sector alike: dV/dt = -k alpha^2 - gamma rho tanh(rho) cos(alpha)^2.
    rho, alpha, beta = variables(*pose)
    assume(rho > 0.05)
    assume(abs(abs(alpha) - math.pi) > 1e-2)
    assume(abs(abs(beta) - math.pi) > 1e-2)
    v, omega = global_law(Navigation(rho, alpha, beta), gains)

    def lyapunov(x, y, theta):
        r, a, b = variables(x, y, theta)
        return 0.5 * (r * r + a * a + gains.h * b * b)

    derivative = drift(lyapunov, pose, v, omega)
    closed = -gains.k * alpha**2 - gains.gamma * rho * math.tanh(rho) * math.cos(alpha) ** 2
    assert derivative == pytest.approx(closed, rel=1e-5, abs=1e-5)
    assert derivative <= 1e-6
    found = global_lyapunov(Navigation(rho, alpha, beta), gains)
    assert found == pytest.approx(lyapunov(*pose), rel=1e-12)


@CHECK
@given(POSITIONS, GAINS)
def test_v_of_eq_15_never_grows_in_omega_l(pose, gains):
    # dV/dt = -gamma rho tanh(rho) cos(alpha)^2 - k_2 theta^2.
    rho, alpha, beta = variables(*pose)
    theta = pose[2]
    assume(rho > 0.05)
    v, omega = local_law(Navigation(rho, alpha, beta), theta, gains)

    def lyapunov(x, y, heading):
        return 0.5 * (x * x + y * y + heading * heading)

    derivative = drift(lyapunov, pose, v, omega)
    closed = -gains.gamma * rho * math.tanh(rho) * math.cos(alpha) ** 2 - gains.k_2 * theta**2
    assert derivative == pytest.approx(closed, rel=1e-5, abs=1e-5)
    assert derivative <= 1e-6
    found = local_lyapunov(Navigation(rho, alpha, beta), theta)
    assert found == pytest.approx(lyapunov(*pose), rel=1e-12)
