"""Bad messages on every topic are dropped, counted and logged once, and do not change what the node sends."""

import copy
import math
from collections import Counter
from importlib.util import find_spec

import one_process
import pytest
from filter_input import START, fix, heading, joint_state, odometry
from geometry_msgs.msg import Twist, Vector3
from nav_msgs.msg import Odometry, Path
from rclpy.serialization import deserialize_message
from robot import DEEP, pose_stamped, twist

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_control.goals.record import MAX_PATH_POSES
from diffbot_sim.plant_node import PlantNode

NAN, INF, HUGE = math.nan, math.inf, 1e308
LONG = "x" * 100_000
BAD_STAMP = {"header.stamp.sec": 2**31 - 1, "header.stamp.nanosec": 2**32 - 1}

POSES = [
    ({"header.frame_id": "elsewhere"}, "wrong frame_id"),
    ({"header.frame_id": LONG}, "wrong frame_id"),
    ({"pose.position.x": NAN}, "position not finite"),
    ({"pose.position.x": HUGE}, "position out of range"),
    ({"pose.orientation.w": NAN}, "orientation not finite"),
    ({"pose.orientation.z": 1.0, "pose.orientation.w": 1.0}, "orientation is not a unit quaternion"),
]
"""Changed fields of a message with a header and a pose, and the kind of the drop."""
UNKNOWN_FRAME = "no transform" if find_spec("tf2_ros") else "wrong frame_id"
GOALS = [(fields, UNKNOWN_FRAME if kind == "wrong frame_id" else kind) for fields, kind in POSES]
"""With tf2 a goal may have any frame that can be transformed to map."""
COVARIANCES = [
    (BAD_STAMP, "stamp not normalised"),
    ({"pose.covariance.0": NAN}, "covariance not finite"),
    ({"pose.covariance.0": 1e9}, "covariance too large"),
    ({"pose.covariance.1": 0.5}, "covariance not symmetric"),
    ({"pose.covariance.0": -0.1}, "covariance not positive definite"),
]
ESTIMATES = [({name.replace("pose.", "pose.pose."): v for name, v in one.items()}, kind) for one, kind in POSES]
ESTIMATES += COVARIANCES
ZERO_STAMP = ({"header.stamp.sec": 0, "header.stamp.nanosec": 0}, "stamp is zero")
HEADINGS = [
    ZERO_STAMP,
    ({"orientation.w": NAN}, "orientation not finite"),
    ({"orientation_covariance.0": -1.0}, "no orientation"),
    ({"orientation_covariance.8": 0.0}, "covariance is zero"),
    (BAD_STAMP, "stamp not normalised"),
]
ODOMETRIES = [
    ZERO_STAMP,
    ({"twist.twist.linear.x": NAN}, "velocity not finite"),
    ({"twist.twist.linear.x": HUGE}, "velocity out of range"),
    ({"child_frame_id": "odom"}, "wrong child_frame_id"),
    ({"twist.covariance.0": NAN}, "covariance not finite"),
    ({"twist.covariance.5": 1.0, "twist.covariance.30": 1.0}, "covariance not positive definite"),
    (BAD_STAMP, "stamp not normalised"),
]
JOINT_STATES = [
    ZERO_STAMP,
    ({"name": ["caster_joint", "right_wheel_joint", LONG]}, "wheel joints missing"),
    ({"velocity": []}, "wheel joints missing"),
    ({"velocity": [0.0, NAN, 1.0]}, "wheel speed not finite"),
    ({"velocity": [0.0, 1.0, -HUGE]}, "wheel speed out of range"),
    (BAD_STAMP, "stamp not normalised"),
]
FILTERED = [ZERO_STAMP, ({"child_frame_id": "base_footprint"}, "wrong child_frame_id")]


