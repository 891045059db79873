"""A second publisher of what one node has to own: an ERROR in /diagnostics and one line of log, with both names."""

import graph
import one_process
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_core.ros import publisher_watch
from diffbot_sim.plant_node import PlantNode


@pytest.fixture
def nodes():
    with one_process.nodes() as running:
        running.reports = running.peer.subscribe(DiagnosticArray, "/diagnostics", 100)
        yield running


def statuses(nodes, name):
    return [one for array in nodes.reports for one in array.status if one.name == name]


def wait_for(nodes, name, text, level):
    """Wait for a new report of a node with this text and level."""
    nodes.reports.clear()
    nodes.peer.spin_until(
        lambda: any(text in one.message and one.level == level for one in statuses(nodes, name)), 10.0, text
    )


def next_report(nodes, name):
    """Return the second report from now on: the first one may have been on its way."""
    nodes.reports.clear()
    nodes.peer.spin_until(lambda: len(statuses(nodes, name)) >= 2, 10.0, "two reports")
    return statuses(nodes, name)[-1]


def test_two_controllers_on_one_cmd_vel_are_both_told_once_and_until_one_leaves(nodes, capfd):
    nodes.add(ControllerNode)
    other = nodes.add(ControllerNode, arguments=("-r", "__node:=other"))
    text = "2 publishers of /cmd_vel, only one may drive the robot: /controller, /other"
    for name in ("/controller", "/other"):
        wait_for(nodes, name, text, DiagnosticStatus.ERROR)
    next_report(nodes, "/controller")
    log = capfd.readouterr().err
    assert log.count(text) == 2, "once by each"
    nodes.remove(other)
    wait_for(nodes, "/controller", "idle; ok", DiagnosticStatus.OK)
    assert capfd.readouterr().err.count("/cmd_vel: no more publishers than allowed") == 1


def test_a_second_controller_of_the_same_name_is_an_error_when_it_lasts(nodes, monkeypatch):
    """For as long as DDS counts a killed process, it may be the one before."""
    nodes.add(ControllerNode)
    nodes.add(ControllerNode)
    wait_for(nodes, "/controller", "robot: /controller, /controller (one that was killed", DiagnosticStatus.WARN)
    monkeypatch.setattr(publisher_watch, "LEASE", 0.1)
    wait_for(nodes, "/controller", "robot: /controller, /controller", DiagnosticStatus.ERROR)


@pytest.mark.parametrize(
    ("kind", "topic", "message_type", "text"),
    [
        (ControllerNode, "pose", PoseWithCovarianceStamped, "/pose, only one may estimate the pose: /first, /second"),
        (EkfNode, "pose", PoseWithCovarianceStamped, "/pose, only one may estimate the pose: /ekf, /first, /second"),
        (EkfNode, "odom", Odometry, "/odom, only one may measure the motion: /first, /second"),
        (PlantNode, "cmd_vel", Twist, "/cmd_vel, only one may drive the robot: /first, /second"),
    ],
)
def test_two_sources_of_one_input_are_named(nodes, kind, topic, message_type, text):
    node = nodes.add(kind)
    with graph.peer("first") as first, graph.peer("second") as second:
        publishers = [one.publisher(message_type, topic) for one in (first, second)]
        wait_for(nodes, node.get_fully_qualified_name(), text, DiagnosticStatus.ERROR)
        del publishers


def test_topics_are_those_after_remapping(nodes):
    """With a mux, each source publishes on a topic of its own."""
    nodes.add(ControllerNode, arguments=("-r", "cmd_vel:=cmd_vel_nav"))
    nodes.peer.publisher(Twist, "cmd_vel")
    assert next_report(nodes, "/controller").message == "idle; ok"
    nodes.peer.publisher(Twist, "cmd_vel_nav")
    text = "2 publishers of /cmd_vel_nav, only one may drive the robot: /controller, /peer"
    wait_for(nodes, "/controller", text, DiagnosticStatus.ERROR)


def test_as_many_as_the_parameter_says_may_publish(nodes):
    nodes.add(ControllerNode, {"max_cmd_vel_publishers": 2})
    nodes.peer.publisher(Twist, "cmd_vel")
    assert next_report(nodes, "/controller").message == "idle; ok"
    with graph.peer("third") as third:
        third.publisher(Twist, "cmd_vel")
        text = "3 publishers of /cmd_vel, only 2 may drive the robot: /controller, /peer, /third"
        wait_for(nodes, "/controller", text, DiagnosticStatus.ERROR)


def test_an_inactive_controller_leaves_the_topic_to_others(nodes):
    node = nodes.add(ControllerNode)
    nodes.peer.publisher(Twist, "cmd_vel")
    wait_for(nodes, "/controller", "2 publishers of /cmd_vel", DiagnosticStatus.ERROR)
    node.trigger_deactivate()
    report = next_report(nodes, "/controller")
    assert (report.level, report.message) == (DiagnosticStatus.OK, "inactive")
    node.trigger_activate()
    wait_for(nodes, "/controller", "2 publishers of /cmd_vel", DiagnosticStatus.ERROR)
