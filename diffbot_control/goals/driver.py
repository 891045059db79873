"""One law as the supervisor drives with it: steps that cannot take the node down, new goals, coming to rest."""

from __future__ import annotations

import math
import traceback
from pathlib import Path
from typing import Any

from diffbot_control.goals.protocol import Law
from diffbot_control.law.configuration import Report
from diffbot_control.law.controller import SwitchingLaw, stop_step
from diffbot_control.law.goal_checker import is_at_rest, is_knowable
from diffbot_control.law.latency import Actuation, after_a_period, is_immediate
from diffbot_control.law.limits import limit_change, limit_velocity, slowed
from diffbot_control.law.regions import OMEGA_L
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty

STOP = Twist(0.0, 0.0)
_MOTION = {"command": Twist, "actuation": Actuation}
"""Fields of a memory that describe the robot's motion, and their types."""


class LawError(DiffbotError):
    """A law raised, or its answer cannot be used."""


class Driver:
    """Any law of the protocol."""

    def __init__(self, law: Law) -> None:
        """Take the law."""
        self.law = law

    def new_memory(self, config: Any) -> Any:
        """Return the memory at rest with a new goal.

        Raises:
            LawError: if the law raises.
        """
        try:
            return self.law.new_memory(config)
        except Exception as error:
            raise self._error(error) from error

    def memory_for_new_goal(self, memory: Any, config: Any) -> Any:
        """Forget the old goal but not the motion: limits of acceleration and commands under way outlive a goal.

        Raises:
            LawError: if the law raises.
        """
        motion, fresh = motion_of(memory), self.new_memory(config)
        return fresh._replace(**motion) if motion and type(fresh) is type(memory) else fresh

    def step(self, memory: Any, estimate: Estimate, goal: Pose, dt: float, config: Any) -> tuple[Any, Twist, Report]:
        """Take the law's step; see :class:`diffbot_control.goals.protocol.Law`.

        Raises:
            LawError: if it raises, or its answer is not finite or not of the types of the protocol.
        """
        try:
            after, command, report = self.law.step(memory, estimate, goal, dt, config)
            v, omega = float(command.v), float(command.omega)
            finite = math.isfinite(v) and math.isfinite(omega)
            complete = after.reached in (True, False) and len([float(number) for number in report]) == len(
                Report._fields
            )
        except Exception as error:
            raise self._error(error) from error
        if not finite:
            raise LawError(f"law {self.law.name} failed: v = {v} m/s, omega = {omega} rad/s: must be finite")
        if not complete:
            raise LawError(f"law {self.law.name} failed: 'reached' or the report is not as the protocol says")
        return after, Twist(v, omega), report

    def limited(self, memory: Any, command: Twist, last: Twist, dt: float, config: Any) -> tuple[Any, Twist]:
        """Return memory and command of a step within the limits, see :meth:`within_limits`."""
        return self.within_limits(memory, command, last, dt, config)

    def within_limits(self, memory: Any, command: Twist, last: Twist, dt: float, config: Any) -> tuple[Any, Twist]:
        """Return memory and command within the limits of the law's data sheet, whatever the law commands.

        Args:
            memory: of the law, after the step.
            command: of the law.
            last: the command before it.
            dt: [s] between them.
            config: of the law; without a data sheet nothing is limited.
        """
        sheet = getattr(config, "data_sheet", None)
        if not isinstance(sheet, DataSheet):
            return memory, command
        within = limit_change(limit_velocity(command, sheet), last, dt, sheet)
        if within != command and "command" in motion_of(memory):
            memory = memory._replace(command=within)
        return memory, within

    def slow_down(self, memory: Any, last: Twist, dt: float, config: Any) -> tuple[Any, Twist]:
        """One step of coming to rest without a goal, along the curve within the limits of acceleration.

        Args:
            memory: as left by the last step.
            last: the last command, for a law whose memory does not have it.
            dt: [s] since the last step.
            config: of the law; without a data sheet the robot is stopped at once.
        """
        sheet, motion = getattr(config, "data_sheet", None), motion_of(memory)
        if not isinstance(sheet, DataSheet):
            return self.halted(memory, dt, config), STOP
        if len(motion) == len(_MOTION):
            after, command = stop_step(memory, dt, config)
            return after, command
        command = slowed(motion.get("command", last), dt, sheet)
        return memory._replace(command=command) if "command" in motion else memory, command

    def halted(self, memory: Any, passed: float, config: Any) -> Any:
        """Return the memory when zero is sent at once, ``passed`` [s] after a command that is still under way."""
        sheet, motion = getattr(config, "data_sheet", None), motion_of(memory)
        if len(motion) == len(_MOTION) and isinstance(sheet, DataSheet) and not is_immediate(sheet):
            memory = memory._replace(actuation=after_a_period(memory.actuation, memory.command, passed, sheet))
        return memory._replace(command=STOP) if "command" in motion else memory

    def reason_to_give_up(self, memory: Any, config: Any) -> str:
        """Return why the law cannot reach the goal, empty if it may; ``config`` is the supervisor's."""
        ask = getattr(self.law, "reason_to_give_up", None)
        try:
            return str(ask(memory, config.controller)) if callable(ask) else ""
        except Exception as error:
            return str(self._error(error))

    def is_too_uncertain(self, memory: Any, command: Twist, uncertainty: Uncertainty, config: Any) -> bool:
        """True if the robot rests with an estimate too uncertain for the goal to count as reached."""
        return False

    def _error(self, error: Exception) -> LawError:
        frames = traceback.extract_tb(error.__traceback__)
        place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
        return LawError(" ".join(f"law {self.law.name} failed: {type(error).__name__}: {error} ({place})".split()))


