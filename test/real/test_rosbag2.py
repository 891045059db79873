"""rosbag2 reads and plays bags of this project, the commands read bags of rosbag2, and a replay has its services."""

import signal
from collections import Counter

import bag_commands
import graph
import one_process
import pytest
import rosbag2_bags
from nav_msgs.msg import Odometry
from overlay import ros2
from rclpy.qos import QoSProfile
from recorders import Recorder
from robot import robot
from rosbag2_interfaces import srv

from diffbot_bag.bag import BagReader

TOPICS = ["/odom", "/global_pose", "/pose", "/ground_truth", "/cmd_vel", "/goal_pose", "/ekf/status"]
RECORDED = {
    "zstd": {},
    "lz4": {"compression": "lz4"},
    "uncompressed": {"compression": "none"},
    "split": {"max_bag_size": 2**16, "compression": "none"},
    "some topics": {"topics": ["/odom", "/cmd_vel"]},
}
"""Parameters of the recorder by the kind of bag."""
CUT = {
    "trimmed": ("trim", "--from", "1s", "--to", "end-1s"),
    "filtered": ("filter", "--topics", "/odom", "/pose"),
}
"""Commands that cut a bag."""
KINDS = (*RECORDED, *CUT, "merged", "killed and repaired")
COMMANDS = sorted(bag_commands.bag_commands() - set(bag_commands.GRAPH))
DEEP = QoSProfile(depth=100_000)


def diffbot(*arguments):
    status, _, error = bag_commands.run(list(map(str, arguments)))
    assert status == 0, error


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    """Record a drive; return a folder with one bag of each kind."""
    folder = tmp_path_factory.mktemp("ours")
    with robot(only=("robot", "plant"), joined=True) as driving, one_process.nodes() as nodes:
        driving.send_goal(5.0, 5.0, 0.0)
        recorders = {
            kind: Recorder(nodes, folder / kind, named(number), **{"topics": TOPICS, **parameters})
            for number, (kind, parameters) in enumerate(RECORDED.items())
        }
        parameters = {"uri": folder / "killed", "topics": TOPICS, "flush_period": 0.1}
        with graph.node("diffbot_bag.recorder_node", parameters) as killed:
            all_have(nodes.peer, recorders.values(), 120)
            graph.wait_for(lambda: killed_has(folder / "killed"), what="messages in the bag of the other process")
            killed.send(signal.SIGKILL)
            killed.wait()
        for recorder in recorders.values():
            recorder.close()
    diffbot("bag", "repair", folder / "killed", folder / "killed and repaired")
    for kind, (verb, *arguments) in CUT.items():
        diffbot("bag", verb, folder / "zstd", folder / kind, *arguments)
    diffbot("bag", "merge", folder / "lz4", folder / "some topics", folder / "merged")
    return folder


def named(number):
    """Return the ROS arguments of a recorder's own name."""
    return "-r", f"__node:=recorder_{number}"


def all_have(peer, recorders, count):
    """Wait until each recorder has subscribed and then ``count`` poses are published."""
    peer.spin_until(lambda: all({one.topic_name for one in each.node.subscriptions} >= {"/odom"} for each in recorders))
    poses = peer.subscribe(Odometry, "/odometry/filtered", DEEP)
    peer.spin_until(lambda: len(poses) >= count, what=f"{count} poses")


def killed_has(folder):
    return sum(path.stat().st_size for path in folder.glob("*.mcap")) > 20_000


@pytest.mark.parametrize("kind", KINDS)
def test_rosbag2_reads_all_messages_of_our_bags(ours, kind, figures):
    folder = ours / kind
    with BagReader(folder) as bag:
        expected = [(one.topic, one.data, one.log_time) for one in bag.messages()]
    found = rosbag2_bags.read(folder)
    assert sorted(found) == sorted(expected)
    known = rosbag2_bags.metadata(folder)
    if len(known.files) == 1:
        # rosbag2 reads file by file, and the log times of two files may overlap.
        assert [time for *_, time in found] == sorted(time for *_, time in expected)
    counts = {one.topic_metadata.name: one.message_count for one in known.topics_with_message_count}
    assert {name: count for name, count in counts.items() if count} == Counter(topic for topic, *_ in expected)
    assert known.message_count == len(expected) > 20
    figures.setdefault("bags read by rosbag2", []).append(kind)


THEIRS = {
    **{f"preset {preset}": {"storage_preset_profile": preset} for preset in rosbag2_bags.PRESETS},
    "split": {"max_bagfile_size": 50_000, "storage_preset_profile": "fastwrite"},
    "custom data": {"custom_data": {"robot": "left"}},
}


