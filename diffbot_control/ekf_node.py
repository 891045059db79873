"""The node ``ekf``: estimates the pose from odometry, fixes, headings, turn rates and landmarks."""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.localization import FilterEstimate, Localization
from diffbot_control.filter.models import move
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.filter.state_file import BrokenStateError, StateKeeper
from diffbot_control.ros.ekf_publishers import EkfPublishers
from diffbot_control.ros.input_watch import CONTRADICT, CONTRADICTED, RUNNING, SILENT, WAITING, WINDOW, InputWatch
from diffbot_control.ros.messages.ekf import EkfInputs, localization_values
from diffbot_control.ros.messages.fields import measured_ns, pose_in_message, pose_of
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors import DockSensor, FixSensor, fuse
from diffbot_control.ros.tf import transform_sender, transforms_of
from diffbot_control.ros.transforms import LastTransform
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.files import file_path
from diffbot_core.geometry import Pose
from diffbot_core.health import Throttle
from diffbot_core.ros.managed_node import INACTIVE, ManagedNode
from diffbot_core.ros.node import status_message
from diffbot_core.ros.qos import LATCHED, STATUS, sensor_qos
from diffbot_core.ros.run import run
from diffbot_core.shared_parameters import odometry_frame
from diffbot_core.stamps import S_PER_NS, ForwardSteps, StampWatch
from diffbot_core.uncertainty import Uncertainty

STANDSTILL = "odometry stands still"
"""Reason in /diagnostics if the stamps of the arriving odometry do not advance."""
_STATUS_PERIOD = 0.5
"""[s]"""
_MAX_SLIP = 3.0
"""[s] The node warns if wheels and gyro disagree for longer than this."""
_FAULT_LOG_PERIOD = 60.0
"""[s] time between two log entries about the same fault of an input"""
_SAVE_PERIOD = 5.0
"""[s] time between two saves of the state file; a crash loses at most this time"""

PoseReceiver = Callable[[int, Pose, Uncertainty], None]
"""Function that receives stamp [ns], pose in ``map_frame`` and uncertainty of an estimate."""