class SwitchingDriver(Driver):
    """This project's law, which also has regions and tolerances."""

    def step(self, memory: Any, estimate: Estimate, goal: Pose, dt: float, config: Any) -> tuple[Any, Twist, Report]:
        """Take the law's step. Its command is finite whatever the numbers, and checking it again would cost 1 us.

        Raises:
            LawError: if it raises.
        """
        try:
            return self.law.step(memory, estimate, goal, dt, config)
        except Exception as error:
            raise self._error(error) from error

    def limited(self, memory: Any, command: Twist, last: Twist, dt: float, config: Any) -> tuple[Any, Twist]:
        """Return them as they are: this law keeps the limits itself."""
        return memory, command

    def halted(self, memory: Any, passed: float, config: Any) -> Any:
        """Return the memory when zero is sent at once: the poses in a row within the tolerances begin anew."""
        memory = super().halted(memory, passed, config)
        return memory._replace(settling=memory.settling._replace(steps_within=0))

    def reason_to_give_up(self, memory: Any, config: Any) -> str:
        """Return why the law cannot reach the goal: it has left Omega_L too often."""
        departures = memory.switching.switches // 2
        if 0 < config.max_departures <= departures:
            return f"hunting: left Omega_L {departures} times (max_departures = {config.max_departures})"
        return ""

    def is_too_uncertain(self, memory: Any, command: Twist, uncertainty: Uncertainty, config: Any) -> bool:
        """True if the robot rests in Omega_L with an estimate too uncertain for the tolerances."""
        tolerance = config.tolerance
        at_rest = memory.switching.region == OMEGA_L and is_at_rest(command, tolerance, config.data_sheet)
        return at_rest and not is_knowable(tolerance, scaled_uncertainty(uncertainty, config))


def driver_of(law: Law) -> Driver:
    """Return the driver of a law."""
    return SwitchingDriver(law) if law is SwitchingLaw else Driver(law)


def scaled_uncertainty(uncertainty: Uncertainty, config: Any) -> Uncertainty:
    """Return the uncertainty times ``uncertainty_scale`` of this project's law; ``config`` is the law's."""
    scale = config.uncertainty_scale
    return Uncertainty(scale * uncertainty.xy, scale * uncertainty.theta)


def motion_of(memory: Any) -> dict[str, Any]:
    """Return the fields of a law's memory that describe the robot's motion, as far as it has them."""
    fields = getattr(memory, "_fields", ())
    return {
        name: getattr(memory, name)
        for name, kind in _MOTION.items()
        if name in fields and isinstance(getattr(memory, name), kind)
    }
