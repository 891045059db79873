"""A path over DDS: its waypoints in order, what is refused of it, and the status that tells of it."""

import math

import graph
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from nav_msgs.msg import Path
from rclpy.qos import DurabilityPolicy, QoSProfile
from robot import distance, lockstep, planar, pose_stamped, stamp, turned

from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.law.finish import FINISH_NAMES
from diffbot_control.law.presets import PRESETS
from diffbot_control.law.supervisor import STATES, Supervisor, SupervisorConfig
from diffbot_core.geometry import Pose
from diffbot_core.schema import build
from diffbot_sim.model.simulator import World, WorldConfig

TUNED = {"preset": "tuned"}
ALL_STATES = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ROUTE = [(-1.0, -3.0, 1.0), (2.0, -2.0, 0.5), (2.0, 1.0, 2.5), (-1.0, 0.5, math.pi)]


def path(goals, frame="map", pose_frame="map"):
    message = Path()
    message.header.frame_id = frame
    message.poses = [pose_stamped(*goal, frame=pose_frame) for goal in goals]
    return message


def waypoints(states):
    """Numbers of the waypoint in statuses, repetitions left out."""
    texts = [values["waypoint"] for values in map(graph.values, states) if "waypoint" in values]
    return [text for index, text in enumerate(texts) if index == 0 or text != texts[index - 1]]


@pytest.fixture(scope="module")
def robot():
    with lockstep({"seed": 12}, controller=TUNED) as running:
        running.paths = running.peer.publisher(Path, "path", QoSProfile(depth=10))
        running.states = running.peer.subscribe(DiagnosticStatus, "controller/status", ALL_STATES)
        running.peer.wait_for_subscribers(running.paths)
        yield running


def send_path(robot, message, number=1):
    """Send a path and have the controller's word that it has it."""
    robot.states.clear()
    robot.paths.publish(message)
    expected = f"{number}/{len(message.poses)}"
    robot.peer.spin_until(lambda: expected in waypoints(robot.states), 10.0, f"waypoint {expected} in the status")


def run(robot, condition, timeout, what):
    robot.pause(False)
    robot.peer.spin_until(condition, timeout, what)
    robot.pause(True)
    robot.catch_up()


def newest(robot):
    return graph.values(robot.states[-1])


def closed_loop(goals, radius, steps):
    """True poses of a drive along a path, without ROS."""
    world = World(build(WorldConfig, {"seed": 4}))
    localization = Localization(LocalizationConfig())
    supervisor = Supervisor(SupervisorConfig(PRESETS["tuned"], waypoint_radius=radius, publish_when_idle=True))
    supervisor.on_path([Pose(*goal) for goal in goals])
    poses = []
    for step in range(steps + 1):
        for fix in world.sense().fixes:
            localization.on_measurement(fix)
        estimate = localization.on_odometry(world.odometry())
        poses.append(world.state.pose)
        command = supervisor.on_pose(estimate.stamp, 0.1 * step, estimate.pose, uncertainty_of(estimate.P))
        world.advance(command)
    return poses


