"""Contact with the dock as the controller receives it: a switch that reports changes only, and a battery."""

import one_process
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from robot import DEEP, pose_stamped, twist
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool

from diffbot_control.controller_node import ControllerNode
from diffbot_control.law.docking import DOCKED
from diffbot_control.ros.messages.fields import set_stamp

CHARGING, DISCHARGING, NOT_CHARGING, FULL, UNKNOWN = (
    getattr(BatteryState, f"POWER_SUPPLY_STATUS_{name}")
    for name in ("CHARGING", "DISCHARGING", "NOT_CHARGING", "FULL", "UNKNOWN")
)
CLOSED, OPEN = True, False


@pytest.fixture
def docking(nodes):
    """Return a controller that docks, and receives the messages of the test."""
    parameters = {"law": "docking", "map_frame": "dock", "reliable_inputs": True, "pose_timeout": 60.0}
    return one_process.Fed(nodes, ControllerNode, parameters)


def report(docking, source):
    """Send the state of the switch, or that of the battery."""
    if isinstance(source, bool):
        docking.send("dock_contact", Bool(data=source))
    else:
        docking.send("battery_state", BatteryState(power_supply_status=source))


@pytest.mark.parametrize(
    ("sources", "touches"),
    [
        ((CHARGING,), True),
        ((FULL,), True),
        ((CHARGING, DISCHARGING), False),
        ((FULL, NOT_CHARGING), False),
        ((CHARGING, UNKNOWN), True),
        ((UNKNOWN,), False),
        *(((CLOSED, state), True) for state in (CHARGING, FULL, DISCHARGING, NOT_CHARGING, UNKNOWN)),
        ((DISCHARGING, CLOSED), True),
        ((FULL, CLOSED, OPEN), True),
        ((CLOSED, DISCHARGING, OPEN), False),
    ],
)
def test_the_law_is_told_of_contact_by_either_source(docking, sources, touches):
    for source in sources:
        report(docking, source)
    assert docking.node.supervisor.memory.contact is touches


def test_a_docked_robot_stays_docked_whatever_its_battery_reports_and_after_a_new_activation(docking):
    commands = docking.peer.subscribe(Twist, "cmd_vel", DEEP)
    report(docking, CLOSED)
    for number, state in enumerate((FULL, DISCHARGING, NOT_CHARGING, UNKNOWN), start=1):
        report(docking, state)
        docking.node.trigger_deactivate()
        docking.node.trigger_activate()
        docking.send("goal_pose", pose_stamped(0.0, 0.0, 0.0, frame="dock"))
        pose = PoseWithCovarianceStamped()
        pose.header.frame_id = "dock"
        pose.pose.pose.orientation.w = 1.0
        set_stamp(pose.header.stamp, number * 10**9)
        docking.send("pose", pose)
        assert docking.node.supervisor.memory.phase == DOCKED
        assert docking.node.supervisor.goals_reached == 1
    docking.peer.spin_until(lambda: commands, what="commands")
    assert {twist(one) for one in commands} == {(0.0, 0.0)}
