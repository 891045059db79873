"""The actions of Nav2 that the controllers serve, with the names and types of Jazzy.

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
_DOCK_ERRORS = """\
uint16 NONE=0
uint16 DOCK_NOT_IN_DB=901
uint16 DOCK_NOT_VALID=902
uint16 FAILED_TO_STAGE=903
uint16 FAILED_TO_DETECT_DOCK=904
uint16 FAILED_TO_CONTROL=905
uint16 FAILED_TO_CHARGE=906
uint16 UNKNOWN=999
"""
_UNDOCK_ERRORS = """\
uint16 NONE=0
uint16 DOCK_NOT_VALID=902
uint16 FAILED_TO_CONTROL=905
uint16 UNKNOWN=999
"""
_DOCK_GOAL = """\
bool use_dock_id true
string dock_id
geometry_msgs/PoseStamped dock_pose
string dock_type
float32 max_staging_time 1000.0
bool navigate_to_staging_pose true
"""
# The parser takes two constants of an action that are equal, comments included, for one.
_DOCK_FEEDBACK = """\
uint16 NONE=0  # no state
uint16 NAV_TO_STAGING_POSE=1
uint16 INITIAL_PERCEPTION=2
uint16 CONTROLLING=3
uint16 WAIT_FOR_CHARGE=4
uint16 RETRY=5
uint16 state
builtin_interfaces/Duration docking_time
uint16 num_retries 0
"""
_DOCK_RESULT = "bool success true\nuint16 error_code 0\n"
ACTIONS = {
    "NavigateToPose": f"geometry_msgs/PoseStamped pose\nstring behavior_tree\n---\n{_RESULT}---\n{_FEEDBACK}",
    "NavigateThroughPoses": (
        "geometry_msgs/PoseStamped[] poses\nstring behavior_tree\n"
        f"---\n{_RESULT}---\n{_FEEDBACK}int16 number_of_poses_remaining\n"
    ),
    "DockRobot": (
        f"{_DOCK_GOAL}---\n{_DOCK_ERRORS}{_DOCK_RESULT}uint16 num_retries 0\nstring error_msg\n---\n{_DOCK_FEEDBACK}"
    ),
    "UndockRobot": (
        f"string dock_type\nfloat32 max_undocking_time 30.0\n---\n{_UNDOCK_ERRORS}{_DOCK_RESULT}string error_msg\n---\n"
    ),
}
