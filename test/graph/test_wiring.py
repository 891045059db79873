"""Faults of the wiring: commands that no base receives, inputs without a matching publisher, second publishers."""

import contextlib
import itertools
import json
import re
import threading
import time

import graph
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from robot import LATCHED, stamped_goal
from std_msgs.msg import String

from diffbot_bag.recorder_node import RecorderNode
from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_core.endpoints import TWIST, TWIST_STAMPED
from diffbot_core.geometry import Pose
from diffbot_core.ros import watches
from diffbot_core.uncertainty import CERTAIN
from diffbot_sim.plant_node import PlantNode
from diffbot_tools import cli
from diffbot_tools.check.ros.observer import Observer

IMPATIENT = {"pose_lost_timeout": 3.0}
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def nodes(nodes):
    nodes.states = nodes.peer.subscribe(DiagnosticStatus, "controller/status", LATCHED)
    nodes.ekf_states = nodes.peer.subscribe(DiagnosticStatus, "ekf/status", LATCHED)
    nodes.results = nodes.peer.subscribe(DiagnosticArray, "controller/goal_results", LATCHED)
    nodes.goals = nodes.peer.publisher(PoseStamped, "goal_pose")
    nodes.reports = nodes.peer.subscribe(DiagnosticArray, "/diagnostics", 100)
    return nodes


@contextlib.contextmanager
def base(*types, topic="cmd_vel"):
    """Run a base in a context of its own: within one context, a topic has one type."""
    with contextlib.ExitStack() as stack:
        for kind in types:
            stack.enter_context(graph.peer(name=f"base_{kind.__name__.lower()}")).subscribe(kind, topic)
        yield


def send_goal(nodes, *goal):
    nodes.peer.wait_for_subscribers(nodes.goals)
    nodes.goals.publish(stamped_goal(goal)[1])


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


def test_commands_follow_the_type_of_the_present_base(nodes, capfd):
    nodes.add(ControllerNode)
    send_goal(nodes, 1.0, 0.0, 0.0)
    wait_for_problem(nodes, "no base subscribes to /cmd_vel")
    assert nodes.peer.node.get_publishers_info_by_topic("/cmd_vel") == [], "the type is not known yet"
    with base(TwistStamped):
        wait_for_type(nodes, TWIST_STAMPED)
    assert "cmd_vel: publishing TwistStamped, the type to which the base subscribes" in capfd.readouterr().err
    with base(Twist):
        wait_for_type(nodes, TWIST)
    with base(Twist, TwistStamped):
        wait_for_problem(nodes, "set cmd_vel_type to")


def test_a_base_that_starts_after_the_goal_is_accelerated_from_rest(nodes):
    limits = {"linear.x.max_velocity": 1.0, "linear.x.max_acceleration": 4.0}
    node = nodes.add(ControllerNode, {**limits, "pose_timeout": 60.0})
    commands, stamps = node.outputs.commands, itertools.count(10**9, 50_000_000)
    send_goal(nodes, 50.0, 0.0, 0.0)
    nodes.peer.spin_until(lambda: node.supervisor.goal is not None, what="the goal")

    def drive():
        time.sleep(0.05)
        node.take_pose(next(stamps), Pose(0.0, 0.0, 0.0), CERTAIN)
        return commands.is_open

    assert not any(drive() for _ in range(10))
    with base(Twist):
        graph.wait_for(drive, what="the publisher")
        assert 0.0 <= commands.newest.v <= 0.2, "the first command that the base can receive"
        for _ in range(10):
            drive()
    assert commands.newest.v == pytest.approx(1.0)


def test_a_recorder_in_the_same_process_records_the_commands_with_the_type_of_a_base_that_starts_later(
    nodes, tmp_path, capfd
):
    nodes.add(ControllerNode)
    recorder = nodes.add(RecorderNode, {"uri": str(tmp_path / "bag")})
    nodes.peer.spin_until(lambda: recorder.health.accepted["/controller/status"], what="a recorded message")
    with base(TwistStamped):
        wait_for_type(nodes, TWIST_STAMPED)
        text = f"subscribed to /cmd_vel [{TWIST_STAMPED}]"
        nodes.peer.spin_until(lambda: "/cmd_vel" in recorder.health.accepted, what="the recorder's subscription")
    recorder.before_shutdown()
    assert text in capfd.readouterr().err


def test_the_type_is_kept_and_the_remedy_is_named_if_another_node_of_the_process_uses_it(nodes):
    recorder = rclpy.create_node("recorder", context=nodes.peer.context)
    recorder.create_subscription(Twist, "cmd_vel", lambda message: None, 1)
    nodes.add(ControllerNode)
    with base(TwistStamped):
        wait_for_problem(nodes, "the commands are Twist: set cmd_vel_type to twist_stamped")
        wait_for_type(nodes, TWIST)
    recorder.destroy_node()


def test_a_goal_without_base_and_filter_names_both_and_the_topic_that_a_base_receives(nodes):
    controller = nodes.add(ControllerNode, IMPATIENT)
    with base(TwistStamped, topic="diff_drive_controller/cmd_vel"):
        send_goal(nodes, 1.0, 0.0, 0.0)
        assert end_of_goal(nodes) == (
            "pose lost: no pose for pose_lost_timeout = 3 s; "
            "nothing publishes /pose: start its source, or remap /pose; "
            "no base subscribes to /cmd_vel: start the driver of the base, or remap cmd_vel to "
            "/diff_drive_controller/cmd_vel"
        )
    send_goal(nodes, 2.0, 0.0, 0.0)
    wait_for_problem(nodes, "no base subscribes to /cmd_vel")
    controller.trigger_deactivate()
    nodes.peer.spin_until(lambda: nodes.states[-1].message == "inactive", what="the state")
    assert "problem" not in graph.values(nodes.states[-1])


