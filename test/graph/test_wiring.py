"""Faults of the wiring around the controller: commands that no base receives, poses that do not come."""

import contextlib
import json

import graph
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry, Path
from rclpy.qos import QoSProfile, ReliabilityPolicy
from robot import LATCHED, stamped_goal

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_core.endpoints import TWIST, TWIST_STAMPED

IMPATIENT = {"pose_lost_timeout": 3.0}
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def nodes(nodes):
    nodes.states = nodes.peer.subscribe(DiagnosticStatus, "controller/status", LATCHED)
    nodes.ekf_states = nodes.peer.subscribe(DiagnosticStatus, "ekf/status", LATCHED)
    nodes.results = nodes.peer.subscribe(DiagnosticArray, "controller/goal_results", LATCHED)
    nodes.goals = nodes.peer.publisher(PoseStamped, "goal_pose")
    nodes.paths = nodes.peer.publisher(Path, "path")
    return nodes


@contextlib.contextmanager
def base(*types, topic="cmd_vel"):
    """Have a base in another process's place: in one process, a topic has one type."""
    with contextlib.ExitStack() as stack:
        for kind in types:
            stack.enter_context(graph.peer(name=f"base_{kind.__name__.lower()}")).subscribe(kind, topic)
        yield


def send_goal(nodes, *poses):
    publisher = nodes.goals if len(poses) == 1 else nodes.paths
    nodes.peer.wait_for_subscribers(publisher)
    publisher.publish(stamped_goal(*poses)[1])


def wait_for_problem(nodes, text):
    nodes.peer.spin_until(
        lambda: nodes.states and text in graph.values(nodes.states[-1]).get("problem", ""), what=f"the problem {text!r}"
    )


def end_of_goal(nodes):
    nodes.peer.spin_until(lambda: nodes.results and nodes.results[-1].status, what="the end of the goal")
    status = nodes.results[-1].status[-1]
    return f"{status.message}: {graph.values(status)['reason']}"


def wait_for_type(nodes, kind):
    found = nodes.peer.node.get_publishers_info_by_topic
    nodes.peer.spin_until(lambda: [one.topic_type for one in found("/cmd_vel")] == [kind], what=kind)


def test_commands_follow_the_type_of_the_base_and_of_the_one_that_follows_it(nodes, capfd):
    nodes.add(ControllerNode)
    wait_for_type(nodes, TWIST)
    with base(TwistStamped):
        wait_for_type(nodes, TWIST_STAMPED)
    assert "cmd_vel: publishing TwistStamped, the type to which the base subscribes" in capfd.readouterr().err
    with base(Twist):
        wait_for_type(nodes, TWIST)
    with base(Twist, TwistStamped):
        wait_for_problem(nodes, "set cmd_vel_type to")


def test_a_node_of_the_same_process_that_holds_the_type_is_named_by_the_remedy(nodes):
    recorder = rclpy.create_node("recorder", context=nodes.peer.context)
    recorder.create_subscription(Twist, "cmd_vel", lambda message: None, 1)
    nodes.add(ControllerNode)
    with base(TwistStamped):
        wait_for_problem(nodes, "the commands are Twist: set cmd_vel_type to twist_stamped")
        wait_for_type(nodes, TWIST)
    recorder.destroy_node()


def test_a_fixed_type_that_the_base_does_not_take_is_named_in_status_and_log(nodes, capfd):
    nodes.add(ControllerNode, {"cmd_vel_type": "twist"})
    text = "/base_twiststamped subscribes to /cmd_vel as TwistStamped, but the commands are Twist: set cmd_vel_type to"
    with base(TwistStamped):
        wait_for_problem(nodes, text)
    assert capfd.readouterr().err.count(text) == 1


def test_a_goal_without_base_and_filter_ends_with_both_and_names_another_topic_of_commands(nodes):
    nodes.add(ControllerNode, IMPATIENT)
    with base(TwistStamped, topic="diff_drive_controller/cmd_vel"):
        send_goal(nodes, (1.0, 0.0, 0.0))
        assert end_of_goal(nodes) == (
            "pose lost: no pose for pose_lost_timeout = 3 s; "
            "nothing publishes /pose: start its source, or remap /pose; "
            "no base subscribes to /cmd_vel: start the driver of the base, or remap cmd_vel to "
            "/diff_drive_controller/cmd_vel"
        )


