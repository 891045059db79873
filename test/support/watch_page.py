"""Clients of the page of ``diffbot watch`` without a browser."""

import json

import graph
from websockets.sync.client import connect


def url_of(watch):
    """Return the address that a process of ``diffbot watch`` prints."""
    return next(line.split()[-1] for line in watch.output.splitlines() if line.startswith("Page: "))


class Client:
    def __init__(self, url):
        address, token = url.split("/")[2], url.split("=")[1]
        self._socket = connect(
            f"ws://{address}/ws?token={token}",
            origin=f"http://{address}",
            open_timeout=graph.PATIENCE,
            compression=None,
            max_size=None,
        )
        self.robot, self.shared = {}, {}
        """newest rows of the robot, and newest values of all robots"""
        self.state = [0.0, 0, ""]
        """time, level and words of the robot's state"""
        self.events = []
        """[time, kind, level, text] of all robots, oldest first"""

    def read(self):
        """Receive the next message, if it arrives within 0.05 s."""
        try:
            message = json.loads(self._socket.recv(timeout=0.05), parse_constant=_refuse)
        except TimeoutError:
            return
        if message["type"] == "state":
            self.shared |= message
            for one in message["robots"].values():
                self.robot |= one.get("rows", {})
                self.state = one.get("state", self.state)
        elif message["type"] == "events":
            self.events += message["events"]

    def wait_for(self, condition, what):
        def found():
            self.read()
            return condition()

        return graph.wait_for(found, what=what)

    def close(self):
        self._socket.close()


def _refuse(name):
    raise AssertionError(f"{name} is not JSON")
