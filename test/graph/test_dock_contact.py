"""Contact with the dock from a switch that reports only changes, and from a battery."""

import one_process
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from robot import DEEP, pose_stamped, twist
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool

from diffbot_control.controller_node import ControllerNode
from diffbot_control.law import CONTACT, CONTACT_UNKNOWN, NO_CONTACT
from diffbot_control.law.docking import DOCKED
from diffbot_control.ros.messages.fields import set_stamp

CHARGING, DISCHARGING, NOT_CHARGING, FULL, UNKNOWN = (
    getattr(BatteryState, f"POWER_SUPPLY_STATUS_{name}")
    for name in ("CHARGING", "DISCHARGING", "NOT_CHARGING", "FULL", "UNKNOWN")
)
CLOSED, OPEN = True, False


@pytest.fixture
def docking(nodes):
    parameters = {"law": "docking", "map_frame": "dock", "reliable_inputs": True, "pose_timeout": 60.0}
    return one_process.Fed(nodes, ControllerNode, parameters)


def report(docking, source):
    if isinstance(source, bool):
        docking.send("dock_contact", Bool(data=source))
    else:
        docking.send("battery_state", BatteryState(power_supply_status=source))


def test_contact_is_a_closed_switch_or_a_charger_and_unknown_without_a_switch(docking):
    for source, contact in (
        (UNKNOWN, CONTACT_UNKNOWN),
        (CHARGING, CONTACT),
        (UNKNOWN, CONTACT),  # the battery keeps its last known state
        (DISCHARGING, CONTACT_UNKNOWN),
        (FULL, CONTACT),
        (NOT_CHARGING, CONTACT_UNKNOWN),
        (CLOSED, CONTACT),
        (OPEN, NO_CONTACT),
        (CHARGING, CONTACT),
        (CLOSED, CONTACT),
        (DISCHARGING, CONTACT),
        (OPEN, NO_CONTACT),
    ):
        report(docking, source)
        assert docking.node.supervisor.contact == contact, source


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
        assert docking.node.supervisor.memory.stage.phase == DOCKED
        assert docking.node.supervisor.goals_reached == 1
    docking.peer.spin_until(lambda: commands, what="commands")
    assert {twist(one) for one in commands} == {(0.0, 0.0)}
