"""The wall clock of the plant, /clock before its first message, without a publisher, and with contradictory times."""

import itertools
import time

import graph
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from robot import DEEP, SIMULATED, planar, pose_stamped, stamp
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from diffbot_control.controller_node import ControllerNode
from diffbot_control.goals.states import DRIVING
from diffbot_core.geometry import Pose
from diffbot_core.ros.node import DiffbotNode
from diffbot_core.uncertainty import CERTAIN
from diffbot_sim.parameters import PlantNodeConfig
from diffbot_sim.plant_node import PlantNode

PLACE = {"initial_pose.x": 3.0, "initial_pose.y": -1.0, "initial_pose.yaw": 1.0}
PERIOD = 100_000_000


def test_steps_have_the_period_and_time_of_the_wall_clock_and_a_paused_plant_sends_nothing(nodes):
    peer = nodes.peer
    clocks = peer.subscribe(Clock, "/clock", 100)
    truths = peer.subscribe(Odometry, "ground_truth", DEEP)
    nodes.add(PlantNode, {**PLACE, "start_paused": True})
    peer.wait_for_publishers("ground_truth")

    def pause(is_paused):
        return peer.call(SetBool, "plant/pause", SetBool.Request(data=is_paused)).message

    assert not truths
    began = time.time_ns()
    assert pause(False) == "running"
    peer.spin_until(lambda: len(truths) >= 15, what="15 steps")
    stamps = [stamp(message) for message in truths]
    assert {after - before for before, after in itertools.pairwise(stamps)} == {PERIOD}
    assert began <= stamps[0] <= time.time_ns()
    assert planar(truths[0].pose.pose) == (3.0, -1.0, 1.0)
    assert not clocks, "wall time needs no /clock"
    assert pause(True) == "paused"
    peer.spin_for(0.3)
    count = len(truths)
    peer.spin_for(1.0)
    assert len(truths) == count
    pause(False)
    peer.spin_until(lambda: len(truths) > count, what="steps")
    # Wall time continues during a pause.
    assert stamp(truths[count]) - stamp(truths[count - 1]) > 0.9e9


def test_a_goal_and_poses_before_the_first_clock_are_used_with_the_time_of_that_clock(nodes):
    node = nodes.add(ControllerNode, {"use_sim_time": True, "publish_when_idle": True, "goal_timeout": 10.0})
    node.goals.accept(pose_stamped(1.0, 2.0, 0.5), "action", "1" * 32)
    assert node.supervisor.goals.present.request.time == 0.0
    last, place = 5000 * 10**9, Pose(-3.0, 2.0, 0.5)
    node.take_pose(last - 10**8, place, CERTAIN)
    node.take_pose(last, place, CERTAIN)
    clocks = nodes.peer.publisher(Clock, "/clock")
    commands = nodes.peer.subscribe(Twist, "cmd_vel")
    nodes.peer.wait_for_publishers("cmd_vel")
    nodes.peer.wait_for_subscribers(clocks)
    clocks.publish(Clock(clock=Time(sec=5000)))
    nodes.peer.spin_until(lambda: node.clock_watch.now() == 5000.0, what="the clock")
    node.take_pose(last + 10**8, place, CERTAIN)
    nodes.peer.spin_until(lambda: commands, what="the answer")
    assert commands[0].linear.x > 0.0
    assert node.supervisor.status == DRIVING
    assert node.supervisor.elapsed <= 1.0


class Listener(DiffbotNode):
    def __init__(self, **options):
        super().__init__("listener", PlantNodeConfig, **options)


def test_a_missing_clock_and_two_times_from_one_publisher_are_reported_and_now_is_monotonic(nodes, monkeypatch, capfd):
    """A bridge may pass on two clocks."""
    for name in ("_WINDOW", "_SETTLE"):
        monkeypatch.setattr(f"diffbot_core.ros.watches.{name}", graph.PATIENCE)
    peer = nodes.peer
    node = nodes.add(Listener, SIMULATED)
    text = "use_sim_time is set, but nothing publishes /clock: time stands still"
    peer.spin_until(lambda: node.health_level() == (1, text), what="the report")
    assert "".join(capfd.readouterr()).count(text) == 1
    publisher = peer.publisher(Clock, "/clock")
    peer.wait_for_subscribers(publisher)
    peer.spin_until(lambda: node.health_level()[0] == 0, what="the all-clear")

    def publish(seconds):
        message = Clock()
        message.clock.sec = seconds
        publisher.publish(message)
        peer.spin_until(lambda: node.get_clock().now().nanoseconds == seconds * 10**9, what=f"the time {seconds} s")
        return node.clock_watch.now()

    assert publish(100) == 100.0
    assert publish(101) == 101.0
    assert publish(20) == 20.0, "one jump back is a simulation that was started again"
    assert node.clock_watch.problem == "time on /clock jumped back"
    assert not node.clock_watch.contradictory
    readings = [publish(seconds) for seconds in (500, 21, 501, 22, 502, 23, 503)]
    assert node.clock_watch.contradictory
    assert "jumps to and fro" in node.clock_watch.problem
    assert node.health_level()[0] == 2
    assert readings[-4:] == sorted(readings[-4:])
    # They advance by the real time between them and not by the jumps of 480 s.
    assert readings[-1] - readings[-4] < 240.0
