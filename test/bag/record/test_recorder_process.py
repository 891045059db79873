"""The recorder as a process: signals, a kill, a full disk, and what it refuses to start with."""

import contextlib
import re
import resource
import signal
import struct

import graph
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from mcap.exceptions import EndOfFile
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rclpy.duration import Duration
from recorders import DEEP, LATCHED, publish, recorded, twists

from diffbot_bag.bag import metadata
from diffbot_bag.tools.repair import repair_bag

pytestmark = pytest.mark.graph

RECORDER = "diffbot_bag.recorder_node"


@pytest.fixture
def peer():
    with graph.peer() as running:
        yield running


def wait_until_recorded(peer, *publishers):
    """Wait until the recorder reports these topics as subscribed; return its reports."""
    reports = peer.subscribe(DiagnosticStatus, "/recorder/status", LATCHED)
    names = {publisher.topic_name for publisher in publishers}
    peer.spin_until(lambda: reports and names <= set(graph.values(reports[-1])["topics"].split()), what=f"{names}")
    return reports


def messages_of(path):
    """Data in the order of a file that may have no end."""
    with path.open("rb") as stream, contextlib.suppress(EndOfFile, struct.error):
        for record in StreamReader(stream).records:
            if isinstance(record, Message):
                yield record.data


def test_a_burst_is_recorded_to_the_byte_and_further_signals_do_not_cut_the_end_short(tmp_path, peer):
    publisher = peer.publisher(Twist, "burst", DEEP)
    with graph.node(RECORDER, cwd=tmp_path) as running:
        wait_until_recorded(peer, publisher)
        sent = publish(publisher, twists(5000))
        assert publisher.wait_for_all_acked(Duration(seconds=graph.PATIENCE))
        running.send(signal.SIGTERM)
        with contextlib.suppress(ProcessLookupError):
            while running.popen.poll() is None:
                running.send(signal.SIGINT)
        assert running.wait() == 0
        # The default name is that of rosbag2.
        (folder,) = tmp_path.iterdir()
        assert re.fullmatch(r"rosbag2_\d{4}(_\d\d){2}-\d\d(_\d\d){2}", folder.name)
        assert f" 0 lost, {folder}" in running.output
    assert recorded(folder, "/burst") == sent
    assert metadata.read(folder).files == (f"{folder.name}_0.mcap",)


def test_a_killed_recorder_loses_only_what_it_had_not_flushed(tmp_path, peer):
    publishers = [peer.publisher(Twist, name, DEEP) for name in ("/one", "/two")]
    path = tmp_path / "run" / "run_0.mcap"
    parameters = {"uri": tmp_path / "run", "flush_period": 0.2, "topics": ["/one", "/two"]}
    with graph.node(RECORDER, parameters) as running:
        wait_until_recorded(peer, *publishers)
        sent = [publish(publisher, twists(500)) for publisher in publishers]
        graph.wait_for(lambda: len(list(messages_of(path))) == 1000, what="a flush")
        for publisher in publishers:
            publish(publisher, twists(10))
        running.popen.kill()
        running.wait()
    result = repair_bag(tmp_path / "run", tmp_path / "fixed")
    assert result.files[0].salvaged.loss.is_cut
    assert result.note == "metadata.yaml is missing"
    for topic, messages in zip(("/one", "/two"), sent, strict=True):
        assert recorded(tmp_path / "fixed", topic)[:500] == messages


def test_a_full_disk_ends_the_recorder_with_one_line_and_a_readable_bag(tmp_path, peer):
    publisher = peer.publisher(Twist, "data", DEEP)
    limit = 60_000
    with graph.node(
        RECORDER,
        {
            "uri": tmp_path / "run",
            "compression": "none",
            "chunk_size": 4096,
            "topics": ["/data"],
            "flush_period": 0.1,
        },
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
        env=graph.environment(ROS_LOG_DIR=str(tmp_path / "log")),
    ) as running:
        wait_until_recorded(peer, publisher)
        sent = publish(publisher, twists(5000))
        assert running.wait() == 1
        (error,) = [line for line in running.output.splitlines() if "ERROR" in line]
        assert "run_0.mcap: File too large; the bag ends after about" in error
        assert "Traceback" not in running.output
    data = list(messages_of(tmp_path / "run" / "run_0.mcap"))
    assert data == sent[: len(data)]
    assert len(data) > 200


def test_a_folder_that_exists_is_refused_in_one_line_and_left_alone(tmp_path):
    (tmp_path / "taken").mkdir()
    with graph.node(RECORDER, {"uri": tmp_path / "taken"}) as running:
        assert running.wait() == 1
        (line,) = running.output.splitlines()
    assert line.startswith("error: ")
    assert "taken exists already" in line
    assert not list((tmp_path / "taken").iterdir())