def changed(message, fields):
    """Return a copy with changed fields; a field is given by names and indices with dots in between."""
    message = copy.deepcopy(message)
    for path, value in fields.items():
        *parents, last = path.split(".")
        target = message
        for parent in parents:
            target = getattr(target, parent)
        if last.isdigit():
            target[int(last)] = value
        else:
            setattr(target, last, value)
    return message


class Spoiler(one_process.Fed):
    """A node that receives bad messages between good messages."""

    def __init__(self, *given):
        super().__init__(*given)
        self.sent = []

    def spoil(self, topic, good, cases):
        """Send a copy of the good message for each case, with the fields of the case changed."""
        for fields, kind in cases:
            self.send(topic, changed(good, fields))
            self.sent.append((topic, kind))

    def check_drops(self, log):
        """Check that each bad message is counted and each kind has one short line in the log."""
        assert self.node.health.dropped == Counter(self.sent)
        lines = [line for line in log.splitlines() if "message dropped" in line]
        assert len(lines) == len(set(self.sent))
        for topic, kind in set(self.sent):
            assert len([line for line in lines if f"]: {topic}: message dropped: {kind}" in line]) == 1
        assert max(map(len, lines)) < 400


@pytest.mark.parametrize(
    ("source", "motion", "cases"), [("odom", odometry, ODOMETRIES), ("joint_states", joint_state, JOINT_STATES)]
)
def test_bad_messages_do_not_change_the_estimate(nodes, source, motion, cases, capfd):
    fed = Spoiler(nodes, EkfNode, {"odometry_source": source, "reliable_inputs": True})
    # Neither a bad fix nor odometry without a fix starts the filter.
    fed.spoil("global_pose", fix(START), ESTIMATES[:3])
    fed.spoil(source, motion(START), [({}, "no fix yet")])
    assert not fed.node.localization.initialised
    fed.send("global_pose", fix())
    fed.send(source, motion(START + 0.1))
    before, time = fed.node.localization.estimate(), START + 0.2
    without_covariance = {"pose.covariance": [0.0] * 36}, "covariance is zero"
    fed.spoil("global_pose", fix(time), [*ESTIMATES, ZERO_STAMP, without_covariance])
    fed.spoil("initialpose", fix(time), ESTIMATES)
    fed.spoil("heading", heading(time), HEADINGS)
    fed.spoil(source, motion(time), cases)
    fed.spoil(source, motion(START - 0.25), [({}, "out of order")])
    fed.spoil("global_pose", fix(START - 5.0), [({}, "too old")])
    after = fed.node.localization.estimate()
    assert after.pose == before.pose
    assert (after.P == before.P).all()
    # Good messages with the stamps of bad messages are accepted.
    fed.send("heading", heading(time))
    fed.send(source, motion(time))
    assert (fed.node.health.accepted["heading"], fed.node.health.accepted[source]) == (1, 2)
    fed.check_drops(capfd.readouterr().err)


def filtered(time):
    message = Odometry(child_frame_id="base_link")
    message.header, message.pose = fix(time).header, fix(time).pose
    return message


def test_bad_messages_do_not_change_the_commands(nodes, capfd):
    fed = Spoiler(nodes, ControllerNode, {"pose_source": "odometry", "pose_timeout": 60.0})
    commands = nodes.peer.subscribe(Twist, "cmd_vel", DEEP)
    fed.send("odometry/filtered", filtered(START))
    fed.send("goal_pose", pose_stamped(5.0, 1.0, 0.3))
    fed.send("odometry/filtered", filtered(START + 0.1))
    fed.spoil("odometry/filtered", filtered(START + 0.2), ESTIMATES + FILTERED)
    fed.spoil("goal_pose", pose_stamped(0.0, 0.0, 0.0), GOALS)
    fed.send("odometry/filtered", filtered(START + 0.2))
    nodes.peer.spin_until(lambda: len(commands) >= 2, what="two commands")
    assert len(commands) == 2, "one good pose with a goal, one command"
    assert commands[1] == commands[0] != Twist(), "the same pose, the same command"
    assert fed.node.supervisor.goal == pytest.approx((5.0, 1.0, 0.3))
    fed.check_drops(capfd.readouterr().err)


