"""The README's commands of ROS 2, and the output of `ros2` about the nodes."""

import re
import signal
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import graph
import pytest
import rosbag2_bags
from overlay import ros2
from robot import robot

ROOT = Path(__file__).resolve().parents[2]
NOT_HERE = {"rviz:=true"}
"""Arguments that need a screen."""
ALONE = ("--no-daemon", "--spin-time", "2")
"""The daemon would outlive the test."""


def of_readme(beginning):
    """Return the words of the README's command with this beginning, without its comment."""
    section = (ROOT / "README.md").read_text().partition("## Use it on ROS 2 Jazzy")[2].partition("\n## ")[0]
    (line,) = (line.strip() for line in section.splitlines() if line.strip().startswith(beginning))
    return [word for word in line.partition("#")[0].split() if word not in NOT_HERE]


def answer(*words, cwd=None):
    """Return the output of a command that ends with status 0; run it again until it has discovered the node."""

    def found():
        with ros2(*words, cwd=cwd) as command:
            status = command.wait()
            if status and any(text in command.output for text in ("Node not found", "Unable to find node")):
                return None
            assert status == 0, command.output
            return command.output

    return graph.wait_for(found, what=" ".join(words))


@contextmanager
def launched(words, cwd, *ready):
    """Run a launch file while the ``with`` block lasts; SIGINT then ends all its processes cleanly."""
    with graph.process(*words, cwd=cwd) as launch:
        for node in ready:
            launch.wait_for_output(f"[{node}]: ready")
        yield launch
        assert launch.stop(signal.SIGINT) == 0
        assert launch.output.count("process has finished cleanly") >= len(ready)
        assert "process has died" not in launch.output


def test_the_commands_of_the_readme_drive_record_and_replay(tmp_path):
    nodes = "recorder", "ekf", "controller", "plant"
    with launched(of_readme("ros2 launch diffbot simulation.launch.py"), tmp_path, *nodes):
        assert "reached" in answer(*of_readme("ros2 run diffbot diffbot goal")[1:], cwd=tmp_path)
    counts = Counter(topic for topic, *_ in rosbag2_bags.read(tmp_path / "run1"))
    assert min(counts[topic] for topic in ("/odom", "/pose", "/cmd_vel", "/tf")) > 20
    with graph.process(*of_readme("ros2 run diffbot replay_node"), cwd=tmp_path) as replay:
        assert replay.wait() == 0
        (sent,) = re.findall(r"(\d+) messages in", replay.output)
        assert int(sent) == sum(counts.values())


@pytest.fixture(scope="module")
def running():
    with robot(only=("robot", "plant"), joined=True, namespace="/left") as one:
        one.peer.spin_until(lambda: one.poses, what="the first pose")
        yield one


PRINTED = {
    ("topic", "list", *ALONE): ("/left/odom", "/left/pose", "/left/cmd_vel", "/tf"),
    ("node", "info", "/left/ekf", *ALONE): ("/left/global_pose: geometry_msgs/msg/PoseWithCovarianceStamped",),
    ("topic", "echo", "--once", "/left/pose"): ("frame_id: map",),
    ("param", "list", "/left/controller", *ALONE): ("linear.x.max_velocity", "waypoint_radius"),
    ("lifecycle", "get", "/left/controller", *ALONE): ("active [3]",),
    ("service", "call", "/left/controller/cancel", "std_srvs/srv/Trigger"): ("there was no goal",),
}
"""Parts of the output of commands about the nodes."""


@pytest.mark.parametrize("words", PRINTED, ids=lambda words: " ".join(words[:3]))
def test_ros2_shows_the_nodes_with_their_topics_parameters_and_states(running, words):
    # On a busy machine the discovery of a node may take longer.
    graph.wait_for(
        lambda: all(text in answer(*words) for text in PRINTED[words]), what=f"{PRINTED[words]} in the answer"
    )


def test_the_robot_drives_to_a_goal_of_ros2_topic_pub(running):
    goal = "{header: {frame_id: map}, pose: {position: {x: 0.5, y: -0.5}, orientation: {w: 1.0}}}"
    answer("topic", "pub", "--once", "-w", "1", "/left/goal_pose", "geometry_msgs/msg/PoseStamped", goal)
    running.wait_for_state("goal reached", 60.0)
    x, y, _ = running.true_pose()
    assert (x, y) == pytest.approx((0.5, -0.5), abs=0.15)
