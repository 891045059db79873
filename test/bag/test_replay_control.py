"""A running replay is controlled: parameters, services, keys of a terminal; several bags, and slow subscribers."""

import contextlib
import os
import signal
import termios
import threading
import time

import graph
import pytest
from bag_makers import BEGIN, point
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from replays import MS, write_mcap, write_rosbags
from std_srvs.srv import Trigger
from terminals import in_terminal

pytestmark = pytest.mark.graph

REPLAY = "diffbot_bag.replay_node"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)
DEEP = 20_000
PATIENCE = 60.0


@pytest.fixture
def peer():
    with graph.peer() as running:
        yield running


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Ten seconds: /a at 100 Hz, the latched /map at 0, 3 and 6 s."""
    messages = [("/a", BEGIN + index * 10 * MS, point(index)) for index in range(1001)]
    messages += [("/map", BEGIN + second * 1000 * MS + 1, point(-second)) for second in (0, 3, 6)]
    path = tmp_path_factory.mktemp("bags") / "run.mcap"
    return write_mcap(path, sorted(messages, key=lambda message: message[1]), latched=("/map",))


@contextlib.contextmanager
def replay(bag, parameters=None, **options):
    quick = {"uri": bag, "wait_timeout": 10.0, "wait_acked_timeout": -1.0}
    with graph.node(REPLAY, {**quick, **(parameters or {})}, **options) as running:
        yield running


class Controlled:
    """A replay and what the test's node receives of it, in one list."""

    def __init__(self, peer):
        self.peer, self.messages = peer, []
        for topic, qos in (("/a", DEEP), ("/map", LATCHED)):
            peer.node.create_subscription(Point, topic, self._append(topic), qos)
        self.reports = peer.subscribe(DiagnosticStatus, "/replay/status", LATCHED)

    def _append(self, topic):
        return lambda message: self.messages.append((topic, message.x))

    def set(self, **values):
        """Set parameters one by one; return the reason of the last refusal, or an empty text."""
        parameters = [
            Parameter(name=name, value=RosParameter(name, value=value).get_parameter_value())
            for name, value in values.items()
        ]
        request = SetParameters.Request(parameters=parameters)
        results = self.peer.call(SetParameters, "/replay/set_parameters", request, PATIENCE).results
        return next((result.reason for result in results if not result.successful), "")

    def call(self, name):
        return self.peer.call(Trigger, f"/replay/{name}", timeout=PATIENCE)

    def wait_for(self, count):
        """Messages in their order, by topic: DDS does not keep an order between topics."""
        self.peer.spin_until(lambda: len(self.messages) >= count, PATIENCE, f"{count} messages")
        return sorted(self.messages, key=lambda message: message[0])


def test_seek_burst_and_rate_by_parameters(peer, bag):
    controlled = Controlled(peer)
    with replay(bag, {"start_paused": True, "clock": 50.0, "burst": 2}) as running:
        assert controlled.wait_for(2) == [("/a", 0.0), ("/map", 0.0)]
        # The same jump twice: to the very message, with the latched one of before it.
        for _ in range(2):
            controlled.messages.clear()
            assert controlled.set(seek=4.56) == ""
            assert controlled.set(burst=3) == ""
            assert controlled.wait_for(4) == [("/a", 456.0), ("/a", 457.0), ("/a", 458.0), ("/map", -3.0)]
        controlled.messages.clear()
        assert controlled.set(seek=0.0) == ""
        assert controlled.call("play_next").success
        assert controlled.wait_for(1) == [("/a", 0.0)]
        assert controlled.set(seek=10.5) == "seek = 10.5: must be >= 0 s and <= 10 s, the part that is played"
        assert controlled.set(seek="soon") == "seek = 'soon': must be a number"
        assert controlled.set(rate=0.0) == "rate = 0.0: must be >= 1e-06 and <= 1e+06"
        assert controlled.set(burst=-1).startswith("burst = -1: must be >= 0")
        assert controlled.set(rate=1e-6) == ""
        assert controlled.call("get_rate").message == "1e-06"
        assert controlled.call("resume").success
        assert controlled.set(burst=3) == "burst = 3: must be set while the replay is paused"
        # /map comes 1 ns later in the bag, which is 1 ms at this rate; the next /a would come after hours.
        assert controlled.wait_for(2) == [("/a", 0.0), ("/map", 0.0)]
        peer.spin_for(0.1)
        assert len(controlled.messages) == 2
        assert controlled.set(rate=1000.0) == ""
        assert running.wait(PATIENCE) == 0
    peer.spin_until_quiet()
    assert [x for topic, x in controlled.messages if topic == "/a"] == list(range(1001))
    assert graph.values(controlled.reports[-1])["rate"] == "1000"


