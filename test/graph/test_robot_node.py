"""Filter and controller in one process, and more nodes beside them."""

import signal
import sys
from pathlib import Path

import graph
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist
from lockstep_drive import PERIOD, START, STEPS, assert_same_path, go
from nav_msgs.msg import Odometry
from robot import distance, lockstep, planar, pose_stamped, robot, stamp, twist

from diffbot_bag.reader import BagReader

GOAL = (3.0, -1.0, 2.5)
WORLD = {"seed": 11, "fix_delay": 0.3, "fix_dropout": 0.3, "fix_outlier": 0.1, "initial_pose.yaw": -2.0}
STAMPED = {"enable_stamped_cmd_vel": True}
DIFFBOT = str(Path(sys.executable).with_name("diffbot"))


def drive(only):
    """Return the last answer to each of the first steps, the poses by stamp, and the true path."""
    with lockstep({**WORLD, **STAMPED}, controller=STAMPED, stamped=True, only=only) as running:
        path = go(running, GOAL)
        running.catch_up()
        stamps = range(START, START + STEPS * PERIOD, PERIOD)
        commands = {stamp(command): twist(command) for command in running.commands}
        poses = {stamp(pose): planar(pose.pose.pose) for pose in running.poses}
        return {when: commands.get(when) for when in stamps}, {when: poses.get(when) for when in stamps}, path


def test_commands_and_poses_are_those_of_two_nodes_to_the_bit():
    commands, poses, path = drive(("robot", "plant"))
    apart, poses_apart, path_apart = drive(("ekf", "controller", "plant"))
    known = [when for when in commands if commands[when] and apart[when]]
    # The test's node may discover the topics during the first steps.
    assert len(known) >= STEPS - 5
    assert {commands[when] for when in known} != {(0.0, 0.0)}
    assert [commands[when] for when in known] == [apart[when] for when in known]
    seen = [when for when in known if poses[when] and poses_apart[when]]
    assert len(seen) >= STEPS // 2
    assert [poses[when] for when in seen] == [poses_apart[when] for when in seen]
    assert path[STEPS] == path_apart[STEPS]
    assert_same_path(path, GOAL, WORLD)


def test_ends_with_status_0_and_the_robot_stopped():
    with robot({"seed": 4}, only=("robot", "plant")) as running:
        running.send_goal(*GOAL)
        running.peer.spin_until(lambda: running.commands and running.commands[-1].linear.x > 0.1, 10.0, "motion")
        assert running.processes["robot"].stop(signal.SIGTERM) == 0
        running.peer.spin_until(lambda: twist(running.commands[-1]) == (0.0, 0.0), 5.0, "the stop")


def test_a_pose_of_another_topic_is_subscribed_to():
    arguments = ("-r", "controller:pose:=amcl_pose")
    with graph.peer() as peer, graph.node("diffbot_control.robot_node", {}, arguments) as process:
        process.wait_for_output("[controller]: ready")
        poses = peer.publisher(PoseWithCovarianceStamped, "amcl_pose")
        peer.wait_for_subscribers(poses)
        assert "pose is not that of this process's ekf: subscribing to it" in process.output