class EkfNode(ManagedNode[EkfNodeConfig]):
    """Answers each odometry message with one pose with the same stamp."""

    pose_receiver: PoseReceiver | None = None
    """called with each estimate before it is published, see :mod:`robot_node`"""

    def __init__(self, **node_options: Any) -> None:
        """Create the node; it is active afterwards if the parameter ``autostart`` is true."""
        super().__init__("ekf", EkfNodeConfig, **node_options)

    def configure(self) -> None:
        """Create publishers, subscriptions and the service ~/reset."""
        config = self.config
        separation = config.wheels.wheel_separation
        self.localization = Localization(
            config.localization,
            separation,
            config.sensor_timeout,
            landmarks=tuple(config.landmarks.points().values()),
        )
        self._outputs = EkfPublishers(self)
        self._statuses = self.create_publisher(DiagnosticStatus, "~/status", STATUS)
        frames = config.map_frame, odometry_frame(config)
        self._transforms = transform_sender(self, *frames, config.transform_tolerance) if config.publish_tf else None
        self._newest: tuple[FilterEstimate, OdometryStep] | None = None
        self._last_state = ""
        self._odometry_stamps = StampWatch()
        self._last_odometry: int | None = None
        """[ns] steady time when the newest valid odometry with an advancing stamp arrived"""
        self._last_arrival: int | None = None
        """[ns] steady time when the newest odometry arrived, even if it was dropped"""
        self._last_gyro: int | None = None
        """[ns] steady time when the newest valid turn rate arrived"""
        self._sensor_transforms = LastTransform(partial(transforms_of, self, config.sensor_timeout))
        self._inputs = EkfInputs(config, self._sensor_transforms)
        self._watch_inputs()
        self._latched: dict[str, Any] = {}
        """subscriptions to latched fixes by topic, until the filter is initialised"""
        self._keeper = self._restore()
        qos = sensor_qos(config.reliable_inputs)
        # Sensors first: the executor handles waiting messages in the order of the subscriptions.
        for topic, sensor in self._inputs.sensors.items():
            self.subscribe(_message_class(sensor.message_type), topic, partial(self._on_sensor, topic), qos)
        self.subscribe(PoseWithCovarianceStamped, "initialpose", self._on_initialpose)
        if config.odometry_source == "odom":
            self.publisher_watch.watch("odom", "measure the motion")
            self.subscribe(Odometry, "odom", self._on_odometry, qos)
        else:
            self.subscribe(JointState, "joint_states", self._on_joint_states, qos)
            if self._transforms is not None:
                self.subscribe(Odometry, "odom", self._on_odometry_pose, qos)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_timer(_STATUS_PERIOD, self._check_and_report, clock=self.steady_clock)
        if self._keeper is not None:
            self.create_timer(_SAVE_PERIOD, self._save, clock=self.steady_clock)

    def _watch_inputs(self) -> None:
        """Prepare the detection of faults in the wiring of the inputs."""
        config = self.config
        delays = {topic: sensor.usual_delay for topic, sensor in self._inputs.sensors.items()}
        self._watch = InputWatch(config.odometry_source, (config.left_wheel_name, config.right_wheel_name), delays)
        self._clock_steps = ForwardSteps()
        self._window_end = time.monotonic() + WINDOW
        self._faults: dict[str, str] = {}
        """text for each fault of the inputs, by the name of the input"""
        self._fault_log = Throttle(_FAULT_LOG_PERIOD)

    def on_config(self, config: EkfNodeConfig) -> None:
        """Apply changed parameters."""
        self.localization.configure(config.localization, config.wheels.wheel_separation)
        self.localization.max_extrapolation = config.sensor_timeout
        self._inputs = EkfInputs(config, self._sensor_transforms)

    def activate(self) -> None:
        """Publish from the next odometry message on; the filter also runs while the node is inactive."""
        self._publish_status()

    def deactivate(self) -> None:
        """Stop publishing poses."""
        self._publish_status()

    def cleanup(self) -> None:
        """Save the state, if there is a state file."""
        self._save(is_last=True)

    def state(self) -> str:
        """Return the message of ~/status: one of WAITING, RUNNING, SILENT, CONTRADICTED, INACTIVE."""
        if not self.is_active:
            return INACTIVE
        if not self.localization.initialised:
            return WAITING
        if not self._is_recent(self._last_odometry):
            return SILENT
        return CONTRADICTED if self.localization.contradiction.cause else RUNNING

    def _is_recent(self, event: int | None) -> bool:
        """Return True if ``event`` [ns, steady clock] is at most sensor_timeout ago."""
        return event is not None and (time.monotonic_ns() - event) * S_PER_NS <= self.config.sensor_timeout

    def _reason(self, state: str) -> str:
        """Return the reason for a state; empty if there is none."""
        faults = [] if state == INACTIVE else list(self._faults.values())
        if state == CONTRADICTED:
            faults.insert(0, self.localization.contradiction.cause)
        elif state == SILENT and self._is_recent(self._last_arrival):
            faults.insert(0, STANDSTILL)
        elif state in (WAITING, SILENT):
            missing = [] if self._is_recent(self._last_odometry) else [self.config.odometry_source]
            if state == WAITING:
                sensors = self._inputs.sensors.items()
                missing += [topic for topic, sensor in sensors if isinstance(sensor, FixSensor | DockSensor)]
            faults += filter(None, map(self._why_silent, missing))
        return "; ".join(faults)

    def _why_silent(self, topic: str) -> str:
        """Return why no message arrives on a topic; empty if messages arrive."""
        if problem := self.input_problem(topic):
            return problem
        now = time.monotonic()
        if now - self.health.last_received.get(topic, -math.inf) <= self.config.sensor_timeout:
            return ""
        dropped = self.health.newest_drop(topic, now, math.inf)
        newest = f", and its newest message was dropped: {dropped}" if dropped else ""
        return f"nothing arrives on {self.resolve_topic_name(topic)}{newest}"

    def _level(self, state: str) -> int:
        if state == INACTIVE or (state == RUNNING and not self._faults):
            return int(DiagnosticStatus.OK[0])
        return int((DiagnosticStatus.WARN if state in (RUNNING, WAITING) else DiagnosticStatus.ERROR)[0])

    def health_level(self) -> tuple[int, str]:
        """Return level and text for /diagnostics; the text begins with the state of the filter."""
        level, text = super().health_level()
        state, consistency = self.state(), self.localization.consistency()
        warnings = []
        if reason := self._reason(state):
            warnings.append(reason)
        warnings += [fault for fault in self._faults.values() if fault not in reason]
        if any(one.nis > one.alarm for one in consistency.values()):
            warnings.append("innovations larger than the covariances allow")
        if self.config.localization.filter.use_gyro and self.localization.initialised:
            if not self._is_recent(self._last_gyro):
                warnings.append("no turn rate on imu")
            elif self.localization.slipping > _MAX_SLIP and "turn rate" not in self._faults:
                warnings.append(CONTRADICT)
        warnings += [
            f"innovations of {name} correlated in time" for name, one in consistency.items() if one.is_correlated
        ]
        if warnings:
            level, text = max(level, DiagnosticStatus.WARN[0]), "; ".join([*warnings, text])
        return max(level, self._level(state)), f"{state}; {text}"

    def _on_sensor(self, topic: str, message: Any) -> None:
        content = self._inputs.sensors[topic].read(message)
        self._watch.clocks.add(topic, measured_ns(message.header.stamp), self._now_ns())
        if content.unknown:
            self.health.counted[f"{topic} with unknown ids"] += content.unknown
        fuse(content, self.localization, partial(self._drop_one, topic))
        if content.gyro is not None:
            self._last_gyro = time.monotonic_ns()
        if content.assumed:
            note = f"{topic} without a transform of its frame"
            self.health.counted[note] += 1
            if self.health.counted[note] == 1:
                self.get_logger().warning(f"{topic}: {content.assumed} (logged once)")
        if content.uses_fallback:
            self.health.counted[f"{topic} with the covariance of the parameters"] += 1

    def _now_ns(self) -> int:
        return int(self.get_clock().handle.get_now().nanoseconds)

    def _receive_latched(self) -> None:
        """Subscribe to latched fixes until the filter is initialised: AMCL publishes a new fix only after a motion."""
        if self.localization.initialised:
            self._end_latched()
            return
        for topic, sensor in self._inputs.sensors.items():
            if not isinstance(sensor, FixSensor) or topic in self._latched:
                continue
            publishers = self.get_publishers_info_by_topic(self.resolve_topic_name(topic))
            if any(one.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for one in publishers):
                receive = self.contained(partial(self._on_latched, topic), topic)
                kind = _message_class(sensor.message_type)
                # Not by self.subscribe(), because the QoS parameters of the topic are for its other subscription.
                self._latched[topic] = Node.create_subscription(self, kind, topic, receive, LATCHED)

    def _end_latched(self) -> None:
        while self._latched:
            self.destroy_subscription(self._latched.popitem()[1])

    def _on_latched(self, topic: str, message: Any) -> None:
        if not self.localization.initialised:
            self._on_sensor(topic, message)

    def _drop_one(self, topic: str, error: BadMessageError) -> None:
        """Count a dropped measurement of a message with several measurements, and log the first one."""
        if self.health.drop(topic, error.kind, str(error)):
            self.get_logger().warning(f"{topic}: dropped: {error} (logged once; see /diagnostics)")

    def _restore(self) -> StateKeeper | None:
        path = file_path("state_file", self.config.state_file)
        if path is None:
            return None
        keeper = StateKeeper(path, self.localization)
        try:
            self.get_logger().info(keeper.restore(self.config.wheels))
        except BrokenStateError as error:
            # The robot must be able to start without the state.
            self.get_logger().error(f"state not restored: {error}")
        except DiffbotError as error:
            self.get_logger().error(f"state not restored, and it will not be saved: {error}")
            return None
        return keeper

    def _save(self, *, is_last: bool = False) -> None:
        if self._keeper is None:
            return
        try:
            if is_last:
                self._keeper.save(self.config.wheels)
            else:
                self._keeper.start_save(self.config.wheels)
        except OSError as error:
            self.get_logger().error(f"cannot write state_file: {error.strerror or error}", throttle_duration_sec=60.0)

    def _on_initialpose(self, message: PoseWithCovarianceStamped) -> None:
        stamp, pose, R = self._inputs.initialpose(message)
        if R is self._inputs.initial_noise.R:
            self.health.counted["initialpose with the covariance of the parameters"] += 1
        self.localization.initialise(pose, R, stamp or None)
        self.get_logger().info("initialised at x {:.3f} m, y {:.3f} m, heading {:.3f} rad".format(*pose))

    def _on_odometry(self, message: Odometry) -> None:
        step = self._inputs.odometry(message)
        expected = odometry_frame(self.config) if self._transforms is not None else ""
        self._watch.receive_frame(message.header.frame_id, expected)
        with suppress(BadMessageError):  # the filter only needs the twist
            self._watch.odometry.add(step.stamp, pose_of(message.pose.pose), step.twist)
        estimate = self._fuse_odometry(step)
        if self._transforms is not None and self.is_active and not self.localization.contradiction.cause:
            self._transforms.send(estimate.stamp, estimate.pose, pose_of(message.pose.pose))

    def _on_joint_states(self, message: JointState) -> None:
        step = self._inputs.joint_states(message)
        self._watch.receive_joints(tuple(message.name), has_wheels=step is not None)
        if step is None:
            self.health.counted["joint_states of other joints"] += 1
            return
        estimate = self._fuse_odometry(step)
        self._newest = estimate, step

    def _on_odometry_pose(self, message: Odometry) -> None:
        """Publish map -> odom if joint_states is the odometry of the filter."""
        self._watch.receive_frame(message.header.frame_id, odometry_frame(self.config))
        stamp, in_odom = self._inputs.odometry(message).stamp, pose_of(message.pose.pose)
        if self._transforms is None or self._newest is None:
            return
        if not self.is_active or self.localization.contradiction.cause:
            return
        estimate, step = self._newest
        dt = (stamp - estimate.stamp) * S_PER_NS
        if abs(dt) <= self.config.sensor_timeout:
            twist, _ = self.localization.twist_of(estimate, step)
            self._transforms.send(stamp, move(estimate.pose, twist, dt), in_odom)

    def _fuse_odometry(self, odometry: OdometryStep) -> FilterEstimate:
        """Move the filter to the stamp of an odometry message, and publish the estimate if the node is active."""
        self._last_arrival = now = time.monotonic_ns()
        self._watch.clocks.add(self.config.odometry_source, odometry.stamp, self._now_ns())
        valid_for, is_simulated = math.inf, self.clock_watch.is_simulated
        self.localization.time_restarts = is_simulated
        if not is_simulated:
            valid_for = self._clock_steps.passed(odometry.stamp, now * S_PER_NS)
        advances = self._odometry_stamps.advances(odometry.stamp)
        if advances and not self.localization.initialised:
            # Before the first fix, on_odometry raises an error even for a valid message.
            self._last_odometry = now
        estimate = self.localization.on_odometry(odometry, valid_for)
        if valid_for < math.inf:
            self.health.counted["forward steps of the odometry clock"] += 1
        if advances:
            self._last_odometry = now
        else:
            self.health.counted["odometry without a later stamp"] += 1
        if not self.is_active:
            return estimate
        if self.localization.contradiction.cause:
            # A wrong estimate must not drive the robot.
            if self._last_state != CONTRADICTED:
                self._publish_status()
            return estimate
        if self.pose_receiver is not None:
            self._call_receiver(estimate, self.pose_receiver)
        self._outputs.send_pose(estimate)
        if self._last_state != RUNNING:
            self._publish_status()
        self._outputs.send_filtered(estimate, *self.localization.twist_of(estimate, odometry))
        return estimate

    def _call_receiver(self, estimate: FilterEstimate, receiver: PoseReceiver) -> None:
        """Pass an estimate to the controller in this process, with the numbers that a message would contain."""
        pose, uncertainty = pose_in_message(estimate.pose), uncertainty_of(estimate.P)
        # The controller would drop a message that is not finite.
        if math.isfinite(sum(pose) + sum(uncertainty)):
            receiver(estimate.stamp, pose, uncertainty)

    def restart(self) -> None:
        """Reset the pose and all estimated errors; the next fix starts the filter again."""
        self.localization.reset()
        self._newest = None
        self._end_latched()  # a new subscription receives the latched fix again

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.restart()
        self.health.reset()
        if self._keeper is not None:
            try:
                self._keeper.delete()
            except OSError as error:
                self.get_logger().error(f"cannot delete state_file: {error.strerror or error}")
        response.success, response.message = True, "waiting for the next fix"
        self._publish_status()
        return response

    def _check_and_report(self) -> None:
        self.localization.check_innovations()
        self._receive_latched()
        if (now := time.monotonic()) >= self._window_end:
            self._window_end = now + WINDOW
            self._watch.clocks.end_window()
        self._faults = self._watch.faults(self.localization.turns, is_simulated=self.clock_watch.is_simulated)
        for name, fault in self._faults.items():
            if self._fault_log.is_due(name, now):
                self.get_logger().warning(fault)
        self._publish_status()

    def _publish_status(self) -> None:
        state = self.state()
        values = self.details() | self.health.ages(time.monotonic())
        if state != self._last_state:
            self.get_logger().info(state)
        self._last_state = state
        if reason := self._reason(state):
            values["reason"] = reason
        self._statuses.publish(status_message(self.get_fully_qualified_name(), self._level(state), state, values))

    def details(self) -> dict[str, str]:
        """Return the values of the filter for ~/status and /diagnostics."""
        values = {"filter": self.config.localization.filter.filter}
        if self.localization.initialised:
            values |= localization_values(self.localization)
        if self.localization.slips:
            values["odometry steps against the gyro"] = str(self.localization.slips)
        if self.localization.clock_set_back:
            values["backward steps of the odometry clock"] = str(self.localization.clock_set_back)
        if self.localization.dropped_before_odometry:
            values["measurements before the first odometry"] = str(self.localization.dropped_before_odometry)
        return values


def _message_class(name: str) -> Any:
    """Return the class of a message type such as ``sensor_msgs/msg/Imu``."""
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def main(args: list[str] | None = None) -> int:
    """Run the node, and return the exit status of the process."""
    return run(EkfNode, args, shared_memory=False)


if __name__ == "__main__":
    raise SystemExit(main())