def test_a_bad_control_at_the_start_is_one_line(bag, tmp_path):
    (tmp_path / "qos.yaml").write_text("/a: {depth: none}\n")
    other = write_mcap(tmp_path / "other.mcap", [("/a", BEGIN, point(0))], kind="geometry_msgs/msg/Vector3")
    cases = {
        "burst = 3: must be 0, unless start_paused is true": {"burst": 3},
        "/a: not a QoS profile: {": {"qos_profile_overrides_path": tmp_path / "qos.yaml"},
        "/a is geometry_msgs/msg/Point in": {"bags": [str(other)]},
    }
    with contextlib.ExitStack() as stack:
        running = [stack.enter_context(graph.node(REPLAY, {"uri": bag, **parameters})) for parameters in cases.values()]
        for process, words in zip(running, cases, strict=True):
            assert process.wait(PATIENCE) == 1
            (line,) = process.output.splitlines()
            assert words in line


class SlowSubscriber:
    """A reliable subscriber, in a thread of its own, that takes a message only every ``period`` [s]."""

    def __init__(self, peer, topics, period):
        self.messages = []
        self._stop = threading.Event()
        self._node = Node("slow", context=peer.context)
        self._executor = SingleThreadedExecutor(context=peer.context)
        for topic in topics:
            self._node.create_subscription(Point, topic, self._append(topic, period), KEEP_ALL)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin)

    def _append(self, topic, period):
        def append(message):
            self.messages.append((topic, message.x))
            time.sleep(period)

        return append

    def _spin(self):
        while not self._stop.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()


def test_merged_bags_as_fast_as_a_slow_subscriber_takes_them(peer, tmp_path):
    one = [("/a", BEGIN + index * 200 * MS, point(index)) for index in range(2000)]
    two = [("/a", BEGIN + (index * 200 + 100) * MS, point(index + 0.5)) for index in range(2000)]
    two += [("/b", time + 1, data) for _, time, data in two]
    first = write_mcap(tmp_path / "one.mcap", one)
    second = write_rosbags(tmp_path / "two", sorted(two, key=lambda message: message[1]))
    (tmp_path / "qos.yaml").write_text("/b: {reliability: best_effort}\n")  # offered reliably all the same
    parameters = {
        "bags": [str(second)],
        "as_fast_as_possible": True,
        "max_unacknowledged": 100,
        "wait_acked_timeout": 20.0,
        "qos_profile_overrides_path": tmp_path / "qos.yaml",
    }
    with SlowSubscriber(peer, ("/a", "/b"), 0.0005) as slow:
        began = time.monotonic()
        with replay(first, parameters) as running:
            assert running.wait(3 * PATIENCE) == 0
            assert "6000 messages in " in running.output
            assert "not acknowledged" not in running.output
        graph.wait_for(lambda: len(slow.messages) == 6000, PATIENCE, "all messages")
        # Bags of 400 s, sent faster than they were recorded.
        assert time.monotonic() - began < 300.0
    assert [x for topic, x in slow.messages if topic == "/a"] == [index / 2 for index in range(4000)]
    assert [x for topic, x in slow.messages if topic == "/b"] == [index + 0.5 for index in range(2000)]


