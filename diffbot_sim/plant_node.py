"""The node ``plant``: cmd_vel -> odom, joint_states, sensors, ground_truth, and the simulation's clock."""

from __future__ import annotations

import time
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped, TwistStamped
from geometry_msgs.msg import Twist as TwistMessage
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState, PointCloud2, PointField
from std_srvs.srv import SetBool, Trigger

from diffbot_control.estimator import Measurement
from diffbot_control.geometry import Pose
from diffbot_control.kinematics import Twist
from diffbot_control.point_cloud import LandmarkPoint, fill_landmark_points
from diffbot_control.ros_messages import (
    NANO,
    TFMessage,
    fill_planar_covariance,
    fill_pose,
    fill_twist,
    fill_twist_covariance,
    fill_yaw,
    odometry_message,
    pose_message,
    set_stamp,
    transform_message,
    twist_from,
)
from diffbot_control.ros_runtime import QUEUE, DiffbotNode, run
from diffbot_sim.node_config import PlantNodeConfig
from diffbot_sim.pacing import LOCKSTEP, WALL, ClockPace, LockStep
from diffbot_sim.world import Arrivals, Sighting, World

_POLL = 0.02
"""[s] between two looks at the graph before the first lock-step, and between two questions of a step in doubt."""
_KNOWN_POLLS = 10
"""Polls in a row that find the same neighbours: what one side of a connection knows the other learns later."""
_FIRST_STEPS, _STEPS_A_POLL = 1000, 5
"""Steps for which a first fix is waited for that is late or lost, and so many of them a poll."""
_SILENT = ("headings", "landmarks")
"""Arrivals whose first message may be missed by the filter unnoticed; without the first fix it gives no answer."""


