"""Filter and controller in one process, with more nodes beside them, and with the file of ``diffbot robot new``."""

import re
from functools import partial

import graph
from action_msgs.msg import GoalStatus, GoalStatusArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TwistStamped
from inside import inside
from lockstep_drive import assert_same_path, go
from nav_msgs.msg import Odometry, Path
from rclpy.qos import QoSProfile
from robot import LATCHED, distance, planar, pose_stamped, stamp, turned, twist

from diffbot_bag.bag import BagReader
from diffbot_control import docking_node
from diffbot_control.ekf_node import EkfNode
from diffbot_control.goals import GoalRequest
from diffbot_control.goals.record import CANCELLED
from diffbot_control.robot_node import RobotControllerNode
from diffbot_core.geometry import Pose
from diffbot_tools import cli
from diffbot_tools.robot_description import RobotDescription, file_of_robot

GOAL = (3.0, -1.0, 2.5)
WORLD = {"seed": 11, "fix_delay": 0.3, "fix_dropout": 0.3, "fix_outlier": 0.1, "initial_pose.yaw": -2.0}
WARNING = re.compile(r"\[(WARN|ERROR|FATAL)\] \[[\d.]+\] \[(controller|ekf|plant)[].]")
HARMLESS = "/clock", "no fix yet", "no odometry yet", "waiting for first fix: nothing arrives on"


def test_robot_plant_and_recorder_in_one_process(tmp_path):
    bag = tmp_path / "bag"
    ros = ["-p", f"recorder:uri:={bag}", "-p", "recorder:topics:=[cmd_vel, pose, ground_truth]"]
    with (
        graph.diffbot("run", "robot", "--with", "recorder", "plant", "--ros-args", *ros) as process,
        graph.peer() as peer,
    ):
        process.wait_for_output("[recorder]: ready")
        truths, goals = peer.subscribe(Odometry, "ground_truth"), peer.publisher(PoseStamped, "goal_pose")
        peer.wait_for_subscribers(goals)
        peer.spin_until(lambda: truths, what="the plant")
        start = planar(truths[-1].pose.pose)

        def moves():
            goals.publish(pose_stamped(1.0, 0.5, 0.0))
            peer.spin_for(0.1)
            return distance(planar(truths[-1].pose.pose), start) > 0.2

        peer.spin_until(moves, what="motion")
        assert process.stop() == 0
        assert "Traceback" not in process.output
    with BagReader(bag) as reader:
        messages = list(reader.messages())
    assert {message.topic for message in messages} == {"/cmd_vel", "/pose", "/ground_truth"}
    last = [message for message in messages if message.topic == "/cmd_vel"][-1]
    # The robot was stopped while the bag was still open: six zeros after the header of four bytes.
    assert bytes(last.data)[4:] == bytes(48)


def test_a_node_twice_is_refused_in_one_line(kept_signal_handlers, capsys):
    assert cli.main(["run", "robot", "--with", "ekf"]) == 1
    assert "--with = 'ekf': each node may appear only once; ekf appears twice" in capsys.readouterr().err


def test_a_bag_that_exists_is_refused_before_anything_moves(kept_signal_handlers, capfd):
    assert cli.main(["run", "controller", "--with", "plant", "recorder", "--ros-args", "-p", "recorder:uri:=/"]) == 1
    output = "".join(capfd.readouterr())
    assert sum("error: /recorder: / already exists" in line for line in output.splitlines()) == 1
    assert "Traceback" not in output
    assert "]: ready" not in output


def test_filter_and_controller_in_one_process_drive_as_two_nodes_and_send_the_command_before_the_pose():
    """One thread sends both, so that the times of the middleware show the order."""
    with inside(WORLD) as pair, graph.peer("times") as observer:
        commanded, posed = {}, {}
        for name, kind, times in (("cmd_vel", TwistStamped, commanded), ("pose", PoseWithCovarianceStamped, posed)):

            def note(message, info, times=times):
                times[stamp(message)] = info["source_timestamp"]

            observer.node.create_subscription(kind, name, note, 1000)
            observer.wait_for_publishers(name)
        assert_same_path(go(pair, GOAL), GOAL, WORLD)
        diagnosis = pair.diagnosis("controller")
        assert int(diagnosis["pose received"]) > 0
        assert int(diagnosis["cmd_vel sent"]) > 0
        observer.spin_until(lambda: len(commanded.keys() & posed) > 10, what="commands and poses")
        assert all(commanded[when] < posed[when] for when in commanded.keys() & posed)


