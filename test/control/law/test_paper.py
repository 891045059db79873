"""The paper's law: against the printed equations written anew, its poles near the goal, its condition, its region."""

import cmath
import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from driven import ORIGIN, T_S, seen
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law.configuration import PaperConfig, PaperGains
from diffbot_control.law.paper import (
    PaperLaw,
    global_law,
    local_law,
    new_paper_memory,
    paper_step,
    tanhc,
)
from diffbot_control.law.regions import OMEGA_G, OMEGA_L
from diffbot_control.law.steering import Navigation, sinc
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.schema import build

INF = math.inf
FREE = PaperConfig(data_sheet=DataSheet(INF, INF, INF, INF, INF))


def printed_law_17(pose, near):
    """Law (17) with the paper's numbers, goal at the origin, in complex numbers; v along the real axis."""
    to_goal = -complex(pose[0], pose[1])
    rho, beta = abs(to_goal), cmath.phase(to_goal)
    alpha = cmath.phase(cmath.exp(1j * (beta - pose[2])))
    v = 1.3 * math.tanh(rho) * math.cos(alpha)
    if near:
        return v, -2.7 * pose[2]
    bend = 1.3 * math.sin(alpha) / alpha * math.tanh(rho) / rho * math.cos(alpha)
    return v, 1.0 * alpha + bend * (alpha + 0.17 * beta)


@pytest.mark.parametrize("pose", [(-2.0, -5.5, math.radians(30.0)), (4.0, 2.0, 0.2)], ids=["scenario A", "goal behind"])
def test_a_drive_without_noise_equals_the_printed_law(pose):
    near, memory, regions = False, new_paper_memory(), []
    for _ in range(300):
        rho = math.hypot(pose[0], pose[1])
        near = rho <= 0.6 if near else rho < 0.5
        v, omega = printed_law_17(pose, near)
        memory, command, report = paper_step(memory, seen(Pose(*pose)), ORIGIN, FREE)
        assert command == pytest.approx((v, omega), abs=1e-12)
        assert (report.rho, report.region) == (pytest.approx(rho, abs=1e-12), int(near))
        assert report.eps_P == (0.6 if near else 0.5)
        regions.append(report.region)
        # Eq. (3) as printed.
        x, y, theta = pose
        pose = (x + T_S * v * math.cos(theta), y + T_S * v * math.sin(theta), theta + T_S * omega)
    assert (regions[0], regions[-1]) == (OMEGA_G, OMEGA_L)
    assert [region for region, _ in itertools.groupby(regions)] == [OMEGA_G, OMEGA_L]
    # It rests abreast of the goal: the lateral error at the entry of Omega_L stays.
    assert (pose[0], pose[2]) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert 0.01 < abs(pose[1]) < 0.5
    assert memory.reached


def test_the_report_holds_the_variables_of_the_step():
    pose, goal = Pose(1.0, 5.0, math.pi), Pose(1.0, 2.0, 0.5 * math.pi)
    # In the goal's frame: (3, 0, pi/2); the goal lies behind along -x: beta = pi, alpha = pi/2.
    _, _, report = paper_step(new_paper_memory(), seen(pose), goal, FREE)
    variables = (report.rho, report.alpha, report.beta, report.theta)
    assert variables == pytest.approx((3.0, math.pi / 2, math.pi, math.pi / 2), abs=1e-12)
    assert report.lyapunov == pytest.approx(0.5 * (9.0 + (math.pi / 2) ** 2 + 0.17 * math.pi**2))
    near = new_paper_memory()._replace(region=OMEGA_L)
    _, _, report = paper_step(near, seen(Pose(-0.55, 0.0, 0.2)), ORIGIN, FREE)
    assert (report.eps_P, report.region) == (0.6, OMEGA_L)
    assert report.lyapunov == pytest.approx(0.5 * (0.55**2 + 0.2**2))


