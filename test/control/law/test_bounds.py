"""The controller publishes only finite numbers, at the bounds of its parameters and between them."""

from typing import Annotated

import numpy as np
import pytest
from extremes import assert_finite, extreme_configs

from diffbot_control.goals import Supervisor, SupervisorConfig
from diffbot_control.law import paper
from diffbot_control.law.goal_checker import smallest_tolerance
from diffbot_control.law.registry import PRECISE, PRESETS, TUNED, registered_laws, resolve_law
from diffbot_control.law.switching import SwitchingLaw
from diffbot_core.geometry import MAX_COORDINATE, Pose
from diffbot_core.schema import PARTIAL, variant
from diffbot_core.uncertainty import Uncertainty

PAIRS = 40
PERIODS = (0.0, 1e-3, 0.1, 10.0)
GOAL = Pose(1.0, -2.0, 0.5)


def poses(rng):
    """Yield time since the last pose [s], pose and uncertainty: at the goal, far away, and at rest near the goal."""
    away = (0.0, *10.0 ** rng.uniform(-9.0, np.log10(MAX_COORDINATE), 5))
    for distance in away:
        x, y = np.clip(np.add(GOAL[:2], distance * rng.uniform(-1.0, 1.0, 2)), -MAX_COORDINATE, MAX_COORDINATE).tolist()
        theta = GOAL.theta + float(rng.uniform(-4.0, 4.0)) * min(distance, 1.0)
        yield float(rng.choice(PERIODS)), Pose(x, y, theta), Uncertainty(*(10.0 ** rng.uniform(-8.0, 4.0, 2)).tolist())
    # Long enough for another approach to begin.
    beside = Pose(GOAL.x, GOAL.y + 10.0 ** float(rng.uniform(-3.0, 0.0)), GOAL.theta)
    for _ in range(12):
        yield 0.1, beside, Uncertainty(1e-3, 1e-3)


def drive(config, law, rng):
    """Yield command and supervisor after each pose, and at last after a long silence."""
    supervisor = Supervisor(config, law)
    supervisor.on_goal(GOAL)
    stamp = 0
    for period, pose, uncertainty in poses(rng):
        stamp += round(period * 1e9)
        yield supervisor.on_pose(stamp, stamp * 1e-9, pose, uncertainty), supervisor
    yield supervisor.on_tick(stamp * 1e-9 + 1e7, 1e7), supervisor


def cases():
    """Yield (name of the law, base configuration); the switching law has all presets."""
    yield from ((one.law.name, SupervisorConfig(controller=one.config)) for one in (PRESETS[TUNED], PRESETS[PRECISE]))
    for name in sorted({*registered_laws()} - {SwitchingLaw.name}):
        law = resolve_law(name)
        yield name, variant(SupervisorConfig, {"controller": Annotated[law.Config, PARTIAL]})()


@pytest.mark.parametrize(("name", "base"), cases())
def test_a_law_commands_finite_numbers(name, base, monkeypatch):
    limited = paper.limit_acceleration

    # The law itself replaces a command that is not finite, so check the command before that.
    def checked(*given):
        result = limited(*given)
        assert_finite(result, given)
        return result

    monkeypatch.setattr(paper, "limit_acceleration", checked)
    law, rng, tried = resolve_law(name), np.random.default_rng(1), 0
    for values, config in extreme_configs(type(base), 2, PAIRS, base):
        for command, supervisor in drive(config, law, rng):
            report = supervisor.report
            if law is SwitchingLaw:
                assert_finite((report, smallest_tolerance(supervisor.tolerance, supervisor.uncertainty)), values)
            # Another law without a Lyapunov function reports nan for it.
            assert_finite((command, report and report._replace(lyapunov=0.0), supervisor.distance_remaining()), values)
            assert not supervisor.has_failed, (supervisor.reason, values)
            supervisor.is_beyond_limits  # noqa: B018
        tried += 1
    assert tried > PAIRS
