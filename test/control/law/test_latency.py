"""The coasted pose compared with a fine integration, the history of the commands, the uncertainty."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law.latency import SLOTS, Coasted, coast, predicted, resting_actuation
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Uncertainty

FINE = 2e-4


def integrated(history, latency, lag):
    """Integrate a ``history`` of (command, dt), and then zero until the robot rests, in steps of 0.2 ms.

    Returns the pose at the end of the history and the pose at rest.
    """
    commands = [command for command, dt in history for _ in range(round(dt / FINE))]
    length = len(commands)
    acting = [Twist(0.0, 0.0)] * round(latency / FINE) + commands
    acting += [Twist(0.0, 0.0)] * round(20.0 * lag / FINE + 1)
    x = y = theta = v = omega = 0.0
    now = (x, y, theta)
    share = 1.0 - math.exp(-FINE / lag) if lag > 0.0 else 1.0
    for index, command in enumerate(acting):
        if index == length:
            now = (x, y, theta)
        v_after, omega_after = v + share * (command.v - v), omega + share * (command.omega - omega)
        middle = theta + 0.25 * FINE * (omega + omega_after)
        way = 0.5 * FINE * (v + v_after) if lag > 0.0 else FINE * v_after
        x, y = x + way * math.cos(middle), y + way * math.sin(middle)
        theta += 0.5 * FINE * (omega + omega_after) if lag > 0.0 else FINE * omega_after
        v, omega = v_after, omega_after
    return Pose(*now), Pose(x, y, theta)


def expected(history, latency, lag):
    """Return the prediction at the end of the history, and the pose at rest of the integration."""
    sheet = DataSheet(command_latency=latency, drive_time_constant=lag)
    actuation = resting_actuation()
    for command, dt in history[:-1]:
        actuation = coast(Pose(0.0, 0.0, 0.0), actuation, command, dt, sheet).actuation
    pose, rest = integrated(history, latency, lag)
    return coast(pose, actuation, history[-1][0], history[-1][1], sheet), rest


def random_history(rng, steps, spans):
    return [(Twist(rng.uniform(-1.0, 1.0), rng.uniform(-2.0, 2.0)), rng.choice(spans)) for _ in range(steps)]


@pytest.mark.parametrize(("latency", "spans"), [(0.1, (0.1,)), (0.24, (0.08, 0.1, 0.2)), (0.5, (0.1,))])
def test_dead_time_alone_is_predicted_exactly(latency, spans):
    rng = random.Random(8)
    for _ in range(4):
        found, rest = expected(random_history(rng, 12, spans), latency, 0.0)
        assert found.pose == pytest.approx((rest.x, rest.y, math.remainder(rest.theta, math.tau)), abs=2e-6)


@pytest.mark.parametrize(("latency", "lag"), [(0.0, 0.3), (0.25, 0.15)])
def test_lag_is_predicted_on_a_line_and_in_the_heading_and_nearly_on_curves(latency, lag):
    rng = random.Random(9)
    for _ in range(4):
        straight = [(Twist(command.v, 0.0), dt) for command, dt in random_history(rng, 15, (0.1,))]
        found, rest = expected(straight, latency, lag)
        assert found.pose == pytest.approx((rest.x, 0.0, 0.0), abs=2e-4)
        found, rest = expected(random_history(rng, 15, (0.1,)), latency, lag)
        assert math.remainder(found.pose.theta - rest.theta, math.tau) == pytest.approx(0.0, abs=5e-4)
        # To first order in the curvature, over up to 0.6 m at up to 2 rad/s.
        assert math.hypot(found.pose.x - rest.x, found.pose.y - rest.y) < 0.02


@settings(max_examples=60)
@given(st.floats(0.0, 5.0), st.lists(st.floats(0.0, 1.0), min_size=0, max_size=60))
def test_the_history_always_covers_the_dead_time(latency, spans):
    sheet = DataSheet(command_latency=latency)
    actuation = resting_actuation()
    for span in spans:
        actuation = coast(Pose(0.0, 0.0, 0.0), actuation, Twist(1.0, 0.0), span, sheet).actuation
        assert len(actuation.history) == SLOTS
    total = sum(held.span for held in actuation.history)
    assert total >= min(latency, sum(spans)) - 1e-9
    found = coast(Pose(0.0, 0.0, 0.0), actuation, Twist(1.0, 0.0), 0.0, sheet)
    # Before the first command the robot was at rest.
    assert found.pose.x == pytest.approx(min(latency, sum(spans)), abs=1e-9)
    assert (found.path_length, found.turned) == pytest.approx((min(latency, sum(spans)), 0.0), abs=1e-9)


def test_the_uncertainty_grows_as_sampled_motions_scatter():
    rng = random.Random(11)
    uncertainty, way, turn, share = Uncertainty(0.02, 0.03), 0.5, 0.4, 0.05
    xs, ys, thetas = [], [], []
    for _ in range(40_000):
        forward, heading = way * (1.0 + rng.uniform(-share, share)), rng.gauss(0.0, uncertainty.theta)
        xs.append(rng.gauss(0.0, uncertainty.xy) + forward * math.cos(heading) - way)
        ys.append(rng.gauss(0.0, uncertainty.xy) + forward * math.sin(heading))
        thetas.append(heading + turn * rng.uniform(-share, share))
    deviations = [math.sqrt(sum(one * one for one in values) / len(values)) for values in (xs, ys, thetas)]
    rest = Pose(0.5, 0.0, 0.4)
    found = predicted(Coasted(resting_actuation(), rest, way, turn), uncertainty).uncertainty
    # The deviation of the position is at least the larger one of both directions.
    assert max(deviations[:2]) < found.xy * 1.02
    assert found.xy < 1.25 * max(deviations[:2])
    assert found.theta == pytest.approx(deviations[2], rel=0.02)
    assert predicted(Coasted(resting_actuation(), rest, 0.0, 0.0), uncertainty) == (rest, uncertainty)
