"""The peer laws: their formulas, signs, limits and finish, against forms worked out apart from the code."""

import cmath
import itertools
import math

import numpy as np
import pytest

from diffbot_control.law.lyapunov_law import PAPER_GAINS, global_law
from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_control.law.presets import PAPER, PRESETS
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_sim.compiled import peer_laws as peers
from diffbot_sim.compiled.batch import EKF, HISTORY_COLUMNS, TRUTH, Starts, run_batch, run_histories
from diffbot_sim.compiled.closed_loop import Case, run_loop
from diffbot_sim.compiled.peer_laws import (
    AICARDI,
    AICARDI_ENDLESS,
    GRACEFUL,
    GRACEFUL_CONFIG,
    GRACEFUL_POSE,
    GRACEFUL_POSE_CONFIG,
    GRACEFUL_SHIPPED,
    GRACEFUL_SHIPPED_CONFIG,
    POLAR,
    POLAR_FAST,
    PYTHON_ROBOTICS_CONFIG,
    SIEGWART_CONFIG,
    GracefulConfig,
    PeerMemory,
    graceful_curvature,
    graceful_step,
    graceful_velocity,
    new_peer_memory,
    peer_step,
    polar_law,
    polar_step,
    turn_in_place,
)
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

CODES = (GRACEFUL_POSE, GRACEFUL, GRACEFUL_SHIPPED, POLAR, POLAR_FAST, AICARDI, AICARDI_ENDLESS)
STOPPING = CODES[:-1]
ORIGIN = Pose(0.0, 0.0, 0.0)
QUIET = PlantConfig(drive_noise=0.0, encoder_noise=0.0)
STARTS = [(-2.0, -5.5, 0.5), (12.0, 0.0, 0.0), (0.0, 12.0, -2.4), (-3.0, 4.0, 2.0), (0.8, 0.3, 3.0)]


def angle(z):
    return cmath.phase(z)


def ego(x, y, theta):
    """Return r, phi, delta of Park and Kuipers for a target at the origin with heading 0, by complex numbers."""
    sight = complex(-x, -y)
    return abs(sight), angle(1.0 / sight), angle(cmath.exp(1j * theta) / sight)


def moved(pose, v, omega, dt):
    x, y, theta = pose
    return x + v * math.cos(theta) * dt, y + v * math.sin(theta) * dt, theta + omega * dt


def case_of(peer, plant=None, feedback=EKF, steps=300):
    plant = plant or PlantConfig()
    return Case(plant, SensorConfig(), PRESETS[PAPER], ORIGIN, feedback, False, steps, 0.1, 0.1, peer=peer)


@pytest.mark.parametrize("k_phi", [1.0, 2.0, 3.5])
@pytest.mark.parametrize("k_delta", [0.5, 1.0, 3.0])
def test_graceful_curvature_draws_the_heading_to_the_manifold(k_phi, k_delta):
    # z = delta - atan(-k_phi phi) shall fall as z' = -k_delta (v / r) z: seen in x, y, theta by differences.
    rng = np.random.default_rng(3)
    v, dt = 0.7, 1e-5

    def off_manifold(pose):
        r, phi, delta = ego(*pose)
        return delta - math.atan(-k_phi * phi), r

    for _ in range(50):
        pose = (*rng.uniform(-4.0, 4.0, 2), rng.uniform(-math.pi, math.pi))
        r, phi, delta = ego(*pose)
        if abs(phi) > 3.0 or abs(delta) > 3.0 or r < 0.3:
            continue  # an angle might wrap between the two
        omega = v * graceful_curvature(r, phi, delta, k_phi, k_delta)
        before, _ = off_manifold(moved(pose, v, omega, -dt))
        after, _ = off_manifold(moved(pose, v, omega, dt))
        z, _ = off_manifold(pose)
        assert (after - before) / (2.0 * dt) == pytest.approx(-k_delta * v / r * z, abs=1e-5)


def test_graceful_curvature_by_hand():
    # Eq. (13) with k_1 = 2, k_2 = 1 at phi = 0.5, delta = 0: -(atan(1) + 0) / 2.
    assert graceful_curvature(2.0, 0.5, 0.0, 2.0, 1.0) == pytest.approx(-math.pi / 8.0)
    # phi = 0, delta = pi / 2: -(pi / 2 + 3) / 1.
    assert graceful_curvature(1.0, 0.0, math.pi / 2.0, 2.0, 1.0) == pytest.approx(-(math.pi / 2.0 + 3.0))
    assert math.isfinite(graceful_curvature(0.0, 0.3, 0.2, 2.0, 1.0))


