"""The services of a running recorder, splits, and what it attaches to each file."""

import secrets

import cut_bags
import graph
import one_process
import pytest
from geometry_msgs.msg import Twist
from recorders import DEEP, LATCHED, Recorder, publish, twists
from std_msgs.msg import String
from std_srvs.srv import Trigger

from diffbot_bag.bag import metadata
from diffbot_bag.bag.reader import BagReader
from diffbot_bag.ros import node_parameters

pytestmark = pytest.mark.graph


class Recording:
    """A recorder of /data and the latched /map, ready, and what is published to it."""

    def __init__(self, nodes, folder, **parameters):
        """Wait until the latched message has come: later it could take the place of others."""
        self.peer, self.sent = nodes.peer, 0
        self.data, latched = self.peer.publisher(Twist, "data", DEEP), self.peer.publisher(String, "map", LATCHED)
        latched.publish(String(data="map"))
        self.recorder = Recorder(nodes, folder, topics=["/data", "/map"], **parameters)
        self.recorder.wait_for(self.data, latched)
        nodes.peer.spin_until(lambda: self.recorder.node.health.accepted["/map"] == 1, what="the latched message")
        self.close = self.recorder.close

    def publish(self, count):
        publish(self.data, twists(count))
        self.sent += count

    def call(self, service):
        answer = self.peer.call(Trigger, f"/recorder/{service}")
        return answer.success, answer.message


def numbers(folder, topic):
    """Sequence numbers of a topic, by file."""
    files = [cut_bags.facts(folder / name) for name in metadata.read(folder).files]
    return [[one.sequence for one in file if one.topic == topic] for file in files]


def test_splits_by_size_and_service_lose_and_repeat_nothing(tmp_path, nodes):
    limits = {"max_bag_size": 20_000, "chunk_size": 2000, "compression": "lz4"}
    recording = Recording(nodes, tmp_path / "run", **limits)
    recording.publish(100)
    recording.recorder.wait("messages", 101)
    file = recording.recorder.value("file")
    assert recording.call("split_bagfile") == (True, f"{file} is complete")
    assert recording.call("split_bagfile")[0] is False
    recording.publish(4000)
    recording.close()
    by_file = numbers(tmp_path / "run", "/data")
    assert by_file[0] == list(range(1, 101))
    assert len(by_file) >= 5
    assert [number for file in by_file for number in file] == list(range(1, 4101))
    assert numbers(tmp_path / "run", "/map") == [[1]] * len(by_file)


def test_a_slow_recording_with_default_parameters_splits_and_deletes_the_oldest_files(tmp_path, nodes):
    size = 2**19
    recorder = Recorder(nodes, tmp_path / "run", topics=["/text"], max_bag_size=size, max_bag_files=2)
    text = nodes.peer.publisher(String, "text", DEEP)
    recorder.wait_for(text)
    # 1.7 MB in chunks smaller than chunk_size, each written by a flush.
    for number in range(1, 15):
        text.publish(String(data=secrets.token_hex(120_000)))
        nodes.peer.spin_until(
            lambda number=number: recorder.node._writer.count == number and not recorder.node._writer.unflushed,
            what="a flush",
        )
        assert len(cut_bags.files_of(tmp_path / "run")) <= 2
    recorder.close()
    kept = cut_bags.files_of(tmp_path / "run")
    assert len(kept) == 2
    assert all(path.stat().st_size < 1.3 * size for path in kept)
    assert len(cut_bags.check_metadata(tmp_path / "run")) < 14


def test_a_pause_is_no_loss(tmp_path, nodes):
    recording = Recording(nodes, tmp_path / "run", start_paused=True)
    assert recording.call("is_paused") == (True, "paused")
    recording.publish(10)
    nodes.peer.spin_until(lambda: recording.recorder.node.health.accepted["/data"] == 10, what="all messages")
    assert recording.call("resume") == (True, "recording")
    recording.publish(10)
    recording.recorder.wait("messages", 11)
    assert recording.call("pause") == (True, "paused")
    nodes.peer.spin_until(lambda: recording.recorder.reports[-1].message == "paused", what="the report")
    recording.close()
    assert metadata.read(tmp_path / "run").custom_data == {"lost_messages": "0"}
    assert numbers(tmp_path / "run", "/data") == [list(range(11, 21))]


def test_parameters_of_the_nodes_that_answer_are_attached_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(node_parameters, "DEADLINE", graph.PATIENCE)
    services = {"start_parameter_services": True}
    # The second has the services, and nobody who spins it; by its name it is asked first.
    with one_process.nodes(name="asked", **services) as nodes, graph.peer("a_silent_one", **services):
        nodes.peer.node.declare_parameter("gain", 0.25)
        nodes.peer.node.declare_parameter("names", ["a", "b"])
        recording = Recording(nodes, tmp_path / "run")
        path, asking = tmp_path / "run" / "run_0.mcap", recording.recorder.node._parameters_of_all
        nodes.peer.spin_until(
            lambda: asking._question and asking._question.name == "/a_silent_one", what="the question to it"
        )
        asking._question._end = 0.0
        # Not only at the end: a killed recorder has them, too.
        nodes.peer.spin_until(lambda: b'"gain": 0.25' in path.read_bytes(), what="the parameters")
        recording.close()
    with BagReader(tmp_path / "run") as reader:
        found = reader.node_parameters()
    assert (found["/asked"]["gain"], found["/asked"]["names"]) == (0.25, ["a", "b"])
    assert found["/recorder"]["uri"] == str(tmp_path / "run")
    assert "/a_silent_one" not in found
