"""Simulate drives and summarise how they ended."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from diffbot.given import AnyPose, AnyRobot, goal_of, robot_of, seed_of
from diffbot_core.errors import DiffbotError
from diffbot_core.installed import install_hint
from diffbot_sim.config import StartPose
from diffbot_sim.simulation import Drive, SimulatedRobot

if TYPE_CHECKING:
    import pandas

Array = NDArray[np.float64]
DEFAULT_ROBOT = "turtlebot3_burger"


class Recording(Drive):
    """One goal, how it ended, and a row for each step on the way.

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
    """Time [s]; true pose and estimate [m, m, rad], nan before the first fix; command [m/s, rad/s]; standard deviation
    of the estimated position [m]; region (0: Omega_G, 1: Omega_L); 1 once the goal is reached."""

    def __repr__(self) -> str:
        """Return a one-line summary of how the goal ended."""
        goal, why = ", ".join(f"{number:g}" for number in self.goal), f" ({self.reason})" if self.reason else ""
        error = f"{self.position_error:.3f} m and {abs(self.error.theta):.3f} rad away"
        return f"<Recording: ({goal}) {self.end}{why} after {self.duration:.1f} s, {error}>"

    __str__ = __repr__

    def to_numpy(self) -> Array:
        """Return (n, 12) numbers, a row for each step; columns as COLUMNS."""
        return np.column_stack(self[3:]).astype(np.float64)

    def to_pandas(self) -> pandas.DataFrame:
        """Return the same as a table, indexed by time.

        Raises:
            DiffbotError: if pandas is not installed.
        """
        try:
            import pandas  # noqa: PLC0415 - an extra
        except ImportError:
            raise DiffbotError(f"to_pandas needs pandas: {install_hint('pandas')}") from None
        return pandas.DataFrame(self.to_numpy(), columns=list(self.COLUMNS)).set_index("time")

    def plot(self, path: str | PathLike[str] | None = None) -> Any:
        """Draw the path, and the distance from the goal over time; return the figure of matplotlib.

        Args:
            path: file to write, e.g. ``drive.png``; None: only return it, for a notebook or ``pyplot.show()``.

        Raises:
            DiffbotError: if the file cannot be written.
        """
        from matplotlib import pyplot  # noqa: PLC0415 - takes a second to load

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


class Simulation(SimulatedRobot):
    """A simulated robot with its filter and its controller; time goes on from drive to drive.

    Examples:
        >>> import diffbot
        >>> simulation = diffbot.Simulation("warehouse_agv", start=(1.0, 0.0, 0.0))
        >>> [simulation.drive(goal).end for goal in ((4.0, 0.0, 1.57), (4.0, 3.0, 3.14))]
        ['reached', 'reached']
        >>> abs(simulation.truth.y - 3.0) < 0.05
        True
    """

    def __init__(self, robot: AnyRobot = DEFAULT_ROBOT, start: AnyPose | None = None, seed: int = 1) -> None:
        """Put the robot at ``start``, or where its file says; ``seed`` names all noise.

        Raises:
            DiffbotError: in one line, for a robot or a start that cannot be used.
        """
        at = None if start is None else StartPose(*goal_of("start", start))
        super().__init__(*robot_of(robot).parts(seed_of(seed), at))

    def drive(self, goal: AnyPose) -> Recording:
        """Drive until the goal is answered: reached, or not and why.

        Raises:
            InvalidValueError: for a goal that is not three numbers.
        """
        return Recording(*super().drive(goal_of("goal", goal)))


def drive(goal: AnyPose, robot: AnyRobot = DEFAULT_ROBOT, start: AnyPose | None = None, seed: int = 1) -> Recording:
    """Drive a simulated robot to one goal.

    Examples:
        >>> import diffbot
        >>> diffbot.drive((0.5, 0.0, 0.0), robot="turtlebot4").is_reached
        True

    Args:
        goal: x [m], y [m], heading [rad] in map.
        robot: parameter file, name of one of ROBOTS, or :func:`robot`.
        start: where it starts; None: where its file says, (0, 0, 0) for ROBOTS.
        seed: of all noise.

    Raises:
        DiffbotError: in one line, for a robot, goal or start that cannot be used.
    """
    return Simulation(robot, start, seed).drive(goal)
