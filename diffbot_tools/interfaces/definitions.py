"""The two actions of Nav2 that the controller serves, with the names and types of Jazzy.

Peers understand each other only if every field agrees: a field more or less is another type.
"""

from __future__ import annotations

PACKAGE = "nav2_msgs"
_RESULT = """\
uint16 NONE=0
uint16 error_code
string error_msg
"""
_FEEDBACK = """\
geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
builtin_interfaces/Duration estimated_time_remaining
int16 number_of_recoveries
float32 distance_remaining
"""
ACTIONS = {
    "NavigateToPose": f"geometry_msgs/PoseStamped pose\nstring behavior_tree\n---\n{_RESULT}---\n{_FEEDBACK}",
    "NavigateThroughPoses": (
        "geometry_msgs/PoseStamped[] poses\nstring behavior_tree\n"
        f"---\n{_RESULT}---\n{_FEEDBACK}int16 number_of_poses_remaining\n"
    ),
}