def test_with_a_radius_waypoints_are_passed_without_stopping_and_repeatably():
    """The same drive as that of a supervisor in the ROS-free loop."""
    # The first test here: the robot of the others, on the same topics, does not run yet.
    goals = [(-1.0, -4.0, 1.0), (0.0, -2.0, 1.0), (0.0, 1.0, 1.5)]
    options = {"preset": "tuned", "waypoint_radius": 0.4}
    steps = 150
    with lockstep({"seed": 4}, controller=options) as robot:
        robot.commands = robot.peer.subscribe(Twist, "cmd_vel", QoSProfile(depth=100_000))
        robot.paths = robot.peer.publisher(Path, "path", QoSProfile(depth=10))
        robot.states = robot.peer.subscribe(DiagnosticStatus, "controller/status", ALL_STATES)
        robot.peer.wait_for_subscribers(robot.paths)
        send_path(robot, path(goals))
        begin = 1000 * 10**9
        run(
            robot,
            lambda: robot.truths and stamp(robot.truths[-1]) >= begin + steps * 10**8,
            20.0,
            "the steps",
        )
        truths = {(stamp(message) - begin) // 10**8: planar(message.pose.pose) for message in robot.truths}
        assert waypoints(robot.states) == ["1/3", "2/3", "3/3"]
    reference = closed_loop(goals, options["waypoint_radius"], steps)
    seen = sorted(step for step in truths if step <= steps)
    assert len(seen) > steps - 3
    for step in seen:
        assert truths[step][:2] == pytest.approx(reference[step][:2], abs=1e-9)
        assert turned(truths[step], reference[step]) < 1e-9
    # It did not stop at those it passed.
    for goal in goals[:2]:
        near = [step for step in seen[:-1] if distance(truths[step], goal) < 0.4 and step + 1 in truths]
        assert near
        assert min(distance(truths[step], truths[step + 1]) for step in near) > 0.01


def test_a_path_is_driven_waypoint_by_waypoint_to_its_end(robot):
    robot.truths.clear()
    send_path(robot, path(ROUTE))
    assert newest(robot)["goals reached"] == "0"
    run(robot, lambda: robot.states[-1].message == "goal reached", 30.0, "the end of the path")
    assert waypoints(robot.states) == ["1/4", "2/4", "3/4", "4/4"]
    assert newest(robot)["goals reached"] == "4"
    truths = [planar(message.pose.pose) for message in robot.truths]
    times = [
        next(
            (index for index, pose in enumerate(truths) if distance(pose, goal) < 0.1 and turned(pose, goal) < 0.1),
            None,
        )
        for goal in ROUTE
    ]
    assert None not in times, times
    assert times == sorted(times)
    # The last one is held.
    end = stamp(robot.truths[-1]) + 5 * 10**9
    run(robot, lambda: stamp(robot.truths[-1]) >= end, 15.0, "five more seconds")
    final = robot.true_pose()
    assert distance(final, ROUTE[-1]) < 0.1
    assert turned(final, ROUTE[-1]) < 0.1
    assert robot.states[-1].message == "goal reached"


def test_the_status_shows_radius_finish_and_smallest_tolerance(robot):
    # The robot stands still; a status that was sent since then tells of the newest pose.
    robot.catch_up()
    robot.states.clear()
    robot.peer.spin_until(lambda: robot.states, 5.0, "a status")
    values = newest(robot)
    assert set(values) == {
        "region",
        "switches",
        "goals reached",
        "goal",
        "distance [m]",
        "heading error [rad]",
        "eps_P [m]",
        "finish",
        "smallest tolerance [m]",
        "smallest tolerance [rad]",
        "waypoint",
    }
    assert values["region"] == "Omega_L"
    assert float(values["eps_P [m]"]) >= 0.1
    assert values["finish"] in FINISH_NAMES
    # Of the newest pose, to the digits that are shown: 99 % of a Rayleigh and of a normal distribution.
    P = np.array(robot.poses[-1].pose.covariance).reshape(6, 6)
    expected = 3.0349 * math.sqrt(np.linalg.eigvalsh(P[:2, :2])[-1]), 2.5758 * math.sqrt(P[5, 5])
    found = float(values["smallest tolerance [m]"]), float(values["smallest tolerance [rad]"])
    assert found == pytest.approx(expected, abs=6e-5)
    assert all(status.message in STATES for status in robot.states)


def test_a_single_goal_has_no_waypoint_and_the_newest_of_goal_and_path_wins(robot):
    send_path(robot, path(ROUTE[:3]))
    robot.send_goal(0.5, 0.5, 0.0)
    # The list of states hears the same topic a little earlier or later.
    robot.peer.spin_until(lambda: "waypoint" not in newest(robot), 5.0, "a status without a waypoint")
    assert newest(robot)["goal"] == "0.5 0.5 0"
    send_path(robot, path([(0.3, 0.4, 0.5)]))
    assert newest(robot)["goal"] == "0.3 0.4 0.5"
    answer = robot.cancel()
    assert (answer.success, answer.message) == (True, "cancelled")
    robot.peer.spin_until(lambda: robot.states[-1].message == "idle", 5.0, "idle")
    assert "waypoint" not in newest(robot)
    assert "goal" not in newest(robot)


def test_bad_paths_are_dropped_and_counted_and_change_nothing(robot):
    send_path(robot, path(ROUTE[:2]))
    before = newest(robot)
    third = path(ROUTE)
    third.poses[2].pose.position.y = math.nan
    turned_wrong = path(ROUTE)
    turned_wrong.poses[3].pose.orientation.w = 5.0
    bad = [
        (path([]), "path is empty"),
        (path(ROUTE, frame="odom"), "wrong frame_id"),
        (path(ROUTE, frame=""), "wrong frame_id"),
        (path(ROUTE, pose_frame="base_link"), "wrong frame_id"),
        (third, "position not finite"),
        (path([*ROUTE, (1e9, 0.0, 0.0)]), "position out of range"),
        (turned_wrong, "orientation is no unit quaternion"),
    ]
    counts = {}
    for message, kind in bad:
        counts[kind] = counts.get(kind, 0) + 1
        robot.paths.publish(message)

    def told():
        found = robot.diagnosis("controller")
        return {kind: int(found.get(f"path dropped: {kind}", 0)) for kind in counts} == counts

    robot.peer.spin_until(told, 10.0, f"the counts {counts}")
    robot.peer.spin_until_quiet()
    after = newest(robot)
    assert (after["goal"], after["waypoint"]) == (before["goal"], before["waypoint"])
    output = robot.processes["controller"].output
    assert output.count("path: message dropped") == len(counts), "said once for each kind"


def test_a_pose_without_a_frame_is_in_the_paths(robot):
    send_path(robot, path(ROUTE[1:3], pose_frame=""))
    robot.peer.spin_until(lambda: newest(robot)["goal"] == "2 -2 0.5", 60.0, "a status with the path's last pose")


def test_ten_thousand_poses_are_taken(robot):
    accepted = int(robot.diagnosis("controller")["path received"])
    goals = [(3.0 * math.cos(0.001 * number), 3.0 * math.sin(0.001 * number), 0.0) for number in range(10_000)]
    send_path(robot, path(goals))
    assert newest(robot)["goal"] == "3 0 0"
    assert int(robot.diagnosis("controller")["path received"]) == accepted + 1
    # And the loop goes on.
    begin = stamp(robot.truths[-1])
    run(robot, lambda: stamp(robot.truths[-1]) >= begin + 2 * 10**9, 15.0, "two more seconds")
    assert robot.states[-1].message == "driving"
    robot.send_goal(0.0, 0.0, 0.0)
