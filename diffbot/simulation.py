"""Simulate drives of a robot to goal poses, and return their recordings."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from diffbot.arguments import AnyPose, AnyRobot, goal_of, robot_of, seed_of
from diffbot_core.errors import DiffbotError
from diffbot_core.installed import install_hint
from diffbot_sim.config import StartPose
from diffbot_sim.simulation import ClosedLoop, Drive

if TYPE_CHECKING:
    import pandas

Array = NDArray[np.float64]
DEFAULT_ROBOT = "turtlebot3_burger"


class Recording(Drive):
    """Recording of a drive to one goal: how the goal ended, and one row for each step.

    Examples:
        >>> import diffbot
        >>> run = diffbot.drive((1.0, 2.0, 0.0), seed=1)
        >>> run.end, run.is_reached, run.position_error < 0.25
        ('reached', True, True)
        >>> run.to_numpy().shape == (len(run.time), len(run.COLUMNS))
        True
    """

    __slots__ = ()
    COLUMNS = (
        *("time", "x", "y", "theta", "estimate_x", "estimate_y", "estimate_theta"),
        *("v", "omega", "sigma", "region", "reached"),
    )
    """Time [s], true pose [m, m, rad], estimated pose [m, m, rad] (nan before the first fix), command [m/s, rad/s],
    standard deviation of the estimated position [m], region (0: Omega_G, 1: Omega_L), reached (1 once the goal is
    reached, otherwise 0)."""

    def __repr__(self) -> str:
        """Return a one-line summary of how the goal ended."""
        goal, why = ", ".join(f"{number:g}" for number in self.goal), f" ({self.reason})" if self.reason else ""
        error = f"{self.position_error:.3f} m and {abs(self.error.theta):.3f} rad away"
        return f"<Recording: ({goal}) {self.end}{why} after {self.duration:.1f} s, {error}>"

    __str__ = __repr__

    def to_numpy(self) -> Array:
        """Return an array (n, 12) with a row for each step and the columns COLUMNS."""
        return np.column_stack(self[3:]).astype(np.float64)

    def to_pandas(self) -> pandas.DataFrame:
        """Return a table with a row for each step; the index is the time, and the other COLUMNS are the columns.

        Raises:
            DiffbotError: if pandas is not installed.
        """
        try:
            import pandas  # noqa: PLC0415 - an extra
        except ImportError:
            raise DiffbotError(f"to_pandas needs pandas: {install_hint('pandas')}") from None
        return pandas.DataFrame(self.to_numpy(), columns=list(self.COLUMNS)).set_index("time")

    def plot(self, path: str | PathLike[str] | None = None) -> Any:
        """Plot the path and the distance from the goal over time; return the figure of matplotlib.

        Args:
            path: file to write, e.g. ``drive.png``. None, for a notebook or ``pyplot.show()``, does not write a file.

        Raises:
            DiffbotError: if the file cannot be written.
        """
        from matplotlib import pyplot  # noqa: PLC0415 - the import takes a second

        from diffbot_tools.robot_trial import draw_drives  # noqa: PLC0415

        figure = pyplot.figure(figsize=(10.0, 4.5), layout="constrained")
        draw_drives(figure, [self])
        if path is not None:
            try:
                figure.savefig(Path(path).expanduser())
            except (OSError, ValueError) as error:  # ValueError: a suffix that matplotlib cannot write
                raise DiffbotError(f"cannot write to {path}: {error}") from error
            finally:
                pyplot.close(figure)
        return figure


class Simulation(ClosedLoop):
    """Simulated robot with filter and controller. Each drive starts where the previous drive ended.

    Examples:
        >>> import diffbot
        >>> simulation = diffbot.Simulation("warehouse_agv", start=(1.0, 0.0, 0.0))
        >>> [simulation.drive(goal).end for goal in ((4.0, 0.0, 1.57), (4.0, 3.0, 3.14))]
        ['reached', 'reached']
        >>> abs(simulation.truth.y - 3.0) < 0.05
        True
    """

    def __init__(self, robot: AnyRobot = DEFAULT_ROBOT, start: AnyPose | None = None, seed: int = 1) -> None:
        """Create a simulation; arguments as for :func:`diffbot.drive`.

        Raises:
            DiffbotError: if the robot is unknown or an argument is not allowed.
        """
        at = None if start is None else StartPose(*goal_of("start", start))
        super().__init__(*robot_of(robot).parts(seed_of(seed), at))

    def drive(self, goal: AnyPose) -> Recording:
        """Drive to a goal until it is reached or given up.

        Raises:
            InvalidValueError: if the goal is not three finite numbers, or its heading seems to be in degrees.
        """
        return Recording(*super().drive(goal_of("goal", goal)))


def drive(goal: AnyPose, robot: AnyRobot = DEFAULT_ROBOT, start: AnyPose | None = None, seed: int = 1) -> Recording:
    """Drive a simulated robot to one goal.

    Examples:
        >>> import diffbot
        >>> diffbot.drive((0.5, 0.0, 0.0), robot="turtlebot4").is_reached
        True

    Args:
        goal: x [m], y [m] and heading [rad] in map.
        robot: parameter file, name in ROBOTS, or result of :func:`robot`.
        start: pose at the start. None uses the start in the parameter file, which is (0, 0, 0) for ROBOTS.
        seed: seed of all noise; the same seed gives the same drive.

    Raises:
        DiffbotError: if the robot is unknown or an argument is not allowed.
    """
    return Simulation(robot, start, seed).drive(goal)
