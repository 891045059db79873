"""What a look at a running robot reports: the usual faults of a first bring-up, each as an observation without ROS."""

import math
from types import SimpleNamespace

import pytest

from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.transforms import NO_TRANSFORMS
from diffbot_core.endpoints import TWIST, TWIST_STAMPED, Endpoint
from diffbot_core.schema import build
from diffbot_tools.live.report import Robot, TopicGraph, input_lines, node_lines, output_lines, sim_time_problems
from diffbot_tools.live.streams import Arrival, Streams

ODOMETRY, IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
FIX = "geometry_msgs/msg/PoseWithCovarianceStamped"
KINDS = {"odom": ODOMETRY, "imu": IMU, "global_pose": FIX}
NOW = 1_800_000_000 * 10**9
EKF = "/ekf"
RUNNING = Robot(ekf=EKF)


def header(stamp, frame):
    sec, nanosec = divmod(stamp, 10**9)
    return SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id=frame)


def pose_at(x, yaw):
    orientation = SimpleNamespace(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    return SimpleNamespace(position=SimpleNamespace(x=x, y=0.0, z=0.0), orientation=orientation)


def twist_of(v, omega):
    return SimpleNamespace(linear=SimpleNamespace(x=v), angular=SimpleNamespace(z=omega))


def odometry(stamp, t, *, omega=0.5, twist_omega=0.5, frame="odom", child="base_link"):
    twist = SimpleNamespace(twist=twist_of(0.0, twist_omega), covariance=[0.0] * 36)
    pose = SimpleNamespace(pose=pose_at(0.0, omega * t), covariance=[0.0] * 36)
    return SimpleNamespace(header=header(stamp, frame), child_frame_id=child, pose=pose, twist=twist)


def fix(stamp, variance=0.01, frame="map"):
    covariance = [0.0] * 36
    covariance[0] = covariance[7] = covariance[35] = variance
    return SimpleNamespace(
        header=header(stamp, frame), pose=SimpleNamespace(pose=pose_at(0.0, 0.0), covariance=covariance)
    )


def imu(stamp, rate):
    rates = SimpleNamespace(x=0.0, y=0.0, z=rate)
    return SimpleNamespace(
        header=header(stamp, "base_link"), angular_velocity=rates, angular_velocity_covariance=[1e-4] * 9
    )


def drive(*, rate=20.0, duration=8.0, offset=0.0, parameters=None, gyro=None, fixes=None, command=None, **fields):
    """Return the streams of a robot that turns; ``offset`` [s] is added to the stamps of its odometry."""
    streams = Streams(build(EkfNodeConfig, parameters or {}), NO_TRANSFORMS)
    for step in range(round(duration * rate)):
        t = step / rate
        now = NOW + round(t * 1e9)
        arrival = Arrival(100.0 + t, now)
        if command is not None:
            streams.add("cmd_vel", twist_of(0.0, command), arrival)
        if gyro is not None:
            streams.add("imu", imu(now, gyro), arrival)
        streams.add("odom", odometry(now + round(offset * 1e9), t, **fields), arrival)
        streams.add("global_pose", fix(now, **(fixes or {})), arrival)
    return streams


def todo_of(streams, **changed):
    """Return what has to be done, for a graph in which each input has one publisher."""
    graphs = {
        name: TopicGraph(f"/{name}", (kind,), [Endpoint("/base", kind)], [Endpoint(EKF, kind, is_reliable=False)])
        for name, kind in KINDS.items()
    }
    graphs |= {name: graphs[name]._replace(**fields) for name, fields in changed.items()}
    return [text for line in input_lines(graphs, streams, RUNNING, 8.0) for text in line.todo]


def test_a_healthy_robot_has_nothing_to_do_and_a_line_with_its_figures():
    streams = drive(parameters={"use_gyro": True}, gyro=0.5)
    assert todo_of(streams) == []
    graph = TopicGraph(
        "/odom", (ODOMETRY,), [Endpoint("/base", ODOMETRY)], [Endpoint(EKF, ODOMETRY, is_reliable=False)]
    )
    (line,) = input_lines({"odom": graph}, streams, RUNNING, 8.0)
    assert line.text() == (
        "ok    /odom: Odometry, 20.0 Hz, latency 0.000 s, system clock, 'odom -> base_link', covariance unknown (0), "
        "from /base, to /ekf"
    )


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"twist_omega": -0.5}, "twist.angular.z and the pose have opposite signs"),
        ({"frame": "wheel_odom"}, "odom has the frame_id 'wheel_odom'"),
        ({"child": "robot2/base_link"}, "'robot2/base_link', not 'base_link': set base_link_frame"),
        ({"rate": 1.0, "duration": 12.0}, "the longest gap between two messages is 1.00 s"),
        ({"offset": 5.0}, "stamped 5.00 s ahead of the system clock"),
        ({"offset": 5.0}, "global_pose is stamped 5.00 s behind odom"),
        ({"fixes": {"variance": 0.0}}, "covariance is zero: set global_pose_sigma_xy and global_pose_sigma_yaw"),
        ({"fixes": {"variance": math.nan}}, "covariance not finite"),
        ({"fixes": {"frame": "world"}}, "'world', not 'map': set map_frame"),
        ({"gyro": 0.5 * 57.3, "parameters": {"use_gyro": True}}, "both have to be in rad/s"),
        ({"gyro": -0.5, "parameters": {"use_gyro": True}}, "turn rates of imu and odom have opposite signs"),
    ],
)
def test_a_fault_of_the_messages_is_named(options, text):
    found = todo_of(drive(**options))
    assert any(text in one for one in found), found


