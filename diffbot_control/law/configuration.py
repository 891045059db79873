"""Parameters of the laws ``switching``, ``docking`` and ``paper``."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_core.data_sheet import PAPER_DATA_SHEET, DataSheet
from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import ANGLE, DISTANCE, GAIN, LENGTH, SPEED, Spec, known_fields

_ALLOW_BACKWARD = Spec("reverse towards a goal behind the robot; otherwise turn on the spot until the goal is in front")


@known_fields
class SwitchingConfig(NamedTuple):
    """Parameters of the law ``switching``."""

    data_sheet: DataSheet = DataSheet()
    tolerance: GoalTolerance = GoalTolerance()
    allow_backward: Annotated[bool, _ALLOW_BACKWARD] = True
    symmetric_yaw_tolerance: Annotated[bool, Spec("the robot may also arrive with the opposite heading")] = False
    sigma_known: Annotated[
        float,
        Spec(
            "standard deviation of the position above which the robot approaches more slowly; at least 0.3 of "
            "xy_goal_tolerance. The reaction time of the speed increases with the square of the deviation",
            "m",
            1e-4,
            10.0,
        ),
    ] = 0.03


@known_fields
class DockingConfig(NamedTuple):
    """Parameters of docking; ``drive`` is the configuration of the law that drives to the staging pose.

    ``allow_backward`` applies to this drive alone: the robot always leaves the dock along the axis, without turning.
    """

    dock_backward: Annotated[bool, Spec("true: the robot docks with its back")] = False
    staging_distance: Annotated[float, Spec("distance of the staging pose from the docked pose", "m", *LENGTH)] = 0.7
    commit_distance: Annotated[
        float,
        Spec(
            "distance from the docked pose that the robot passes only if it will dock within the tolerances",
            "m",
            0.0,
            10.0,
        ),
    ] = 0.33
    dock_speed: Annotated[float, Spec("speed along the axis", "m/s", *SPEED)] = 0.12
    contact_speed: Annotated[float, Spec("speed at contact", "m/s", *SPEED)] = 0.08
    press_distance: Annotated[
        float,
        Spec("largest distance that the robot drives beyond the docked pose to find contact", "m", 0.0, 1.0),
    ] = 0.03
    dock_xy_tolerance: Annotated[
        float, Spec("largest lateral error at contact, including 2.6 standard deviations", "m", *LENGTH)
    ] = 0.02
    dock_yaw_tolerance: Annotated[
        float, Spec("largest heading error at contact, including 2.6 standard deviations", "rad", *ANGLE)
    ] = 0.013
    dock_tries: Annotated[int, Spec("number of approaches before the robot gives up", minimum=1, maximum=100)] = 3
    drive: SwitchingConfig = SwitchingConfig()


@known_fields
class PaperGains(NamedTuple):
    """Gains of the laws (13) and (17); the defaults are the values of section 4.1 of the paper.

    With k = 2 lambda and h = (lambda / gamma)^2, the loop near the goal has a double pole at -lambda; see
    docs/explanation/law.md.
    """

    gamma: Annotated[float, Spec("gamma, bound of |v|", "m/s", *SPEED)] = 1.3
    k: Annotated[float, Spec("weight of alpha in Omega_G", "1/s", *GAIN)] = 1.0
    h: Annotated[float, Spec("weight of beta in Omega_G", "-", *GAIN)] = 0.17
    k_2: Annotated[float, Spec("heading gain in Omega_L", "1/s", *GAIN)] = 2.7


@known_fields
class PaperConfig(NamedTuple):
    """Parameters of the law ``paper``.

    The radius meets the condition eps_P > |eps_rho| + |eps_v| / gamma (paper, section 3.2) with the raw noise of the
    paper: sqrt(0.3^2 + 0.3^2) + 0.065 / 1.3 = 0.474 m. A lateral error of about 0.2 m remains, hence the tolerance.
    """

    data_sheet: DataSheet = PAPER_DATA_SHEET
    tolerance: GoalTolerance = GoalTolerance(xy_goal_tolerance=0.4)
    allow_backward: Annotated[bool, _ALLOW_BACKWARD] = True
    gains: PaperGains = PaperGains()
    eps_P: Annotated[
        float, Spec("Omega_L is entered below this distance; 0: never, law (13) everywhere", "m", *DISTANCE)
    ] = 0.5
    eps_P_leave: Annotated[float, Spec("Omega_L is left above this distance", "m", *DISTANCE)] = 0.6

    def check(self) -> None:
        """Refuse a leaving radius below the entering radius, because the region would alternate.

        Raises:
            InvalidValueError: naming both radii.
        """
        if self.eps_P_leave < self.eps_P:
            raise InvalidValueError("eps_P_leave", self.eps_P_leave, f">= eps_P = {self.eps_P:g}")
