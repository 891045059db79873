"""Bad messages on every topic: dropped, counted, said once, without any effect on what the node sends."""

import copy
import math
import random

import graph
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from filter_input import R_FIX, START, VARIANCES, fix, heading, joint_state, odometry, timed
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from graph import MODULES
from hostile import spoiled
from nav_msgs.msg import Odometry
from robot import DEEP, planar, pose_stamped, stamp, yaw
from std_srvs.srv import Trigger

from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import Heading, OdometryStep, PoseFix
from diffbot_control.law.controller import ControllerMemory, step
from diffbot_control.law.presets import PRESETS
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist as TwistValue
from diffbot_core.kinematics import TwistCovariance, WheelGeometry, WheelSpeeds, body_twist, encoder_covariance
from diffbot_core.uncertainty import Estimate, Uncertainty

NAN, INF, HUGE = math.nan, math.inf, 1e308
LONG = "x" * 1_000_000
UNCERTAINTY = Uncertainty(math.sqrt(R_FIX[0, 0]), math.sqrt(R_FIX[2, 2]))
"""of the poses that the controller gets: the error ellipse of a fix is a circle"""


def changed(message, **fields):
    """Change fields of a copy; ``a__b`` is field b of field a, ``a__3`` is item 3 of it."""
    message = copy.deepcopy(message)
    for path, value in fields.items():
        *parents, last = path.split("__")
        target = message
        for parent in parents:
            target = getattr(target, parent)
        if last.isdigit():
            target[int(last)] = value
        else:
            setattr(target, last, value)
    return message


def bad_poses(good, pose):
    """Changes of a message whose geometry_msgs/Pose is at ``pose``, each with the kind under which it is counted."""
    q = f"{pose}__orientation__"
    return [
        (changed(good, **{f"{pose}__position__x": NAN}), "position not finite"),
        (changed(good, **{f"{pose}__position__y": -INF}), "position not finite"),
        (changed(good, **{f"{pose}__position__x": HUGE}), "position out of range"),
        (changed(good, **{f"{q}w": NAN}), "orientation not finite"),
        (changed(good, **{f"{q}z": INF}), "orientation not finite"),
        (changed(good, **{f"{q}z": 0.0, f"{q}w": 0.0}), "orientation is no unit quaternion"),
        (changed(good, **{f"{q}z": 1.0, f"{q}w": 1.0}), "orientation is no unit quaternion"),
        *bad_headers(good),
    ]


def bad_headers(good, wrong="elsewhere"):
    return [
        (changed(good, header__frame_id=wrong), "wrong frame_id"),
        (changed(good, header__frame_id=""), "wrong frame_id"),
        (changed(good, header__frame_id=LONG), "wrong frame_id"),
    ]


BAD_STAMP = {"header__stamp__sec": 2**31 - 1, "header__stamp__nanosec": 2**32 - 1}


def bad_covariances(good, field, places):
    first, second, mirrored = places
    return [
        (changed(good, **{f"{field}__{first}": NAN}), "covariance not finite"),
        (changed(good, **{f"{field}__{second}": INF}), "covariance not finite"),
        (changed(good, **{f"{field}__{first}": 1e-310}), "covariance not positive definite"),
        (changed(good, **{f"{field}": [0.0] * len(getattr_path(good, field))}), "covariance is zero"),
        (changed(good, **{f"{field}__{first}": 1e9}), "covariance too large"),
        (changed(good, **{f"{field}__{second}": 0.5}), "covariance not symmetric"),
        (changed(good, **{f"{field}__{second}": 0.5, f"{field}__{mirrored}": 0.5}), "covariance not positive definite"),
        (changed(good, **{f"{field}__{first}": -0.1}), "covariance not positive definite"),
    ]


def getattr_path(message, path):
    for part in path.split("__"):
        message = getattr(message, part)
    return message


def bad_fixes():
    good = fix(START)
    return [
        *bad_poses(good, "pose__pose"),
        *bad_covariances(good, "pose__covariance", (0, 1, 6)),
        (changed(good, **BAD_STAMP), "stamp not normalised"),
    ]


def filtered(time, *pose):
    message = Odometry(child_frame_id="base_link")
    estimate = fix(time, *pose)
    message.header, message.pose = estimate.header, estimate.pose
    return message