def test_faults_that_stand_behind_each_other_are_named_together():
    found = todo_of(drive(child="base_footprint", offset=-0.5, fixes={"variance": 0.0}))
    texts = "base_footprint", "covariance is zero", "global_pose is stamped 0.50 s ahead of odom"
    assert all(any(text in one for one in found) for text in texts), found


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"publishers": []}, "nothing publishes /odom: start its source, or remap /odom"),
        (
            {"publishers": [], "elsewhere": ["/robot1/odom"]},
            "nothing publishes /odom: run all nodes in the namespace /robot1, or remap /odom to /robot1/odom",
        ),
        (
            {"publishers": [], "elsewhere": ["/wheel_odometry"]},
            "nothing publishes /odom: start its source, or remap /odom to /wheel_odometry",
        ),
        (
            {
                "publishers": [Endpoint("/base", ODOMETRY, is_reliable=False)],
                "subscriptions": [Endpoint(EKF, ODOMETRY)],
            },
            "/base does not publish /odom as reliable, which /ekf requests: change the reliability of one of them",
        ),
        ({"publishers": [Endpoint("/base", ODOMETRY), Endpoint("/sim", ODOMETRY)]}, "end one of /base, /sim"),
        ({"publishers": [Endpoint("/base", FIX)]}, "publishes /odom as PoseWithCovarianceStamped"),
    ],
)
def test_a_fault_of_the_graph_is_named(changed, text):
    found = todo_of(drive(), odom=changed)
    assert any(text in one for one in found), found


@pytest.mark.parametrize(
    ("subscription", "robot", "text"),
    [
        (Endpoint("/base", TWIST), Robot(), ""),
        (Endpoint("/base", TWIST_STAMPED), Robot(), ""),
        (Endpoint("/base", TWIST_STAMPED), Robot(cmd_vel_type="twist"), "set cmd_vel_type to twist_stamped"),
        (Endpoint("/rviz", TWIST), Robot(), "nobody but /rviz subscribes to /cmd_vel"),
        (None, Robot(), "or remap cmd_vel to /base/cmd_vel"),
    ],
)
def test_the_subscriber_of_the_commands_is_judged_before_a_controller_runs(subscription, robot, text):
    ends = [subscription] if subscription else []
    graph = TopicGraph("/cmd_vel", (TWIST, TWIST_STAMPED), [], ends, ["/base/cmd_vel"])
    (line,) = output_lines({"cmd_vel": graph}, drive(), robot, 8.0)
    assert (text in " ".join(line.todo)) if text else not line.todo


def test_a_robot_that_turns_against_its_commands_is_named():
    graph = TopicGraph("/cmd_vel", (TWIST,), [Endpoint("/teleop", TWIST)], [Endpoint("/base", TWIST)])
    (line,) = output_lines({"cmd_vel": graph}, drive(command=-0.5), Robot(), 8.0)
    assert line.todo == ("the robot turns against its commands: swap left and right wheel, or the sign of the motors",)


def test_one_node_with_simulated_time_is_named():
    robot = Robot(EKF, "/controller", use_sim_time={EKF: True, "/controller": False})
    (text,) = sim_time_problems(robot, drive(), has_clock=True)
    assert text.startswith("/ekf follow /clock, /controller, the source of odom")
    (text,) = sim_time_problems(robot, drive(), has_clock=False)
    assert "nothing publishes /clock" in text


def test_two_ekf_and_what_a_node_reports_are_named_once():
    states = {EKF: (1, "running; odom: twist stays 0; innovations larger than the covariances allow; ok")}
    (line,) = node_lines(states, {EKF: 2}, ["odom: twist stays 0"])
    assert line.todo == (
        "2 nodes have this name: end all but one (ps, or ros2 node list)",
        "innovations larger than the covariances allow",
    )
