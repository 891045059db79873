"""Filter and controller in one process, and more nodes beside them."""

import signal

import graph
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TwistStamped
from lockstep_drive import PERIOD, START, STEPS, assert_same_path, go
from nav_msgs.msg import Odometry
from robot import distance, lockstep, planar, pose_stamped, robot, stamp, twist

from diffbot_bag.bag.reader import BagReader

GOAL = (3.0, -1.0, 2.5)
WORLD = {"seed": 11, "fix_delay": 0.3, "fix_dropout": 0.3, "fix_outlier": 0.1, "initial_pose.yaw": -2.0}
STAMPED = {"enable_stamped_cmd_vel": True}


def drive(only):
    """Return the answers to the first steps and the poses, by stamp, and the true path."""
    with lockstep({**WORLD, **STAMPED}, controller=STAMPED, stamped=True, only=only) as running:
        path = go(running, GOAL)
        running.catch_up()
        stamps = range(START, START + STEPS * PERIOD, PERIOD)
        commands = {stamp(command): twist(command) for command in running.commands}
        poses = {stamp(pose): planar(pose.pose.pose) for pose in running.poses}
        assert running.commands[0].header.frame_id == "base_link"
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


def test_a_pose_of_another_topic_is_subscribed_to():
    arguments = ("-r", "controller:pose:=amcl_pose")
    with graph.peer() as peer, graph.node(graph.MODULES["robot"], {}, arguments) as process:
        process.wait_for_output("[controller]: ready")
        poses = peer.publisher(PoseWithCovarianceStamped, "amcl_pose")
        peer.wait_for_subscribers(poses)
        assert "pose is not that of this process's ekf: subscribing to it" in process.output


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


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (("robot", "--with", "ekf"), 1, "--with = 'ekf': must be each node once, ekf is in it twice"),
        (("robot", "--with", "wheels"), 2, "argument --with: invalid choice: 'wheels'"),
        (("robot", "--with", "plant", "--ros-args", "-p", "plant:clock:=sundial"), 1, "error: clock = 'sundial'"),
        # A bag that exists, before anything moves.
        (("robot", "--with", "recorder", "--ros-args", "-p", "recorder:uri:=/"), 1, "error: / exists already"),
    ],
)
def test_wrong_usage_is_one_line(arguments, status, text):
    with graph.diffbot("run", *arguments) as process:
        assert process.wait() == status
        assert sum(text in line for line in process.output.splitlines()) == 1
        assert "Traceback" not in process.output
        assert "]: ready" not in process.output


def test_nodes_and_services_are_those_of_two_and_a_pose_follows_the_command_that_answers_it():
    """Both are sent by one thread: the times of the middleware are in the order of sending."""
    with robot({"seed": 3, **STAMPED}, controller=STAMPED, only=("robot", "plant"), stamped=True) as pair:
        node = pair.peer.node
        pair.peer.spin_until(lambda: {"controller", "ekf", "plant"} <= set(node.get_node_names()), what="the nodes")
        assert not [name for name in node.get_node_names() if "robot" in name]
        commanded, posed = {}, {}
        for name, kind, times in (("cmd_vel", TwistStamped, commanded), ("pose", PoseWithCovarianceStamped, posed)):

            def note(message, info, times=times):
                times[stamp(message)] = info["source_timestamp"]

            node.create_subscription(kind, name, note, 100)
        pair.send_goal(*GOAL)
        pair.wait_for_state("driving")
        diagnosis = pair.diagnosis("controller")
        assert int(diagnosis["pose received"]) > 0
        assert int(diagnosis["cmd_vel sent"]) > 0
        pair.peer.spin_until(lambda: len(commanded.keys() & posed) > 10, what="ten steps")
        assert all(commanded[when] < posed[when] for when in commanded.keys() & posed)
        assert pair.cancel().success
        pair.send_goal(*GOAL)
        pair.wait_for_state("driving")
        assert pair.processes["robot"].stop(signal.SIGTERM) == 0
        pair.peer.spin_until(lambda: twist(pair.commands[-1]) == (0.0, 0.0), what="the stop")
