"""Helpers for tests over DDS: a free domain, nodes as processes, a node of the test itself, waiting with a deadline.

Every wait is for a condition, and fails with the name of the condition after its deadline. Deadlines end a test that
hangs. They are long, so that a test does not fail on a busy machine; times that users are promised are measured
(repeated.py). Only processes that a test started are ended.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import diffbot_control
from diffbot_tools.processes import PrivateDomain

MODULES = {
    "plant": "diffbot_sim.plant_node",
    "ekf": "diffbot_control.ekf_node",
    "controller": "diffbot_control.controller_node",
    "robot": "diffbot_control.robot_node",
}
PATIENCE = 120.0
"""[s] Minimum deadline of every wait: a node may take a minute to start beside a dozen processes on two cores."""
ANSWER = 10.0
"""[s] until a service is called again"""
_QUIET = 0.03
"""[s] without a change in the graph"""
SOURCE = Path(diffbot_control.__file__).resolve().parent.parent


@contextlib.contextmanager
def private_domain():
    """Give this process and its children a ROS domain of their own while the ``with`` block lasts."""
    before, domain = os.environ.get("ROS_DOMAIN_ID"), PrivateDomain()
    os.environ["ROS_DOMAIN_ID"] = str(domain.id)
    try:
        yield domain.id
    finally:
        domain.release()
        if before is None:
            del os.environ["ROS_DOMAIN_ID"]
        else:
            os.environ["ROS_DOMAIN_ID"] = before


def environment(**changes):
    """Return the environment for a process of the graph: the source under test comes first on PYTHONPATH.

    The other entries of PYTHONPATH remain: a ROS installation has rclpy there.
    """
    path = os.pathsep.join(filter(None, (str(SOURCE), os.environ.get("PYTHONPATH", ""))))
    # PYTHONSAFEPATH: without the working folder, which may be a source tree.
    return {**os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": "1", "PYTHONUNBUFFERED": "1", **changes}


def wait_for(condition, timeout=PATIENCE, what="the condition"):
    """Return the first true value of ``condition()``; fail after ``timeout`` [s], but not before PATIENCE."""
    timeout = max(timeout, PATIENCE)
    if not (value := comes_true(condition, timeout)):
        raise AssertionError(f"waited {timeout:g} s in vain for {what}")
    return value


def comes_true(condition, duration):
    """Return the first true value of ``condition()``, or its last false value after ``duration`` [s]."""
    deadline = time.monotonic() + duration
    while not (value := condition()) and time.monotonic() < deadline:
        time.sleep(0.005)
    return value


class Process:
    """A process of the test. Its output is written to a file, so that the process does not wait for a reader."""

    def __init__(self, command, **options):
        options.setdefault("env", environment())
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - closed in end()
        self.popen = subprocess.Popen(command, stdout=self._output, stderr=subprocess.STDOUT, **options)
        self.command = command

    @property
    def output(self):
        """The output of the process to stdout and stderr until now."""
        # The child shares the position in the file, and os.pread does not change it.
        size = os.fstat(self._output.fileno()).st_size
        return os.pread(self._output.fileno(), size, 0).decode(errors="replace")

    def wait_for_output(self, text, timeout=PATIENCE):
        """Wait until ``text`` is in the output; fail if the process ends before."""

        def found():
            ended = self.popen.poll() is not None
            if text in self.output:
                return True
            assert not ended, f"ended with {self.popen.returncode} before {text!r}:\n{self.output}"
            return False

        wait_for(found, timeout, repr(text))

    def send(self, number):
        """Send a signal if the process still runs."""
        self.popen.send_signal(number)

    def wait(self, timeout=PATIENCE):
        """Wait for the end and return the exit status; fail after ``timeout`` [s], but not before PATIENCE."""
        return self.popen.wait(max(timeout, PATIENCE))

    def stop(self, number=signal.SIGINT):
        self.send(number)
        return self.wait()

    def end(self):
        """End the process, by force if necessary; a failed test shows its output."""
        if self.popen.poll() is None:
            self.popen.send_signal(signal.SIGINT)
            try:
                self.popen.wait(5.0)
            except subprocess.TimeoutExpired:
                self.popen.kill()
                self.popen.wait()
        print(f"--- {' '.join(map(str, self.command))} -> {self.popen.returncode}\n{self.output}")
        self._output.close()


@contextlib.contextmanager
def process(*command, **options):
    running = Process(list(command), **options)
    try:
        yield running
    finally:
        running.end()


def diffbot(*arguments, **options):
    """Run the command ``diffbot`` while the ``with`` block lasts."""
    return process(sys.executable, "-m", "diffbot_tools.cli", *arguments, **options)


def node(module, parameters=None, arguments=(), **options):
    """Run ``python -m module`` with parameters and other ROS arguments while the ``with`` block lasts."""
    return process(sys.executable, "-m", module, "--ros-args", *ros_arguments(parameters), *arguments, **options)


def ros_arguments(parameters):
    return [
        word
        for name, value in (parameters or {}).items()
        for word in ("-p", f"{name}:={json.dumps(value, default=str)}")
    ]


class Peer:
    """A node of the test itself, in a context of its own."""

    def __init__(self, name="peer", executor=None, **options):
        """Create the node. ``executor`` makes an executor from a context; ``options`` are of rclpy's Node."""
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        # Without parameter services: a recorder would call them, and may end before the response.
        self.node = Node(name, context=self.context, **{"start_parameter_services": False, **options})
        self.executor = executor(self.context) if executor else SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._drains = executor is None
        self._clients = {}

    def spin_until(self, condition, timeout=PATIENCE, what="the condition"):
        """Handle callbacks until ``condition()`` is true and return its value; fail after ``timeout`` [s]."""
        timeout = max(timeout, PATIENCE)
        if not (value := self.comes_true(condition, timeout)):
            raise AssertionError(f"waited {timeout:g} s in vain for {what}")
        return value

    def comes_true(self, condition, duration):
        """Handle callbacks until ``condition()`` is true or ``duration`` [s] has passed; return its last value."""
        deadline = time.monotonic() + duration
        while not (value := condition()) and time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.02)
            self.drain()
        return value

    def drain(self):
        """Handle all received messages, faster than the executor, which would be late on a busy machine."""
        for subscription in self.node.subscriptions if self._drains else ():
            is_plain = subscription._callback_type is subscription.CallbackType.MessageOnly
            with subscription.handle:
                while taken := subscription.handle.take_message(subscription.msg_type, subscription.raw):
                    subscription.callback(*(taken[:1] if is_plain else taken))

    def spin_for(self, duration):
        """Handle callbacks for ``duration`` [s], to check that a message is not sent."""
        deadline = time.monotonic() + duration
        while (left := deadline - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=left)
            self.drain()

    def spin_until_quiet(self, duration=0.2):
        waited = 0.0
        while waited < duration:
            begin = time.monotonic()
            self.executor.spin_once(timeout_sec=duration)
            waited = time.monotonic() - begin

    def subscribe(self, message_type, topic, qos=10, raw=False):
        """Return a list to which each message of a topic is appended."""
        received = []
        self.node.create_subscription(message_type, topic, received.append, qos, raw=raw)
        return received

    def publisher(self, message_type, topic, qos=10):
        return self.node.create_publisher(message_type, topic, qos)

    def wait_for_subscribers(self, *publishers, count=1):
        """Wait until each publisher has discovered this many subscribers."""
        for publisher in publishers:
            wait_for(
                lambda publisher=publisher: publisher.get_subscription_count() >= count,
                what=f"a subscriber of {publisher.topic_name}",
            )

    def wait_for_publishers(self, *topics):
        """Wait until the subscription of each topic has discovered a publisher."""
        for topic in topics:
            name = self.node.resolve_topic_name(topic)
            subscription = next(each for each in self.node.subscriptions if each.topic_name == name)
            self.spin_until(subscription.get_publisher_count, what=f"a publisher of {name}")

    def call(self, service_type, name, request=None, timeout=PATIENCE):
        """Call a service, again after ANSWER without a response, and return the response.

        DDS drops the response to a client whose reader the server has not discovered yet. The client is not informed.
        """
        # Keep the client for further calls: after its discovery, responses are not dropped any more.
        if name not in self._clients:
            self._clients[name] = self.node.create_client(service_type, name)
        client = self._clients[name]
        futures = []

        def answered():
            return any(future.done() for future in futures)

        def ask_again():
            futures.append(client.call_async(request or service_type.Request()))
            return self.comes_true(answered, ANSWER)

        self.spin_until(client.service_is_ready, timeout, f"the service {name}")
        wait_for(ask_again, timeout, f"an answer of {name}")
        return next(future.result() for future in futures if future.done())

    def close(self):
        """Destroy the node when the graph does not change: otherwise Fast DDS may hang, see run.forced_exit()."""
        self.executor.shutdown()
        before, deadline = None, time.monotonic() + ANSWER
        while (now := self._graph()) != before and time.monotonic() < deadline:
            before = now
            time.sleep(_QUIET)
        self.node.destroy_node()
        self.context.try_shutdown()

    def _graph(self):
        topics = self.node.get_topic_names_and_types(no_demangle=True)
        return topics, self.node.get_node_names_and_namespaces()


@contextlib.contextmanager
def peer(name="peer", **options):
    running = Peer(name, **options)
    try:
        yield running
    finally:
        running.close()


def values(status):
    return {pair.key: pair.value for pair in status.values}
