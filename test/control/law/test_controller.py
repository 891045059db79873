"""One step of the controller, against an implementation of law (17) written anew here."""

import cmath
import itertools
import math

import pytest
from driven import ORIGIN, T_S, step

from diffbot_control.goals.driver import driver_of
from diffbot_control.law.controller import ControllerMemory, SwitchingLaw, new_memory
from diffbot_control.law.finish import V_LEG, Finish
from diffbot_control.law.goal_checker import Settling
from diffbot_control.law.latency import Actuation
from diffbot_control.law.paper.reapproach import RETREATING, Reapproach
from diffbot_control.law.presets import PRESETS
from diffbot_control.law.regions import OMEGA_G, OMEGA_L, Switching
from diffbot_control.law.steering import BACK, Course
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist

INF = math.inf
PAPER = PRESETS["paper"]
FREE = PAPER._replace(data_sheet=DataSheet(INF, INF, INF, INF, INF))


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
    near = False
    memory = ControllerMemory()
    regions = []
    for _ in range(300):
        rho = math.hypot(pose[0], pose[1])
        near = rho <= 0.6 if near else rho < 0.5
        v, omega = printed_law_17(pose, near)
        memory, command, report = step(memory, Pose(*pose), ORIGIN, T_S, FREE)
        assert command == pytest.approx((v, omega), abs=1e-12)
        assert report.rho == pytest.approx(rho, abs=1e-12)
        assert report.region == int(near)
        regions.append(report.region)
        # Eq. (3) as printed.
        x, y, theta = pose
        pose = (x + T_S * v * math.cos(theta), y + T_S * v * math.sin(theta), theta + T_S * omega)
    assert regions[0] == OMEGA_G
    assert regions[-1] == OMEGA_L
    assert memory.switching.switches == sum(a != b for a, b in itertools.pairwise(regions))
    # It rests abreast of the goal: the lateral error at the entry of Omega_L stays.
    assert pose[0] == pytest.approx(0.0, abs=1e-6)
    assert abs(pose[1]) < 0.5
    assert pose[2] == pytest.approx(0.0, abs=1e-6)


def test_the_report_holds_the_variables_of_the_step():
    pose, goal = Pose(1.0, 5.0, math.pi), Pose(1.0, 2.0, 0.5 * math.pi)
    # In the goal's frame: (3, 0, pi/2); the goal lies behind along -x: beta = pi, alpha = pi/2.
    _, _, report = step(ControllerMemory(), pose, goal, T_S, PAPER)
    variables = (report.rho, report.alpha, report.beta, report.theta)
    assert variables == pytest.approx((3.0, math.pi / 2, math.pi, math.pi / 2), abs=1e-12)
    assert (report.eps_P, report.region) == (0.5, OMEGA_G)
    angles = (math.pi / 2) ** 2 + 0.17 * math.pi**2
    assert report.lyapunov == pytest.approx(0.5 * (9.0 + angles))
    _, _, report = step(ControllerMemory(Switching(OMEGA_L)), Pose(-0.55, 0.0, 0.2), ORIGIN, T_S, PAPER)
    assert (report.eps_P, report.region) == (0.6, OMEGA_L)
    assert report.lyapunov == pytest.approx(0.5 * (0.55**2 + 0.2**2))


def test_a_new_goal_forgets_all_but_the_motion():
    moving = {"command": Twist(0.7, -0.3), "actuation": Actuation(Twist(0.5, -0.2))}
    memory = ControllerMemory(
        Switching(OMEGA_L, 4),
        settling=Settling(9, True),
        reapproach=Reapproach(RETREATING, 2, 1, 3.0, 0.4),
        finish=Finish(V_LEG, -1.0, 0.3, 2),
        course=Course(BACK, True),
        reached=True,
        **moving,
    )
    assert driver_of(SwitchingLaw).memory_for_new_goal(memory, PRESETS["tuned"]) == new_memory()._replace(**moving)


@pytest.mark.parametrize("preset", ["paper", "tuned"])
def test_numbers_that_overflow_stop_the_robot(preset):
    memory = ControllerMemory(Switching(OMEGA_L), Twist(0.5, 0.1))
    after, command, _ = step(memory, Pose(math.nan, 0.0, 0.0), ORIGIN, T_S, PRESETS[preset])
    assert command == after.command == (0.0, 0.0)
    assert not after.reached
