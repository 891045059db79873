"""The recorder as a process: signals, a kill, a full disk, and what it refuses to start with."""

import contextlib
import re
import signal

import graph
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from rclpy.duration import Duration
from recorders import DEEP, LATCHED, publish, recorded, twists

from diffbot_bag.bag import metadata

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
