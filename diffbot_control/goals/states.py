"""What becomes of a goal: one table, (state, event) -> state, command, answer.

An event that a state's row does not name changes nothing there and sends nothing. :class:`Supervisor` finds out which
events happen; what follows from them stands here alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple

from diffbot_control.goals.goal_record import CANCELLED, NOT_REACHED, POSE_LOST, REACHED, REPLACED


class State(Enum):
    """Where the controller is with its goal; the value names it in the diagram, :func:`status_text` in ~/status."""

    IDLE = "idle"
    WAITING = "waiting for pose"
    """a goal was accepted, no pose has been answered since"""
    DRIVING = "driving"
    STALE = "stale pose"
    """on the way to the goal, standing until poses come again"""
    CANCELLING = "cancelling"
    """the goal was cancelled, the robot still brakes"""
    HOLDING = "holding"
    """the goal was answered, and the robot stays there"""
    HOLDING_STALE = "holding, stale pose"
    DONE = "done"
    """the goal was answered, and is not held"""
    GIVEN_UP = "given up"


class Event(Enum):
    """What can happen; the value says it in the diagram."""

    GOAL = "goal accepted"
    CANCEL = "cancelled"
    POSE = "pose"
    REACHED = "goal reached"
    RELEASE = "not to be held"
    HOPELESS = "hopeless"
    """time over, no progress, hunting or too uncertain"""
    FAULT = "fault of law or node"
    OVERDUE = "pose overdue"
    """no pose within pose_timeout"""
    LOST = "pose lost"
    """no pose within pose_lost_timeout"""
    ELSEWHERE = "robot found elsewhere"
    AT_REST = "at rest"
    STOP = "node stops"


class Command(Enum):
    """What is sent."""

    NOTHING = ""
    LAW = "step of the law"
    BRAKE = "brake within the limits"
    ZERO = "zero at once"


class Transition(NamedTuple):
    """What an event leads to."""

    state: State
    command: Command = Command.NOTHING
    answer: str = ""
    """how the present goal ends, one of goal_record.ENDS; empty: it does not"""


def _without_goal(state: State) -> dict[Event, Transition]:
    return {
        Event.GOAL: Transition(State.WAITING),
        Event.POSE: Transition(state, Command.BRAKE),
        Event.OVERDUE: Transition(state, Command.ZERO),
        Event.FAULT: Transition(State.GIVEN_UP, Command.ZERO),
        Event.STOP: Transition(State.IDLE, Command.ZERO),
    }


_ON_THE_WAY = {
    Event.GOAL: Transition(State.WAITING, answer=REPLACED),
    Event.CANCEL: Transition(State.CANCELLING, Command.BRAKE),
    Event.POSE: Transition(State.DRIVING, Command.LAW),
    Event.OVERDUE: Transition(State.STALE, Command.ZERO),
    Event.HOPELESS: Transition(State.GIVEN_UP, answer=NOT_REACHED),
    Event.LOST: Transition(State.GIVEN_UP, answer=POSE_LOST),
    Event.FAULT: Transition(State.GIVEN_UP, Command.BRAKE, NOT_REACHED),
    Event.STOP: Transition(State.IDLE, Command.ZERO, CANCELLED),
}
_HELD = {
    Event.GOAL: Transition(State.WAITING),
    Event.CANCEL: Transition(State.IDLE, Command.BRAKE),
    Event.POSE: Transition(State.HOLDING, Command.LAW),
    Event.OVERDUE: Transition(State.HOLDING_STALE, Command.ZERO),
    Event.LOST: Transition(State.IDLE),
    Event.ELSEWHERE: Transition(State.IDLE, Command.BRAKE),
    Event.FAULT: Transition(State.GIVEN_UP, Command.BRAKE),
    Event.STOP: Transition(State.IDLE, Command.ZERO),
}

TABLE: Mapping[State, Mapping[Event, Transition]] = {
    State.IDLE: _without_goal(State.IDLE),
    State.DONE: _without_goal(State.DONE),
    State.GIVEN_UP: _without_goal(State.GIVEN_UP),
    State.WAITING: _ON_THE_WAY,
    State.DRIVING: {**_ON_THE_WAY, Event.REACHED: Transition(State.HOLDING, answer=REACHED)},
    State.STALE: _ON_THE_WAY,
    State.CANCELLING: {
        Event.GOAL: Transition(State.WAITING, answer=CANCELLED),
        Event.POSE: Transition(State.CANCELLING, Command.BRAKE),
        Event.AT_REST: Transition(State.IDLE, answer=CANCELLED),
        Event.OVERDUE: Transition(State.IDLE, Command.ZERO, CANCELLED),
        Event.LOST: Transition(State.IDLE, Command.ZERO, CANCELLED),
        Event.HOPELESS: Transition(State.IDLE, Command.ZERO, CANCELLED),
        Event.FAULT: Transition(State.GIVEN_UP, Command.BRAKE, CANCELLED),
        Event.STOP: Transition(State.IDLE, Command.ZERO, CANCELLED),
    },
    State.HOLDING: {**_HELD, Event.RELEASE: Transition(State.DONE)},
    State.HOLDING_STALE: _HELD,
}

IDLE, WAITING, DRIVING, STALE, CANCELLING = (
    state.value for state in (State.IDLE, State.WAITING, State.DRIVING, State.STALE, State.CANCELLING)
)
AT_GOAL, NOT_AT_GOAL = "goal reached", "goal not reached"
UNCERTAIN = "tolerance below uncertainty"
STATUS_TEXTS = (IDLE, WAITING, DRIVING, UNCERTAIN, STALE, CANCELLING, AT_GOAL, NOT_AT_GOAL)
"""All messages of ~/status."""
_TEXTS = {State.HOLDING_STALE: STALE, State.DONE: AT_GOAL, State.GIVEN_UP: NOT_AT_GOAL}


def status_text(state: State, is_uncertain: bool, is_away: bool) -> str:
    """Return the message of ~/status.

    Args:
        state: of the table.
        is_uncertain: the robot rests, with an estimate too uncertain for an answer.
        is_away: the robot is on its way, to the goal or back to it.
    """
    if state is State.DRIVING:
        return UNCERTAIN if is_uncertain else DRIVING
    if state is State.HOLDING:
        return DRIVING if is_away else AT_GOAL
    return _TEXTS[state] if state in _TEXTS else str(state.value)


OPEN = frozenset({State.WAITING, State.DRIVING, State.STALE, State.CANCELLING})
"""States in which a goal waits for its answer."""
WITH_GOAL = frozenset({State.WAITING, State.DRIVING, State.STALE, State.HOLDING, State.HOLDING_STALE})
"""States in which the robot has a goal to drive to or to hold."""
ACTIVE = OPEN | WITH_GOAL
"""States that are neither idle nor the end of a goal."""
