"""What becomes of a goal: docs/reference/nodes/states.svg, drawn from the table in the code."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator

from diffbot_control.goals.states import OPEN, TABLE, WITH_GOAL, Event, State

PLACES = {
    State.IDLE: (90, 60),
    State.WAITING: (370, 60),
    State.DRIVING: (700, 60),
    State.STALE: (700, 270),
    State.CANCELLING: (90, 270),
    State.HOLDING: (980, 60),
    State.HOLDING_STALE: (980, 440),
    State.DONE: (1220, 60),
    State.GIVEN_UP: (480, 440),
}
"""[px] centres of the boxes"""
IDLE_AGAIN = (1220, 250)
"""[px] of a second box for what goes back from a held goal, whose arrows would cross all others"""
WIDTH, HEIGHT = 150, 40
"""[px] of a box"""
BEND = 18.0
"""[px] of an arrow's middle beside the straight line"""
HELD = WITH_GOAL - OPEN
FROM_ANYWHERE = (Event.GOAL, Event.STOP, Event.FAULT)
"""Drawn in no arrow: they lead from each state to the same one."""
BLUE, GREEN, GREY = "#0072B2", "#009E73", "#777777"


def picture() -> str:
    """Return the diagram as SVG; what leads from each state to the same one is left out."""
    labels: dict[tuple[State, State], list[str]] = defaultdict(list)
    for state, row in TABLE.items():
        for event, to in row.items():
            if to.state is not state and event not in FROM_ANYWHERE:
                labels[state, to.state].append(f"{event.value}: {to.answer}" if to.answer else event.value)
    labels[State.IDLE, State.WAITING].append(Event.GOAL.value)
    lines = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1300 490" font-family="sans-serif" font-size="11">',
        '<rect width="1300" height="490" fill="white"/>',
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 0L8 4L0 8z" fill="#444444"/></marker></defs>',
        *(line for (source, target), texts in labels.items() for line in _arrow(source, target, texts)),
        *(line for state, place in PLACES.items() for line in _box(state, place)),
        *_box(State.IDLE, IDLE_AGAIN),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _box(state: State, place: tuple[int, int]) -> Iterator[str]:
    x, y = place
    colour = BLUE if state in OPEN else GREEN if state in HELD else GREY
    corner = f'x="{x - WIDTH // 2}" y="{y - HEIGHT // 2}" width="{WIDTH}" height="{HEIGHT}" rx="8"'
    yield f'<rect {corner} fill="white" stroke="{colour}" stroke-width="2"/>'
    yield f'<text x="{x}" y="{y + 5}" text-anchor="middle" font-size="14">{state.value}</text>'


def _arrow(source: State, target: State, texts: list[str]) -> Iterator[str]:
    """Draw a bent arrow, with its labels at the middle of the bend."""
    is_far = source in HELD and target is State.IDLE
    (x, y), end = PLACES[source], IDLE_AGAIN if is_far else PLACES[target]
    to_x, to_y = end
    length = math.hypot(to_x - x, to_y - y)
    # To the right of its direction, so that two opposite arrows have their own sides.
    across_x, across_y = -(to_y - y) / length, (to_x - x) / length
    shift_x, shift_y = 7.0 * across_x, 7.0 * across_y
    x, y = _edge(x, y, *end)
    to_x, to_y = _edge(*end, *PLACES[source])
    middle_x, middle_y = 0.5 * (x + to_x) + BEND * across_x, 0.5 * (y + to_y) + BEND * across_y
    path = (
        f"M{x + shift_x:.0f} {y + shift_y:.0f}Q{middle_x:.0f} {middle_y:.0f} {to_x + shift_x:.0f} {to_y + shift_y:.0f}"
    )
    yield f'<path d="{path}" fill="none" stroke="#444444" marker-end="url(#head)"/>'
    steep = abs(across_x) > 0.8
    anchor = ("start" if across_x > 0.0 else "end") if steep else "middle"
    # Not at the middle, where arrows cross; but a short flat one has no room elsewhere.
    share = 0.0 if abs(across_x) < 0.05 else 0.4
    label_x = (1.0 - share) * middle_x + share * x + (0.0 if steep else 8.0 * across_x)
    label_y = (1.0 - share) * middle_y + share * y + 4 + 6.0 * across_y - 6.5 * (len(texts) - 1)
    for index, text in enumerate(texts):
        place = f'x="{label_x:.0f}" y="{label_y + 13 * index:.0f}" text-anchor="{anchor}"'
        yield f'<text {place} stroke="white" stroke-width="4" paint-order="stroke" fill="#222222">{text}</text>'


def _edge(x: float, y: float, to_x: float, to_y: float) -> tuple[float, float]:
    """Return where the line from the centre of a box leaves it."""
    across, up = to_x - x, to_y - y
    share = min(0.5 * WIDTH / abs(across) if across else math.inf, 0.5 * HEIGHT / abs(up) if up else math.inf)
    return x + share * across, y + share * up
