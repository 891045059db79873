"""The law with braking profiles: the Lyapunov function falls, no bound breaks, and what it promises it keeps.

Robots of the tests move by small steps of the kinematics, with dead time and lag written anew here.
"""

import itertools
import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law import controller
from diffbot_control.law.controller import ControllerMemory, new_memory
from diffbot_control.law.finish import LEAVING, RESTING, SHUTTLING, Finish, Standing, next_finish
from diffbot_control.law.polar_coordinates import Navigation, navigation_variables
from diffbot_control.law.presets import PRESETS
from diffbot_control.law.regions import OMEGA_G, OMEGA_L, Switching
from diffbot_control.law.speed_profile import ProfileGains, auto_gains
from diffbot_control.law.steering import BACK, FRONT, Course, drive_and_hold, drive_and_steer, led_by
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, WheelGeometry
from diffbot_core.uncertainty import CERTAIN, Estimate, Uncertainty

CHECK = settings(max_examples=400)
INF = math.inf
TUNED = PRESETS["tuned"]
ORIGIN = Pose(0.0, 0.0, 0.0)
T_S = 0.1
GAINS = st.builds(
    ProfileGains,
    st.floats(0.05, 20.0),
    st.floats(0.05, 5.0),
    st.floats(0.01, 0.2),
    st.floats(0.05, 5.0),
    st.floats(0.1, 30.0),
    st.floats(0.05, 5.0),
    st.floats(0.1, 30.0),
    st.floats(0.05, 5.0),
)
SHEETS = st.builds(
    lambda v, omega, wheel, radius, separation: DataSheet(v, omega, wheel, wheels=WheelGeometry(radius, separation)),
    st.floats(0.02, 5.0) | st.just(INF),
    st.floats(0.02, 10.0) | st.just(INF),
    st.floats(0.1, 100.0) | st.just(INF),
    st.floats(0.02, 0.3),
    st.floats(0.1, 2.0),
)
ANGLES = st.floats(-math.pi, math.pi)


def rate_of_v(rho, alpha, beta, v, omega, weight):
    """dV/dt with the kinematics: rho' = -v cos(alpha), alpha' = v sin(alpha)/rho - omega, beta' = v sin(alpha)/rho."""
    turn = v * math.sin(alpha) / rho
    terms = (rho * -v * math.cos(alpha), alpha * (turn - omega), weight * beta * turn)
    return sum(terms), sum(abs(term) for term in terms) + abs(alpha * omega)


@CHECK
@given(st.floats(1e-3, 50.0), ANGLES, ANGLES, st.floats(0.0, 0.5), GAINS, SHEETS)
def test_the_lyapunov_function_falls_in_omega_g_with_any_profile_and_limits(rho, alpha, beta, sigma, gains, sheet):
    v, omega = drive_and_steer(Navigation(rho, alpha, beta), sigma, FRONT, gains, sheet)
    rate, size = rate_of_v(rho, alpha, beta, v, omega, gains.bearing_weight)
    assert rate <= 1e-12 * (1.0 + size)


@CHECK
@given(st.floats(1e-3, 50.0), ANGLES, ANGLES, GAINS, SHEETS)
def test_it_falls_with_the_back_leading_too(rho, alpha, beta, gains, sheet):
    """The robot turned round sees the goal at alpha - pi in a goal turned round, and drives the other way."""
    led = led_by(Navigation(rho, alpha, beta), BACK)
    assert abs(math.remainder(led.alpha - alpha, math.tau)) == pytest.approx(math.pi)
    assert abs(math.remainder(led.beta - beta, math.tau)) == pytest.approx(math.pi)
    v, omega = drive_and_steer(led, 0.0, BACK, gains, sheet)
    rate, size = rate_of_v(rho, led.alpha, led.beta, -v, omega, gains.bearing_weight)
    assert rate <= 1e-11 * (1.0 + size)


@CHECK
@given(st.floats(1e-3, 50.0), ANGLES, ANGLES, GAINS, SHEETS)
def test_it_falls_in_omega_l(rho, alpha, theta, gains, sheet):
    v, omega = drive_and_hold(Navigation(rho, alpha, 0.0), theta, 0.0, gains, sheet)
    # d/dt (rho^2 + theta^2) / 2, both terms for themselves.
    assert -rho * v * math.cos(alpha) <= 0.0
    assert theta * omega <= 0.0