@pytest.mark.parametrize(
    ("r", "curvature", "v", "omega"),
    [
        (3.0, 0.0, 0.5, 0.0),
        (0.75, 0.0, 0.25, 0.0),  # half the slowdown radius
        (0.01, 0.0, 0.1, 0.0),  # not below v_linear_min
        (3.0, 2.0, 0.5 / 2.6, 1.0 / 2.6),  # 1 + 0.4 * 2^2
        (3.0, -2.0, 0.5 / 2.6, -1.0 / 2.6),
        (3.0, 20.0, 0.05, 1.0),  # v_angular_max, curvature kept
    ],
)
def test_graceful_velocity_by_hand(r, curvature, v, omega):
    assert graceful_velocity(r, curvature, GracefulConfig()) == pytest.approx((v, omega))


@pytest.mark.parametrize(("left", "omega"), [(1.0, 0.5), (-3.0, -1.5), (0.1, 0.25), (-0.1, -0.25)])
def test_rotation_in_place_by_hand(left, omega):
    assert turn_in_place(left, GracefulConfig()) == pytest.approx((0.0, omega))


def test_nav2s_defaults():
    # nav2_graceful_controller/src/parameter_handler.cpp
    config = GRACEFUL_SHIPPED_CONFIG._asdict()
    assert (config.pop("stop").xy_goal_tolerance) > 0.0
    assert config == {
        "v_linear_max": 0.5,
        "v_angular_max": 1.0,
        "max_lookahead": 1.0,
        "prefer_final_rotation": True,
        "initial_rotation": True,
        "allow_backward": False,
        "initial_rotation_tolerance": 0.75,
        "k_phi": 2.0,
        "k_delta": 1.0,
        "beta": 0.4,
        "lambda_": 2.0,
        "v_linear_min": 0.1,
        "slowdown_radius": 1.5,
        "rotation_scaling_factor": 0.5,
        "v_angular_min_in_place": 0.25,
    }
    for config in (GRACEFUL_POSE_CONFIG, GRACEFUL_CONFIG, GRACEFUL_SHIPPED_CONFIG):
        assert not (config.initial_rotation and config.allow_backward)  # Nav2 refuses the two together


def test_initial_rotation_ends_for_good():
    pose = Pose(-5.0, 0.0, 2.0)  # the goal is 2 rad to the right
    memory, command = graceful_step(new_peer_memory(), pose, GRACEFUL_POSE_CONFIG)
    assert command == pytest.approx((0.0, -0.5 * 2.6 * 2.0))
    memory, command = graceful_step(memory, pose._replace(theta=0.7), GRACEFUL_POSE_CONFIG)
    assert command.v > 0.0
    assert memory.turned
    _, command = graceful_step(memory, pose._replace(theta=0.8), GRACEFUL_POSE_CONFIG)
    assert command.v > 0.0


def test_a_target_ahead_on_the_path_slows_nav2_down():
    memory = PeerMemory(True, False, False, 0.0)
    for x in (-12.0, -5.0, -1.0):
        _, command = graceful_step(memory, Pose(x, 0.0, 0.0), GRACEFUL_SHIPPED_CONFIG)
        assert command == pytest.approx((0.5 / 1.5, 0.0))


def test_final_rotation_forgets_no_arrival():
    memory, command = graceful_step(new_peer_memory(), Pose(0.01, 0.0, 1.0), GRACEFUL_CONFIG)
    assert command == pytest.approx((0.0, -1.3))
    assert memory.arrived
    assert not memory.reached
    # Noise puts it outside again: it turns on, it does not set off.
    memory, command = graceful_step(memory, Pose(0.2, 0.1, 0.5), GRACEFUL_CONFIG)
    assert command == pytest.approx((0.0, -0.65))
    memory, command = graceful_step(memory, Pose(0.2, 0.1, 0.01), GRACEFUL_CONFIG)
    assert memory.reached
    assert command == (0.0, 0.0)


