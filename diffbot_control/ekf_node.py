"""The node ``ekf``: odometry, fixes, headings and landmarks -> pose and odometry/filtered."""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_control.ekf_node"))

import importlib
import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.localization import FilterEstimate, Localization
from diffbot_control.filter.models import move
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.filter.state_file import BrokenStateError, StateKeeper
from diffbot_control.ros.ekf_publishers import EkfPublishers
from diffbot_control.ros.frames import odometry_frame
from diffbot_control.ros.messages.ekf import EkfInputs, error_values
from diffbot_control.ros.messages.fields import pose_in_message, pose_of
from diffbot_control.ros.messages.raw import read_odometry, read_pose
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors.fixes import POSE_MESSAGE
from diffbot_control.ros.sensors.sensor import Sensor, fuse
from diffbot_control.ros.tf import transform_sender
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.files import file_path
from diffbot_core.geometry import Pose
from diffbot_core.ros.managed_node import INACTIVE, ManagedNode
from diffbot_core.ros.node import run, status_message
from diffbot_core.ros.qos import STATUS, sensor_qos
from diffbot_core.stamps import StampWatch
from diffbot_core.uncertainty import Uncertainty
from diffbot_core.units import S_PER_NS

WAITING = "waiting for first fix"
RUNNING = "running"
SILENT = "no odometry"
CONTRADICTED = "poses withheld"
STANDSTILL = "odometry stands still"
"""What /diagnostics adds if messages come, but none with a later stamp."""
_STATUS_PERIOD = 0.5
_READERS = {POSE_MESSAGE: read_pose}
"""Readers of frequent messages from their bytes."""
_MAX_SLIP = 3.0
"""[s] of wheels and gyro that contradict each other, after which one of them is broken"""
_SAVE_PERIOD = 5.0
"""[s] between two saves of the state file: what a crash can lose."""

PoseReceiver = Callable[[int, Pose, Uncertainty], None]
"""Takes stamp [ns], pose in ``map_frame`` and uncertainty of an estimate."""