def test_a_pose_that_is_remapped_is_received_by_a_subscription(nodes):
    ekf = nodes.add(EkfNode)
    for topic, is_handed_over in (("pose", True), ("amcl_pose", False)):
        arguments = ("-r", f"pose:={topic}", "-r", f"__node:={topic}_controller")
        ekf.pose_receiver = None
        nodes.add(partial(RobotControllerNode, ekf), arguments=arguments)
        assert (ekf.pose_receiver is not None) == is_handed_over
        assert bool(nodes.peer.node.get_subscriptions_info_by_topic(f"/{topic}")) != is_handed_over


def test_a_goal_in_map_cancels_a_docking_only_if_it_is_newer(nodes, monkeypatch):
    monkeypatch.setattr(docking_node, "_RELEASE_TIME", 0.0)
    ekf = nodes.add(docking_node.DockEkfNode, arguments=docking_node.remappings(docking_node.EKF))
    arguments = docking_node.remappings(docking_node.CONTROLLER)
    dock = nodes.add(partial(docking_node.DockControllerNode, ekf), {"pose_lost_timeout": 100.0}, arguments)
    statuses = nodes.peer.publisher(GoalStatusArray, "controller/goal_status", LATCHED)
    dock.supervisor.on_goal(Pose(0.0, 0.0, 0.0), GoalRequest("1" * 32, "goal_pose", 0.0))
    dock._check_goals()
    # An older goal, received after the begin of the docking.
    goal = GoalStatus(status=GoalStatus.STATUS_SUCCEEDED)
    goal.goal_info.goal_id.uuid[0] = 1
    statuses.publish(GoalStatusArray(status_list=[goal]))
    nodes.peer.spin_until(lambda: dock._in_map is not None, what="the older goal")
    dock._check_goals()
    assert not dock.supervisor.goals.present.is_cancelling
    goal.goal_info.goal_id.uuid[0] = 2
    statuses.publish(GoalStatusArray(status_list=[goal]))
    nodes.peer.spin_until(lambda: dock.supervisor.goals.ended, what="the end of the docking")
    assert dock.supervisor.goals.ended[0].end == CANCELLED


def test_a_docking_begins_before_its_filter_is_configured(nodes):
    ekf = nodes.add(docking_node.DockEkfNode, {"autostart": False}, docking_node.remappings(docking_node.EKF))
    arguments = docking_node.remappings(docking_node.CONTROLLER)
    dock = nodes.add(partial(docking_node.DockControllerNode, ekf), arguments=arguments)
    dock.supervisor.on_goal(Pose(0.0, 0.0, 0.0))
    dock._check_goals()
    assert dock.supervisor.goals.present is not None


def test_the_written_file_drives_along_a_path_within_its_limits(tmp_path, capfd):
    (tmp_path / "my_robot.yaml").write_text(file_of_robot(RobotDescription(use_gyro=True), "my_robot.yaml"))
    goal = (0.6, 0.2, 0.5)
    with inside({}, arguments=("--params-file", str(tmp_path / "my_robot.yaml"))) as robot:
        paths = robot.peer.publisher(Path, "path", QoSProfile(depth=10))
        robot.peer.wait_for_subscribers(paths)
        path = Path(poses=[pose_stamped(0.3, 0.0, 0.2), pose_stamped(*goal)])
        path.header.frame_id = "map"
        paths.publish(path)
        robot.peer.spin_until(lambda: "1/2" in waypoints(robot), what="the path in the status")
        robot.run(lambda: robot.state() == "goal reached", "the arrival")
        assert distance(robot.true_pose(), goal) < 0.1
        assert turned(robot.true_pose(), goal) < 0.1
        v, omega = zip(*map(twist, robot.commands), strict=True)
    assert graph.values(robot.controller_states[-1])["goals reached"] == "1", "passed waypoints do not count"
    assert 0.1 < max(map(abs, v)) <= 0.2
    assert max(map(abs, omega)) <= 2.0
    # rcl also warns if a node of an earlier test with the same name is not yet garbage-collected.
    warnings = [line for line in "".join(capfd.readouterr()).splitlines() if WARNING.match(line)]
    assert not [line for line in warnings if not any(text in line for text in HARMLESS)]


def waypoints(robot):
    return [graph.values(one).get("waypoint") for one in robot.controller_states]
