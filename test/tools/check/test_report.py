"""The report of `diffbot check`: usual faults of a first bring-up, from messages and endpoints without ROS."""

import math

import pytest
from view_bags import header

from diffbot_bag.messages import make
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.transforms import NO_TRANSFORMS
from diffbot_core.endpoints import TWIST, TWIST_STAMPED, Endpoint
from diffbot_core.schema import build
from diffbot_tools import cli
from diffbot_tools.check.report import (
    ObservedRobot,
    TopicGraph,
    clock_lines,
    input_lines,
    node_lines,
    output_lines,
    unmatched,
)
from diffbot_tools.check.streams import MessageArrival, Streams

ODOMETRY, IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
FIX = "geometry_msgs/msg/PoseWithCovarianceStamped"
INPUTS = {"odom": ODOMETRY, "imu": IMU, "heading": IMU, "global_pose": FIX}
NOW = 1_800_000_000 * 10**9
EKF = "/ekf"


def twist(omega):
    return {"angular": {"z": omega}}


def odometry(stamp, t, *, omega=0.5, twist_omega=0.5, frame="odom", child="base_link"):
    pose = {"orientation": {"z": math.sin(omega * t / 2), "w": math.cos(omega * t / 2)}}
    fields = {"pose": {"pose": pose}, "twist": {"twist": twist(twist_omega)}}
    return make(ODOMETRY, header=header(stamp, frame), child_frame_id=child, **fields)


def fix(now, variance=0.01, frame="map", delay=0.0):
    message = make(FIX, header=header(now - round(delay * 1e9), frame), pose={"pose": {"orientation": {"w": 1.0}}})
    message.pose.covariance[[0, 7, 35]] = variance
    return message


def imu(stamp, rate):
    message = make(IMU, header=header(stamp, "base_link"), angular_velocity={"z": rate})
    message.angular_velocity_covariance[:] = 1e-4
    return message


def drive(*, rate=20.0, duration=8.0, offset=0.0, parameters=None, gyro=None, fixes=None, command=None, **fields):
    """Return the streams of a robot that turns; ``offset`` [s] is added to the stamps of its odometry."""
    streams = Streams(build(EkfNodeConfig, parameters or {}), NO_TRANSFORMS)
    for step in range(round(duration * rate)):
        t = step / rate
        now = NOW + round(t * 1e9)
        arrival = MessageArrival(100.0 + t, now)
        if command is not None:
            streams.add("cmd_vel", make(TWIST, **twist(command)), arrival)
        if gyro is not None:
            streams.add("imu", imu(now, gyro), arrival)
        streams.add("odom", odometry(now + round(offset * 1e9), t, **fields), arrival)
        streams.add("global_pose", fix(now, **(fixes or {})), arrival)
    return streams


def lines_of(streams, **odom):
    """Return the lines of a graph in which each input has one publisher; ``odom`` changes the endpoints of odom."""
    graphs = {
        name: TopicGraph(f"/{name}", kind, [Endpoint("/base", kind)], [Endpoint(EKF, kind, is_reliable=False)])
        for name, kind in {"odom": ODOMETRY, "imu": IMU, "global_pose": FIX}.items()
    }
    graphs["odom"] = graphs["odom"]._replace(**odom)
    return input_lines(graphs, streams, ObservedRobot(EKF), 8.0)


def todo_of(streams, **odom):
    return [text for line in lines_of(streams, **odom) for text in line.todo]


def test_a_healthy_robot_has_nothing_to_do_and_a_line_with_its_facts():
    streams = drive(parameters={"use_gyro": True}, gyro=0.5)
    assert todo_of(streams) == []
    assert streams.has_moved
    assert lines_of(streams)[0].text() == (
        "ok    /odom: Odometry, 20.0 Hz, latency 0.000 s, system clock, 'odom -> base_link', covariance unknown (0), "
        "from /base, to /ekf"
    )


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"twist_omega": -0.5}, "twist.angular.z and the pose have opposite signs"),
        ({"frame": "wheel_odom"}, "odom has the frame_id 'wheel_odom'"),
        ({"rate": 1.0, "duration": 12.0}, "the longest gap between two messages is 1.00 s"),
        ({"offset": 5.0}, "stamped 5.00 s ahead of the system clock"),
        ({"fixes": {"variance": math.nan}}, "covariance not finite"),
        ({"gyro": -0.5, "parameters": {"use_gyro": True}}, "turn rates of imu and odom have opposite signs"),
        ({"gyro": 0.5}, "set use_gyro"),
    ],
)
def test_a_fault_of_the_messages_is_named(options, text):
    found = [one for line in lines_of(drive(**options)) for one in (*line.todo, *line.notes)]
    assert any(text in one for one in found), found