class EkfNode(ManagedNode[EkfNodeConfig]):
    """Answers each odometry message with one pose that has the same stamp."""

    pose_receiver: PoseReceiver | None = None
    """called with each estimate before it is published, see robot_node"""

    def __init__(self, **node_options: Any) -> None:
        """Create the node, and with ``autostart`` start it."""
        super().__init__("ekf", EkfNodeConfig, **node_options)

    def configure(self) -> None:
        """Create publishers, subscriptions and the service ~/reset."""
        config = self.config
        separation = config.wheels.wheel_separation
        self.localization = Localization(
            config.localization,
            separation,
            config.sensor_timeout,
            landmarks=bool(config.landmarks.landmark_ids),
        )
        self._outputs = EkfPublishers(self)
        self._statuses = self.create_publisher(DiagnosticStatus, "~/status", STATUS)
        frames = config.map_frame, odometry_frame(config)
        self._transforms = transform_sender(self, *frames, config.transform_tolerance) if config.publish_tf else None
        self._newest: tuple[FilterEstimate, OdometryStep] | None = None
        self._last_state = ""
        self._odometry_stamps = StampWatch()
        self._last_odometry: int | None = None
        """[ns] steady time of the newest odometry that was accepted and whose stamp advanced"""
        self._last_arrival: int | None = None
        """[ns] steady time of the newest odometry of any kind"""
        self._last_gyro: int | None = None
        """[ns] steady time of the newest turn rate that was used"""
        self._inputs = EkfInputs(config)
        self._keeper = self._restore()
        qos = sensor_qos(config.reliable_inputs)
        # Sensors before odometry: an executor that finds both waiting handles them in this order.
        for sensor in self._inputs.sensors:
            self._subscribe_to(sensor, qos)
        self.subscribe(PoseWithCovarianceStamped, "initialpose", self._on_initialpose)
        if config.odometry_source == "odom":
            self.publisher_watch.watch("odom", "measure the motion")
            self.subscribe(Odometry, "odom", lambda data: self._on_odometry(read_odometry(data)), qos, raw=True)
        else:
            self.subscribe(JointState, "joint_states", self._on_joint_states, qos)
            if self._transforms is not None:
                self.subscribe(Odometry, "odom", self._on_odometry_pose, qos)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_timer(_STATUS_PERIOD, self._check_and_report, clock=self.steady_clock)
        if self._keeper is not None:
            self.create_timer(_SAVE_PERIOD, self._save, clock=self.steady_clock)

    def on_config(self, config: EkfNodeConfig) -> None:
        """Apply changed options."""
        self.localization.configure(config.localization, config.wheels.wheel_separation)
        self.localization.max_extrapolation = config.sensor_timeout
        self._inputs = EkfInputs(config)

    def activate(self) -> None:
        """Publish from the next odometry on; an inactive filter fuses, too, so that its estimate is the present one."""
        self._publish_status()

    def deactivate(self) -> None:
        """Publish no more poses."""
        self._publish_status()

    def cleanup(self) -> None:
        """Save the state, if there is a state file."""
        self._save()

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
        """Return why the filter does not run, where there is more to say."""
        if state == CONTRADICTED:
            return self.localization.contradiction.cause
        return STANDSTILL if state == SILENT and self._is_recent(self._last_arrival) else ""

    def _level(self, state: str) -> int:
        if state in (RUNNING, INACTIVE):
            return int(DiagnosticStatus.OK[0])
        return int((DiagnosticStatus.WARN if state == WAITING else DiagnosticStatus.ERROR)[0])

    def health_level(self) -> tuple[int, str]:
        """Report the filter's state in /diagnostics."""
        level, text = super().health_level()
        state, nis = self.state(), self.localization.monitor.nis()
        warnings = []
        if reason := self._reason(state):
            warnings.append(reason)
        if nis is not None and nis.mean > nis.alarm:
            warnings.append("innovations larger than the covariances allow")
        if self.config.localization.filter.use_gyro and self.localization.initialised:
            if not self._is_recent(self._last_gyro):
                warnings.append("no turn rate on imu")
            elif self.localization.slipping > _MAX_SLIP:
                warnings.append("wheels and gyro contradict each other")
        warnings += [f"innovations of {name} correlated in time" for name in self.localization.correlated()]
        if warnings:
            level, text = max(level, DiagnosticStatus.WARN[0]), "; ".join([*warnings, text])
        return max(level, self._level(state)), f"{state}; {text}"

    def _subscribe_to(self, sensor: Sensor, qos: QoSProfile) -> None:
        message_type = _message_class(sensor.message_type)
        read = _READERS.get(sensor.message_type)
        if read is None:
            self.subscribe(message_type, sensor.topic, partial(self._on_sensor, sensor.topic), qos)
        else:
            handle = partial(self._on_sensor, sensor.topic)
            self.subscribe(message_type, sensor.topic, lambda data: handle(read(data)), qos, raw=True)

    def _on_sensor(self, topic: str, message: Any) -> None:
        reading = self._inputs.sensor(topic).read(message)
        if reading.unknown:
            self.health.counted[f"{topic} of unknown number"] += reading.unknown
        fuse(reading, self.localization, partial(self._drop_one, topic))
        if reading.gyro is not None:
            self._last_gyro = time.monotonic_ns()
        if reading.uses_fallback:
            self.health.counted[f"{topic} with the covariance of the parameters"] += 1

    def _drop_one(self, topic: str, error: BadMessageError) -> None:
        """Count one measurement of several: the others of the message may be good."""
        if self.health.drop(topic, error.kind):
            self.get_logger().warning(f"{topic}: dropped: {error} (logged once; see /diagnostics)")

    def _restore(self) -> StateKeeper | None:
        path = file_path("state_file", self.config.state_file)
        if path is None:
            return None
        keeper = StateKeeper(path, self.localization)
        try:
            self.get_logger().info(keeper.restore(self.config.wheels))
        except BrokenStateError as error:
            # The robot must start without it.
            self.get_logger().error(f"state not restored: {error}")
        except DiffbotError as error:
            self.get_logger().error(f"state not restored, and none will be saved: {error}")
            return None
        return keeper

    def _save(self) -> None:
        if self._keeper is None:
            return
        try:
            self._keeper.save(self.config.wheels)
        except OSError as error:
            self.get_logger().error(f"cannot write state_file: {error.strerror or error}", throttle_duration_sec=60.0)

    def _on_initialpose(self, message: PoseWithCovarianceStamped) -> None:
        fix = self._inputs.initialpose(message)
        if fix.R is self._inputs.initial_noise.R:
            self.health.counted["initialpose with the covariance of the parameters"] += 1
        x, y, theta = fix.pose
        self.localization.initialise(fix.pose, fix.R, fix.stamp or None)
        self.get_logger().info(f"initialised at x {x:.3f} m, y {y:.3f} m, heading {theta:.3f} rad")

    def _on_odometry(self, message: Odometry) -> None:
        estimate = self._answer(self._inputs.odometry(message))
        if self._transforms is not None and self.is_active and not self.localization.contradiction.cause:
            self._transforms.send(estimate.stamp, estimate.pose, pose_of(message.pose.pose))

    def _on_joint_states(self, message: JointState) -> None:
        step = self._inputs.joint_states(message)
        estimate = self._answer(step)
        self._newest = estimate, estimate.odometry or step

    def _on_odometry_pose(self, message: Odometry) -> None:
        """Send the transform to the odometry's frame, though the motion is that of joint_states."""
        stamp, in_odom = self._inputs.odometry(message).stamp, pose_of(message.pose.pose)
        if self._transforms is None or self._newest is None:
            return
        if not self.is_active or self.localization.contradiction.cause:
            return
        estimate, step = self._newest
        dt = (stamp - estimate.stamp) * S_PER_NS
        if abs(dt) <= self.config.sensor_timeout:
            twist, _ = self.localization.twist_of(estimate, step)
            self._transforms.send(stamp, move(estimate.pose, twist, dt).end, in_odom)

    def _answer(self, odometry: OdometryStep) -> FilterEstimate:
        self._last_arrival = now = time.monotonic_ns()
        advances = self._odometry_stamps.advances(odometry.stamp)
        if advances and not self.localization.initialised:
            # Refused for want of a fix only.
            self._last_odometry = now
        estimate = self.localization.on_odometry(odometry)
        if advances:
            self._last_odometry = now
        else:
            self.health.counted["odometry without a later stamp"] += 1
        if not self.is_active:
            return estimate
        if self.localization.contradiction.cause:
            # No robot may be driven by this estimate.
            if self._last_state != CONTRADICTED:
                self._publish_status()
            return estimate
        if self.pose_receiver is not None:
            self._hand_over(estimate, self.pose_receiver)
        self._outputs.send_pose(estimate)
        if self._last_state != RUNNING:
            self._publish_status()
        self._outputs.send_filtered(estimate, *self.localization.twist_of(estimate, estimate.odometry or odometry))
        return estimate

    def _hand_over(self, estimate: FilterEstimate, receiver: PoseReceiver) -> None:
        """Give an estimate to the controller of this process, which receives the numbers that the message carries."""
        pose, uncertainty = pose_in_message(estimate.pose), uncertainty_of(estimate.P)
        # All that the checks of a message would find here: the robot must not be driven by a filter that has failed.
        if math.isfinite(sum(pose) + sum(uncertainty)):
            receiver(estimate.stamp, pose, uncertainty)

    def restart(self) -> None:
        """Forget the pose and all estimated errors: the next fix begins anew."""
        self.localization.reset()
        self._newest = None

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
        """Return the filter's values for ~/status and /diagnostics."""
        values = {"filter": self.config.localization.filter.filter}
        if self.localization.initialised:
            values |= self.localization.monitor.values() | error_values(self.localization.filter)
        if self.localization.slips:
            values["odometry steps against the gyro"] = str(self.localization.slips)
        if self.localization.dropped_before_odometry:
            values["measurements before the first odometry"] = str(self.localization.dropped_before_odometry)
        return values


def _message_class(name: str) -> Any:
    """Return the class of a type of messages such as ``sensor_msgs/msg/Imu``."""
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def main(args: list[str] | None = None) -> int:
    """Run the node; the exit status of the process."""
    return run(EkfNode, args, shared_memory=False)
