"""The plant with sensors and time: stamps, delays, faults, repeatability and covariances."""

import cmath
import math

import numpy as np
import pytest
from scipy.stats import chi2

from diffbot_control.filter.config import LandmarkMap
from diffbot_core.geometry import into_frame
from diffbot_core.kinematics import Twist
from diffbot_sim.config import PlantConfig, SensorConfig, StartPose, WorldConfig
from diffbot_sim.world import World

QUIET = WorldConfig(
    PlantConfig(drive_noise=0.0, encoder_noise=0.0),
    SensorConfig(eps_xy_max=0.0, eps_theta_max=0.0),
    StartPose(0.0, 0.0, 0.0),
)
ARC = Twist(1.0, 0.4)


def simulated(config, steps, command=ARC, start_stamp=0):
    """Return stamp, true pose, odometry, fixes and headings of each step of a world."""
    world, seen = World(config, start_stamp), []
    for _ in range(steps + 1):
        arrivals = world.sense()
        fixes = [(one.stamp, tuple(one.pose)) for one in arrivals.fixes]
        headings = [(one.stamp, one.theta) for one in arrivals.headings]
        seen.append((world.stamp, world.state.pose, world.odometry(), fixes, headings))
        world.advance(command)
    return seen


def test_sensors_and_faults_do_not_change_other_noise():
    plain = simulated(WorldConfig(seed=7), 30)
    sensors = SensorConfig(
        heading_rate=10.0, fix_rate=5.0, fix_dropout=0.3, fix_outlier=0.2, fix_delay=0.2, landmark_rate=10.0
    )
    landmarks = LandmarkMap((1, 2), (0.0, 1.0), (0.0, 1.0))
    faulty = simulated(WorldConfig(seed=7, sensors=sensors, landmarks=landmarks), 30)
    assert [one[1] for one in faulty] == [one[1] for one in plain]
    # A fix has the same noise whether or not it is late and other sensors are on.
    on_time = {stamp: z for step in plain for stamp, z in step[3]}
    for step in faulty:
        for stamp, z in step[3]:
            distance = math.hypot(z[0] - on_time[stamp][0], z[1] - on_time[stamp][1])
            assert distance == pytest.approx(0.0, abs=1e-12) or distance == pytest.approx(3.0)
            assert z[2] == on_time[stamp][2]


@pytest.mark.parametrize(("delay", "steps"), [(0.0, 0), (0.25, 3)])
def test_a_late_fix_has_the_pose_at_its_stamp(delay, steps):
    sensors = QUIET.sensors._replace(fix_delay=delay, fix_rate=5.0, heading_rate=10.0)
    sensors = sensors._replace(heading_error_max=0.0)
    seen = simulated(QUIET._replace(sensors=sensors), 40)
    poses = {stamp: pose for stamp, pose, *_ in seen}
    fixes = [(number, stamp, z) for number, step in enumerate(seen) for stamp, z in step[3]]
    assert [number for number, _, _ in fixes] == [number for number in range(steps, 41) if (number - steps) % 2 == 0]
    for number, stamp, z in fixes:
        assert stamp == (number - steps) * 10**8
        assert z == pytest.approx(poses[stamp], abs=1e-12)
    headings = [(number, stamp, z) for number, step in enumerate(seen) for stamp, z in step[4]]
    assert headings
    for number, stamp, z in headings:
        assert number * 10**8 == stamp
        assert z == pytest.approx(poses[stamp].theta, abs=1e-12)


def test_the_covariance_of_the_odometry_is_the_covariance_of_its_errors():
    # Without drive noise the true motion is known. Uniform wheel errors over 25 steps are nearly normal.
    total, runs = 0.0, 200
    for run in range(runs):
        config = QUIET._replace(plant=PlantConfig(drive_noise=0.0), seed=3, run=run)
        world = World(config)
        for step in range(25):
            world.advance(Twist(1.0, 0.8 if step < 12 else -0.5))
        odometry, truth = world.state.odometry, world.state.pose
        turn = into_frame(odometry, truth).theta
        error = np.array([odometry.x - truth.x, odometry.y - truth.y, turn])
        total += error @ np.linalg.solve(world.odometry_P, error)
    low, high = chi2.ppf([0.001, 0.999], 3 * runs)
    assert low < total < high