def bad_estimates(good):
    """Invalid changes of the controller's pose; one without any covariance is valid, its uncertainty unknown."""
    covariances = bad_covariances(good, "pose__covariance", (0, 1, 6))
    bad = [
        *bad_poses(good, "pose__pose"),
        *((message, kind) for message, kind in covariances if kind != "covariance is zero"),
        (changed(good, **BAD_STAMP), "stamp not normalised"),
    ]
    if isinstance(good, Odometry):
        bad += [(changed(good, child_frame_id=frame), "wrong child_frame_id") for frame in ("base_footprint", "", LONG)]
    return bad


def bad_headings():
    good, field = heading(START), "orientation_covariance__"
    return [
        *bad_headers(good, "map"),
        (changed(good, orientation__w=NAN), "orientation not finite"),
        (changed(good, orientation__z=0.0, orientation__w=0.0), "orientation is no unit quaternion"),
        (changed(good, **{f"{field}0": -1.0}), "no orientation in it"),
        (changed(good, **{f"{field}8": NAN}), "covariance not finite"),
        (changed(good, **{f"{field}8": 0.0}), "covariance is zero"),
        (changed(good, **{f"{field}8": HUGE}), "covariance too large"),
        (changed(good, **BAD_STAMP), "stamp not normalised"),
    ]


def bad_odometries(time):
    good, field = odometry(time), "twist__covariance__"
    return [
        (changed(good, twist__twist__linear__x=NAN), "velocity not finite"),
        (changed(good, twist__twist__angular__z=INF), "velocity not finite"),
        (changed(good, twist__twist__linear__x=HUGE), "velocity out of range"),
        (changed(good, child_frame_id="odom"), "wrong child_frame_id"),
        (changed(good, child_frame_id=LONG), "wrong child_frame_id"),
        (changed(good, **{f"{field}0": NAN}), "covariance not finite"),
        (changed(good, **{f"{field}35": HUGE}), "covariance too large"),
        (changed(good, **{f"{field}5": 1.0, f"{field}30": 1.0}), "covariance not positive definite"),
        (changed(good, **{f"{field}0": 0.0}), "covariance not positive definite"),
        (changed(good, **BAD_STAMP), "stamp not normalised"),
    ]


def bad_joint_states(time):
    good = joint_state(time)
    return [
        (changed(good, name=["caster_joint", "right_wheel_joint", LONG]), "wheel joints missing"),
        (changed(good, name=[], position=[], velocity=[]), "wheel joints missing"),
        (changed(good, velocity=[]), "wheel joints missing"),
        (changed(good, velocity=[0.0, NAN, 1.0]), "wheel speed not finite"),
        (changed(good, velocity=[0.0, 1.0, -HUGE]), "wheel speed out of range"),
        (changed(good, **BAD_STAMP), "stamp not normalised"),
    ]


class Subject:
    """A node under test and the test's own node."""

    def __init__(self, process, peer, name):
        self.process, self.peer, self.name = process, peer, name
        self.diagnostics = peer.subscribe(DiagnosticArray, "/diagnostics", DEEP)
        self.publishers = {}

    def publish(self, topic, message):
        if topic not in self.publishers:
            self.publishers[topic] = self.peer.publisher(type(message), topic, 100)
            self.peer.wait_for_subscribers(self.publishers[topic])
            # The other side has to know this publisher, too: there is no message of the test that tells so.
            self.peer.spin_for(0.3)
        self.publishers[topic].publish(message)

    def counts(self):
        before = len(self.diagnostics)
        self.peer.spin_until(
            lambda: len(self.diagnostics) > before + 1 and self.diagnostics[-1].status[0].name == self.name, 6.0, "news"
        )
        return graph.values(self.diagnostics[-1].status[0])

    def assert_dropped(self, expected):
        """Compare counters and the log with a list of (topic, kind), one per message."""
        wanted = {}
        for topic, kind in expected:
            wanted[f"{topic} dropped: {kind}"] = wanted.get(f"{topic} dropped: {kind}", 0) + 1

        def as_wanted():
            found = {key: int(value) for key, value in self.counts().items() if "dropped" in key}
            return found == wanted or found

        found = as_wanted()
        if found is not True:
            found = as_wanted()  # the last ones may have come after the report was made
        assert found is True, {key: (found.get(key), wanted.get(key)) for key in found.keys() | wanted.keys()}
        lines = [line for line in self.process.output.splitlines() if "message dropped" in line]
        assert len(lines) == len(wanted), lines
        for topic, kind in set(expected):
            assert len([line for line in lines if f"]: {topic}: message dropped: {kind}" in line]) == 1
        assert max(map(len, lines)) < 400, "a message of a megabyte must not fill the log"
        assert self.process.popen.poll() is None


