"""Goals with any law: accept a goal, drive to it, report its end once, and hold it. Free of ROS; times in seconds.

A :class:`Supervisor` turns goals, poses and the passing of time into commands::

    from diffbot_control.goals import Supervisor, SupervisorConfig

    supervisor = Supervisor(SupervisorConfig())
    supervisor.on_goal(goal)
    command = supervisor.on_pose(stamp, now, pose, uncertainty)

The table in :mod:`diffbot_control.goals.states` defines the effects of all events.
"""

from diffbot_control.goals.record import ENDS, GoalRequest, goal_id
from diffbot_control.goals.states import STATUS_TEXTS, TABLE, GoalEvent, State
from diffbot_control.goals.supervisor import Supervisor, SupervisorConfig

__all__ = [
    "ENDS",
    "STATUS_TEXTS",
    "TABLE",
    "GoalEvent",
    "GoalRequest",
    "State",
    "Supervisor",
    "SupervisorConfig",
    "goal_id",
]