def test_landmarks_within_range_are_measured_at_their_rate_and_position():
    sensors = QUIET.sensors._replace(
        fix_rate=0.0,
        landmark_rate=5.0,
        landmark_range=4.0,
        landmark_range_error_max=0.0,
        landmark_bearing_error_max=0.0,
    )
    points = {7: (3.0, 1.0), -2: (5.0, 4.0), 30: (-9.0, 0.0), 4: (0.0, 3.0)}
    landmarks = LandmarkMap(tuple(points), *(tuple(column) for column in zip(*points.values(), strict=True)))
    world, numbers = World(QUIET._replace(sensors=sensors, landmarks=landmarks), 123), set()
    for step in range(120):
        arrivals, pose = world.sense(), world.state.pose
        assert not arrivals.fixes
        near = {n for n, point in points.items() if math.dist(point, pose[:2]) <= 4.0} if step % 2 == 0 else set()
        assert [one.number for one in arrivals.landmarks] == [n for n in sorted(points, key=points.get) if n in near]
        for stamp, distance, bearing, R, number, place in arrivals.landmarks:
            assert (stamp, place) == (world.stamp, points[number])
            end = complex(pose.x, pose.y) + cmath.rect(distance, pose.theta + bearing)
            assert abs(end - complex(*points[number])) < 1e-9
            np.testing.assert_allclose(R, 1e-8 * np.eye(2))
        numbers |= near
        world.advance(ARC)
    assert numbers == {7, -2, 4}


def test_errors_are_uniform_and_independent_and_have_the_variances_of_the_messages():
    sensors = SensorConfig(eps_xy_max=0.6, eps_theta_max=0.17, heading_rate=10.0, landmark_rate=10.0, gyro_rate=10.0)
    # Even two landmarks at the same position have independent errors. Some headings are beyond pi.
    landmarks, yaw = LandmarkMap((1, 2), (6.0, 6.0), (0.0, 0.0)), 3.1
    config = QUIET._replace(sensors=sensors, start=StartPose(0.0, 0.0, yaw), landmarks=landmarks, seed=5)
    world, errors = World(config), []
    for _ in range(2000):
        world.advance(Twist(0.0, 0.0))
        arrivals, gyro = world.sense(), world.turn_rate()
        fix, turns = arrivals.fixes[0].pose, [one.bearing + yaw for one in arrivals.landmarks]
        turns += [fix.theta - yaw, arrivals.headings[0].theta - yaw]
        assert -math.pi < fix.theta <= math.pi
        ranges = [one.range - 6.0 for one in arrivals.landmarks]
        angles = [math.remainder(one, math.tau) for one in turns]
        errors.append([fix.x, fix.y, *ranges, *angles, gyro.rate - sensors.gyro_bias])
    of_landmarks = [one.R.diagonal() for one in arrivals.landmarks]
    of_fix, of_heading = arrivals.fixes[0].R.diagonal(), arrivals.headings[0].R.diagonal()
    variances = *of_fix[:2], *np.transpose(of_landmarks).ravel(), of_fix[2], *of_heading, gyro.variance
    bounds = np.array((0.6, 0.6, 0.1, 0.1, 0.05, 0.05, 0.17, 0.087, 0.01))
    np.testing.assert_allclose(variances, bounds**2 / 3.0)
    assert (np.abs(errors) <= bounds * (1.0 + 1e-9)).all()
    np.testing.assert_allclose(np.mean(errors, axis=0) / bounds, 0.0, atol=4.0 / math.sqrt(3.0 * len(errors)))
    np.testing.assert_allclose(np.var(errors, axis=0), variances, rtol=0.09)
    assert np.abs(np.corrcoef(np.transpose(errors)) - np.eye(len(bounds))).max() < 0.1
    plain, scaled = World(config).sense(), World(config._replace(sensors=sensors._replace(fix_covariance_scale=10.0)))
    fix = scaled.sense().fixes[0]
    np.testing.assert_allclose(fix.R, 10.0 * plain.fixes[0].R)
    assert fix.pose == plain.fixes[0].pose


def test_changed_noise_applies_from_the_next_step_on():
    world = World(QUIET)
    world.advance(ARC)
    sensors = QUIET.sensors._replace(eps_xy_max=0.5)
    quiet = world.state.pose
    world.configure(QUIET._replace(sensors=sensors, plant=QUIET.plant._replace(drive_noise=0.5)))
    fix = world.sense().fixes[0]
    assert world.state.pose == quiet
    assert fix.R[0, 0] == pytest.approx(0.25 / 3.0)
    assert abs(fix.pose.x - quiet.x) > 1e-6
    world.advance(ARC)
    assert world.state.twist != pytest.approx(ARC)
