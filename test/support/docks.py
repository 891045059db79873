"""A robot that docks over DDS from random poses. A detector in between disturbs what the plant measures of the dock.

Plant, robot_node and docking_node are processes, in simulated time that runs faster than real time.
"""

import math
import random
import threading
import time
from typing import NamedTuple

import graph
import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future
from std_msgs.msg import Bool

from diffbot_control.ros.messages.fields import fill_pose, pose_of, set_stamp, stamp_ns
from diffbot_control.ros.navigator import Navigator, TaskResult
from diffbot_core.geometry import Pose, into_frame, out_of_frame
from diffbot_core.ros.qos import QUEUE

DOCK = Pose(3.0, 1.0, 0.5)
SPEED = 3.0
"""of simulated time over real time"""
NONE, FROZEN, SWAPPED = FAULTS = "none", "frozen", "swapped"
NEAR = 0.6
"""[m] from the dock at which a fault begins"""
OTHER_DOCK = Pose(0.0, 0.5, 0.0)
_TIMEOUT = 120.0
"""[s] of real time for one drive"""
_QUEUED = 2 * QUEUE.depth
"""true poses that may be on their way, in the queues of both ends, when an answer comes"""


class Docking(NamedTuple):
    """How one run ended."""

    end: str
    contact: tuple[float, float] | None
    """lateral error [m] and heading error [rad] of the true pose at the first contact"""
    undocking: str
    """how that ended then; empty after another end than ``reached``"""


class Detector:
    """Passes the plant's detections and contacts on to the docking node, changed by a fault, in a thread of its own."""

    def __init__(self):
        self.fault, self.is_near = NONE, False
        self.truth = None
        """of the robot in the dock's frame"""
        self.contact = None
        self.touches = None
        """state of the contact switch; None: as the plant reports it"""
        self._truths, self._came = 0, threading.Condition()
        self._frozen = None
        node = rclpy.create_node("detector")
        self._sent = node.create_publisher(PoseWithCovarianceStamped, "detected_dock_pose", 10)
        self._switch = node.create_publisher(Bool, "dock_contact", 10)
        node.create_subscription(PoseWithCovarianceStamped, "detected_by_plant", self._on_detection, 10)
        node.create_subscription(Bool, "contact_of_plant", self._on_contact, 10)
        node.create_subscription(Odometry, "ground_truth", self._on_truth, 10)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._closed = Future()
        self._thread = threading.Thread(
            target=self._executor.spin_until_future_complete, args=(self._closed,), daemon=True
        )
        self._thread.start()

    def close(self):
        self._closed.set_result(None)
        self._thread.join()
        self._executor.shutdown()  # last: it does not wait for a running callback

    def begin(self, fault):
        self.fault, self.is_near, self.contact, self._frozen = fault, False, None, None

    def catch_up(self):
        """Wait for a true pose that is newer than this call: an answer may arrive before its pose."""
        with self._came:
            last = self._truths + _QUEUED
            if not self._came.wait_for(lambda: self._truths > last, 30.0):
                raise RuntimeError("no true pose within 30 s")

    def _on_contact(self, message):
        self._switch.publish(message if self.touches is None else Bool(data=self.touches))

    def _on_truth(self, message):
        pose = into_frame(pose_of(message.pose.pose), DOCK)
        if self.contact is None and pose.x >= 0.0 and self.truth is not None and self.truth.x < 0.0:
            self.contact = pose.y, pose.theta
        self.truth = pose
        self.is_near = self.is_near or -pose.x < NEAR
        with self._came:
            self._truths += 1
            self._came.notify_all()

    def _on_detection(self, message):
        if self.fault == FROZEN:
            # Keep a detection from farther away. If this process is held up, the robot may already stand at its
            # staging pose when the next detection arrives, and the frozen detection would then be true.
            place = message.pose.pose.position
            self.is_near = self.is_near or math.hypot(place.x, place.y) < NEAR
            if not self.is_near or self._frozen is None:
                self._frozen = message
            set_stamp(self._frozen.header.stamp, stamp_ns(message.header.stamp))
            message = self._frozen
        if self.is_near and self.fault == SWAPPED:
            fill_pose(message.pose.pose, out_of_frame(OTHER_DOCK, pose_of(message.pose.pose)))
        self._sent.publish(message)


class Scene:
    """The nodes, on the DDS domain of this process."""

    def __init__(self, seed):
        """Prepare the nodes, which run while the ``with`` block lasts."""
        self._random = random.Random(seed)
        simulated = {"use_sim_time": True}
        plant = {"clock": "scaled", "real_time_factor": SPEED, "seed": seed, "detection_rate": 10.0}
        plant |= {"dock_x": DOCK.x, "dock_y": DOCK.y, "dock_yaw": DOCK.theta, "max_cmd_vel_publishers": 2}
        remapped = ("-r", "detected_dock_pose:=detected_by_plant", "-r", "dock_contact:=contact_of_plant")
        self._processes = {
            "plant": graph.node("diffbot_sim.plant_node", plant, remapped),
            "robot": graph.node("diffbot_control.robot_node", simulated | {"max_cmd_vel_publishers": 2}),
            # In simulated time that runs fast: as long in real time as by default.
            "docking": graph.node("diffbot_control.docking_node", simulated | {"pose_lost_timeout": 5.0 * SPEED}),
        }
        self.processes = {}

    def __enter__(self):
        """Start the nodes and wait until the controllers accept goals."""
        for name, one in self._processes.items():
            self.processes[name] = one.__enter__()
        # A node that is held up on a busy machine answers later.
        self.navigator = Navigator(restart_timeout=graph.PATIENCE)
        self.detector = Detector()
        if not self.navigator.waitUntilReady(graph.PATIENCE):
            raise RuntimeError(f"no controller within {graph.PATIENCE:g} s")
        return self

    def __exit__(self, *error):
        """Stop the nodes."""
        self.detector.close()
        self.navigator.destroyNode()
        for one in reversed(self._processes.values()):
            one.__exit__(*error)

    def run(self, fault):
        """Drive to a random pose before the dock, dock and undock."""
        self.detector.begin(NONE)
        x, y, turn = self._random.uniform(-3.0, -0.9), self._random.uniform(-0.5, 0.5), self._random.uniform(-0.7, 0.7)
        start = PoseStamped()
        start.header.frame_id = "map"
        fill_pose(start.pose, out_of_frame(Pose(x, y, turn), DOCK))
        self.navigator.goToPose(start)
        self.wait()
        self.detector.begin(fault)
        self.navigator.dock()
        end = self.wait()
        self.detector.catch_up()
        contact = self.detector.contact
        self.detector.begin(NONE)
        undocking = ""
        if end == "reached":
            undocking = self.wait() if self.navigator.undock() else "refused"
        return Docking(end, contact, undocking)

    def wait(self):
        """Return how the task ended; empty without an answer in time."""
        deadline = time.monotonic() + _TIMEOUT
        while not self.navigator.isTaskComplete():
            if time.monotonic() > deadline:
                self.navigator.cancelTask()
                return ""
        if self.navigator.getResult() == TaskResult.SUCCEEDED:
            return "reached"
        return self.navigator.getReason()
