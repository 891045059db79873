"""The bounds of the arena as text for a terminal."""

from __future__ import annotations

from diffbot_lab.arena.report.targets import Results
from diffbot_lab.targets import number

_FIGURES = (("settling_time", "median", 1), ("settling_time", "p99", 1), ("position", "p95", 3))
"""Where a figure is, and its digits."""


def table(bounds: Results) -> str:
    """Lay out the least times and the figures of NMPC for a terminal."""
    lines = [f"{'':<14}{'least time into / at':<24}{'starts':>7}{'median [s]':>12}{'largest':>9}"]
    for row in _time_rows(bounds):
        lines.append(f"{row[0]:<14}{row[1]:<24}{row[2]:>7}{row[3]:>12}{row[4]:>9}")
    lines += ["", f"{'':<14}{'':<40}{'settled':>9}{'time [s]: median':>18}{'99 %':>7}{'|pos| [m]: 95 %':>17}"]
    for case in bounds["cases"]:
        for one in case["nmpc"]:
            figures = [number(one[part][key], digits) for part, key, digits in _FIGURES]
            settled = f"{one['settled']}/{one['runs']}"
            widths = zip(figures, (18, 7, 17), strict=True)
            cells = "".join(f"{text:>{width}}" for text, width in widths)
            lines.append(f"{case['name']:<14}{one['label']:<40}{settled:>9}{cells}")
    return "\n".join(lines)


def _time_rows(bounds: Results) -> list[list[str]]:
    return [
        [
            case["name"],
            one["target"],
            f"{one['confirmed']} of {bounds['starts']}",
            number(one["median"], 2),
            number(one["max"], 2),
        ]
        for case in bounds["cases"]
        for one in case.get("least_time", [])
    ]
