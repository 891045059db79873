"""The filter over a bag: compared with the node ekf, with the true poses, and with a second run."""

import contextlib
import math
from types import SimpleNamespace

import bag_makers
import numpy as np
import pytest
import rclpy
import yaml
from dataset_files import OMEGA, import_mrclam, write_mrclam
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message

from diffbot_bag.bag import BagReader
from diffbot_bag.conversions import message_class
from diffbot_control.ekf_node import EkfNode
from diffbot_control.filter.measurement import GyroSample
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_core.schema import build
from diffbot_tools import cli
from diffbot_tools.parameter_file import read_config
from diffbot_tools.refilter import FilterRun, run, topics_of

HANDLERS = {
    "/initialpose": EkfNode._on_initialpose,
    "/landmarks": lambda node, message: node._on_sensor("landmarks", message),
    "/odom": EkfNode._on_odometry,
}


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    return import_mrclam(write_mrclam(folder / "set"), 1, folder / "bag")


@pytest.fixture(scope="module")
def refiltered(bag):
    out = bag.parent / "out"
    assert run(bag, None, out, None, {}) == 0
    return out


def read(path):
    return {topic: [message for _, message in rows] for topic, rows in bag_makers.read(path).items()}


def row(message):
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return [message.header.stamp.sec, message.header.stamp.nanosec, p.x, p.y, q.z, q.w, *message.pose.covariance]


def odometry_row(message):
    twist = message.twist
    return [*row(message), twist.twist.linear.x, twist.twist.angular.z, *twist.covariance.tolist()]


class FakePublisher:
    """A publisher with a subscriber that keeps the numbers of each message."""

    def __init__(self, rows, numbers):
        self.get_subscription_count = lambda: 1
        self.publish = lambda message: rows.append(numbers(message))


@pytest.mark.graph
def test_estimates_are_equal_to_the_estimates_of_the_node(bag, refiltered):
    """The callbacks of the node get the messages of the bag in order, decoded by ROS."""
    context = rclpy.Context()
    rclpy.init(context=context)
    values = yaml.safe_load((bag / "ekf.yaml").read_text())["/**/ekf"]["ros__parameters"]
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    node = EkfNode(context=context, parameter_overrides=overrides)
    poses, filtered = [], []
    try:
        node._outputs._poses = FakePublisher(poses, row)
        node._outputs._filtered_odometry = FakePublisher(filtered, odometry_row)
        with BagReader(bag) as reader:
            types = {name: message_class(topic.type) for name, topic in reader.topics.items()}
            for message in reader.messages(HANDLERS):
                with contextlib.suppress(BadMessageError):
                    HANDLERS[message.topic](node, deserialize_message(message.data, types[message.topic]))
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
    found = read(refiltered)
    assert len(poses) == 400
    assert np.array([row(message) for message in found["/pose"]]).tolist() == poses
    assert list(map(odometry_row, found["/odometry/filtered"])) == filtered
    assert found["/odometry/filtered"][0].child_frame_id == "base_link"


def test_a_second_run_writes_the_same_bytes_and_the_printed_errors_are_those_of_its_poses(
    bag, refiltered, tmp_path, capsys
):
    """The expected values are computed from the new bag and the true circle."""
    run(bag, None, tmp_path / "out", "/ground_truth", {})
    assert (tmp_path / "out" / "out_0.mcap").read_bytes() == (refiltered / "out_0.mcap").read_bytes()
    lines = dict(line.split("  ", 1) for line in capsys.readouterr().out.splitlines() if "  " in line)
    errors, squares = [], []
    start = 1_248_446_190
    for message in read(tmp_path / "out")["/pose"]:
        p, q = message.pose.pose.position, message.pose.pose.orientation
        time = message.header.stamp.sec - start + message.header.stamp.nanosec * 1e-9
        angle = OMEGA * time
        e = np.array([p.x - 1.5 * math.cos(angle), p.y - 1.5 * math.sin(angle), 0.0])
        e[2] = math.remainder(2.0 * math.atan2(q.z, q.w) - angle - 0.5 * math.pi, 2.0 * math.pi)
        P = message.pose.covariance.reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]
        errors.append(e)
        squares.append(e @ np.linalg.inv(P) @ e)
    distance = np.hypot(*np.array(errors).T[:2])
    expected = {
        "position, RMSE": math.sqrt(np.mean(distance**2)),
        "position, largest": distance.max(),
        "heading, RMSE": math.sqrt(np.mean(np.array(errors)[:, 2] ** 2)),
        "NEES, mean": np.mean(squares),
    }
    for name, value in expected.items():
        assert float(lines[name].split()[0]) == pytest.approx(value, abs=1.1e-3), name
    assert lines["measurements"].split()[0] == str(sum(m.width for m in read(bag)["/landmarks"]))


