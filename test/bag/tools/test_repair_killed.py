"""Repair of what a killed recorder leaves."""

import graph
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.highlevel import AnyReader

from diffbot_bag.tools.repair import repair_bag

pytestmark = pytest.mark.graph

RECORDER = "diffbot_bag.recorder_node"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEEP = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""of publishers that lose nothing, however late their subscriber is"""
FLUSH = 0.2
"""[s]"""


@pytest.mark.parametrize("rounds", [300, 700])
def test_a_killed_recorder_loses_only_what_it_had_not_flushed(tmp_path, rounds):
    with graph.peer() as peer, graph.node(RECORDER, {"uri": tmp_path / "run", "flush_period": FLUSH}) as running:
        publishers = [peer.publisher(Twist, name, DEEP) for name in ("one", "two")]
        running.wait_for_output("ready")
        reports = peer.subscribe(DiagnosticStatus, "/recorder/status", LATCHED)
        peer.spin_until(
            lambda: reports and {"/one", "/two"} <= set(graph.values(reports[-1])["topics"].split()), what="both topics"
        )
        message = Twist()
        for index in range(rounds):
            message.linear.x = float(index)
            for publisher in publishers:
                publisher.publish(message)
        path = tmp_path / "run" / "run_0.mcap"
        before = path.stat().st_size
        graph.wait_for(lambda: path.stat().st_size > before, what="a flush")
        running.popen.kill()
        running.wait()
    result = repair_bag(tmp_path / "run", tmp_path / "fixed")
    assert result.files[0].salvaged.loss.is_cut
    assert result.note == "metadata.yaml is missing"
    with AnyReader([tmp_path / "fixed"]) as reader:
        for topic in ("/one", "/two"):
            connections = [one for one in reader.connections if one.topic == topic]
            values = [reader.deserialize(data, one.msgtype).linear.x for one, _, data in reader.messages(connections)]
            assert values == [values[0] + index for index in range(len(values))]
            assert len(values) > 0
            # The second kind of QoS that a replay needs to latch.
            assert [qos.durability.name for one in connections for qos in one.ext.offered_qos_profiles] == [
                "TRANSIENT_LOCAL"
            ]