def broken(command, previous, dt, sheet):
    """Return how far, relatively, the worst bound is broken."""
    rim = abs(command.v) + 0.5 * abs(command.omega) * sheet.wheels.wheel_separation
    shares = [abs(command.v) / sheet.v_max, abs(command.omega) / sheet.omega_max]
    shares.append(rim / (sheet.wheel_max * sheet.wheels.wheel_radius))
    if sheet.a_max < INF:
        shares.append((abs(command.v - previous.v) - sheet.a_max * dt) / (1.0 + sheet.v_max) + 1.0)
    if sheet.omega_dot_max < INF:
        shares.append((abs(command.omega - previous.omega) - sheet.omega_dot_max * dt) / (1.0 + sheet.omega_max) + 1.0)
    return max(shares) - 1.0


def test_no_limit_is_broken_in_100_000_random_configurations():
    rng = random.Random(3)
    worst = -1.0
    for _ in range(100_000):
        sheet = DataSheet(
            rng.uniform(0.05, 3.0),
            rng.uniform(0.1, 6.0),
            rng.uniform(1.0, 60.0),
            rng.choice((INF, 10.0 ** rng.uniform(-1.5, 1.5))),
            rng.choice((INF, 10.0 ** rng.uniform(-1.0, 2.0))),
            WheelGeometry(rng.uniform(0.02, 0.2), rng.uniform(0.1, 1.5)),
            rng.choice((0.0, 0.25)),
            rng.choice((0.0, 0.1)),
            rng.choice((0.0, 0.05)),
            rng.choice((0.0, 0.1)),
        )
        rim = sheet.wheel_max * sheet.wheels.wheel_radius
        half = 0.5 * sheet.wheels.wheel_separation
        v = rng.uniform(-1.0, 1.0) * min(sheet.v_max, rim)
        omega = rng.uniform(-1.0, 1.0) * min(sheet.omega_max, max(rim - abs(v), 0.0) / half)
        memory = ControllerMemory(Switching(rng.choice((OMEGA_G, OMEGA_L))), Twist(v, omega))
        size = 10.0 ** rng.uniform(-2.5, 1.2)
        pose = Pose(rng.uniform(-size, size), rng.uniform(-size, size), rng.uniform(-3.1, 3.1))
        config = TUNED._replace(data_sheet=sheet)
        dt = rng.choice((0.02, 0.1, 0.2))
        _, command, _ = controller.step(memory, Estimate(pose, Uncertainty(0.03, 0.01)), ORIGIN, dt, config)
        worst = max(worst, broken(command, memory.command, dt, sheet))
    assert worst <= 1e-12


class Robot:
    """Dead time, lag and the unicycle, integrated in steps of a millisecond."""

    def __init__(self, pose, latency=0.0, lag=0.0):
        self.pose, self.lag, self.step = list(pose), lag, 0.001
        self.queue = [Twist(0.0, 0.0)] * round(latency / self.step)
        self.motion = [0.0, 0.0]
        self.turned = 0.0

    def drive(self, command, duration=T_S):
        for _ in range(round(duration / self.step)):
            self.queue.append(command)
            acting = self.queue.pop(0)
            share = 1.0 - math.exp(-self.step / self.lag) if self.lag else 1.0
            self.motion = [now + share * (new - now) for now, new in zip(self.motion, acting, strict=True)]
            x, y, theta = self.pose
            middle = theta + 0.5 * self.step * self.motion[1]
            x += self.step * self.motion[0] * math.cos(middle)
            y += self.step * self.motion[0] * math.sin(middle)
            self.pose = [x, y, math.remainder(theta + self.step * self.motion[1], math.tau)]
            self.turned += abs(self.motion[1]) * self.step


