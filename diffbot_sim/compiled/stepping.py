"""Many robots, stepped together by commands from outside: what an environment for learning needs.

Each has its own noise, sensors and filter, as in :mod:`closed_loop`; between two steps they stand in :class:`Fleet`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import CERTAIN
from diffbot_sim.compiled.closed_loop import Feedback, next_feedback
from diffbot_sim.compiled.gated_filter import new_track, reset_arrays
from diffbot_sim.compiled.late_fusion import LateRecord, new_sensed, reset_record
from diffbot_sim.compiled.sensing import Robot
from diffbot_sim.model.actuators import delayed_command
from diffbot_sim.model.philox import NoiseKey
from diffbot_sim.model.plant import PlantState, new_plant, plant_step_at


class Body(NamedTuple):
    """One robot after a step."""

    state: PlantState
    feedback: Feedback


class Fleet(NamedTuple):
    """What is kept of n robots between two steps, changed in place."""

    bodies: Any
    """list of n :class:`Body`"""
    tracks: Any
    """list of the filters' states in their records, one robot's after the other's"""
    filter: Any
    """(n,) of :func:`gated_filter.filter_type`"""
    steps: Any
    """(n, late) as in :class:`late_fusion.LateRecord`, and so are the next two"""
    stamps: Any
    """(n,)"""
    seen: Any
    """(n, late + 1, landmarks)"""
    commands: Any
    """(n, rows, 2) the newest commands, see :func:`actuators.delayed_command`"""


def new_body(start: Pose) -> Body:
    """Return a robot at rest, before it senses anything."""
    return Body(new_plant(start), Feedback(new_sensed(), start, CERTAIN, False))


def put(fleet: Fleet, index: int, kind: int, robot: Robot, seed: int, run: int, start: Pose) -> Body:
    """Put one robot at rest at ``start``, forget its past, and let it sense at step 0."""
    reset_arrays(fleet.filter[index], robot.filter)
    commands, first = fleet.commands[index], new_body(start)
    for row in range(len(commands)):
        commands[row, 0] = commands[row, 1] = 0.0
    late = fleet.steps.shape[1]
    record = LateRecord(fleet.steps[index], [new_track() for _ in range(late)], fleet.stamps[index], fleet.seen[index])
    reset_record(record)
    return _sensed(fleet, index, kind, robot, NoiseKey(seed, run, 0), first, record)


def advance(fleet: Fleet, index: int, kind: int, robot: Robot, seed: int, run: int, command: Twist) -> Body:
    """Drive one robot for one sampling time, and let it sense."""
    state, feedback = fleet.bodies[index]
    plant = robot.plant
    delay, t_s = plant.actuators.command_delay, plant.sampling_time
    arrived = delayed_command(fleet.commands[index], state.step, command, delay, t_s)
    state = plant_step_at(NoiseKey(seed, run, state.step), state, arrived, plant)
    late = fleet.steps.shape[1]
    tracks = [fleet.tracks[index * late + row] for row in range(late)]
    record = LateRecord(fleet.steps[index], tracks, fleet.stamps[index], fleet.seen[index])
    return _sensed(fleet, index, kind, robot, NoiseKey(seed, run, state.step), Body(state, feedback), record)


def _sensed(fleet: Fleet, index: int, kind: int, robot: Robot, key: NoiseKey, body: Body, record: LateRecord) -> Body:
    """Sense and filter; keep and return the robot."""
    arrays = fleet.filter[index]
    after = Body(body.state, next_feedback(kind, robot, key, body.state, body.feedback, arrays, record))
    fleet.bodies[index] = after
    for row in range(len(record.tracks)):
        fleet.tracks[index * len(record.tracks) + row] = record.tracks[row]
    return after