@pytest.fixture
def start(request):
    """Start a node alone in a namespace of its own."""
    opened = []

    def begin(name, parameters=None):
        space = f"/alone_{request.node.name.replace('[', '_').replace(']', '')[5:45]}"
        # Each message counts here, and best effort loses some of a megabyte.
        parameters = {"reliable_inputs": True, **(parameters or {})} if name != "plant" else parameters
        running = graph.node(MODULES[name], parameters, ("-r", f"__ns:={space}"))
        opened.append(running)
        process = running.__enter__()
        peer = graph.peer(namespace=space)
        opened.append(peer)
        talking = peer.__enter__()
        process.wait_for_output("]: ready")
        return Subject(process, talking, f"{space}/{name}")

    yield begin
    for context in reversed(opened):
        context.__exit__(None, None, None)


def ask(subject, topic, message, answers, time):
    """Send an odometry and return the pose that answers it."""
    subject.publish(topic, message)
    wanted = round(time * 1e9)
    subject.peer.spin_until(lambda: answers and stamp(answers[-1]) == wanted, 5.0, f"a pose at {time}")
    return answers[-1]


def assert_same_estimate(pose, estimate):
    assert planar(pose.pose.pose) == pytest.approx(tuple(estimate.pose), abs=1e-9)
    covariance = np.array(pose.pose.covariance).reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]
    assert covariance == pytest.approx(estimate.P, abs=1e-9)


def measured(message):
    pose = planar(message.pose.pose)
    return PoseFix(stamp(message), Pose(*pose), R_FIX)


@pytest.mark.parametrize("source", ["odom", "joint_states"])
def test_filter_goes_on_as_if_the_bad_messages_had_not_come(start, source):
    subject = start("ekf", {"odometry_source": source})
    poses = subject.peer.subscribe(PoseWithCovarianceStamped, "pose", DEEP)
    reference = Localization(LocalizationConfig())
    wheels = WheelGeometry()
    time, dropped = START, []

    def move():
        nonlocal time
        time = round(time + 0.1, 3)
        message = odometry(time) if source == "odom" else joint_state(time)
        pose = ask(subject, source, message, poses, time)
        if source == "odom":
            step = OdometryStep(stamp(message), TwistValue(0.4, 0.1), TwistCovariance(*VARIANCES))
        else:
            speeds = WheelSpeeds(5.0, 6.0)
            step = OdometryStep(stamp(message), body_twist(speeds, wheels), encoder_covariance(speeds, 0.05, wheels))
        assert_same_estimate(pose, reference.on_odometry(step))

    def spoil(topic, bad):
        for message, kind in bad:
            subject.publish(topic, message)
            dropped.append((topic, kind))
            move()

    # Bad before the first good one, too: neither must it start the filter.
    for message, kind in bad_fixes()[:3]:
        subject.publish("global_pose", message)
        dropped.append(("global_pose", kind))
    subject.publish(source, odometry(START) if source == "odom" else joint_state(START))
    dropped.append((source, "no fix yet"))
    subject.peer.spin_for(0.2)
    assert not poses
    subject.publish("global_pose", fix())
    reference.on_measurement(measured(fix()))
    subject.peer.spin_for(0.2)
    move()
    subject.publish("heading", heading(time))
    reference.on_measurement(Heading(round(time * 1e9), 0.6, np.array([[0.01]])))
    move()
    spoil("global_pose", bad_fixes())
    spoil("initialpose", bad_fixes())
    spoil("heading", bad_headings())
    spoil(source, bad_odometries(time) if source == "odom" else bad_joint_states(time))
    if source == "odom":
        spoil("odom", [(odometry(time - 0.35), "out of order")])
    subject.publish("global_pose", fix(time - 5.0))
    dropped.append(("global_pose", "too old"))
    move()
    # A good fix still counts.
    good = fix(time, 3.0, 3.0, 1.0)
    subject.publish("global_pose", good)
    reference.on_measurement(measured(good))
    subject.peer.spin_for(0.2)
    move()
    subject.assert_dropped(dropped)
    assert {stamp(pose) for pose in poses} == {round((START + 0.1 * n) * 1e9) for n in range(1, len(poses) + 1)}


