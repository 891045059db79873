"""What becomes of a goal, with any law: accepted, driven to, answered once, held. Free of ROS; times in seconds.

A :class:`Supervisor` takes goals, poses and the passing of time, and returns commands::

    from diffbot_control.goals import Supervisor, SupervisorConfig

    supervisor = Supervisor(SupervisorConfig())
    supervisor.on_goal(goal)
    command = supervisor.on_pose(stamp, now, pose, uncertainty)

Which event leads where stands in one table, :mod:`diffbot_control.goals.states`.
"""

from diffbot_control.goals.configuration import SupervisorConfig
from diffbot_control.goals.driver import LawError
from diffbot_control.goals.goal_record import ENDS, GoalBook, GoalRecord, GoalRequest
from diffbot_control.goals.protocol import Law, data_sheet_of, tolerance_of
from diffbot_control.goals.states import STATUS_TEXTS, TABLE, Event, State
from diffbot_control.goals.supervisor import Supervisor

__all__ = [
    "ENDS",
    "STATUS_TEXTS",
    "TABLE",
    "Event",
    "GoalBook",
    "GoalRecord",
    "GoalRequest",
    "Law",
    "LawError",
    "State",
    "Supervisor",
    "SupervisorConfig",
    "data_sheet_of",
    "tolerance_of",
]