@pytest.fixture(scope="module")
def theirs(ours, tmp_path_factory):
    """Write the messages of one of our bags with rosbag2; return a folder with one bag of each kind."""
    folder = tmp_path_factory.mktemp("theirs")
    messages = rosbag2_bags.read(ours / "zstd")
    known = rosbag2_bags.metadata(ours / "zstd").topics_with_message_count
    types = {one.topic_metadata.name: one.topic_metadata.type for one in known}
    for kind, options in THEIRS.items():
        rosbag2_bags.write(folder / kind, messages, types, **options)
    rosbag2_bags.write(folder / "sqlite3", messages, types, storage="sqlite3")
    rosbag2_bags.write(folder / "file compression", messages, types, compression="FILE")
    rosbag2_bags.write(folder / "message compression", messages, types, compression="MESSAGE")
    return folder


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    return bag_commands.given_files(tmp_path_factory.mktemp("bags") / "given")


@pytest.mark.parametrize("kind", THEIRS)
def test_every_command_reads_a_bag_of_rosbag2(theirs, ours, given, kind, tmp_path, figures):
    with BagReader(theirs / kind) as bag:
        found = [(one.topic, one.data, one.log_time) for one in bag.messages()]
    assert sorted(found) == sorted(rosbag2_bags.read(ours / "zstd"))
    for name in COMMANDS:
        words = bag_commands.words_of(name, theirs / kind, given, tmp_path / name)
        if name == "calibrate":
            words = words[: words.index("--until")]  # it needs all of the drive
        status, out, error = bag_commands.run(words)
        assert status in ((0, 1) if name == "bag check" else (0,)), (name, out, error)
    figures.setdefault("bags of rosbag2 read by every command", []).append(kind)


@pytest.mark.parametrize(
    ("kind", "word"), [("sqlite3", "sqlite3"), ("file compression", "FILE"), ("message compression", "MESSAGE")]
)
def test_a_bag_that_is_not_supported_is_refused_in_one_line_that_says_why(theirs, kind, word):
    status, _, error = bag_commands.run(["bag", "info", str(theirs / kind)])
    assert status == 1
    assert error.count("\n") == 1
    assert word in error


def test_ros2_bag_play_sends_all_messages_of_our_bag(ours):
    expected = [data for topic, data, _ in rosbag2_bags.read(ours / "zstd") if topic == "/odom"]
    with graph.peer() as peer:
        received = peer.subscribe(Odometry, "/odom", DEEP, raw=True)
        arguments = ("--rate", "2.0", "--delay", "3.0", "--disable-keyboard-controls", "--wait-for-all-acked", "10000")
        with ros2("bag", "play", ours / "zstd", *arguments) as command:
            peer.spin_until(lambda: command.popen.poll() is not None, what="the end of the replay")
            peer.spin_until_quiet()
            assert command.wait() == 0
        assert list(map(bytes, received)) == expected


def test_ros2_bag_record_records_the_robot_and_the_commands_read_it(tmp_path):
    with robot(only=("robot", "plant"), joined=True, namespace="/left") as driving:
        driving.send_goal(3.0, -3.0, 0.0)
        with ros2("bag", "record", "-o", tmp_path / "bag", "-s", "mcap", "-a") as command:
            command.wait_for_output("Subscribed to topic '/left/pose'")
            driving.catch_up()
            count = len(driving.poses)
            driving.peer.spin_until(lambda: len(driving.poses) > count + 30, what="more poses")
            assert command.stop() == 0
    with BagReader(tmp_path / "bag") as bag:
        counts = Counter(one.topic for one in bag.messages())
    assert counts["/left/pose"] >= 25
    diffbot("bag", "info", tmp_path / "bag")
    diffbot("report", tmp_path / "bag", "-o", tmp_path / "report.html")


def test_the_services_of_a_replay_have_the_types_of_rosbag2s_player(ours):
    """test_replay.py tests what they do."""
    names = "is_paused", "get_rate", "set_rate", "play_next", "seek", "pause", "resume", "toggle_paused", "stop"
    arguments = ("replay", ours / "zstd", "--start-paused", "--disable-keyboard-controls", "--rate", "0.5")
    with graph.diffbot(*map(str, arguments)) as replay, graph.peer() as peer:
        for name in names:
            kind = getattr(srv, "".join(part.capitalize() for part in name.split("_")))
            peer.call(kind, f"/rosbag2_player/{name}")
        assert replay.wait() == 0