def test_robot_plant_and_recorder_in_one_process(tmp_path):
    bag = tmp_path / "bag"
    ros = ["-p", f"recorder:uri:={bag}", "-p", "recorder:topics:=[cmd_vel, pose, ground_truth]"]
    command = [DIFFBOT, "run", "robot", "--with", "recorder", "plant", "--ros-args", *ros]
    with graph.process(*command) as process, graph.peer() as peer:
        process.wait_for_output("[recorder]: ready", 60.0)
        truths, goals = (
            peer.subscribe(Odometry, "ground_truth"),
            peer.publisher(PoseStamped, "goal_pose"),
        )
        peer.wait_for_subscribers(goals)
        peer.spin_until(lambda: truths, 10.0, "the plant")
        goals.publish(pose_stamped(1.0, 0.5, 0.0))
        start = planar(truths[-1].pose.pose)
        peer.spin_until(lambda: distance(planar(truths[-1].pose.pose), start) > 0.2, 15.0, "motion")
        assert process.stop() == 0
        assert "Traceback" not in process.output
    with BagReader(bag) as reader:
        messages = list(reader.messages())
    assert {message.topic for message in messages} == {"/cmd_vel", "/pose", "/ground_truth"}
    last = [message for message in messages if message.topic == "/cmd_vel"][-1]
    # The robot was stopped while the bag was still open: six zeros after the header of four bytes.
    assert bytes(last.data)[4:] == bytes(48)


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (("robot", "--with", "ekf"), 1, "--with = 'ekf': must be each node once, ekf is in it twice"),
        (("plant", "--with", "plant"), 1, "plant is in it twice"),
        (("robot", "--with", "wheels"), 2, "argument --with: invalid choice: 'wheels'"),
        (("robot", "--with", "plant", "--ros-args", "-p", "plant:clock:=sundial"), 1, "error: clock = 'sundial'"),
    ],
)
def test_wrong_usage_is_one_line(arguments, status, text):
    with graph.process(DIFFBOT, "run", *arguments) as process:
        assert process.wait(30.0) == status
        assert sum(text in line for line in process.output.splitlines()) == 1
        assert "Traceback" not in process.output


def test_a_bag_that_exists_is_refused_before_anything_moves(tmp_path):
    command = [DIFFBOT, "run", "robot", "--with", "recorder", "--ros-args", "-p", f"recorder:uri:={tmp_path}"]
    with graph.process(*command) as process:
        assert process.wait(30.0) == 1
        assert f"error: {tmp_path} exists already" in process.output
        assert "]: ready" not in process.output


@pytest.fixture(scope="module")
def pair():
    """Filter and controller in one process, and a plant."""
    with robot({"seed": 3}, only=("robot", "plant")) as running:
        yield running


def test_graph_is_that_of_two_nodes(pair):
    # A subset: nodes of processes that earlier tests killed stay in the middleware's graph for a while.
    expected = {"controller", "ekf", "peer", "plant"}
    pair.peer.spin_until(lambda: expected <= set(pair.peer.node.get_node_names()), 40.0, f"the nodes {expected}")
    assert not [name for name in pair.peer.node.get_node_names() if "robot" in name]
    filtered = pair.peer.subscribe(Odometry, "odometry/filtered")
    pair.peer.spin_until(lambda: filtered and pair.poses, 10.0, "pose and odometry/filtered")
    pair.send_goal(*GOAL)
    pair.wait_for_state("driving")
    diagnosis = pair.diagnosis("controller")
    assert int(diagnosis["pose received"]) > 0
    assert int(diagnosis["cmd_vel sent"]) > 0
    assert int(pair.diagnosis("ekf")["odom received"]) > 0
    assert pair.cancel().success
    pair.wait_for_state("idle")


def test_pose_is_published_after_the_command_that_answers_it(pair):
    """Both are sent by one thread, so the times at which the middleware took them are in the order of sending."""
    times = {"cmd_vel": [], "pose": []}
    for name, kind in (("cmd_vel", Twist), ("pose", PoseWithCovarianceStamped)):
        pair.peer.node.create_subscription(
            kind, name, lambda _message, info, name=name: times[name].append(info["source_timestamp"]), 10
        )
    pair.send_goal(*GOAL)
    pair.wait_for_state("driving")
    pair.peer.spin_until(lambda: min(map(len, times.values())) > 10, 10.0, "ten steps")
    pose = times["pose"][-10]
    # The answer came shortly before; the one before it a period of 0.1 s earlier.
    before = [pose - sent for sent in times["cmd_vel"] if sent < pose]
    assert min(before) < 50e6
    pair.cancel()