class PlantNode(DiffbotNode[PlantNodeConfig]):
    """The simulated robot in the graph."""

    def __init__(self, **node_options: Any) -> None:
        """Create publishers, the command's subscription, the pace, and the services ~/reset and ~/pause."""
        super().__init__("plant", PlantNodeConfig, **node_options)
        config = self.config
        start = round(config.start_time * NANO) or time.time_ns()
        self.world = World(config.world, start)
        self.paused = config.start_paused
        self._make_publishers(config)
        self._command = Twist(0.0, 0.0)
        self._command_step = 0
        self._arrivals: Arrivals | None = None
        command_type, heard = (
            (TwistStamped, lambda message: self._on_command(message.twist))
            if config.enable_stamped_cmd_vel
            else (TwistMessage, self._on_command)
        )
        self._commands = self.listen(command_type, "cmd_vel", heard, QoSProfile(depth=1))
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self._sent_first = False
        self._neighbours: list[int] = []
        self._known_polls = 0
        self._sent_once: set[str] = set()
        self._progress = 0
        self._lockstep = LockStep()
        factor = 1.0 if config.clock == WALL else config.real_time_factor
        period = config.world.plant.sampling_time / factor
        self._pace = ClockPace(period, self._now())
        if config.clock == LOCKSTEP:
            self.create_timer(config.lockstep_timeout, self._on_stall_check, clock=self.steady_clock)
            self._poll = self.create_timer(_POLL, self._on_poll, clock=self.steady_clock)
        else:
            self.create_timer(period, self._on_clock_tick, clock=self.steady_clock)

    def on_config(self, config: PlantNodeConfig) -> None:
        """Take over changed noise, faults and rates; a changed start counts from the next reset."""
        self.world.configure(config.world)

    def health_level(self) -> tuple[int, str]:
        """Add the pace to /diagnostics."""
        level, text = super().health_level()
        self.health.notes = {
            "steps": str(self.world.state.step),
            "steps skipped": str(self._pace.skipped),
            "steps sent again": str(self._lockstep.repeats),
        }
        return level, f"{'paused' if self.paused else 'running'}; {text}"

    def _make_publishers(self, config: PlantNodeConfig) -> None:
        self._odometry = odometry_message(config.odom_frame, config.base_link_frame)
        self._truth = odometry_message(config.map_frame, config.base_link_frame)
        self._fix = pose_message(config.map_frame)
        self._heading = Imu()
        self._heading.header.frame_id = config.base_link_frame
        # REP-145: no angular velocity, no acceleration in it.
        self._heading.angular_velocity_covariance[0] = -1.0
        self._heading.linear_acceleration_covariance[0] = -1.0
        self._heading.orientation_covariance[[0, 4]] = 1e6
        self._cloud = PointCloud2()
        self._cloud.header.frame_id = config.base_link_frame
        self._joints = JointState(name=[config.left_wheel_name, config.right_wheel_name])
        self._clock_message = Clock()
        self._odometries = self.create_publisher(Odometry, "odom", QUEUE)
        self._truths = self.create_publisher(Odometry, "ground_truth", QUEUE)
        self._fixes = self.create_publisher(PoseWithCovarianceStamped, "global_pose", QUEUE)
        self._headings = self.create_publisher(Imu, "heading", QUEUE)
        self._clouds = self.create_publisher(PointCloud2, "landmarks", QUEUE)
        self._joint_states = self.create_publisher(JointState, "joint_states", QUEUE)
        self._clocks = self.create_publisher(Clock, "/clock", QUEUE) if config.clock != WALL else None
        self._transforms = None
        if config.publish_tf and TFMessage is None:
            self.get_logger().info("tf2_msgs is not installed: no TF is published")
        elif config.publish_tf:
            self._transforms = self.create_publisher(TFMessage, "/tf", QUEUE)

    def _now(self) -> float:
        return float(self.steady_clock.now().nanoseconds / NANO)

    def _on_command(self, message: TwistMessage) -> None:
        self._command = twist_from(message)
        self._command_step = self.world.state.step
        if self.config.clock == LOCKSTEP:
            self._progress += 1
            self._lockstep.answer()
            self._lock_step_if_sure()

    def _on_poll(self) -> None:
        """Look for the filter before the first step; later ask a step in doubt again."""
        if not self._sent_first:
            self._count_known_polls()
        if self.paused:
            return
        if not self._sent_first:
            self._wait_for_first_step()
        elif self._lockstep.complete:
            if self._lockstep.ask_once_more():
                self._ask()
            else:
                self._poll.cancel()
                self._lock_step()

    def _first_heard(self) -> list[Any]:
        """Publishers that a filter has to hear from the first step on; one that hears joint_states needs no odom."""
        moving = self._odometries
        if self._joint_states.get_subscription_count() and not self._odometries.get_subscription_count():
            moving = self._joint_states
        return [moving, self._fixes] if self.config.world.sensors.fix_rate > 0.0 else [moving]

    def _count_known_polls(self) -> None:
        before = self._neighbours
        senders = (self._odometries, self._fixes, self._headings, self._clouds)
        self._neighbours = [sender.get_subscription_count() for sender in senders]
        self._neighbours.append(self._commands.get_publisher_count())
        found = all(sender.get_subscription_count() for sender in self._first_heard())
        self._known_polls = self._known_polls + 1 if found and self._neighbours == before else 0

    def _wait_for_first_step(self) -> None:
        """Take it once the filter hears and has a fix to begin with: a lost one would make another run of this one.

        While the first fix is late or lost only time passes. The filter gets no odometry: it has no pose to answer
        with, and heard after the fix the answer would be taken for that to another step.
        """
        if self._known_polls < _KNOWN_POLLS:
            topics = " and ".join(publisher.topic_name for publisher in self._first_heard())
            self.get_logger().info(f"waiting for a filter on {topics}", throttle_duration_sec=5.0)
            return
        for _ in range(_STEPS_A_POLL):
            no_fix = self._fixes in self._first_heard() and not self._sense().fixes
            if no_fix and self.world.state.step < _FIRST_STEPS:
                self._publish_truth(self.world)
                self._advance(Twist(0.0, 0.0))
                continue
            if no_fix:
                self.get_logger().error(
                    f"no fix in the first {_FIRST_STEPS} steps (see fix_delay and fix_dropout):"
                    " the filter cannot answer before it has one, or an initialpose"
                )
            self._poll.cancel()
            self._sent_first = True
            self._begin_step()
            return

    def _on_stall_check(self) -> None:
        moved, self._progress = self._progress, 0
        if moved or self.paused or not self._sent_first:
            return
        if self._lockstep.stalled():
            self._lock_step_if_sure()
            return
        self.get_logger().warning(
            "no command on cmd_vel: the step's messages are sent again (is the controller's publish_when_idle set?)",
            throttle_duration_sec=10.0,
        )
        self._poll.reset()
        self._ask()
        self._progress = 0

    def _ask(self) -> None:
        self._progress += 1
        self._lockstep.ask()
        self._publish(self.world)

    def _lock_step_if_sure(self) -> None:
        """Go on if the step is answered; one in doubt is left to the polls."""
        if self._lockstep.complete and not self._lockstep.doubts and not self.paused:
            self._lock_step()

    def _lock_step(self) -> None:
        self._advance(self._command)
        self._begin_step()

    def _begin_step(self) -> None:
        self._lockstep.next_step()
        arrivals = self._sense()
        news = {name for name in _SILENT if getattr(arrivals, name)} - self._sent_once
        if news:
            self._sent_once |= news
            self._lockstep.doubt()
            self._poll.reset()
        self._ask()

    def _advance(self, command: Twist) -> None:
        self.world.advance(command)
        self._arrivals = None

    def _sense(self) -> Arrivals:
        """Measurements of the present step: the same ones whenever its messages are sent again."""
        if self._arrivals is None:
            self._arrivals = self.world.sense()
        return self._arrivals

    def _on_clock_tick(self) -> None:
        if self.paused:
            return
        if not self._sent_first:
            self._sent_first = True
            self._catch_up_with_the_wall()
            self._pace.restart(self._now())
            self._publish(self.world)
        for _ in range(self._pace.due(self._now())):
            plant = self.config.world.plant
            silence = (self.world.state.step - self._command_step) * plant.sampling_time
            self._advance(self._command if silence < plant.cmd_vel_timeout else Twist(0.0, 0.0))
            self._publish(self.world)

    def _catch_up_with_the_wall(self) -> None:
        """Let the present step be now, after a time in which nothing moved; simulated time stands still in a pause."""
        if self.config.clock == WALL and self.config.start_time == 0.0:
            self.world.start_stamp += time.time_ns() - self.world.stamp

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        # Time goes on: messages stamped in the past would upset everyone who listens.
        self.world = World(self.config.world, self.world.stamp + self.world.period)
        self._command, self._command_step = Twist(0.0, 0.0), 0
        self._arrivals = None
        response.success, response.message = (
            True,
            "back at the start pose, noise from its first number on",
        )
        if self.config.clock == LOCKSTEP:
            self._lockstep.next_step()
            # What was asked before is answered while the polls count anew.
            self._sent_first, self._known_polls = False, 0
            self._sent_once.clear()
            self._poll.reset()
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        resumed = self.paused and not request.data
        self.paused = request.data
        response.success, response.message = True, "paused" if self.paused else "running"
        if resumed:
            self._pace.restart(self._now())
            if self._sent_first:
                self._catch_up_with_the_wall()
            self._lock_step_if_sure()
        return response

    def _publish_truth(self, world: World) -> None:
        """Send the time and where the robot is: what no filter answers."""
        if self._clocks is not None:
            set_stamp(self._clock_message.clock, world.stamp)
            self._clocks.publish(self._clock_message)
        if self._truths.get_subscription_count():
            self._send_odometry(self._truths, self._truth, world.stamp, world.state.pose, world.state.twist)

    def _publish(self, world: World) -> None:
        """Send all messages of the present step, the odometry last: it is what the filter answers."""
        stamp = world.stamp
        self._publish_truth(world)
        arrivals = self._sense()
        for fix in arrivals.fixes:
            self._send_fix(fix)
        for heading in arrivals.headings:
            self._send_heading(heading)
        if arrivals.landmarks:
            self._send_landmarks(stamp, arrivals.landmarks)
        if self._joint_states.get_subscription_count():
            self._send_joint_states(stamp, world)
        in_odom = world.state.odometry
        if self._transforms is not None:
            frames = self.config.odom_frame, self.config.base_link_frame
            self._transforms.publish(transform_message(stamp, *frames, in_odom))
        odometry = world.odometry()
        fill_planar_covariance(self._odometry.pose.covariance, world.odometry_P)
        fill_twist_covariance(self._odometry.twist.covariance, odometry[2:])
        self._send_odometry(self._odometries, self._odometry, stamp, in_odom, odometry.twist)
        self.health.sent["odom"] += 1

    def _send_odometry(self, publisher: Any, message: Odometry, stamp: int, pose: Pose, twist: Twist) -> None:
        set_stamp(message.header.stamp, stamp)
        fill_pose(message.pose.pose, pose)
        fill_twist(message.twist.twist, twist)
        publisher.publish(message)

    def _send_fix(self, fix: Measurement) -> None:
        set_stamp(self._fix.header.stamp, fix.stamp)
        x, y, theta = fix.z.tolist()
        fill_pose(self._fix.pose.pose, Pose(x, y, theta))
        fill_planar_covariance(self._fix.pose.covariance, fix.R)
        self._fixes.publish(self._fix)
        self.health.sent["global_pose"] += 1

    def _send_heading(self, heading: Measurement) -> None:
        set_stamp(self._heading.header.stamp, heading.stamp)
        fill_yaw(self._heading.orientation, float(heading.z[0]))
        self._heading.orientation_covariance[8] = heading.R[0, 0]
        self._headings.publish(self._heading)
        self.health.sent["heading"] += 1

    def _send_landmarks(self, stamp: int, sightings: list[Sighting]) -> None:
        set_stamp(self._cloud.header.stamp, stamp)
        seen = [
            LandmarkPoint(number, *measured.z.tolist(), *measured.R.diagonal().tolist())
            for number, measured in sightings
        ]
        fill_landmark_points(self._cloud, seen, PointField)
        self._clouds.publish(self._cloud)
        self.health.sent["landmarks"] += 1

    def _send_joint_states(self, stamp: int, world: World) -> None:
        set_stamp(self._joints.header.stamp, stamp)
        self._joints.position = list(world.state.angles)
        self._joints.velocity = list(world.state.encoder)
        self._joint_states.publish(self._joints)
        self.health.sent["joint_states"] += 1


def main(args: list[str] | None = None) -> int:
    """Run the node; the exit status of the process."""
    return run(PlantNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
