"""States of the controller: a table of transitions, (state, event) -> next state, command, end of the goal.

An event without an entry in the row of a state has no effect in this state. The :class:`Supervisor` detects the events,
and the table defines their effects.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple

from diffbot_control.goals.record import CANCELLED, NOT_REACHED, POSE_LOST, REACHED, REPLACED


class State(Enum):
    """State of the controller."""

    IDLE = "idle"
    """there is no goal, and the robot stands"""
    DRIVING = "driving"
    """a goal was accepted and has not ended"""
    HOLDING = "holding"
    """the goal was reached, and the robot stays there"""
    STOPPING = "stopping"
    """the robot brakes after its goal; a cancelled goal ends when the robot is at rest"""


class GoalEvent(Enum):
    """Events of the table; the documentation uses the values as names."""

    GOAL = "goal accepted"
    CANCEL = "cancelled"
    POSE = "pose"
    REACHED = "goal reached"
    RELEASE = "reached and not to be held"
    HOPELESS = "hopeless"
    """the timeout has passed, the robot makes no progress, or the law gives up"""
    FAULT = "error of law or node"
    OVERDUE = "pose overdue"
    """no pose within pose_timeout"""
    LOST = "pose lost"
    """no pose within pose_lost_timeout"""
    ELSEWHERE = "robot found elsewhere"
    AT_REST = "at rest"
    STOP = "node stops"


class Reaction(Enum):
    """Command of a transition."""

    NOTHING = ""
    LAW = "step of the law"
    BRAKE = "brake within the limits"
    ZERO = "zero at once"
    REST = "zero, a few times"


class Transition(NamedTuple):
    """Effect of an event in a state."""

    state: State
    command: Reaction = Reaction.NOTHING
    end: str = ""
    """end of the current goal, one of record.ENDS; empty if the goal does not end"""
    text: str = ""
    """new text of ~/status while there is no goal; empty for no change"""


IDLE, WAITING, DRIVING, STALE, CANCELLING = "idle", "waiting for pose", "driving", "stale pose", "cancelling"
AT_GOAL, NOT_AT_GOAL = "goal reached", "goal not reached"
UNCERTAIN = "tolerance below uncertainty"
STATUS_TEXTS = (IDLE, WAITING, DRIVING, UNCERTAIN, STALE, CANCELLING, AT_GOAL, NOT_AT_GOAL)
"""All texts of ~/status."""

TABLE: Mapping[State, Mapping[GoalEvent, Transition]] = {
    State.IDLE: {
        GoalEvent.GOAL: Transition(State.DRIVING),
        GoalEvent.POSE: Transition(State.IDLE, Reaction.REST),
        GoalEvent.OVERDUE: Transition(State.IDLE, Reaction.REST),
        GoalEvent.FAULT: Transition(State.IDLE, Reaction.ZERO, text=NOT_AT_GOAL),
        GoalEvent.STOP: Transition(State.IDLE, Reaction.ZERO, text=IDLE),
    },
    State.DRIVING: {
        GoalEvent.GOAL: Transition(State.DRIVING, end=REPLACED),
        GoalEvent.CANCEL: Transition(State.STOPPING, Reaction.BRAKE, text=IDLE),
        GoalEvent.POSE: Transition(State.DRIVING, Reaction.LAW),
        GoalEvent.REACHED: Transition(State.HOLDING, end=REACHED),
        GoalEvent.RELEASE: Transition(State.STOPPING, end=REACHED, text=AT_GOAL),
        GoalEvent.OVERDUE: Transition(State.DRIVING, Reaction.ZERO),
        GoalEvent.HOPELESS: Transition(State.STOPPING, end=NOT_REACHED, text=NOT_AT_GOAL),
        GoalEvent.LOST: Transition(State.IDLE, Reaction.ZERO, POSE_LOST, NOT_AT_GOAL),
        GoalEvent.FAULT: Transition(State.STOPPING, Reaction.BRAKE, NOT_REACHED, NOT_AT_GOAL),
        GoalEvent.STOP: Transition(State.IDLE, Reaction.ZERO, CANCELLED, IDLE),
    },
    State.HOLDING: {
        GoalEvent.GOAL: Transition(State.DRIVING),
        GoalEvent.CANCEL: Transition(State.STOPPING, Reaction.BRAKE, text=IDLE),
        GoalEvent.POSE: Transition(State.HOLDING, Reaction.LAW),
        GoalEvent.OVERDUE: Transition(State.HOLDING, Reaction.ZERO),
        GoalEvent.LOST: Transition(State.IDLE, Reaction.ZERO, text=IDLE),
        GoalEvent.ELSEWHERE: Transition(State.STOPPING, Reaction.BRAKE, text=IDLE),
        GoalEvent.FAULT: Transition(State.STOPPING, Reaction.BRAKE, text=NOT_AT_GOAL),
        GoalEvent.STOP: Transition(State.IDLE, Reaction.ZERO, text=IDLE),
    },
    State.STOPPING: {
        GoalEvent.GOAL: Transition(State.DRIVING, end=CANCELLED),
        GoalEvent.POSE: Transition(State.STOPPING, Reaction.BRAKE),
        GoalEvent.AT_REST: Transition(State.IDLE, end=CANCELLED),
        GoalEvent.OVERDUE: Transition(State.IDLE, Reaction.ZERO, CANCELLED),
        GoalEvent.LOST: Transition(State.IDLE, Reaction.ZERO, CANCELLED),
        GoalEvent.HOPELESS: Transition(State.IDLE, Reaction.ZERO, CANCELLED),
        GoalEvent.FAULT: Transition(State.STOPPING, Reaction.BRAKE, CANCELLED, NOT_AT_GOAL),
        GoalEvent.STOP: Transition(State.IDLE, Reaction.ZERO, CANCELLED, IDLE),
    },
}
"""The ends in STOPPING are for a cancelled goal; they have no effect without one."""

WITH_GOAL = frozenset({State.DRIVING, State.HOLDING})
"""States in which the robot drives to a goal or holds it."""
