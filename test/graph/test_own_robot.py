"""The parameter file of ``diffbot robot new``: the nodes know all its parameters, and a robot drives with it."""

import re

import graph
from inside import inside
from nav_msgs.msg import Path
from rclpy.qos import QoSProfile
from robot import distance, pose_stamped, turned, twist

from diffbot_tools.robot_description import RobotDescription, file_of_robot

FILE = file_of_robot(RobotDescription(use_gyro=True), "my_robot.yaml")
WARNING = re.compile(r"\[(WARN|ERROR|FATAL)\] \[[\d.]+\] \[(controller|ekf|plant)[].]")
HARMLESS = "/clock", "no fix yet", "no odometry yet", "waiting for first fix: nothing arrives on"


def test_the_written_file_drives_along_a_path_within_its_limits(tmp_path, capfd):
    (tmp_path / "my_robot.yaml").write_text(FILE)
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