class Run:
    """A run without noise."""

    def __init__(self, start, config=TUNED, steps=300, latency=0.0, lag=0.0, uncertainty=CERTAIN, goal=ORIGIN):
        self.robot = Robot(start, latency, lag)
        self.poses, self.commands, self.memories, self.reports = [], [], [], []
        memory = new_memory()
        for index in range(steps):
            pose = Pose(*self.robot.pose)
            present = uncertainty(index) if callable(uncertainty) else uncertainty
            memory, command, report = controller.step(
                memory, Estimate(pose, present), goal, T_S if index else 0.0, config
            )
            for values, value in (
                (self.poses, pose),
                (self.commands, command),
                (self.memories, memory),
                (self.reports, report),
            ):
                values.append(value)
            self.robot.drive(command)
        self.end = Pose(*self.robot.pose)

    @property
    def settled_after(self):
        outside = [i for i, p in enumerate(self.poses) if math.hypot(p.x, p.y) > 0.1 or abs(p.theta) > 0.1]
        return T_S * (outside[-1] + 1) if outside else 0.0


STARTS = [(-4.0, 3.0, 2.0), (2.0, -5.0, -1.0), (0.5, 0.6, 3.0), (-8.0, 0.0, 0.0), (3.0, 0.2, 0.1), (-0.3, 0.4, -2.0)]


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize(
    ("latency", "lag", "limits"),
    [
        (0.0, 0.0, {}),
        (0.3, 0.0, {}),
        (0.0, 0.3, {}),
        (0.1, 0.1, {"a_max": 0.5, "omega_dot_max": 1.5}),
        (0.25, 0.15, {"a_max": 0.5, "omega_dot_max": 1.5, "omega_max": 1.5}),
    ],
)
def test_a_robot_whose_data_sheet_is_known_arrives_without_spinning(start, latency, lag, limits):
    sheet = TUNED.data_sheet._replace(command_latency=latency, drive_time_constant=lag, **limits)
    run = Run(start, TUNED._replace(data_sheet=sheet), 400, latency, lag)
    assert run.memories[-1].reached
    assert math.hypot(run.end.x, run.end.y) < 0.03
    assert abs(run.end.theta) < 0.01
    assert run.robot.turned < 1.5 * math.tau
    assert run.settled_after < 2.0 * math.hypot(start[0], start[1]) + 12.0


@pytest.mark.parametrize("angle", [0.5, 1.5, 2.5, 3.1, -3.0])
@pytest.mark.parametrize(("latency", "omega_dot"), [(0.0, INF), (0.3, INF), (0.0, 1.5), (0.2, 1.5), (0.3, 0.5)])
def test_a_turn_on_the_spot_does_not_overshoot(angle, latency, omega_dot):
    sheet = TUNED.data_sheet._replace(command_latency=latency, omega_dot_max=omega_dot)
    run = Run((0.0, 0.0, angle), TUNED._replace(data_sheet=sheet), 200, latency)
    headings = [pose.theta * math.copysign(1.0, angle) for pose in run.poses]
    assert min(headings) > -0.02
    assert abs(headings[-1]) < 1e-3


def test_without_its_latency_on_the_data_sheet_it_is_stable_up_to_0_2_s():
    for start in STARTS:
        run = Run(start, TUNED, 400, latency=0.2)
        assert run.memories[-1].reached, start
        assert run.robot.turned < 1.5 * math.tau


@CHECK
@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-3.1, 3.1))
def test_the_end_that_needs_less_turning_leads(x, y, theta):
    pose = Pose(x, y, theta)
    alpha, beta = navigation_variables(pose)[1:]
    memory, _, report = controller.step(new_memory(), Estimate(pose), ORIGIN, T_S, TUNED)
    if report.region == OMEGA_L:
        return
    front = abs(alpha) + abs(beta)
    back = sum(abs(math.remainder(angle - math.pi, math.tau)) for angle in (alpha, beta))
    if abs(front - back) > 1e-9:
        assert memory.course == Course(FRONT if front < back else BACK, False)
    forward = TUNED._replace(driving=TUNED.driving._replace(allow_backward=False))
    memory, command, _ = controller.step(new_memory(), Estimate(pose), ORIGIN, T_S, forward)
    assert memory.course.leading == FRONT
    assert command.v >= 0.0


def test_a_goal_behind_with_the_same_heading_is_reached_backwards_and_only_if_allowed():
    run = Run((3.0, 0.0, 0.0))
    assert run.commands[0].v < 0.0
    assert run.robot.turned < 0.05
    forward = TUNED._replace(driving=TUNED.driving._replace(allow_backward=False))
    run = Run((3.0, 0.3, 0.0), forward, 500)
    assert all(command.v >= 0.0 for command in run.commands)
    assert run.memories[-1].reached