BACKWARD = GRACEFUL_POSE_CONFIG._replace(initial_rotation=False, allow_backward=True)


@pytest.mark.parametrize(
    ("step", "config"),
    [
        (graceful_step, BACKWARD),
        (graceful_step, GRACEFUL_CONFIG),
        (polar_step, SIEGWART_CONFIG),
        (polar_step, PYTHON_ROBOTICS_CONFIG),
    ],
)
def test_backwards_is_forwards_for_one_who_faces_the_other_way(step, config):
    # Robot and goal turned by pi: in the goal's frame the position changes sign and the heading stays.
    rng = np.random.default_rng(4)
    backwards = 0
    for _ in range(200):
        x, y = rng.uniform(-5.0, 5.0, 2)
        pose = Pose(x, y, rng.uniform(-math.pi, math.pi))
        _, one = step(new_peer_memory(), pose, config)
        _, other = step(new_peer_memory(), Pose(-x, -y, pose.theta), config)
        assert one == pytest.approx((-other.v, other.omega), abs=1e-9)
        backwards += one.v < 0.0
    assert 60 < backwards < 140


@pytest.mark.parametrize("config", [SIEGWART_CONFIG, PYTHON_ROBOTICS_CONFIG])
def test_polar_law_has_astolfis_polynomial(config):
    # d(alpha, beta)/dt of the real motion near the axis, by differences; beta = -theta - alpha.
    def polar(pose):
        sight = complex(-pose[0], -pose[1])
        alpha = angle(sight / cmath.exp(1j * pose[2]))
        return np.array([alpha, -pose[2] - alpha])

    def rate(alpha, beta, dt=1e-6):
        bearing = -beta
        pose = (-math.cos(bearing), -math.sin(bearing), bearing - alpha)
        v, omega = polar_law(1.0, alpha, beta, config)
        return (polar(moved(pose, v, omega, dt)) - polar(moved(pose, v, omega, -dt))) / (2.0 * dt)

    step = 1e-4
    jacobian = np.column_stack(
        [(rate(step, 0.0) - rate(-step, 0.0)) / (2 * step), (rate(0.0, step) - rate(0.0, -step)) / (2 * step)]
    )
    k_rho, k_alpha, k_beta = config[:3]
    # lambda^2 + (k_alpha - k_rho) lambda - k_rho k_beta
    assert np.trace(jacobian) == pytest.approx(-(k_alpha - k_rho), rel=1e-4)
    assert np.linalg.det(jacobian) == pytest.approx(-k_rho * k_beta, rel=1e-4)
    assert k_rho > 0.0 > k_beta
    assert k_alpha > k_rho


def test_gains_are_those_of_the_sources():
    assert SIEGWART_CONFIG[:3] == (3.0, 8.0, -1.5)
    assert PYTHON_ROBOTICS_CONFIG[:3] == (9.0, 15.0, -3.0)


def test_polar_law_is_that_of_python_robotics():
    # Its convention in complex numbers: bearing from the front or the back, w = 15 alpha - 3 beta.
    rng = np.random.default_rng(5)
    for _ in range(200):
        x, y, theta = rng.uniform(-3.0, 3.0, 3)
        sight, heading = complex(-x, -y), cmath.exp(1j * theta)
        backwards = (sight / heading).real < 0.0
        alpha = angle((-sight if backwards else sight) / heading)
        beta = angle(1.0 / heading / cmath.exp(1j * alpha))
        wanted = ((-9.0 if backwards else 9.0) * abs(sight), 15.0 * alpha - 3.0 * beta)
        _, command = polar_step(new_peer_memory(), Pose(x, y, theta), PYTHON_ROBOTICS_CONFIG)
        assert command == pytest.approx(wanted, abs=1e-9)


def test_siegwart_keeps_its_first_direction_and_python_robotics_does_not():
    front, rear = Pose(-2.0, 0.5, 0.0), Pose(2.0, 0.5, 0.0)
    for config, second_is_backwards in ((SIEGWART_CONFIG, False), (PYTHON_ROBOTICS_CONFIG, True)):
        memory, command = polar_step(new_peer_memory(), front, config)
        assert command.v > 0.0
        _, command = polar_step(memory, rear, config)
        assert (command.v < 0.0) == second_is_backwards


