"""The room as a library: its public names, and what importing it loads."""

import subprocess
import sys

import pytest

HEAVY = ("numpy", "scipy", "filterpy", "numba", "matplotlib", "rclpy")


@pytest.mark.parametrize("room", ["diffbot_control.law", "diffbot_core"])
def test_importing_the_room_loads_no_heavy_package(room):
    code = f"import sys, {room}; print(*(name for name in {HEAVY!r} if name in sys.modules))"
    found = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60.0)
    assert found.stdout.split() == []


def test_a_step_with_the_public_names_alone_drives_towards_the_goal():
    from diffbot_control.law import ControllerConfig, ControllerMemory, step
    from diffbot_core import CERTAIN, Estimate, Pose

    memory, command, report = step(
        ControllerMemory(), Estimate(Pose(-2.0, 0.0, 0.0), CERTAIN), Pose(0.0, 0.0, 0.0), 0.1, ControllerConfig()
    )
    assert command.v > 1.0
    assert abs(command.omega) < 1e-12
    assert report.rho == 2.0
    assert memory.command == command