@pytest.mark.parametrize("start", [(-3.0, 0.0, math.pi), (0.0, 0.0, 3.0), (2.0, 0.5, -2.9), (-0.02, 0.0, 2.0)])
def test_either_heading_will_do_with_symmetric_yaw_tolerance(start):
    either = TUNED._replace(driving=TUNED.driving._replace(symmetric_yaw_tolerance=True))
    run, usual = Run(start, either), Run(start)
    assert run.memories[-1].reached
    assert abs(abs(run.end.theta) - math.pi) < 0.01
    assert abs(usual.end.theta) < 0.01
    assert run.robot.turned < usual.robot.turned - 0.7
    assert abs(run.reports[-1].theta) < 0.01


def noisy(index):
    """Deviations of an estimate that converges."""
    return Uncertainty(0.012 + 0.05 * math.exp(-0.03 * index), 0.005)


@pytest.mark.parametrize("tolerance", [0.05, 0.1, 0.3])
@pytest.mark.parametrize("y", [-1.9, -0.9, -0.6, 0.3, 0.5, 0.7, 0.93])
def test_a_lateral_error_is_worked_off_inside_the_tolerance_before_the_goal_counts_as_reached(tolerance, y):
    goal = TUNED.tolerance._replace(xy_goal_tolerance=tolerance)
    policy = TUNED.region_policy._replace(
        covariance=TUNED.region_policy.covariance._replace(eps_P_min=2.5 * tolerance, eps_P_leave_min=10.0)
    )
    config = TUNED._replace(tolerance=goal, region_policy=policy)
    run = Run((0.0, y * tolerance, 0.0), config, 900, uncertainty=Uncertainty(0.02 * tolerance, 0.002))
    assert {memory.switching.region for memory in run.memories} == {OMEGA_L}
    assert run.memories[-1].reached
    assert abs(run.end.y) < 0.25 * tolerance
    assert run.memories[-1].finish.tries >= 1
    if abs(y) < 0.94:
        # The tolerance is not left for it.
        assert max(math.hypot(pose.x, pose.y) for pose in run.poses) < tolerance
        assert max(abs(pose.theta) for pose in run.poses) < 0.1
    else:
        assert max(math.hypot(pose.x, pose.y) for pose in run.poses) > 1.9 * tolerance


def after_poses(laterals, sigma, config=TUNED, memory=None):
    """Stand beside the goal at each of these lateral errors in turn; return the controller's memory."""
    memory = memory or new_memory()._replace(switching=Switching(OMEGA_L))
    for lateral in laterals:
        estimate = Estimate(Pose(0.0, lateral, 0.0), Uncertainty(sigma, 0.005))
        memory, _, _ = controller.step(memory, estimate, ORIGIN, T_S, config)
    return memory


@pytest.mark.parametrize("tolerance", [0.05, 0.1, 0.3])
def test_omega_l_ends_after_three_poses_beyond_the_tolerance_and_not_within_it(tolerance):
    config = TUNED._replace(tolerance=TUNED.tolerance._replace(xy_goal_tolerance=tolerance))
    assert after_poses([0.99 * tolerance] * 20, 0.01, config).switching.region == OMEGA_L
    assert after_poses([1.01 * tolerance] * 2, 0.01, config).switching.region == OMEGA_L
    assert after_poses([1.01 * tolerance] * 3, 0.01, config).switching.region == OMEGA_G


def test_omega_l_does_not_end_while_the_position_is_so_uncertain_that_the_error_is_no_error():
    # Twice (1.6 * 0.05 m + 0.05 tanh(0.15 m)) is 0.175 m.
    assert after_poses([0.15] * 20, 0.05).switching.region == OMEGA_L
    assert after_poses([0.18] * 3, 0.05).switching.region == OMEGA_G


def test_poses_beyond_the_tolerance_do_not_begin_a_way_out():
    """The pose after which a try begins is thrown beyond the leaving radius: nothing begins."""
    settling = TUNED.tolerance.settling_steps
    memory = after_poses([0.08] * (settling - 1), 0.01)
    assert memory.finish.quiet_steps == settling - 1
    memory = after_poses([0.13], 0.01, memory=memory)
    assert (memory.switching.region, memory.finish.phase, memory.finish.quiet_steps) == (OMEGA_L, RESTING, 0)
    # And a try that is under way does not become one.
    memory = after_poses([0.08] * settling, 0.01)
    assert memory.finish.phase == SHUTTLING
    assert after_poses([0.13], 0.01, memory=memory).finish.phase == SHUTTLING