@pytest.mark.parametrize(
    ("kind", "topic", "fields", "parameters", "reason"),
    [
        (
            Odometry,
            "odom",
            {"child_frame_id": "base_footprint"},
            {},
            "drops odom: wrong child_frame_id: 'base_footprint', not 'base_link': set base_link_frame",
        ),
        (
            PoseWithCovarianceStamped,
            "global_pose",
            {"child_frame_id": "world"},
            {},
            "drops global_pose: wrong frame_id: 'world', not 'map'",
        ),
        (PoseStamped, "global_pose", {}, {}, "publishes /global_pose as PoseStamped: convert it to"),
        (
            Odometry,
            "odom",
            {"child_frame_id": "base_link"},
            {"reliable_inputs": True},
            "does not publish /odom as reliable, which /ekf requests",
        ),
    ],
    ids=["child frame", "frame of fixes", "type of fixes", "reliability"],
)
def test_a_goal_that_loses_its_pose_names_what_the_filter_reports(nodes, kind, topic, fields, parameters, reason):
    nodes.add(EkfNode, parameters)
    nodes.add(ControllerNode, IMPATIENT)
    message = kind()
    message.header.frame_id = "odom" if kind is Odometry else fields.get("child_frame_id", "map")
    if kind is Odometry:
        message.child_frame_id = fields["child_frame_id"]
    with graph.peer(name="driver") as driver:
        publisher = driver.publisher(kind, topic, BEST_EFFORT)
        nodes.peer.node.create_timer(0.05, lambda: publisher.publish(message))
        send_goal(nodes, (1.0, 0.0, 0.0))
        end = end_of_goal(nodes)
    assert end.startswith("pose lost: no pose for pose_lost_timeout = 3 s; /ekf: ")
    assert reason in end
    assert "no base subscribes to /cmd_vel" in end


def test_the_filter_names_topics_that_nobody_publishes(nodes):
    nodes.add(EkfNode)
    nodes.peer.spin_until(lambda: nodes.ekf_states, what="the status")
    nodes.peer.spin_until(
        lambda: (
            graph.values(nodes.ekf_states[-1]).get("reason")
            == "nothing publishes /odom: start its source, or remap /odom; "
            "nothing publishes /global_pose: start its source, or remap /global_pose"
        ),
        what="the reason",
    )


def test_inputs_and_commands_that_are_remapped_wrong_name_the_topics_that_exist(nodes):
    nodes.add(EkfNode, arguments=["-r", "odom:=/base/odom", "-r", "global_pose:=/robot1/global_pose"])
    nodes.add(ControllerNode, arguments=["-r", "cmd_vel:=/cmd_vel_nav"])
    with base(TwistStamped), graph.peer(name="driver") as driver:
        driver.publisher(Odometry, "odom")
        driver.publisher(PoseWithCovarianceStamped, "robot2/global_pose")
        nodes.peer.spin_until(
            lambda: (
                graph.values(nodes.ekf_states[-1]).get("reason")
                == "nothing publishes /base/odom: run all nodes in the namespace /, or remap /base/odom to /odom; "
                "nothing publishes /robot1/global_pose: run all nodes in the namespace /robot2, or remap "
                "/robot1/global_pose to /robot2/global_pose"
                if nodes.ekf_states
                else ""
            ),
            what="the reason",
        )
        send_goal(nodes, (1.0, 0.0, 0.0))
        wait_for_problem(
            nodes, "no base subscribes to /cmd_vel_nav: start the driver of the base, or remap cmd_vel to /cmd_vel"
        )


def test_the_check_of_a_robot_without_nodes_names_each_fault_of_its_base(nodes):
    odometry = Odometry(child_frame_id="base_footprint")
    odometry.header.frame_id = "odom"
    fix = PoseWithCovarianceStamped()
    fix.header.frame_id = "map"
    with graph.peer(name="driver") as driver:
        publishers = (
            driver.publisher(Odometry, "odom", BEST_EFFORT),
            driver.publisher(PoseWithCovarianceStamped, "global_pose"),
        )

        def publish():
            for message, publisher in zip((odometry, fix), publishers, strict=True):
                message.header.stamp = nodes.peer.node.get_clock().now().to_msg()
                publisher.publish(message)

        nodes.peer.node.create_timer(0.05, publish)
        driver.subscribe(TwistStamped, "cmd_vel")
        with graph.diffbot("check", "--duration", "3", "--json") as check:
            nodes.peer.spin_until(lambda: check.popen.poll() is not None, what="the end of the check")
            assert check.popen.returncode == 1
            lines = {one["name"]: one for one in json.loads(check.output)}
    assert "wrong child_frame_id: 'base_footprint', not 'base_link'" in " ".join(lines["/odom"]["todo"])
    assert "set global_pose_sigma_xy" in " ".join(lines["/global_pose"]["todo"])
    assert lines["/cmd_vel"]["todo"] == []


def test_a_path_without_headings_gets_those_of_its_direction_with_a_line_in_the_log(nodes, capfd):
    controller = nodes.add(ControllerNode)
    send_goal(nodes, *((0.0, 0.1 * i, 0.0) for i in range(10)))
    nodes.peer.spin_until(lambda: controller.supervisor.goals_ahead, what="the path")
    headings = [round(one.theta, 3) for one in controller.supervisor.goals_ahead]
    assert headings == [1.571] * 9 + [0.0]
    log = capfd.readouterr().err
    assert "path of 10 goals: its orientations are equal and contradict its direction" in log