@pytest.mark.parametrize(("pause", "count", "wait_acked_timeout"), [(0.0, 6000, 60.0), (2.0, 12_000, 0.3)])
def test_faster_than_dds_nothing_is_lost_and_a_subscriber_that_takes_nothing_is_named(
    peer, tmp_path, pause, count, wait_acked_timeout
):
    # DDS keeps 5000 messages on either side.
    path = write_mcap(tmp_path / "run.mcap", [("/a", BEGIN + index * MS, point(index)) for index in range(count)])
    with SlowSubscriber(peer, ("/a",), pause) as slow:
        with replay(path, {"rate": 20.0, "wait_acked_timeout": wait_acked_timeout}) as running:
            assert running.wait(3 * PATIENCE) == 0
            assert f"{count} messages in " in running.output
            named = f"/a: not acknowledged after {wait_acked_timeout:g} s, messages may be lost from now on"
            assert (named in running.output) == (pause > 0.0)
        if pause == 0.0:
            graph.wait_for(lambda: len(slow.messages) == count, PATIENCE, "all messages")
            assert [x for _, x in slow.messages] == list(range(count))


def test_qos_overrides_are_offered(peer, bag, tmp_path):
    (tmp_path / "qos.yaml").write_text(
        "/a: {reliability: best_effort, deadline: {sec: 2, nsec: 0}}\n/map: {durability: volatile}\n"
    )
    with replay(bag, {"start_paused": True, "qos_profile_overrides_path": tmp_path / "qos.yaml"}):
        infos = {}

        def seen():
            infos.update({name: peer.node.get_publishers_info_by_topic(name) for name in ("/a", "/map")})
            return all(infos.values())

        peer.spin_until(seen, PATIENCE, "publishers")
    a, latched = (infos[name][0].qos_profile for name in ("/a", "/map"))
    assert (a.reliability, a.deadline.nanoseconds) == (ReliabilityPolicy.BEST_EFFORT, 2 * 10**9)
    assert (latched.reliability, latched.durability) == (ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)


def test_keys_pause_step_and_change_the_rate_and_ctrl_c_restores_the_terminal(peer, bag, terminal):
    ours, theirs = terminal
    before = termios.tcgetattr(theirs)
    controlled = Controlled(peer)
    with replay(bag, {"rate": 0.5}, **in_terminal(theirs)) as running:
        running.wait_for_output("keys: space", PATIENCE)
        controlled.wait_for(5)
        os.write(ours, b" ")
        peer.spin_until(lambda: controlled.call("is_paused").message == "paused", PATIENCE, "the pause")
        peer.spin_until_quiet()
        count = len(controlled.messages)
        os.write(ours, b"\x1b[C\x1b[C")
        controlled.wait_for(count + 2)
        os.write(ours, b"\x1b[A\x1b[A\x1b[B")
        # Up twice and down once: 10 % of what it was each time.
        peer.spin_until(
            lambda: float(controlled.call("get_rate").message) == pytest.approx(0.5 * 1.1 * 1.1 * 0.9),
            PATIENCE,
            "the rate",
        )
        peer.spin_until_quiet()
        assert len(controlled.messages) == count + 2
        assert running.popen.poll() is None
        os.write(ours, b"\x03")
        assert running.wait(PATIENCE) == 0
    assert termios.tcgetattr(theirs) == before


@pytest.mark.parametrize("is_disabled", [False, True])
def test_sigterm_restores_the_terminal_and_keys_can_be_disabled(bag, terminal, is_disabled):
    ours, theirs = terminal
    before = termios.tcgetattr(theirs)
    parameters = {"wait_timeout": 0.0, "disable_keyboard_controls": is_disabled}
    with replay(bag, parameters, **in_terminal(theirs)) as running:
        running.wait_for_output("ready", PATIENCE)
        assert (termios.tcgetattr(theirs) == before) is is_disabled
        os.write(ours, b" ")
        assert running.stop(signal.SIGTERM) == 0
        assert ("keys: space" in running.output) is not is_disabled
    assert termios.tcgetattr(theirs) == before
