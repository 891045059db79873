"""The law's benchmark as pages: docs/results/benchmark with a summary, the method and the bounds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from diffbot_lab.arena.bounds.report import bound_section
from diffbot_lab.arena.entries import EQUAL_NAME
from diffbot_lab.arena.method import method_page
from diffbot_lab.arena.report.targets import (
    Results,
    answered,
    false_share,
    figures_of_law,
    peers_ahead,
    share,
    targets,
)
from diffbot_lab.targets import markdown_table, number, target_table

REALISTIC = "mix"
"""The case with all the plant's effects at once."""
Figure = Callable[[Results], "float | None"]


def pages(results: Results, bounds: Results | None = None) -> dict[str, str]:
    """Return the pages by their file names in docs/results/benchmark, that of the bounds only if there are any."""
    found = {"index.md": _index(results), "method.md": method_page(results)}
    if bounds is not None:
        found["bounds.md"] = bound_section(bounds, results)
    return {name: "\n".join(lines) + "\n" for name, lines in found.items()}


def _index(results: Results) -> list[str]:
    return [
        "# The law and its peers",
        "",
        "Does the switching law bring a robot to a pose more reliably, faster and closer than other laws?",
        "",
        *_answer(results),
        "",
        "    diffbot benchmark              # all figures of all laws; --runs, --seed, --out; --law: a law of yours",
        "    make docs ARGS=--benchmark     # repeats it, and writes these pages",
        "",
        "Conditions, laws and tuning: [Method](method.md). What is possible at best: [Bounds](bounds.md). What each "
        "part of the law does: [Effects](effects.md). All figures of all laws with their intervals: "
        "[benchmark.json](../data/benchmark.json).",
        "",
        "![Paths from one start, and distributions of answers, settling times and final errors](benchmark.png)",
        "",
        "*Above: runs of each law from one start. Below: share of all runs answered, settled or ended within.*",
        "",
        "## Beside the best peer",
        "",
        "Each cell: the switching law / the best peer in this figure, in bold where a peer is better. *Answered*: a "
        "client gets the answer `reached` within 60 s, by one rule for all laws; *falsely*: the true pose was outside "
        "of the tolerances then. Square brackets: 95 % interval.",
        "",
        *_beside_peers(results),
        "",
        *_with_equal_budget(results),
        "",
        "## The switching law alone",
        "",
        *_alone(results),
        "",
        "## Promised, and missed",
        "",
        *_missed(results),
    ]


def _answer(results: Results) -> list[str]:
    ahead = peers_ahead(results)
    more = len({one["case"] for one in ahead if one["figure"].startswith("share answered")}) or "none"
    rows = {(one["case"], one["figure"]) for one in ahead}
    slowest = len([figure for _, figure in rows if figure.endswith("99 %")])
    cases = len({one["case"] for one in ahead})
    compared = len([row for row in results["cases"] if _peers_in(results, row)])
    lines = [
        f"**In short:** of {compared} cases, a peer is answered more often in {more}. In {cases} of them at least one "
        f"peer is ahead in some figure: {len(rows)} figures, {slowest} of them about the slowest runs (99 %).",
    ]
    own = figures_of_law(results, REALISTIC)
    if own is not None:
        answer, position = own["reached_time"], own["position"]
        lines.append(
            f"In the realistic case `{REALISTIC}` a client of the switching law gets the answer `reached` in "
            f"{100.0 * answered(own):.2f} % of the runs, after {number(answer['median'], 1)} s (median; 99 %: "
            f"{number(answer['p99'], 1)} s), falsely in {100.0 * false_share(own):.2f} %; the robot ends "
            f"{number(position['p95'])} m from the goal (95 %)."
        )
    return lines


def _peers_in(results: Results, row: Results) -> list[Results]:
    peers = {one["name"] for one in results["laws"] if not one["ours"] and not one["bound"]}
    return [one for one in row["laws"] if one["name"] in peers]


def _of(part: str, key: str) -> Figure:
    return lambda one: None if one[part][key] is None else float(one[part][key])


_COLUMNS: tuple[tuple[str, Figure, int], ...] = (
    ("time of the answer [s]: median", _of("reached_time", "median"), 1),
    ("99 %", _of("reached_time", "p99"), 1),
    ("settling time [s]: 99 %", _of("settling_time", "p99"), 1),
    ("\\|position\\| [m]: 95 %", _of("position", "p95"), 3),
)


def _shares(one: Results) -> tuple[str, str]:
    """Return the shares answered and answered falsely [%], with their intervals."""
    return (
        f"{100.0 * answered(one):.2f} {_percent(one['answered_interval'])}",
        f"{100.0 * false_share(one):.2f} {_percent(one['false_reached_interval'])}",
    )


def _percent(interval: list[float]) -> str:
    return f"[{100.0 * interval[0]:.2f}, {100.0 * interval[1]:.2f}]"


def _beside_peers(results: Results) -> list[str]:
    rows = []
    for row in results["cases"]:
        own, peers = figures_of_law(results, row["name"]), _peers_in(results, row)
        if own is None or not peers:
            continue
        most = max(map(answered, peers))
        by, falsely = _shares(own)
        cells = [f"{by} / " + _bold(f"{100.0 * most:.2f}", most > answered(own)), falsely]
        for _, figure, digits in _COLUMNS:
            ours = figure(own)
            best = min((value for one in peers if (value := figure(one)) is not None), default=None)
            is_better = best is not None and (ours is None or best < ours)
            cells.append(f"{number(ours, digits)} / " + _bold(number(best, digits), is_better))
        rows.append([f"`{row['name']}`: {row['text']}", *cells])
    head = ("case", "answered [%]", "falsely [%]", *(name for name, _, _ in _COLUMNS))
    return markdown_table(head, rows)


def _bold(text: str, is_better: bool) -> str:
    return f"**{text}**" if is_better else text


def _with_equal_budget(results: Results) -> list[str]:
    if not any(one["name"] == EQUAL_NAME for one in results["laws"]):
        return []
    ahead, equal = peers_ahead(results), peers_ahead(results, EQUAL_NAME)
    return [
        "The preset had more work than the tuning that the peers had. With the same budget peers are ahead in "
        f"{len(equal)} figures instead of {len(ahead)}, in {len({one['case'] for one in equal})} cases instead of "
        f"{len({one['case'] for one in ahead})}; each peer and each figure is counted by itself."
    ]


def _alone(results: Results) -> list[str]:
    rows = []
    for row in results["cases"]:
        own = figures_of_law(results, row["name"])
        if own is None or _peers_in(results, row):
            continue
        figures = [number(figure(own), digits) for _, figure, digits in _COLUMNS]
        rows.append([f"`{row['name']}`: {row['text']}", *_shares(own), *figures, f"{100.0 * share(own):.2f}"])
    head = ("case", "answered [%]", "falsely [%]", *(name for name, _, _ in _COLUMNS), "settled [%]")
    return markdown_table(head, rows) if rows else ["Every case was run with peers, too."]


def _missed(results: Results) -> list[str]:
    found: list[Any] = targets(results)
    missed = [one for one in found if not one.met]
    lines = [
        f"{len(found) - len(missed)} of {len(found)} promised figures are met" + (". The others:" if missed else ".")
    ]
    return [*lines, "", *target_table(missed)] if missed else lines