def test_simultaneous_faults_are_all_named():
    found = todo_of(drive(child="base_footprint", offset=-0.5, fixes={"variance": 0.0}))
    texts = "base_footprint", "covariance is zero", "global_pose is stamped 0.50 s ahead of odom"
    assert all(any(text in one for one in found) for text in texts), found


@pytest.mark.parametrize(
    ("odom", "text"),
    [
        (
            {"publishers": [], "elsewhere": ["/robot1/odom"]},
            "nothing publishes /odom: run all nodes in the namespace /robot1, or remap /odom to /robot1/odom",
        ),
        ({"publishers": [Endpoint("/base", ODOMETRY), Endpoint("/sim", ODOMETRY)]}, "all but one of /base, /sim"),
        ({"publishers": [Endpoint("/base", FIX)], "subscriptions": []}, "publishes /odom as PoseWithCovarianceStamped"),
    ],
)
def test_a_fault_of_the_endpoints_is_named(odom, text):
    found = todo_of(drive(), **odom)
    assert any(text in one for one in found), found


@pytest.mark.parametrize(
    ("subscription", "robot", "text"),
    [
        (Endpoint("/base", TWIST_STAMPED), ObservedRobot(), ""),
        (Endpoint("/base", TWIST_STAMPED), ObservedRobot(cmd_vel_type="twist"), "set cmd_vel_type to twist_stamped"),
        (Endpoint("/rviz", TWIST), ObservedRobot(), "no base subscribes to /cmd_vel, only /rviz"),
        (None, ObservedRobot(), "or remap cmd_vel to /base/cmd_vel"),
    ],
)
def test_the_subscription_of_the_base_is_checked_before_a_controller_runs(subscription, robot, text):
    ends = [subscription] if subscription else []
    graph = TopicGraph("/cmd_vel", TWIST, [], ends, ["/base/cmd_vel"])
    (line,) = output_lines({"cmd_vel": graph}, drive(), robot, 8.0)
    assert (text in " ".join(line.todo)) if text else not line.todo


@pytest.mark.parametrize(
    ("section", "text"),
    [
        ("controller: {ros__parameters: {pose_timeout: soon}}", "pose_timeout = 'soon'"),
        ("ekf: {ros__parameters: {use_gyo: true}}", "did you mean use_gyro"),
    ],
)
def test_a_wrong_parameter_file_is_refused_in_one_line(section, text, tmp_path, capsys):
    file = tmp_path / "robot.yaml"
    file.write_text(f"/**/{section}")
    assert cli.main(["check", str(file)]) == 1
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(("allowed", "is_fault"), [(1, True), (2, False)])
def test_the_controller_sets_how_many_nodes_may_send_commands(allowed, is_fault):
    both = [Endpoint("/controller", TWIST, is_reliable=True), Endpoint("/dock_controller", TWIST, is_reliable=True)]
    graph, robot = TopicGraph("/cmd_vel", TWIST, both, [Endpoint("/base", TWIST)]), ObservedRobot(EKF, "/controller")
    (line,) = output_lines({"cmd_vel": graph}, drive(), robot._replace(max_cmd_vel_publishers=allowed), 8.0)
    assert any("2 publishers, only one may publish it" in text for text in line.todo) is is_fault
    assert len(line.todo) == is_fault


@pytest.mark.parametrize(
    ("fields", "text"),
    [({}, "turns in the direction opposite to its commands"), ({"omega": 0.0, "twist_omega": 0.0}, "but does not")],
)
def test_a_robot_that_does_not_obey_its_commands_is_named(fields, text):
    graph = TopicGraph("/cmd_vel", TWIST, [Endpoint("/teleop", TWIST)], [Endpoint("/base", TWIST)])
    (line,) = output_lines({"cmd_vel": graph}, drive(command=-0.5, **fields), ObservedRobot(), 8.0)
    assert len(line.todo) == 1
    assert text in line.todo[0]


