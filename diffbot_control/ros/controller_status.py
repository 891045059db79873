"""Values of ~/status of the node ``controller``."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus

from diffbot_control.goals import states
from diffbot_control.goals.protocol import Law
from diffbot_control.goals.supervisor import Supervisor
from diffbot_control.law.configuration import TANH
from diffbot_control.law.controller import SwitchingLaw
from diffbot_control.law.finish import FINISH_NAMES
from diffbot_control.law.paper.reapproach import PHASE_NAMES
from diffbot_control.law.regions import REGION_NAMES

LEVELS = {
    states.STALE: DiagnosticStatus.ERROR[0],
    states.WAITING: DiagnosticStatus.WARN[0],
    states.UNCERTAIN: DiagnosticStatus.WARN[0],
    states.NOT_AT_GOAL: DiagnosticStatus.ERROR[0],
}
"""Of the states that are not OK."""
BEYOND_LIMITS = "the command exceeds limits that were lowered: braking as fast as the accelerations allow"


def status_values(supervisor: Supervisor, law: Law) -> dict[str, str]:
    """Return what the status says besides the state; regions and tolerances only of this project's law."""
    is_own, memory, report = law is SwitchingLaw, supervisor.memory, supervisor.report
    values = {}
    if is_own:
        values["region"] = REGION_NAMES[memory.switching.region]
        values["switches"] = str(memory.switching.switches)
    else:
        values["law"] = law.name
        describe = getattr(law, "describe", None)
        values |= describe(memory) if callable(describe) else {}
    values["goals reached"] = str(supervisor.goals_reached)
    if supervisor.goal is not None:
        values["goal"] = " ".join(f"{number:.6g}" for number in supervisor.goal)
        if supervisor.goals.newest is not None and supervisor.goals.newest.request.id:
            values["goal id"] = supervisor.goals.newest.request.id
        if supervisor.goals.present is not None:
            values["timeout [s]"] = f"{supervisor.timeout:.6g}"
    if supervisor.updates:
        values["goal updates"] = str(supervisor.updates)
    if report is not None:
        values["distance [m]"] = f"{report.rho:.4f}"
        values["heading error [rad]"] = f"{report.theta:.4f}"
        if is_own:
            values["eps_P [m]"] = f"{report.eps_P:.4f}"
            values |= _switching_values(supervisor)
    if supervisor.waypoints:
        values["waypoint"] = f"{supervisor.waypoint}/{supervisor.waypoints}"
    if supervisor.is_beyond_limits:
        values["limits"] = BEYOND_LIMITS
    if supervisor.reason:
        values["reason"] = supervisor.reason
    return values


def _switching_values(supervisor: Supervisor) -> dict[str, str]:
    memory = supervisor.memory
    if supervisor.config.controller.profile == TANH:
        values = {"re-approach": f"{PHASE_NAMES[memory.reapproach.phase]}, {memory.reapproach.tries} begun"}
    else:
        values = {"finish": FINISH_NAMES[memory.finish.kind]}
    xy, theta = supervisor.smallest_tolerance()
    return {**values, "smallest tolerance [m]": f"{xy:.4f}", "smallest tolerance [rad]": f"{theta:.4f}"}
