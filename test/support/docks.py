"""A robot that docks over DDS from random poses. A detector in between disturbs what the plant measures of the dock.

Plant, robot_node and docking_node are processes, in simulated time that runs faster than real time.
"""

import math
import threading
import time
from contextlib import closing

import graph
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool

from diffbot_control.ros.messages.fields import fill_pose, pose_of, set_stamp, stamp_ns
from diffbot_control.ros.navigator import Navigator, TaskResult
from diffbot_core.geometry import Pose, into_frame, out_of_frame
from diffbot_core.ros.qos import QUEUE

DOCK = Pose(3.0, 1.0, 0.5)
SPEED = 2.0
"""of simulated time over real time"""
NONE, FROZEN, SWAPPED = FAULTS = "none", "frozen", "swapped"
NEAR = 0.6
"""[m] from the dock at which a fault begins"""
OTHER_DOCK = Pose(0.0, 0.5, 0.0)
_TIMEOUT = 120.0
"""[s] of real time for one drive"""
_QUEUED = 2 * QUEUE.depth
"""true poses that may be on their way, in the queues of both ends, when an answer comes"""


class Detector:
    """Passes the plant's detections and contacts on to the docking node, changed by a fault, in a thread of its own."""

    def __init__(self, peer):
        self.fault, self.is_near = NONE, False
        self.truth = None
        """of the robot in the dock's frame"""
        self.contact = None
        """lateral error [m] and heading error [rad] of the true pose at the first contact"""
        self.touches = None
        """state of the contact switch; None: as the plant reports it"""
        self._truths, self._frozen = 0, None
        self._sent = peer.publisher(PoseWithCovarianceStamped, "detected_dock_pose")
        self._switch = peer.publisher(Bool, "dock_contact")
        peer.node.create_subscription(PoseWithCovarianceStamped, "detected_by_plant", self._on_detection, 10)
        peer.node.create_subscription(Bool, "contact_of_plant", self._on_contact, 10)
        peer.node.create_subscription(Odometry, "ground_truth", self._on_truth, 10)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._spin, args=(peer.executor,), daemon=True)
        self._thread.start()

    def _spin(self, executor):
        while not self._ended.is_set():
            executor.spin_once(timeout_sec=0.1)

    def close(self):
        self._ended.set()
        self._thread.join()

    def begin(self, fault):
        self.fault, self.is_near, self.contact, self._frozen = fault, False, None, None

    def catch_up(self):
        """Wait for a true pose that is newer than this call: an answer may arrive before its pose."""
        last = self._truths + _QUEUED
        graph.wait_for(lambda: self._truths > last, what="a true pose")

    def _on_contact(self, message):
        self._switch.publish(message if self.touches is None else Bool(data=self.touches))

    def _on_truth(self, message):
        pose = into_frame(pose_of(message.pose.pose), DOCK)
        if self.contact is None and pose.x >= 0.0 and self.truth is not None and self.truth.x < 0.0:
            self.contact = pose.y, pose.theta
        self.truth = pose
        self.is_near = self.is_near or -pose.x < NEAR
        self._truths += 1

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
    """The nodes, which run until ``stack`` is closed."""

    def __init__(self, stack):
        simulated = {"use_sim_time": True}
        plant = {"clock": "scaled", "real_time_factor": SPEED, "seed": 11, "detection_rate": 10.0}
        plant |= {"dock_x": DOCK.x, "dock_y": DOCK.y, "dock_yaw": DOCK.theta, "max_cmd_vel_publishers": 2}
        remapped = ("-r", "detected_dock_pose:=detected_by_plant", "-r", "dock_contact:=contact_of_plant")
        nodes = {
            "plant": graph.node("diffbot_sim.plant_node", plant, remapped),
            "robot": graph.node("diffbot_control.robot_node", simulated | {"max_cmd_vel_publishers": 2}),
            # In simulated time that runs fast: as long in real time as by default.
            "docking": graph.node("diffbot_control.docking_node", simulated | {"pose_lost_timeout": 5.0 * SPEED}),
        }
        self.processes = {name: stack.enter_context(one) for name, one in nodes.items()}
        # A node that is held up on a busy machine answers later.
        self.navigator = Navigator.in_own_context(restart_timeout=graph.PATIENCE)
        stack.callback(self.navigator.context.try_shutdown)
        stack.callback(self.navigator.destroyNode)
        self.detector = stack.enter_context(closing(Detector(stack.enter_context(graph.peer("detector")))))
        assert self.navigator.waitUntilReady(graph.PATIENCE)

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
