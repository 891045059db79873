"""Two robots in one graph: topics and frames apart, one clock for both, and what two clocks do."""

import itertools
from collections import Counter

import one_process
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TwistStamped
from nav_msgs.msg import Odometry
from robot import DEEP, LATCHED, pose_stamped, stamp
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from std_srvs.srv import SetBool

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_core.errors import InvalidValueError
from diffbot_core.ros.node import DiffbotNode
from diffbot_core.schema import build
from diffbot_sim.plant_node import PlantNode
from diffbot_sim.ros.parameters import PlantNodeConfig

SIMULATED = {"use_sim_time": True}
PERIOD = 100_000_000


def add_robot(nodes, name, plant, others=SIMULATED):
    """Add plant, filter and controller under ``/name`` with the frame prefix ``name/``."""
    arguments = ("-r", f"__ns:=/{name}")
    frames = {"frame_prefix": f"{name}/"}
    nodes.add(EkfNode, {**frames, **others}, arguments)
    controller = nodes.add(ControllerNode, {**frames, **others, "enable_stamped_cmd_vel": True}, arguments)
    plant = {"enable_stamped_cmd_vel": True, **frames, **plant}
    return controller, nodes.add(PlantNode, plant, arguments)


def subscribed(peer, name):
    """Return what is received of one robot, by topic."""
    kinds = {
        "odom": Odometry,
        "odometry/filtered": Odometry,
        "ground_truth": Odometry,
        "pose": PoseWithCovarianceStamped,
        "global_pose": PoseWithCovarianceStamped,
        "heading": Imu,
        "cmd_vel": TwistStamped,
    }
    return {topic: peer.subscribe(kind, f"/{name}/{topic}", DEEP) for topic, kind in kinds.items()}


def go(peer, name, *goal):
    goals = peer.publisher(PoseStamped, f"/{name}/goal_pose")
    peer.wait_for_subscribers(goals)
    goals.publish(pose_stamped(*goal))


def frames_of(message):
    return message.header.frame_id, getattr(message, "child_frame_id", "")


@pytest.fixture
def nodes():
    with one_process.nodes() as running:
        yield running


def test_topics_and_frames_of_two_robots_are_apart(nodes):
    """On the wall clock; each goes to its own goal and receives nothing of the other's."""
    peer = nodes.peer
    received = {name: subscribed(peer, name) for name in ("left", "right")}
    controllers = {}
    for name, heading_rate in (("left", 10.0), ("right", 10.0)):
        plant = {"heading_rate": heading_rate, "initial_pose.x": 0.0, "sampling_time": 0.02, "fix_rate": 50.0}
        controllers[name], _ = add_robot(nodes, name, plant, {})
    go(peer, "left", 0.4, 0.0, 0.0)
    peer.spin_until(lambda: controllers["left"].supervisor.goals_reached == 1, 15.0, "the left robot at its goal")
    peer.spin_until(lambda: all(received["right"][one] for one in ("pose", "heading")), 5.0, "poses of the right one")
    assert not received["right"]["cmd_vel"], "the left robot's goal is not the right one's"
    for name, topics in received.items():
        expected = {
            "odom": (f"{name}/odom", f"{name}/base_link"),
            "odometry/filtered": ("map", f"{name}/base_link"),
            "ground_truth": ("map", f"{name}/base_link"),
            "pose": ("map", ""),
            "global_pose": ("map", ""),
            "heading": (f"{name}/base_link", ""),
            "cmd_vel": (f"{name}/base_link", ""),
        }
        for topic, messages in topics.items():
            assert {frames_of(one) for one in messages} <= {expected[topic]}, (name, topic)
    for controller in controllers.values():
        assert not controller.health.dropped
    absolute = {"/diagnostics", "/parameter_events", "/rosout", "/tf", "/clock"}

    def first_words():
        names = {name for name, _ in peer.node.get_topic_names_and_types()} - absolute
        # rclpy keeps this publisher of a lifecycle node until the process ends, here that of other tests.
        return {name.split("/")[1] for name in names if not name.endswith("/transition_event")}

    # Nodes of other tests may stay listed for 20 s.
    peer.spin_until(lambda: first_words() == {"left", "right"}, 30.0, f"left and right alone, not {first_words()}")


def changes_in_a_second(states):
    """Return the most changes of state in any second of [(time [s], state), ...]."""
    times = [later[0] for former, later in itertools.pairwise(states) if former[1] != later[1]]
    return max((sum(first <= one < first + 1.0 for one in times) for first in times), default=0)


