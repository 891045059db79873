"""The recorder as a process: its services, splits under load, and what it attaches to each file."""

import json

import graph
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from mcap.reader import make_reader
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from diffbot_bag import metadata
from diffbot_bag.reader import BagReader

pytestmark = pytest.mark.graph

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEEP = 10_000


@pytest.fixture
def peer():
    with graph.peer() as running:
        yield running


class Recorder:
    """A running recorder of /data and the latched /map."""

    def __init__(self, peer, running, first=1):
        """Wait until both topics are recorded and the file has ``first`` messages."""
        self.peer, self.running = peer, running
        self.data, self.map = peer.publisher(Twist, "data", DEEP), peer.publisher(String, "map", LATCHED)
        self.reports = peer.subscribe(DiagnosticStatus, "/recorder/status", LATCHED)
        self.map.publish(String(data="map"))
        self.sent = 0
        peer.spin_until(lambda: self.value("topics") == "/data /map", what="both topics")
        self.wait("messages", first)

    def value(self, key):
        return graph.values(self.reports[-1])[key] if self.reports else ""

    def wait(self, key, expected):
        self.peer.spin_until(lambda: self.value(key) == str(expected), 20.0, f"{key} = {expected}")

    def publish(self, count):
        for _ in range(count):
            self.sent += 1
            message = Twist()
            message.linear.x = float(self.sent)
            self.data.publish(message)

    def call(self, service):
        answer = self.peer.call(Trigger, f"/recorder/{service}")
        return answer.success, answer.message


def record(folder, **parameters):
    return graph.node("diffbot_bag.recorder_node", {"uri": folder, "topics": ["/data", "/map"], **parameters})


def numbers(folder, topic):
    """Sequence numbers of a topic, by file."""
    found = []
    for name in metadata.read(folder).files:
        with (folder / name).open("rb") as stream:
            found.append([one.sequence for _, _, one in make_reader(stream).iter_messages(topics=[topic])])
    return found


def test_splits_by_size_and_service_lose_and_repeat_nothing(tmp_path, peer):
    limits = {"max_bag_size": 20_000, "chunk_size": 2000, "compression": "lz4", "topic_polling_interval": 0.05}
    with record(tmp_path / "run", **limits) as running:
        recorder = Recorder(peer, running)
        recorder.publish(100)
        recorder.wait("messages", 101)
        file = recorder.value("file")
        assert recorder.call("split_bagfile") == (True, f"{file} is complete")
        assert recorder.call("split_bagfile")[0] is False
        recorder.publish(5000)
        recorder.wait("messages", 5101)
        assert running.stop() == 0
        assert "5101 messages, 0 lost" in running.output
    by_file = numbers(tmp_path / "run", "/data")
    assert by_file[0] == list(range(1, 101))
    assert len(by_file) >= 5
    assert [number for file in by_file for number in file] == list(range(1, 5101))
    assert numbers(tmp_path / "run", "/map") == [[1]] * len(by_file)


def test_a_snapshot_is_written_when_asked_for(tmp_path, peer):
    with record(tmp_path / "run", snapshot_mode=True, max_cache_size=2**20) as running:
        recorder = Recorder(peer, running, first=0)
        recorder.publish(5000)
        peer.spin_until(lambda: int(recorder.value("in memory") or 0) > 3000, what="messages in memory")
        peer.spin_for(1.0)
        assert recorder.value("messages") == "0"
        success, text = recorder.call("snapshot")
        assert success
        recorder.wait("in memory", 0)
        recorder.wait("messages", int(text.split()[0]))
        assert running.stop() == 0
    (newest,) = numbers(tmp_path / "run", "/data")
    assert newest == list(range(5001 - len(newest), 5001))
    assert 3000 < len(newest) < 4000, "a megabyte"
    assert numbers(tmp_path / "run", "/map") == [[1]]


def test_a_pause_is_no_loss(tmp_path, peer):
    with record(tmp_path / "run", start_paused=True) as running:
        recorder = Recorder(peer, running)
        assert recorder.call("is_paused") == (True, "paused")
        recorder.publish(10)
        peer.wait_for_subscribers(recorder.data)
        assert recorder.data.wait_for_all_acked()
        peer.spin_for(0.5)
        assert recorder.call("resume") == (True, "recording")
        recorder.publish(10)
        recorder.wait("messages", 11)
        assert recorder.call("pause") == (True, "paused")
        assert recorder.reports[-1].message == "paused"
        assert running.stop() == 0
        assert "11 messages, 0 lost" in running.output
    assert numbers(tmp_path / "run", "/data") == [list(range(11, 21))]


def test_parameters_of_all_nodes_and_the_host_are_attached(tmp_path):
    with graph.peer("asked", start_parameter_services=True) as peer, record(tmp_path / "run") as running:
        peer.node.declare_parameter("gain", 0.25)
        peer.node.declare_parameter("names", ["a", "b"])
        Recorder(peer, running)
        # Written at once, not only at the end: a killed recorder has them, too.
        content = b'"gain": 0.25'
        peer.spin_until(lambda: content in (tmp_path / "run" / "run_0.mcap").read_bytes(), 20.0, "the parameters")
        assert running.stop() == 0
    with BagReader(tmp_path / "run") as reader:
        found = reader.node_parameters()
        host = json.loads(reader.attachment("host.json"))
    assert found["/asked"]["gain"] == 0.25
    assert found["/asked"]["names"] == ["a", "b"]
    assert found["/recorder"]["uri"] == str(tmp_path / "run")
    assert host["package"]["diffbot"]


def test_a_node_that_does_not_answer_delays_nothing(tmp_path, peer):
    with graph.peer("silent", start_parameter_services=True) as silent, record(tmp_path / "run") as running:
        # It has the services, and nobody who spins it.
        recorder = Recorder(peer, running)
        recorder.publish(100)
        recorder.wait("messages", 101)
        assert running.stop() == 0
        assert silent.node.get_name() == "silent"
    with BagReader(tmp_path / "run") as reader:
        assert "/recorder" in reader.node_parameters()
        assert "/silent" not in reader.node_parameters()


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"qos_profile_overrides_path": "/none.yaml"}, "cannot open /none.yaml: No such file"),
        ({"max_bag_size": 5}, "max_bag_size = 5: must be 0 or >= chunk_size"),
    ],
)
def test_what_is_refused_is_one_line_and_no_folder(tmp_path, parameters, words):
    with record(tmp_path / "run", **parameters) as running:
        assert running.wait() == 1
        (line,) = running.output.splitlines()
        assert words in line
    assert not (tmp_path / "run").exists()
