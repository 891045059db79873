"""A second publisher of a topic that only one node may publish: an ERROR in /diagnostics and a log line name both."""

import graph
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_core.ros import watches
from diffbot_sim.plant_node import PlantNode


@pytest.fixture
def nodes(nodes):
    nodes.reports = nodes.peer.subscribe(DiagnosticArray, "/diagnostics", 100)
    return nodes


def statuses(nodes, name):
    return [one for array in nodes.reports for one in array.status if one.name == name]


def wait_for(nodes, name, text, level):
    """Wait for a new report of a node with this text and level."""
    nodes.reports.clear()
    nodes.peer.spin_until(
        lambda: any(text in one.message and one.level == level for one in statuses(nodes, name)), what=text
    )


def next_report(nodes, name):
    """Return the second report from now on: the first may have been sent before."""
    nodes.reports.clear()
    nodes.peer.spin_until(lambda: len(statuses(nodes, name)) >= 2, what="two reports")
    return statuses(nodes, name)[-1]


def test_two_controllers_on_one_cmd_vel_are_logged_once_by_each_and_reported_until_one_ends(nodes, capfd):
    # The topic is remapped, as for a mux. Publishers of cmd_vel itself do not count.
    nodes.peer.publisher(Twist, "cmd_vel")
    nodes.peer.subscribe(Twist, "cmd_vel_nav")
    mux = ("-r", "cmd_vel:=cmd_vel_nav")
    nodes.add(ControllerNode, arguments=mux)
    other = nodes.add(ControllerNode, {}, ("-r", "__node:=other", *mux))
    text = "2 publishers of /cmd_vel_nav, only one may drive the robot: /controller, /other"
    for name in ("/controller", "/other"):
        wait_for(nodes, name, text, DiagnosticStatus.ERROR)
    next_report(nodes, "/controller")
    assert capfd.readouterr().err.count(text) == 2, "once by each"
    # An inactive controller does not report the other.
    other.trigger_deactivate()
    report = next_report(nodes, "/other")
    assert (report.level, report.message) == (DiagnosticStatus.OK, "inactive")
    nodes.remove(other)
    wait_for(nodes, "/controller", "idle; ok", DiagnosticStatus.OK)
    assert (
        capfd.readouterr().err.count("[controller]: /cmd_vel_nav: the number of publishers is within the limit again")
        == 1
    )


def test_a_second_controller_of_the_same_name_is_an_error_after_the_lease(nodes, monkeypatch):
    """Within the lease, DDS still counts the publishers of a killed process."""
    nodes.peer.subscribe(Twist, "cmd_vel")
    nodes.add(ControllerNode)
    nodes.add(ControllerNode)
    wait_for(nodes, "/controller", "robot: /controller, /controller (the publisher of a killed", DiagnosticStatus.WARN)
    monkeypatch.setattr(watches, "LEASE", 0.1)
    wait_for(nodes, "/controller", "robot: /controller, /controller", DiagnosticStatus.ERROR)


def test_two_sources_of_each_input_are_named(nodes):
    inputs = {
        "pose": (PoseWithCovarianceStamped, (ControllerNode, EkfNode), "estimate the pose: /ekf, /first, /second"),
        "odom": (Odometry, (EkfNode,), "measure the motion: /first, /plant, /second"),
        "cmd_vel": (Twist, (PlantNode, ControllerNode), "drive the robot: /controller, /first, /second"),
    }
    names = {kind: nodes.add(kind).get_fully_qualified_name() for kind in (ControllerNode, EkfNode, PlantNode)}
    with graph.peer("first") as first, graph.peer("second") as second:
        publishers = [one.publisher(kind, topic) for topic, (kind, *_) in inputs.items() for one in (first, second)]
        for topic, (_, kinds, text) in inputs.items():
            for kind in kinds:
                wait_for(nodes, names[kind], f"/{topic}, only one may {text}", DiagnosticStatus.ERROR)
        del publishers
