"""The paper's law: compared with the printed equations, its condition, its region."""

import cmath
import itertools
import math
from fractions import Fraction

import pytest
from driven import ORIGIN, T_S, seen
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law.configuration import PaperConfig, PaperGains
from diffbot_control.law.paper import (
    PaperLaw,
    new_paper_memory,
    paper_step,
    tanhc,
)
from diffbot_control.law.regions import OMEGA_G, OMEGA_L
from diffbot_control.law.steering import sinc
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.schema import build

INF = math.inf
FREE = PaperConfig(data_sheet=DataSheet(INF, INF, INF, INF, INF))


def printed_laws(pose, near, gains):
    """Return (13) or (17), with the goal at the origin, in complex numbers, v along the real axis; and the variables.

    The variables are rho, alpha, beta, theta and the Lyapunov function of the region.
    """
    gamma, k, h, k_2 = gains
    theta, to_goal = pose[2], -complex(pose[0], pose[1])
    rho, beta = abs(to_goal), cmath.phase(to_goal)
    alpha = cmath.phase(cmath.exp(1j * (beta - theta)))
    v = gamma * math.tanh(rho) * math.cos(alpha)
    if near:
        return (v, -k_2 * theta), (rho, alpha, beta, theta, 0.5 * (rho**2 + theta**2))
    bend = gamma * math.sin(alpha) / alpha * math.tanh(rho) / rho * math.cos(alpha)
    omega = k * alpha + bend * (alpha + h * beta)
    return (v, omega), (rho, alpha, beta, theta, 0.5 * (rho**2 + alpha**2 + h * beta**2))


@pytest.mark.parametrize(
    ("pose", "gains"),
    [
        ((-2.0, -5.5, math.radians(30.0)), (1.3, 1.0, 0.17, 2.7)),
        ((4.0, 2.0, 0.2), (1.3, 1.0, 0.17, 2.7)),
        ((-2.0, -5.5, 0.5), (0.8, 4.0, 2.37, 4.0)),
    ],
    ids=["scenario A", "goal behind", "other gains"],
)
def test_commands_and_report_of_a_drive_without_noise_are_those_of_the_printed_law(pose, gains):
    near, memory, regions, goal = False, new_paper_memory(), [], Pose(1.0, 2.0, 0.5 * math.pi)
    config = FREE if gains == FREE.gains else FREE._replace(gains=PaperGains(*gains))
    for _ in range(300):
        x, y, theta = pose
        near = math.hypot(x, y) <= 0.6 if near else math.hypot(x, y) < 0.5
        (v, omega), variables = printed_laws(pose, near, gains)
        on_map = Pose(goal.x - y, goal.y + x, goal.theta + theta)
        memory, command, report = paper_step(memory, seen(on_map), goal, config)
        assert command == pytest.approx((v, omega), abs=1e-12)
        found = report.rho, report.alpha, report.beta, report.theta, report.lyapunov
        assert found == pytest.approx(variables, abs=1e-12)
        assert (report.eps_P, report.region) == ((0.6, OMEGA_L) if near else (0.5, OMEGA_G))
        regions.append(report.region)
        # Eq. (3) as printed.
        pose = (x + T_S * v * math.cos(theta), y + T_S * v * math.sin(theta), theta + T_S * omega)
    assert [region for region, _ in itertools.groupby(regions)] == [OMEGA_G, OMEGA_L]
    # The lateral error at the entry of Omega_L remains.
    assert (pose[0], pose[2]) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert 0.01 < abs(pose[1]) < 0.5
    assert memory.reached


@pytest.mark.parametrize(
    ("before", "rho", "after"),
    [
        (OMEGA_G, 0.5, OMEGA_G),
        (OMEGA_G, math.nextafter(0.5, 0.0), OMEGA_L),
        (OMEGA_L, 0.6, OMEGA_L),
        (OMEGA_L, math.nextafter(0.6, 1.0), OMEGA_G),
        # A distance that is not a number must not count as near.
        (OMEGA_L, math.nan, OMEGA_G),
    ],
)
def test_the_region_has_a_hysteresis(before, rho, after):
    memory, _, report = paper_step(new_paper_memory()._replace(region=before), seen(Pose(-rho, 0.0, 0.0)), ORIGIN, FREE)
    assert memory.region == report.region == after


def test_a_leaving_radius_below_the_entering_radius_is_refused():
    with pytest.raises(InvalidValueError, match=r"eps_P_leave = 0\.3: must be >= eps_P = 0\.5"):
        build(PaperConfig, {"eps_P_leave": 0.3})


@settings(max_examples=150)
@given(st.floats(1e-8, 1e-2))
def test_sinc_and_tanhc_equal_their_exact_series(x):
    # Taylor series in exact fractions; the rest is below x^8 = 1e-16 of the value.
    square = Fraction(x) ** 2
    sine = 1 - square / 6 + square**2 / 120 - square**3 / 5040
    tangent = 1 - square / 3 + 2 * square**2 / 15 - 17 * square**3 / 315
    assert sinc(x) == sinc(-x) == pytest.approx(float(sine), rel=3e-16)
    assert tanhc(x) == tanhc(-x) == pytest.approx(float(tangent), rel=3e-16)
    assert sinc(0.0) == tanhc(0.0) == 1.0


def test_a_new_goal_keeps_the_motion_and_a_robot_that_must_not_reverse_turns():
    memory = new_paper_memory()._replace(region=OMEGA_L, command=Twist(0.3, 0.1), reached=True)
    assert PaperLaw.memory_for_new_goal(memory, FREE) == new_paper_memory()._replace(command=Twist(0.3, 0.1))
    _, command, report = paper_step(
        new_paper_memory(), seen(Pose(2.0, 0.5, 0.1)), ORIGIN, FREE._replace(allow_backward=False)
    )
    assert command == (0.0, pytest.approx(report.alpha))