def test_filter_answers_a_repeated_odometry_with_the_same_pose_and_starts_anew_after_a_jump_back(start):
    subject = start("ekf")
    poses = subject.peer.subscribe(PoseWithCovarianceStamped, "pose", DEEP)
    subject.publish("global_pose", fix())
    subject.peer.spin_for(0.2)
    subject.publish("odom", odometry(START))
    first = ask(subject, "odom", odometry(START + 0.1), poses, START + 0.1)
    subject.publish("odom", odometry(START + 0.1, v=9.0))
    subject.peer.spin_until(lambda: len(poses) == 3, 5.0, "the repeated answer")
    assert planar(poses[2].pose.pose) == planar(first.pose.pose)
    subject.publish("odom", odometry(START - 100.0))
    subject.publish("odom", odometry(START - 99.9))
    subject.peer.spin_for(0.2)
    assert len(poses) == 3
    subject.publish("global_pose", fix(START - 99.9, x=7.0))
    subject.peer.spin_for(0.2)
    anew = ask(subject, "odom", odometry(START - 99.9), poses, START - 99.9)
    assert planar(anew.pose.pose) == pytest.approx((7.0, 2.0, 0.5), abs=1e-12)
    subject.assert_dropped([("odom", "time jumped back"), ("odom", "no fix yet")])


def test_fixes_from_the_future_do_not_shut_out_the_real_ones(start):
    """A sensor whose clock is far ahead must not fill the place where fixes wait for their odometry."""
    subject = start("ekf", {"gate_probability": 1.0})
    poses = subject.peer.subscribe(PoseWithCovarianceStamped, "pose", DEEP)
    subject.publish("global_pose", fix())
    subject.peer.spin_for(0.2)
    time = START
    for number in range(1010):
        subject.publish("global_pose", fix(START + 3600.0 + number, x=50.0))
        if number % 5 == 0:
            time += 0.01
            ask(subject, "odom", odometry(time, v=0.0, omega=0.0), poses, time)
    before = planar(poses[-1].pose.pose)
    assert before[0] == pytest.approx(1.0, abs=0.01)
    subject.publish("global_pose", fix(time, x=9.0))
    subject.peer.spin_for(0.2)
    time += 0.01
    ask(subject, "odom", odometry(time, v=0.0, omega=0.0), poses, time)
    assert planar(poses[-1].pose.pose)[0] > 3.0


@pytest.mark.parametrize(
    ("source", "topic", "estimate"),
    [("pose", "pose", fix), ("odometry", "odometry/filtered", filtered)],
    ids=["pose", "odometry"],
)
def test_controller_goes_on_as_if_the_bad_messages_had_not_come(start, source, topic, estimate):
    subject = start("controller", {"pose_source": source})
    commands = subject.peer.subscribe(Twist, "cmd_vel", DEEP)
    goal, memory = Pose(5.0, 1.0, 0.3), ControllerMemory()
    subject.publish(topic, estimate(START))
    subject.publish("goal_pose", pose_stamped(*goal))
    subject.peer.spin_until(lambda: "driving" in subject.process.output, 5.0, "the goal")
    time, dropped = START, []

    def move():
        nonlocal time, memory
        time = round(time + 0.1, 3)
        count = len(commands)
        pose = Pose(0.01 * (time - START), 0.5, 0.2)
        subject.publish(topic, estimate(time, *pose))
        subject.peer.spin_until(lambda: len(commands) > count, 5.0, "a command")
        memory, command, _ = step(memory, Estimate(pose, UNCERTAINTY), goal, 0.1, PRESETS["tuned"])
        assert len(commands) == count + 1, "one pose, one command"
        assert (commands[-1].linear.x, commands[-1].angular.z) == pytest.approx(tuple(command), abs=1e-9)

    spoiled = [(topic, *bad) for bad in bad_estimates(estimate(START))]
    spoiled += [("goal_pose", *bad) for bad in bad_poses(pose_stamped(0, 0, 0), "pose")]
    move()
    for spoiled_topic, message, kind in spoiled:
        subject.publish(spoiled_topic, message)
        dropped.append((spoiled_topic, kind))
        move()
    subject.assert_dropped(dropped)
    assert subject.process.output.count("goal: x") == 1


