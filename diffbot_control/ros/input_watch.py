"""Detection of faults in the inputs of the ekf that a single message does not show, such as wrong clocks or axes."""

from __future__ import annotations

from collections.abc import Mapping

from diffbot_control.filter.odometry_check import Agreement, OdometryCheck
from diffbot_core.stamps import RelativeClocks

WAITING, RUNNING, SILENT, CONTRADICTED = "waiting for first fix", "running", "no odometry", "poses withheld"
"""States of the ekf in ~/status; in SILENT and CONTRADICTED it publishes no pose."""
WINDOW = 2.0
"""[s] duration of the windows in which the clocks of the inputs are compared"""
_MAX_OFFSET, _MAX_OFFSET_SIMULATED = 0.1, 0.5
"""[s] Largest offset between the clocks of two inputs. Simulated time advances in steps and is less accurate."""
_MAX_NAMES = 5
"""Largest number of joints that the text of a fault lists."""
CONTRADICT = "wheels and gyro contradict each other"


class InputWatch:
    """Compares the clocks of all inputs, twist and pose of the odometry, and the turn rates of wheels and gyro."""

    def __init__(self, reference: str, wheels: tuple[str, str], delays: Mapping[str, float]) -> None:
        """Start without a message.

        Args:
            reference: topic of the odometry, with whose clock the other clocks are compared.
            wheels: names of the joints of both wheels.
            delays: typical delay [s] from a measurement to its message, by topic.
        """
        self._reference, self._wheels, self._delays = reference, wheels, delays
        self.clocks = RelativeClocks()
        """clocks of all inputs; the windows last for WINDOW seconds"""
        self.odometry = OdometryCheck()
        self._joints: tuple[str, ...] = ()
        """joints of the newest JointState; empty if any JointState has contained a wheel"""
        self._has_wheels = False
        self._frames: tuple[str, str] | None = None
        """frame of the newest odometry message, and the expected frame, if they differ"""

    def receive_frame(self, frame: str, expected: str) -> None:
        """Add the frame of an odometry message; ``expected`` is the child frame of a published map -> odom, else ""."""
        self._frames = (frame, expected) if expected and frame != expected else None

    def receive_joints(self, names: tuple[str, ...], *, has_wheels: bool) -> None:
        """Add the names of the joints of a JointState."""
        self._has_wheels = self._has_wheels or has_wheels
        self._joints = () if self._has_wheels else names

    def faults(self, turns: Agreement, *, is_simulated: bool) -> dict[str, str]:
        """Return a text for each fault, by the name of the input. It describes the fault and says what to do.

        Args:
            turns: agreement of the turn rates of wheels and gyro.
            is_simulated: the node uses the time of /clock.
        """
        found = {}
        limit = _MAX_OFFSET_SIMULATED if is_simulated else _MAX_OFFSET
        for topic, ahead in self.clocks.ahead_of(self._reference).items():
            if ahead > limit:
                remedy = f"synchronise the clocks that stamp both (chrony), or stamp {self._reference} sooner"
                found[topic] = f"{topic} is stamped {ahead:.2f} s ahead of {self._reference}: {remedy}"
            elif -ahead > limit + self._delays.get(topic, 0.0):
                remedy = f"synchronise the clocks that stamp both (chrony), or publish {topic} with less delay"
                found[topic] = f"{topic} is stamped {-ahead:.2f} s behind {self._reference}: {remedy}"
        if fault := self.odometry.fault():
            found["odom"] = f"odom: {fault}"
        if self._frames is not None:
            frame, expected = self._frames
            found["frame"] = (
                f"odom has the frame_id {frame[:80]!r}, but map -> odom is published for {expected!r}: set odom_frame "
                "(and frame_prefix) to the frame_id of the driver"
            )
        if fault := turn_fault(turns, self._reference):
            found["turn rate"] = f"{CONTRADICT}: {fault}"
        if self._joints:
            names = ", ".join(self._joints[:_MAX_NAMES])
            left, right = self._wheels
            found["joint_states"] = (
                f"joint_states has neither {left!r} nor {right!r}, but {names[:200]}: set left_wheel_name and "
                "right_wheel_name to the joints of the wheels"
            )
        return found


def turn_fault(turns: Agreement, reference: str) -> str:
    """Return how the turn rates of wheels (first) and gyro (second) contradict each other; empty if they agree."""
    texts = {
        "opposed": f"the turn rates of imu and {reference} have opposite signs: publish the transform of the frame of "
        "imu if its z axis does not point up, or swap left and right wheel",
        "only_first": f"{reference} shows a turn, but imu does not: check that its driver fills angular_velocity.z "
        "in rad/s",
        "only_second": f"imu shows a turn, but {reference} does not: check that its driver fills the turn rate, and "
        "that the wheels have grip",
        "scaled": f"the turn rates of imu and {reference} differ by a factor of ten or more: both must be in rad/s",
    }
    return texts.get(turns.contradiction(), "")