def test_nothing_begins_after_reached_while_the_error_is_within_the_tolerance():
    """The estimate wanders through the whole tolerance once the goal is reached."""
    rng = random.Random(1)
    for _ in range(30):
        memory = new_memory()
        for _ in range(8):
            memory, _, _ = controller.step(memory, Estimate(Pose(0.001, 0.002, 0.0)), ORIGIN, T_S, TUNED)
        assert memory.reached
        for _ in range(200):
            angle, far = rng.uniform(-math.pi, math.pi), rng.uniform(0.0, 0.099)
            pose = Pose(far * math.cos(angle), far * math.sin(angle), rng.uniform(-0.02, 0.02))
            memory, command, _ = controller.step(memory, Estimate(pose, Uncertainty(0.01, 0.01)), ORIGIN, T_S, TUNED)
            assert memory.finish.phase == RESTING
            assert memory.switching.region == OMEGA_L
            assert abs(command.v) < 0.25


@pytest.mark.parametrize(
    ("lateral", "sigma", "rested", "phase"),
    [
        (0.06, 0.04, 5.0, RESTING),  # at first it waits for a better estimate
        (0.06, 0.04, 7.0, SHUTTLING),
        (0.06, 0.09, 7.0, RESTING),  # not even one deviation of room for the shortest leg
        (0.12, 0.06, 5.0, RESTING),
        (0.12, 0.06, 7.0, LEAVING),  # nearer than one deviation to the tolerance of 0.15 m
        (0.12, 0.02, 7.0, SHUTTLING),  # the goal will count as reached: no reason to leave
        (0.16, 0.06, 1.0, LEAVING),  # 2.7 deviations are no accident
        (0.16, 0.14, 1.0, RESTING),
    ],
)
def test_what_begins_after_a_while_at_rest_with_errors_of_fixes_that_last(lateral, sigma, rested, phase):
    tolerance, config = TUNED.tolerance._replace(xy_goal_tolerance=0.15), TUNED.finish
    state = Finish(quiet_steps=tolerance.settling_steps, time=rested)
    standing = Standing(resting=True, inside=True, reached=False, dt=0.1)
    after = next_finish(state, Pose(0.0, lateral, 0.0), standing, Uncertainty(sigma, 0.01), tolerance, config)
    assert after.phase == phase


@pytest.mark.parametrize(("tolerance", "enough"), [(0.03, 0.033), (0.1, 0.1 / 3.0), (0.3, 0.1), (1.5, 0.5)])
def test_a_position_known_to_a_third_of_the_tolerance_is_approached_at_full_speed(tolerance, enough):
    config = TUNED._replace(tolerance=TUNED.tolerance._replace(xy_goal_tolerance=tolerance))

    def speed(sigma):
        pose = Estimate(Pose(-0.8, 0.0, 0.0), Uncertainty(sigma, 0.01))
        memory = new_memory()._replace(switching=Switching(OMEGA_G))
        return controller.step(memory, pose, ORIGIN, T_S, config)[1].v

    assert speed(enough) == pytest.approx(speed(0.0), rel=1e-9)
    assert speed(2.0 * enough) < 0.8 * speed(0.0)


def test_the_goal_does_not_count_as_reached_while_a_try_is_due():
    memory = new_memory()._replace(switching=Switching(OMEGA_L))
    seen = []
    for _ in range(12):
        memory, _, _ = controller.step(
            memory, Estimate(Pose(0.0, 0.03, 0.0), Uncertainty(0.01, 0.01)), ORIGIN, T_S, TUNED
        )
        seen.append((memory.finish.phase != RESTING, memory.reached))
    assert not any(reached for _, reached in seen)
    assert seen[-1][0]