def test_plant_keeps_the_last_good_command(start):
    subject = start("plant", {"cmd_vel_timeout": 30.0, "drive_noise": 0.0})
    truths = subject.peer.subscribe(Odometry, "ground_truth", DEEP)
    good = Twist()
    good.linear.x, good.angular.z = 0.4, 0.2
    subject.publish("cmd_vel", good)
    subject.peer.spin_until(lambda: truths and truths[-1].twist.twist.linear.x > 0.3, 5.0, "motion")
    kinds = {"velocity not finite": [NAN, INF, -INF], "velocity out of range": [HUGE, -2e4]}
    dropped = []
    count = len(truths)
    for kind, numbers in kinds.items():
        for number in numbers:
            for field in ("linear__x", "angular__z"):
                subject.publish("cmd_vel", changed(good, **{field: number}))
                dropped.append(("cmd_vel", kind))
                subject.peer.spin_for(0.05)
    subject.peer.spin_until(lambda: len(truths) > count + 10, 5.0, "steps")
    twists = {(truth.twist.twist.linear.x, truth.twist.twist.angular.z) for truth in truths[count:]}
    assert len(twists) == 1
    assert next(iter(twists)) == pytest.approx((0.4, 0.2))
    # Only linear.x and angular.z mean anything to a robot with two wheels.
    subject.publish("cmd_vel", changed(good, linear__x=0.1, linear__y=NAN, angular__x=INF))
    subject.peer.spin_until(lambda: truths[-1].twist.twist.linear.x == pytest.approx(0.1), 5.0, "the new command")
    subject.assert_dropped(dropped)


@pytest.mark.parametrize("name", ["ekf", "controller"])
def test_nothing_random_ends_a_node_or_makes_it_send_what_is_not_finite(start, name):
    rng = random.Random(20240917)
    subject = start(name)
    sent = [
        subject.peer.subscribe(kind, topic, DEEP)
        for kind, topic in ((PoseWithCovarianceStamped, "pose"), (Odometry, "odometry/filtered"), (Twist, "cmd_vel"))
    ]
    makers = {
        "ekf": {"global_pose": fix, "initialpose": fix, "heading": heading, "odom": odometry},
        "controller": {"pose": fix, "goal_pose": lambda time: timed(pose_stamped(1, 1, 1), time)},
    }[name]
    for topic, make in makers.items():
        subject.publish(topic, make(START))
    for number in range(600):
        topic = rng.choice(list(makers))
        good = makers[topic](round(START + 0.02 * number, 3))
        subject.publish(topic, good if rng.random() < 0.4 else spoiled(rng, good))
        if number % 4 == 0:
            subject.peer.spin_for(0.004)
    subject.counts()
    assert subject.process.popen.poll() is None, subject.process.output
    assert "Traceback" not in subject.process.output
    outputs = [message for received in sent for message in received]
    # The test's node subscribes to pose, so its own bad ones are in the list of the controller's test.
    outputs = [one for one in outputs if name == "ekf" or isinstance(one, Twist)]
    assert len(outputs) > 30
    for message in outputs:
        assert all(map(math.isfinite, numbers_of(message))), message
    if name == "ekf":
        # It can be used again.
        subject.peer.call(Trigger, "ekf/reset")
        subject.publish("global_pose", fix(5000.0, x=4.0))
        subject.peer.spin_for(0.2)
        pose = ask(subject, "odom", odometry(5000.0), sent[0], 5000.0)
        assert planar(pose.pose.pose) == pytest.approx((4.0, 2.0, 0.5), abs=1e-9)


def numbers_of(message):
    if isinstance(message, Twist):
        return message.linear.x, message.linear.y, message.angular.z
    pose = message.pose.pose
    return (pose.position.x, pose.position.y, yaw(pose.orientation), *message.pose.covariance)