def test_the_given_parameter_file_is_used_and_stored_in_the_bag(bag, refiltered, tmp_path):
    values = yaml.safe_load((bag / "ekf.yaml").read_text())["/**/ekf"]["ros__parameters"]
    params = tmp_path / "other.yaml"
    params.write_text(yaml.safe_dump({"/robot/ekf": {"ros__parameters": values | {"alpha3": 1e-4}}}))
    run(bag, params, tmp_path / "out", None, {})
    one, other = (read(path)["/pose"][300].pose.covariance[0] for path in (refiltered, tmp_path / "out"))
    assert other < one
    assert (tmp_path / "out" / "ekf.yaml").read_text() == params.read_text()


def test_the_covariance_of_the_twist_contains_the_gyro_as_that_of_the_node_does():
    step = OdometryStep(10**8, Twist(0.2, 0.1), TwistCovariance(1.0, 0.0, 1.0))
    filtered = FilterRun(build(EkfNodeConfig, {"use_gyro": True}), {})
    filtered.localization.initialise(Pose(0.0, 0.0, 0.0), 0.01 * np.eye(3), 0)
    for stamp in range(10**7, 2 * 10**8, 10**7):
        filtered.localization.on_gyro(GyroSample(stamp, 0.1, 1e-4))
    answer = filtered._answer(step)
    assert (answer.twist, answer.covariance) == filtered.localization.twist_of(answer.estimate, step)
    assert answer.covariance.var_omega < 0.1


def test_the_topic_of_a_further_source_of_fixes_can_be_remapped():
    config = build(EkfNodeConfig, {"pose_sources": ["gps"]})
    kinds = {"/robot1/odom": "nav_msgs/msg/Odometry", "/robot1/gps": "geometry_msgs/msg/PoseWithCovarianceStamped"}
    reader = SimpleNamespace(path="bag", topics={name: SimpleNamespace(type=kind) for name, kind in kinds.items()})
    words = ["refilter", "bag", "--out", "out", "--remap", "odom:=/robot1/odom", "gps:=/robot1/gps"]
    remap = dict(cli._parser().parse_args(words).remap)
    assert topics_of(reader, config, remap) == {"/robot1/odom": "odom", "/robot1/gps": "gps"}
    with pytest.raises(DiffbotError, match=r"^--remap = 'gsp': must be a known name .*did you mean gps"):
        topics_of(reader, config, {"gsp": "/robot1/gps"})


def test_a_misspelt_section_is_refused(tmp_path):
    (tmp_path / "p.yaml").write_text("/**/efk: {ros__parameters: {}}")
    with pytest.raises(DiffbotError, match=r"section /\*\*/efk: did you mean ekf?"):
        read_config(tmp_path / "p.yaml")


@pytest.mark.parametrize(("topic", "text"), [("/truth", "has no topic /truth"), ("/landmarks", "is not a pose")])
def test_a_topic_without_true_poses_is_refused_in_one_line(bag, tmp_path, topic, text, capsys, kept_signal_handlers):
    assert cli.main(["refilter", str(bag), "--compare", topic, "--out", str(tmp_path / "out")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert text in line
    assert not (tmp_path / "out").exists()
