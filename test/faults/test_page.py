"""Hostile requests, numbers and names for `diffbot watch`, while another client receives the data of the page."""

import contextlib
import itertools
import signal
import socket
from collections import deque
from pathlib import Path

import graph
import pytest
import watch_page
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from hostile import SPECIAL
from hostile_requests import requests
from rclpy.qos import QoSProfile
from repeated import tried
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from diffbot_tools.view.model import LAW_LABELS
from diffbot_tools.watch.watch_node import MAX_NODES

SHARE = 1000
MAX_GROWTH = 20.0
"""[MB] of the process"""
LEFT_OPEN = 12
"""Open connections, fewer than the page serves."""


class Shown:
    """`diffbot watch`, a client of its page, and the publisher of a pose."""

    def __init__(self, watch, peer):
        self.watch, self.peer, self.url = watch, peer, watch_page.url_of(watch)
        self.client = watch_page.Client(self.url)
        self._pose = peer.publisher(PoseWithCovarianceStamped, "pose")
        peer.wait_for_subscribers(self._pose)
        self._count = itertools.count(1)

    def is_served(self):
        """Publish a new pose until the client has it."""
        number = next(self._count)
        message = PoseWithCovarianceStamped()
        message.header.stamp.sec, message.pose.pose.orientation.w = number, 1.0
        message.pose.pose.position.x = float(number)

        def shows():
            self._pose.publish(message)
            self.client.read()
            return self.client.robot.get("estimate", [0, 0])[:2] == [pytest.approx(number - 1), number]

        return graph.wait_for(shows, what=f"pose {number}")

    def memory(self):
        status = Path(f"/proc/{self.watch.popen.pid}/status").read_text()
        return int(status.partition("VmRSS:")[2].split()[0]) / 1024.0


@pytest.fixture(scope="module")
def shown():
    with graph.diffbot("watch", "--port", "0") as watch, graph.peer("visitor") as peer:
        watch.wait_for_output("Page: ")
        found = Shown(watch, peer)
        found.is_served()
        yield found
        found.client.close()
        assert watch.stop(signal.SIGINT) == 0
        assert "Traceback" not in watch.output
        assert "internal error" not in watch.output


@tried(2000, once=60)
def test_hostile_requests_and_numbers_leave_another_browser_served(shown, trials, seeded):
    host, token = shown.url.split("/")[2], shown.url.split("=")[1]
    kinds = list(requests(host, token).values())
    name, port = host.split(":")
    # A deep queue, so that a short burst is not lost.
    laws = shown.peer.publisher(Float64MultiArray, "controller/navigation", QoSProfile(depth=100))
    shown.peer.wait_for_subscribers(laws)
    labels = ["stamp", *(label for label in LAW_LABELS if label != "stamp")]
    before, held = shown.watch.output, deque()
    for number in trials:
        held.append(socket.create_connection((name, int(port)), timeout=graph.PATIENCE))
        # The server may refuse a request before the end of it.
        with contextlib.suppress(OSError):
            held[-1].sendall(kinds[number % len(kinds)](seeded))
        if len(held) > LEFT_OPEN:
            held.popleft().close()
        message = Float64MultiArray(data=seeded.choices([*SPECIAL, 1e300], k=len(labels)))
        message.layout.dim = [MultiArrayDimension(label=label) for label in labels]
        laws.publish(message)
        assert shown.is_served()
        assert shown.watch.output == before
    for one in held:
        one.close()


@tried(120, once=3)
def test_memory_is_bounded_for_any_number_of_names(shown, trials):
    reports = shown.peer.publisher(DiagnosticArray, "/diagnostics")
    shown.peer.wait_for_subscribers(reports)

    def dropped():
        """Return the number of dropped names that the node reports."""
        rows = shown.client.shared.get("diagnostics", [])
        assert len(rows) <= MAX_NODES
        texts = [one["message"] for one in rows if one["name"] == "/watch"]
        return int(texts[0].split()[0]) if texts and "names dropped" in texts[0] else 0

    before = shown.memory()
    for number in trials:
        names = (f"/node{number * SHARE + n}{'x' * 200}" for n in range(SHARE))
        reports.publish(DiagnosticArray(status=[DiagnosticStatus(name=name, message="ok") for name in names]))
        least = (number + 1) * SHARE - MAX_NODES
        shown.client.wait_for(lambda least=least: dropped() >= least, f"{least} dropped names")
        assert shown.memory() - before <= MAX_GROWTH
    assert shown.is_served()
