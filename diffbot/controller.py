"""The controller of a robot in a loop of one's own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from diffbot.given import AnyPose, AnyRobot, pose_of, robot_of, with_parameters
from diffbot_control.goals import GoalRequest, Supervisor
from diffbot_control.ros.parameters.controller import ControllerNodeConfig, law_of
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Uncertainty
from diffbot_core.units import NS_PER_S


class Controller(Supervisor):
    """Answers each pose with a command, and each goal with how it ended.

    >>> import diffbot
    >>> controller = diffbot.Controller(linear_x_max_velocity=0.5, linear_x_max_acceleration=1.0)
    >>> controller.go_to((2.0, 0.0, 0.0))
    >>> controller.step(0.0, (0.0, 0.0, 0.0)), controller.step(0.1, (0.0, 0.0, 0.0)).v <= 0.1
    (Twist(v=0.0, omega=0.0), True)
    >>> controller.status, controller.end
    ('driving', '')
    """

    def __init__(self, robot: AnyRobot | None = None, **parameters: Any) -> None:
        """Take a robot's controller, or the default one, with some parameters changed.

        Args:
            robot: parameter file, name of one of ROBOTS, or :func:`robot`; None: the defaults of the node.
            parameters: by their names in docs/reference/parameters, with ``_`` for the dots.

        Raises:
            DiffbotError: in one line, for a robot or a value that cannot be used.
        """
        node = ControllerNodeConfig() if robot is None else robot_of(robot).controller
        super().__init__(with_parameters(node.supervisor, parameters), law_of(node.law))

    def go_to(self, goal: AnyPose) -> None:
        """Drive to ``goal`` from the next pose on; it replaces the present one. ``on_cancel()`` drops it.

        Raises:
            InvalidValueError: for a goal that is not three numbers.
        """
        self.on_goal(pose_of("goal", goal), GoalRequest(source="go_to"))

    def step(self, time: float, pose: AnyPose, sigma: Sequence[float] = (0.0, 0.0)) -> Twist:
        """Answer a pose with the command until the next one; zero without a goal.

        Args:
            time: [s] of the pose, rising.
            pose: estimate in the frame of the goal.
            sigma: its standard deviations [m], [rad]; zero: exact.
        """
        at = pose_of("pose", pose)
        return self.on_pose(round(time * NS_PER_S), time, at, Uncertainty(*sigma)) or Twist(0.0, 0.0)

    @property
    def end(self) -> str:
        """How the newest goal ended: reached, not reached, cancelled ...; empty while it is driven to."""
        return self.goals.ended[-1].end if self.goals.present is None and self.goals.ended else ""