def test_a_goal_that_loses_its_pose_names_what_the_filter_reports(nodes):
    nodes.add(EkfNode)
    nodes.add(ControllerNode, IMPATIENT)
    message = Odometry(child_frame_id="base_footprint")
    message.header.frame_id = "odom"
    with graph.peer(name="driver") as driver:
        publisher = driver.publisher(Odometry, "odom")
        driver.publisher(PoseStamped, "global_pose")
        timer = nodes.peer.node.create_timer(0.05, lambda: publisher.publish(message))
        send_goal(nodes, 1.0, 0.0, 0.0)
        end = end_of_goal(nodes)
        timer.cancel()
    assert end.startswith("pose lost: no pose for pose_lost_timeout = 3 s; /ekf: ")
    for reason in (
        "drops odom: wrong child_frame_id: 'base_footprint', not 'base_link': set base_link_frame",
        "publishes /global_pose as PoseStamped: convert it to",
        "no base subscribes to /cmd_vel",
    ):
        assert reason in end


def test_a_goal_reached_with_fixes_of_another_clock_is_reached_and_names_the_clocks(nodes):
    nodes.add(EkfNode)
    nodes.add(ControllerNode)
    nodes.add(PlantNode, {"fix_delay": 0.5})
    text = re.compile(r"global_pose is stamped 0\.[45]\d s behind odom")
    nodes.peer.spin_until(
        lambda: (
            nodes.ekf_states
            and nodes.ekf_states[-1].level == DiagnosticStatus.WARN
            and nodes.ekf_states[-1].message == "running"
            and text.search(graph.values(nodes.ekf_states[-1]).get("reason", ""))
        ),
        what="the warning of the ekf",
    )
    send_goal(nodes, 0.5, 0.0, 0.0)
    assert text.match(end_of_goal(nodes).removeprefix("reached: /ekf: "))


def test_a_single_fix_that_was_dropped_is_named_as_long_as_nothing_arrives(nodes):
    nodes.add(EkfNode)
    fixes, text = nodes.peer.publisher(PoseWithCovarianceStamped, "global_pose"), "wrong frame_id: 'odom', not 'map'"
    nodes.peer.wait_for_subscribers(fixes)
    fix = PoseWithCovarianceStamped()
    fix.header.frame_id = "odom"
    fixes.publish(fix)
    text = f"nothing arrives on /global_pose, and its newest message was dropped: {text}"
    states = nodes.ekf_states
    nodes.peer.spin_until(lambda: states and text in graph.values(states[-1]).get("reason", ""), what="the reason")


def test_wrong_remappings_of_inputs_name_the_existing_topics(nodes):
    nodes.add(EkfNode, arguments=["-r", "odom:=/base/odom", "-r", "global_pose:=/robot1/global_pose"])
    with graph.peer(name="driver") as driver:
        driver.publisher(Odometry, "odom")
        driver.publisher(PoseWithCovarianceStamped, "robot2/global_pose")
        reason = (
            "nothing publishes /base/odom: run all nodes in the namespace /, or remap /base/odom to /odom; "
            "nothing publishes /robot1/global_pose: run all nodes in the namespace /robot2, or remap "
            "/robot1/global_pose to /robot2/global_pose"
        )
        states = nodes.ekf_states
        nodes.peer.spin_until(lambda: states and graph.values(states[-1]).get("reason") == reason, what="the reason")


def test_diffbot_check_names_each_fault_of_a_base_before_the_nodes_run(kept_signal_handlers, capfd):
    odometry, fix = Odometry(child_frame_id="base_footprint"), PoseWithCovarianceStamped()
    odometry.header.frame_id, fix.header.frame_id = "odom", "map"
    ended = threading.Event()
    with graph.peer(name="driver") as driver:
        driver.subscribe(TwistStamped, "cmd_vel")
        outputs = (
            (odometry, driver.publisher(Odometry, "odom", BEST_EFFORT)),
            (fix, driver.publisher(PoseWithCovarianceStamped, "global_pose")),
        )

        def publish():
            while not ended.wait(0.05):
                for message, publisher in outputs:
                    message.header.stamp = driver.node.get_clock().now().to_msg()
                    publisher.publish(message)

        thread = threading.Thread(target=publish, daemon=True)
        thread.start()
        try:
            assert cli.main(["check", "--duration", "3", "--json"]) == 1
        finally:
            ended.set()
            thread.join()
    lines = {one["name"]: one for one in json.loads(capfd.readouterr().out)}
    assert "wrong child_frame_id: 'base_footprint', not 'base_link'" in " ".join(lines["/odom"]["todo"])
    assert "set global_pose_sigma_xy" in " ".join(lines["/global_pose"]["todo"])
    assert lines["/cmd_vel"]["todo"] == []


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


@pytest.mark.parametrize(("topic", "received"), [("/r1/tf", "/r1/tf"), ("/tf", "/tf")])
def test_the_check_receives_tf_from_the_namespace_of_the_robot_or_from_all(nodes, topic, received):
    nodes.peer.publisher(String, topic)
    observer = Observer("r1", {}, [])
    try:
        graph.wait_for(lambda: observer._node.count_publishers(topic), what="the publisher")
        node = observer.transform_node()
        assert node.resolve_topic_name("/tf") == received
        assert node.resolve_topic_name("/tf_static") == f"{received}_static"
    finally:
        observer.close()


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