def test_the_uncertainty_that_counts_is_a_multiple_of_the_filters():
    scaled = TUNED._replace(uncertainty_scale=2.5)
    memory = other = new_memory()
    for number in range(60):
        pose = Pose(-2.0 + 0.04 * number, 0.3, 0.1)
        memory, command, report = controller.step(memory, Estimate(pose, Uncertainty(0.02, 0.01)), ORIGIN, T_S, scaled)
        other, expected, same = controller.step(other, Estimate(pose, Uncertainty(0.05, 0.025)), ORIGIN, T_S, TUNED)
        assert (memory, command, report) == (other, expected, same)


def test_automatic_gains_are_the_defaults_at_the_papers_period_and_follow_the_data_sheet():
    assert auto_gains(DataSheet(), 0.1) == pytest.approx(ProfileGains())
    slow = auto_gains(DataSheet(a_max=0.5, omega_dot_max=1.5, command_latency=0.3), 0.2)
    assert (slow.brake, slow.turn_brake, slow.hold_brake) == pytest.approx((0.43, 0.975, 0.975))
    # Half a period, 0.2 s that nobody told and a tenth of what is known.
    assert (slow.react, slow.turn_react, slow.hold_react) == pytest.approx((0.66, 0.594, 0.528))


@pytest.mark.parametrize("period", [0.02, 0.05, 0.1, 0.2, 0.4])
@pytest.mark.parametrize("latency", [0.0, 0.3])
def test_automatic_gains_arrive_at_any_period(period, latency):
    sheet = TUNED.data_sheet._replace(command_latency=latency)
    config = TUNED._replace(gain_source=1, data_sheet=sheet)
    robot, memory = Robot((-2.0, 1.5, 2.5), latency), new_memory()
    for _ in range(round(25.0 / period)):
        memory, command, _ = controller.step(memory, Estimate(Pose(*robot.pose)), ORIGIN, period, config)
        robot.drive(command, period)
    assert memory.reached
    assert math.hypot(robot.pose[0], robot.pose[1]) < 0.03
    assert robot.turned < 1.5 * math.tau


@pytest.mark.parametrize("bad", [math.nan, INF, 1e308])
@pytest.mark.parametrize("region", [OMEGA_G, OMEGA_L])
def test_numbers_that_overflow_stop_the_robot(bad, region):
    memory = ControllerMemory(Switching(region), Twist(0.5, 0.1))
    for pose in (Pose(bad, 0.0, 0.0), Pose(0.0, bad, 0.0), Pose(0.0, 0.0, bad)):
        if bad == 1e308 and pose.x + pose.y < bad:
            continue
        after, command, _ = controller.step(memory, Estimate(pose), Pose(-bad, -bad, 0.0), T_S, TUNED)
        assert command == (0.0, 0.0)
        assert not after.reached


@pytest.mark.parametrize("least", [0.03, 0.1])
def test_commands_are_outside_the_dead_bands(least):
    sheet = TUNED.data_sheet._replace(min_velocity=least, min_rotation=2.0 * least)
    for start in STARTS:
        run = Run(start, TUNED._replace(data_sheet=sheet), 250)
        for command in run.commands:
            assert command.v == 0.0 or abs(command.v) >= least * (1.0 - 1e-12)
            # Where the bound of the rims lets the steering keep its rate.
            assert abs(command.omega) < 1e-12 or abs(command.omega) >= 2.0 * least * (1.0 - 1e-12) or command.v
        assert math.hypot(run.end.x, run.end.y) < 0.1


def test_the_stop_is_on_the_curve_for_any_limits():
    rng = random.Random(4)
    for _ in range(300):
        sheet = TUNED.data_sheet._replace(a_max=rng.uniform(0.2, 2.0), omega_dot_max=rng.uniform(0.2, 5.0))
        start = Twist(rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0))
        memory = ControllerMemory(command=start)
        config = TUNED._replace(data_sheet=sheet)
        commands = [start]
        while commands[-1] != (0.0, 0.0):
            memory, command = controller.stop_step(memory, T_S, config)
            commands.append(command)
            assert command.v * start.omega == pytest.approx(command.omega * start.v, abs=1e-12)
        for before, after in itertools.pairwise(commands):
            assert abs(after.v - before.v) <= sheet.a_max * T_S + 1e-12
            assert abs(after.omega - before.omega) <= sheet.omega_dot_max * T_S + 1e-12
        needed = max(abs(start.v) / sheet.a_max, abs(start.omega) / sheet.omega_dot_max)
        assert (len(commands) - 1) * T_S < needed + T_S + 1e-9