@pytest.mark.parametrize(
    ("before", "rho", "after"),
    [
        (OMEGA_G, 0.5, OMEGA_G),
        (OMEGA_G, math.nextafter(0.5, 0.0), OMEGA_L),
        (OMEGA_L, 0.6, OMEGA_L),
        (OMEGA_L, math.nextafter(0.6, 1.0), OMEGA_G),
        # A distance that is no number must not count as near.
        (OMEGA_L, math.nan, OMEGA_G),
    ],
)
def test_hysteresis(before, rho, after):
    memory, _, report = paper_step(new_paper_memory()._replace(region=before), seen(Pose(-rho, 0.0, 0.0)), ORIGIN, FREE)
    assert memory.region == report.region == after


def test_the_papers_condition():
    # Section 3.2: eps_P > |eps_rho| + |eps_v| / gamma, with the noise of section 4.1.
    assert PaperConfig().eps_P > math.hypot(0.3, 0.3) + 0.065 / PaperConfig().gains.gamma
    with pytest.raises(InvalidValueError, match=r"eps_P_leave = 0\.3: must be >= eps_P = 0\.5"):
        build(PaperConfig, {"eps_P_leave": 0.3})


def near_the_goal(gains):
    """State matrices of the angles in Omega_G, of the distance and of the heading in Omega_L, for small ones.

    From the laws themselves, by differences, with the kinematics alpha' = v sin(alpha) / rho - omega,
    beta' = v sin(alpha) / rho, rho' = -v cos(alpha).
    """
    rho, small = 1e-6, 1e-6

    def rates(alpha, beta):
        v, omega = global_law(Navigation(rho, alpha, beta), gains)
        turn = v * math.sin(alpha) / rho
        return np.array([turn - omega, turn])

    columns = [(rates(*step) - rates(*(-step))) / (2.0 * small) for step in small * np.eye(2)]
    v, _ = global_law(Navigation(rho, 0.0, 0.0), gains)
    _, omega = local_law(Navigation(rho, 0.0, 0.0), small, gains)
    return np.column_stack(columns), np.array([[-v / rho]]), np.array([[omega / small]])


@pytest.mark.parametrize("gains", [PaperGains(), PaperGains(1.3, 4.0, 2.37, 4.0)])
def test_the_poles_near_the_goal_are_those_of_the_linearised_laws(gains):
    angles, distance, heading = (np.linalg.eigvals(A) for A in near_the_goal(gains))
    # The roots of s^2 + k s + gamma^2 h, whose sum and product rounding hurts less than themselves at a double pole.
    assert [angles.sum(), angles.prod()] == pytest.approx([-gains.k, gains.gamma**2 * gains.h], rel=1e-6)
    assert [*distance, *heading] == pytest.approx([-gains.gamma, -gains.k_2], rel=1e-6)


@settings(max_examples=150)
@given(st.floats(1e-8, 1e-2))
def test_sinc_and_tanhc_against_exact_series(x):
    # Taylor series in exact fractions; the rest is below x^8 = 1e-16 of the value.
    square = Fraction(x) ** 2
    sine = 1 - square / 6 + square**2 / 120 - square**3 / 5040
    tangent = 1 - square / 3 + 2 * square**2 / 15 - 17 * square**3 / 315
    assert sinc(x) == sinc(-x) == pytest.approx(float(sine), rel=3e-16)
    assert tanhc(x) == tanhc(-x) == pytest.approx(float(tangent), rel=3e-16)
    assert sinc(0.0) == tanhc(0.0) == 1.0


def test_the_motion_outlives_a_goal_and_a_robot_that_must_not_reverse_turns():
    memory = new_paper_memory()._replace(region=OMEGA_L, command=Twist(0.3, 0.1), reached=True)
    assert PaperLaw.memory_for_new_goal(memory, FREE) == new_paper_memory()._replace(command=Twist(0.3, 0.1))
    _, command, report = paper_step(
        new_paper_memory(), seen(Pose(2.0, 0.5, 0.1)), ORIGIN, FREE._replace(allow_backward=False)
    )
    assert command == (0.0, pytest.approx(report.alpha))
