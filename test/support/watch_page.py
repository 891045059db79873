"""Clients of the page of ``diffbot watch`` without a browser."""

import json
import socket
import time

import graph
from websockets.sync.client import connect


def url_of(watch):
    """Return the address that a process of ``diffbot watch`` prints."""
    return next(line.split()[-1] for line in watch.output.splitlines() if line.startswith("Page: "))


class Client:
    """A connection that reads what the page would show."""

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
        """newest values of the robot, and of what concerns all"""
        self.answers = []

    def send(self, text):
        self._socket.send(text)

    def read(self):
        """Take all messages that come within a twentieth of a second."""
        end = time.monotonic() + 0.05
        while (left := end - time.monotonic()) > 0.0:
            try:
                text = self._socket.recv(timeout=left)
            except TimeoutError:
                return
            message = json.loads(text, parse_constant=_refuse)
            if message["type"] == "answer":
                self.answers.append(message["text"])
            if message["type"] == "state":
                self.shared |= message
                for one in message["robots"].values():
                    self.robot |= one.get("rows", {}) | {name: value for name, value in one.items() if name != "rows"}

    def wait_for(self, condition, what):
        """Read until ``condition()`` is true and return its value."""

        def found():
            self.read()
            return condition()

        return graph.wait_for(found, what=what)

    def close(self):
        self._socket.close()


def _refuse(name):
    raise AssertionError(f"{name} is no JSON")


def raw(url, data):
    """Send bytes on a connection of their own; return it."""
    host, port = url.split("/")[2].split(":")
    made = socket.create_connection((host, int(port)), timeout=graph.PATIENCE)
    made.sendall(data)
    return made