def test_a_path_of_too_many_poses_is_refused_before_it_is_read(nodes, monkeypatch):
    """Reading a million poses would take longer than pose_timeout."""
    fed, read = one_process.Fed(nodes, ControllerNode, {"pose_timeout": 60.0}), []
    place = "diffbot_control.ros.messages.conversions.deserialize_message"
    monkeypatch.setattr(place, lambda data, kind: read.append(len(data)) or deserialize_message(data, kind))
    message = Path()
    message.header.frame_id = "map"
    for count in (MAX_PATH_POSES, MAX_PATH_POSES + 1, 8 * MAX_PATH_POSES):
        message.poses = [pose_stamped(1.0, 0.0, 0.0)] * count
        fed.send("path", message)
    health = fed.node.health
    assert (health.accepted["path"], health.dropped["path", "path too long"]) == (1, 2)
    assert len(read) == 2, "the longest path is not read"
    assert fed.node.supervisor.goals.present is not None


def test_corrections_of_a_goal_are_used_unless_they_are_old_repeated_or_far_away(nodes):
    parameters = {"pose_source": "odometry", "pose_timeout": 60.0}
    fed = one_process.Fed(nodes, ControllerNode, parameters)
    supervisor = fed.node.supervisor

    def update(x, age=0.0):
        message, now = pose_stamped(x, 0.0, 0.0), fed.node.get_clock().now().nanoseconds - round(age * 1e9)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
        return message

    fed.send("goal_update", update(5.1))
    assert fed.node.health.counted["goal_update without a goal"] == 1
    fed.send("goal_pose", pose_stamped(5.0, 0.0, 0.0))
    seen = update(5.1)
    fed.send("goal_update", seen)
    for message, kind in (
        (seen, "stamp not later than the previous stamp"),
        (update(5.2, age=100.0), "stamp too old"),
        (update(5.7), "far from the goal"),
        (changed(update(5.2), {"pose.position.x": NAN}), "position not finite"),
    ):
        fed.send("goal_update", message)
        assert fed.node.health.dropped["goal_update", kind] == 1
    assert supervisor.goal == (5.1, 0.0, 0.0)
    # A correction from a command line has no stamp.
    fed.send("goal_update", pose_stamped(5.3, 0.0, 0.0))
    assert (supervisor.goal, supervisor.updates) == ((5.3, 0.0, 0.0), 2)


def test_bad_commands_do_not_change_the_motion_of_the_plant(nodes, capfd):
    fed = Spoiler(nodes, PlantNode, {"cmd_vel_timeout": 60.0, "drive_noise": 0.0})
    truths = nodes.peer.subscribe(Odometry, "ground_truth", DEEP)
    good = Twist(linear=Vector3(x=0.4), angular=Vector3(z=0.2))

    def moves_at(v):
        return truths and twist(truths[-1].twist) == pytest.approx((v, 0.2))

    fed.send("cmd_vel", good)
    nodes.peer.spin_until(lambda: moves_at(0.4), what="motion")
    for field in ("linear.x", "angular.z"):
        for number, kind in ((NAN, "not finite"), (-INF, "not finite"), (HUGE, "out of range"), (-2e4, "out of range")):
            fed.spoil("cmd_vel", good, [({field: number}, f"velocity {kind}")])
    truths.clear()
    nodes.peer.spin_until(lambda: len(truths) > 3, what="steps")
    assert moves_at(0.4)
    # Only linear.x and angular.z mean anything to a robot with two wheels.
    fed.send("cmd_vel", changed(good, {"linear.x": 0.1, "linear.y": NAN, "angular.x": INF}))
    nodes.peer.spin_until(lambda: moves_at(0.1), what="the new command")
    fed.check_drops(capfd.readouterr().err)
