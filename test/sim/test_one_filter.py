"""The filter as plain Python with filterpy and the compiled filter have equal results."""

import math

import numpy as np
import pytest

from diffbot_control.filter import ekf, models, state
from diffbot_control.filter.config import FILTERS, FilterConfig, LocalizationConfig, options_of
from diffbot_control.filter.models import Motion, Reading, TurnRate
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_sim.jit import compile_kernel, one_compiler

STEPS, DT = 600, 0.1
LANDMARKS = (Point(4.0, 1.0), Point(-2.0, 5.0))
SIGMAS = {models.POSE_FIX: (0.2, 0.2, 0.1), models.POSITION_FIX: (0.3, 0.3), models.HEADING: (0.05,)} | {
    models.LANDMARK: (0.1, 0.03),
    models.RANGE: (0.1,),
    models.BEARING: (0.03,),
}


def fuse(filter_, options, motions, readings, outcomes):
    """Fuse all measurements in the order of their rows. Late ones make the filter return by five steps."""
    memory = np.zeros((5, len(filter_.memory)))
    for step in range(len(motions)):
        late = step % 7 == 6
        if late:
            filter_.memory[:] = memory[step % 5]
        for again in range(step - 5 if late else step, step + 1):
            memory[again % 5] = filter_.memory
            row = motions[again]
            covariance = TwistCovariance(row[2], 0.1 * row[2], row[2])
            motion = Motion(Twist(row[0], row[1]), DT, covariance, TurnRate(row[3], 1e-4), 1e-6)
            ekf.take_rate(filter_, options, motion)
            ekf.predict(filter_, options, motion)
            for number in range(len(readings[again])):
                row = readings[again, number]
                kind, m = int(row[0]), models.size_of(int(row[0]))
                if kind >= 0 and (late or row[12] == 0.0):
                    at = Point(row[9], row[10])
                    R = np.zeros((m, m))
                    for i in range(m):
                        R[i, i] = row[6 + i]
                    one = Reading(kind, int(row[1]), int(row[2]), again * DT, row[3 : 3 + m].copy(), R, at)
                    outcomes[ekf.take(filter_, options, one)] += 1
    return ekf.average(filter_, options)


def drive(rng):
    """Return motions (n, 4) and readings (n, 4, 13) of a winding drive, with outliers and late measurements."""
    motions, readings = np.zeros((STEPS, 4)), np.full((STEPS, 4, 13), -1.0)
    pose, error = Pose(0.0, 0.0, 0.0), np.zeros(3)
    for step in range(STEPS):
        v, omega = 0.6 + 0.3 * math.sin(0.05 * step), 0.4 * math.cos(0.03 * step)
        pose = models.move(pose, Twist(1.02 * v, 0.98 * omega), DT)
        motions[step] = v, omega, 0.01 * v * v + 1e-4, 0.98 * omega + 0.02 + 0.01 * rng.normal()
        error = 0.9 * error + math.sqrt(0.19) * rng.normal(size=3)
        for number, kind in enumerate(rng.choice(6, 4)):
            if rng.random() < 0.5:
                place = int(rng.integers(2))
                at = LANDMARKS[place]
                dx, dy = at.x - pose.x, at.y - pose.y
                true = {
                    models.POSE_FIX: tuple(pose),
                    models.POSITION_FIX: pose[:2],
                    models.HEADING: (pose.theta,),
                    models.LANDMARK: (1.01 * math.hypot(dx, dy) + 0.05, math.atan2(dy, dx) - pose.theta),
                    models.RANGE: (1.01 * math.hypot(dx, dy) + 0.05,),
                    models.BEARING: (math.atan2(dy, dx) - pose.theta,),
                }[kind]
                sigmas = np.array(SIGMAS[kind])
                z = np.array(true) + sigmas * (
                    error[: len(true)] if kind == models.POSE_FIX else rng.normal(size=len(true))
                )
                z += 30.0 * sigmas * (rng.random() < 0.05)
                source = 0 if kind <= models.POSITION_FIX else 1 if kind == models.HEADING else 2
                row = readings[step, number]
                row[:3], row[3 : 3 + len(z)], row[6 : 6 + len(z)] = (
                    (kind, source, 3 + place if source == 2 else source),
                    z,
                    sigmas**2,
                )
                row[9], row[10], row[12] = at.x, at.y, float(rng.random() < 0.2)
    return motions, readings


@pytest.fixture(scope="module")
def compiled():
    return compile_kernel(fuse)


@pytest.mark.parametrize("variant", FILTERS)
def test_compiled_and_plain_filter_are_equal_with_all_options(variant, compiled):
    motions, readings = drive(np.random.default_rng(3))
    # The robot is kidnapped at step 400, so the following fixes relocate the filter.
    fixes = (readings[400:, :, 0] == models.POSE_FIX) | (readings[400:, :, 0] == models.POSITION_FIX)
    readings[400:, :, 3][fixes] += 8.0
    config = LocalizationConfig(filter=FilterConfig(filter=variant, use_gyro=True))
    options = options_of(config, 0.6, LANDMARKS)
    results = []
    for run in (fuse, compiled):
        found, outcomes = state.new_filter(options, len(LANDMARKS)), np.zeros(5, dtype=np.int64)
        state.start(found, Pose(0.1, 0.0, 0.05), np.diag((0.5, 0.5, 0.1)))
        with one_compiler(""):
            x, P = run(found, options, motions, readings, outcomes)
        results.append((found.memory, x, P, outcomes))
    (memory, x, P, outcomes), (same_memory, same_x, same_P, same_outcomes) = results
    np.testing.assert_array_equal(outcomes, same_outcomes)
    assert outcomes[[ekf.ACCEPTED, ekf.REJECTED, ekf.RELOCATED, ekf.WEIGHED]].all()
    np.testing.assert_allclose(same_x, x, atol=1e-9)
    np.testing.assert_allclose(same_P, P, atol=1e-9)
    np.testing.assert_allclose(same_memory, memory, rtol=1e-9, atol=1e-9)