def test_two_clocks_are_named_as_an_error_and_stop_both_robots_without_flickering(nodes, capfd):
    peer = nodes.peer
    states = {"left": [], "right": []}
    for name, history in states.items():
        peer.node.create_subscription(
            DiagnosticStatus,
            f"/{name}/controller/status",
            lambda message, history=history: history.append(
                (peer.node.get_clock().now().nanoseconds / 1e9, message.message)
            ),
            LATCHED,
        )
    reports = peer.subscribe(DiagnosticArray, "/diagnostics", DEEP)
    scaled = {"clock": "scaled", "real_time_factor": 2.0, "start_time": 1000.0}
    add_robot(nodes, "left", scaled)
    go(peer, "left", 60.0, 0.0, 0.0)
    peer.spin_until(lambda: states["left"] and states["left"][-1][1] == "driving", 8.0, "the left robot's drive")
    # Minutes apart: far more than any timeout.
    add_robot(nodes, "right", {**scaled, "start_time": 5000.0})
    reports.clear()
    text = "2 publishers of /clock, only one may own time: /left/plant, /right/plant"

    def named():
        errors = {one.name for array in reports for one in array.status if one.level == b"\x02" and text in one.message}
        return len(errors) == 6

    peer.spin_until(named, 2.0, "the error of all six nodes")
    go(peer, "right", 60.0, 0.0, 0.0)
    stopped = {"left": "stale pose", "right": "waiting for pose"}
    peer.spin_until(lambda: {name: one[-1][1] for name, one in states.items()} == stopped, 3.0, "the stop of both")
    for history in states.values():
        del history[:-1]
    capfd.readouterr()
    peer.spin_for(3.0)
    for name, history in states.items():
        assert changes_in_a_second(history) <= 1, (name, history)
        assert history[-1][1] == stopped[name]
    lines = Counter(line.split("]: ")[-1] for line in "".join(capfd.readouterr()).splitlines())
    assert all(count <= 6 * 3 for count in lines.values()), lines


def test_one_plant_of_two_owns_time_and_the_other_follows_it(nodes):
    peer = nodes.peer
    clocks, own, other = (
        peer.subscribe(Clock, "/clock", DEEP),
        peer.subscribe(Odometry, "/left/odom", DEEP),
        peer.subscribe(Odometry, "/right/odom", DEEP),
    )
    scaled = {"clock": "scaled", "start_time": 1000.0}
    # Half the period of the one that owns time.
    nodes.add(PlantNode, {**scaled, "publish_clock": False, "sampling_time": 0.05, **SIMULATED}, ("-r", "__ns:=/right"))
    peer.spin_for(0.5)
    assert not other, "no time, no step"
    nodes.add(PlantNode, {**scaled, "real_time_factor": 4.0}, ("-r", "__ns:=/left"))
    peer.spin_until(lambda: len(own) > 40, 8.0, "40 steps")
    assert peer.call(SetBool, "/left/plant/pause", SetBool.Request(data=True)).success
    peer.spin_for(0.3)
    assert {info.node_namespace for info in peer.node.get_publishers_info_by_topic("/clock")} == {"/left"}
    stamps = [stamp(one) for one in other]
    steps = Counter(after - before for before, after in itertools.pairwise(stamps))
    assert steps == {PERIOD // 2: len(stamps) - 1}
    newest = max(one.clock.sec * 10**9 + one.clock.nanosec for one in clocks)
    assert abs(newest - stamps[-1]) < PERIOD
    peer.spin_for(0.5)
    assert len(other) == len(stamps), "it stands still in the pause of the other"


class Listener(DiffbotNode):
    """A node with use_sim_time and nothing else."""

    def __init__(self, **options):
        super().__init__("listener", PlantNodeConfig, **options)


def problem_of(reports, name):
    found = [one for array in reports for one in array.status if one.name == name]
    return (found[-1].level, found[-1].message) if found else None


def test_a_missing_clock_is_reported_after_two_seconds_and_its_coming_too(nodes, capfd):
    peer = nodes.peer
    reports = peer.subscribe(DiagnosticArray, "/diagnostics", DEEP)
    node = nodes.add(Listener, SIMULATED)
    begin = node.steady_clock.now().nanoseconds
    text = "use_sim_time is set, but nothing publishes /clock: time stands still"
    peer.spin_until(lambda: problem_of(reports, "/listener") == (b"\x01", text), 4.0, "the report")
    assert 2.0 <= (node.steady_clock.now().nanoseconds - begin) * 1e-9 <= 10.0
    assert "".join(capfd.readouterr()).count(text) == 1
    publisher = peer.publisher(Clock, "/clock")
    peer.wait_for_subscribers(publisher)
    peer.spin_until(lambda: problem_of(reports, "/listener") == (b"\x00", "ok"), 4.0, "the all-clear")


def test_time_that_jumps_to_and_fro_from_one_publisher_is_an_error_and_now_runs_on(nodes):
    """As of a bridge that passes on two clocks."""
    peer = nodes.peer
    node = nodes.add(Listener, SIMULATED)
    publisher = peer.publisher(Clock, "/clock")
    peer.wait_for_subscribers(publisher)

    def tell(seconds):
        message = Clock()
        message.clock.sec = seconds
        publisher.publish(message)
        peer.spin_until(lambda: node.get_clock().now().nanoseconds == seconds * 10**9, 3.0, f"the time {seconds} s")
        return node.clock_watch.now()

    assert tell(100) == 100.0
    assert tell(101) == 101.0
    assert tell(20) == 20.0, "one jump back is a simulation that was started again"
    assert node.clock_watch.problem == "time on /clock jumped back"
    assert not node.clock_watch.contradictory
    readings = [tell(seconds) for seconds in (500, 21, 501, 22, 502, 23, 503)]
    assert node.clock_watch.contradictory
    assert "jumps to and fro" in node.clock_watch.problem
    assert node.health_level()[0] == 2
    assert all(0.0 <= after - before < 3.0 for before, after in itertools.pairwise(readings[-4:])), readings


def test_lockstep_needs_its_clock():
    with pytest.raises(InvalidValueError, match=r"publish_clock = False: must be true with clock = 'lockstep'"):
        build(PlantNodeConfig, {"clock": "lockstep", "publish_clock": False})
