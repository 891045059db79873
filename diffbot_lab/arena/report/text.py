"""The law's benchmark as tables for a terminal."""

from __future__ import annotations

from typing import Any

from diffbot_lab.arena.report.ahead import Results, answered, false_share, share
from diffbot_lab.arena.statistics import ANSWER_TIMES
from diffbot_lab.tables import number


def table(results: Results) -> str:
    """Lay out all cases and the figures in which a peer is ahead, for a terminal."""
    labels = {one["name"]: one["label"] for one in results["laws"]}
    head = f"{'':<42}{'answered: 20 s':>15}{'30 s':>8}{'60 s':>8}{'false':>8}{'time [s]: median':>18}{'99 %':>7}"
    head += f"{'settled':>10}{'99 % [s]':>10}{'|pos| [m]: 95 %':>17}{'turns':>7}"
    lines = [f"{one['label']}: {one['parameters']}" for one in results["laws"]]
    lines += [f"(in the case {results['cases'][0]['name']}; the others as their titles say)", ""]
    lines += _ahead_lines(results["ahead"])
    for row in results["cases"]:
        lines += ["", f"{row['name']}: {row['text']}", head, "-" * len(head)]
        lines += [_terminal_row(labels[one["name"]], one) for one in row["laws"]]
    return "\n".join(lines)


def _terminal_row(label: str, one: Results) -> str:
    answer, by = one["reached_time"], [f"{100.0 * answered(one, time):.2f}" for time in ANSWER_TIMES]
    return (
        f"{label:<42}{by[0]:>15}{by[1]:>8}{by[2]:>8}{100.0 * false_share(one):>8.2f}"
        f"{number(answer['median'], 1):>18}{number(answer['p99'], 1):>7}"
        f"{100.0 * share(one):>10.2f}{number(one['settling_time']['p99'], 1):>10}"
        f"{number(one['position']['p95']):>17}{one['revolutions']:>7.2f}"
    )


def _ahead_lines(ahead: list[dict[str, Any]]) -> list[str]:
    if not ahead:
        return ["No peer is ahead of the switching law in shares, times or final position error."]
    lines = ["Where a peer is ahead of the switching law:"]
    return lines + [f"  {one['case']}: {one['peer']}, {one['figure']} {_pair(one)}" for one in ahead]


def _pair(one: dict[str, Any]) -> str:
    """Return the peer's figure and this project's, rounded to the first digit that differs."""
    ours, peers = one["ours"], one["peers"]
    unit = f" {one['unit']}" if one["unit"] else ""
    if ours is None:
        return f"{peers:.3f}{unit}, ours none"
    digits = next((d for d in (3, 4, 5) if f"{peers:.{d}f}" != f"{ours:.{d}f}"), 6)
    sure = "" if one["apart"] else " (intervals overlap)"
    return f"{peers:.{digits}f}{unit}, ours {ours:.{digits}f}{unit}{sure}"