def test_aicardi_is_law_13():
    for start in STARTS:
        pose = Pose(*start)
        for code in (AICARDI, AICARDI_ENDLESS):
            assert peer_step(code, new_peer_memory(), pose)[1] == global_law(navigation_variables(pose), PAPER_GAINS)


@pytest.mark.parametrize("code", STOPPING)
def test_what_is_reached_is_held(code):
    memory, command = peer_step(code, new_peer_memory(), Pose(0.001, -0.001, 0.001))
    assert memory.reached
    assert command == Twist(0.0, 0.0)
    for start in STARTS:
        memory, command = peer_step(code, memory, Pose(*start))
        assert command == Twist(0.0, 0.0)


def test_endless_never_rests():
    memory, command = peer_step(AICARDI_ENDLESS, new_peer_memory(), Pose(1e-6, 1e-6, 1e-6))
    assert not memory.reached
    assert command.omega != 0.0


@pytest.mark.parametrize("code", CODES)
def test_without_noise_each_comes_to_the_goal(code):
    sensors = SensorConfig(eps_x_max=0.0, eps_y_max=0.0, eps_theta_max=0.0)
    case = case_of(code, QUIET, TRUTH, 900)._replace(sensors=sensors)
    outcomes = run_batch(case, Starts(np.array(STARTS)), 1, 0, len(STARTS))
    # At 10 Hz; the stop tolerances are at most 0.05.
    assert np.hypot(outcomes[:, 0], outcomes[:, 1]).max() < 0.06
    assert np.abs(outcomes[:, 2]).max() < 0.06
    assert np.isfinite(outcomes[:, 3]).all()
    assert (outcomes[:, 4] >= np.hypot(*np.array(STARTS).T[:2]) - 0.06).all()
    assert (outcomes[:, 6] == 0.0).all()
    assert np.isnan(outcomes[:, 7]).all()


@pytest.mark.parametrize("code", CODES)
def test_limits_are_kept_with_the_curvature(code):
    histories = run_histories(case_of(code, steps=200), Starts(np.array(STARTS)), 2, 0, 10)
    v, omega = (histories[:, :, HISTORY_COLUMNS.index(name)] for name in ("v", "omega"))
    assert np.abs(v).max() <= 1.3 * (1.0 + 1e-12)
    if code in (GRACEFUL_POSE, GRACEFUL, GRACEFUL_SHIPPED):
        config = {
            GRACEFUL_POSE: GRACEFUL_POSE_CONFIG,
            GRACEFUL: GRACEFUL_CONFIG,
            GRACEFUL_SHIPPED: GRACEFUL_SHIPPED_CONFIG,
        }[code]
        assert np.abs(v).max() <= config.v_linear_max
        assert np.abs(omega[v != 0.0]).max() <= config.v_angular_max * (1.0 + 1e-12)
        assert (v >= 0.0).all() or config.allow_backward
    else:
        # What was seen gives what was wanted; what was sent has its curvature.
        memory = new_peer_memory()
        for row in histories[0]:
            memory, wanted = peer_step(code, memory, Pose(*row[3:6]))
            scale = min(1.0, 1.3 / abs(wanted.v)) if wanted.v != 0.0 else 1.0
            assert row[6:8] == pytest.approx((scale * wanted.v, scale * wanted.omega), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("code", CODES)
def test_uncompiled_is_the_same(code):
    case = case_of(code, steps=250)
    starts = STARTS[:2]
    compiled = run_histories(case, Starts(np.array(starts)), 7, 0, 2)
    outcomes = run_batch(case, Starts(np.array(starts)), 7, 0, 2)
    for run, start in enumerate(starts):
        history = np.empty((case.steps + 1, len(HISTORY_COLUMNS)))
        outcome = run_loop(case, 7, run, Pose(*start), history)
        np.testing.assert_allclose(history, compiled[run], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(outcome, outcomes[run], rtol=1e-9, atol=1e-9)


def test_codes_differ_and_so_do_the_drives():
    assert sorted((peers.OURS, *CODES)) == list(range(8))
    start = Starts(np.array(STARTS[:1]))
    paths = [run_histories(case_of(code, steps=60), start, 1, 0, 1)[0, :, :2] for code in (peers.OURS, *CODES[:-1])]
    assert all(np.abs(one - other).max() > 0.02 for one, other in itertools.combinations(paths, 2))