@pytest.mark.parametrize(
    ("parameters", "is_fault"), [({}, False), ({"use_gyro": True}, True), ({"heading_sigma": 0.1}, True)]
)
def test_a_silent_sensor_is_a_fault_only_if_a_parameter_configures_it(parameters, is_fault):
    streams = drive(parameters=parameters)
    graphs = {name: TopicGraph(f"/{name}", kind, [Endpoint("/base", kind)]) for name, kind in INPUTS.items()}
    lines = {one.name: one for one in input_lines(graphs, streams, ObservedRobot(EKF), 8.0)}
    silent = [lines["/imu"], lines["/heading"]]
    assert any(line.todo for line in silent) is is_fault
    assert all("no message was received from /base" in " ".join(line.todo + line.notes) for line in silent)


@pytest.mark.parametrize(
    ("delay", "is_fault"),
    [(0.1, False), (0.15, False), (0.3, True), (-0.3, True)],
    ids=["AMCL", "GNSS", "another computer", "its clock ahead"],
)
def test_the_delay_of_a_fix_is_not_a_fault_of_its_clock(delay, is_fault):
    found = todo_of(drive(fixes={"delay": delay}))
    assert any("global_pose is stamped 0.30 s" in one for one in found) if is_fault else found == []


def test_a_publisher_with_another_type_beside_a_matching_publisher_is_named():
    publishers = [Endpoint("/amcl", FIX), Endpoint("/tracker", "geometry_msgs/msg/PoseStamped")]
    graph = TopicGraph("/global_pose", FIX, publishers, [Endpoint(EKF, FIX, is_reliable=False)])
    (line,) = unmatched(graph, graph.subscriptions)
    assert line.startswith("/tracker publishes /global_pose as PoseStamped")


def test_a_latched_subscription_of_a_node_that_also_has_a_matching_one_is_not_a_fault():
    publishers = [Endpoint("/amcl", FIX, is_latched=True), Endpoint("/gnss", FIX)]
    own = [Endpoint(EKF, FIX, is_reliable=False), Endpoint(EKF, FIX, is_latched=True)]
    assert unmatched(TopicGraph("/global_pose", FIX, publishers, own), own) == []


@pytest.mark.parametrize(
    ("message", "todo", "text"),
    [
        ("waiting for first fix; ok", [], "TO DO /ekf: waiting for first fix\n      it has no start pose"),
        ("waiting for first fix; 3 messages dropped in the last 10 s", [], "it has no start pose"),
        ("waiting for first fix; nothing publishes /x", ["nothing publishes /x"], "a line above names the cause"),
    ],
)
def test_an_ekf_without_a_start_pose_is_not_ok(message, todo, text):
    (line,) = node_lines({EKF: (1, message)}, {EKF: 1}, [], todo)
    assert text in line.text()


def test_a_node_whose_clock_differs_is_named():
    robot = ObservedRobot(EKF, "/controller", use_sim_time={EKF: True, "/controller": False})
    clock = TopicGraph("/clock", publishers=[Endpoint("/plant", "rosgraph_msgs/msg/Clock")])
    (line,) = clock_lines(clock, drive(), robot)
    assert line.todo[0].startswith("/ekf follow /clock, but /controller, the source of odom, the source of global_pose")
    (line,) = clock_lines(TopicGraph("/clock"), drive(), robot)
    assert "no node publishes /clock" in line.todo[0]
    assert clock_lines(TopicGraph("/clock"), drive(), ObservedRobot()) == []


def test_a_problem_in_diagnostics_is_not_repeated():
    states = {EKF: (1, "running; odom: twist stays 0; innovations larger than the covariances allow; ok")}
    (line,) = node_lines(states, {EKF: 2}, [EKF], ["odom: twist stays 0"])
    assert line.facts == ("running",)
    assert line.todo == (
        "2 nodes have this name: end all but one (ps, or ros2 node list)",
        "innovations larger than the covariances allow",
    )
    assert "parameters could not be read" in line.notes[0]
