"""The law's benchmark as the pages of docs/results/benchmark."""

from __future__ import annotations

from typing import Any, NamedTuple

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
from diffbot_lab.arena.report.text import figures_text
from diffbot_lab.arena.statistics import ANSWER_TIMES
from diffbot_lab.targets import markdown_table, number, target_table, with_interval

_HEAD = (
    *("law", "answered [%] by 20, 30, 60 s", "falsely [%]", "time of the answer [s]: median", "99 %"),
    *("settled [%]", "settling time [s]: median", "99 %", "\\|position\\| [m]: 95 %"),
    *("largest error [m], [rad]", "revolutions: most (runs > 1.5)"),
)
_IN_OVERVIEW = 9
"""columns of the head that the overview has, too"""
REALISTIC = "mix"
"""The case with all the plant's effects at once."""


class CasePage(NamedTuple):
    """One page of cases: its file, title and question, and the names of the cases."""

    file: str
    title: str
    question: str
    cases: tuple[str, ...]


CASE_PAGES = (
    CasePage(
        "starts.md",
        "Nominal case and starts",
        "How do the laws compare on an ideal robot with bounded speeds, from far, near and in front of the goal?",
        ("nominal", "random_far", "random_near", "docking"),
    ),
    CasePage(
        "delays.md",
        "Dead time and lag",
        "What do dead time and lag of the drives cost each law, when they are on its data sheet and when they are not?",
        ("dead_time_01", "dead_time_02", "dead_time_03", "dead_time_02_unknown", "lag_015", "lag_030"),
    ),
    CasePage(
        "disturbances.md",
        "Wheels and fixes",
        "How do the laws cope with wheels that stick, slip or are mismeasured, and fixes that are late or correlated?",
        ("dead_band", "slip", "separation", "coloured_05", "coloured_09", "late_fixes"),
    ),
    CasePage(
        "acceleration.md",
        "Bounded acceleration and the realistic mix",
        "Which law is best with accelerations up to 0.5 m/s^2 and 1.5 rad/s^2, alone and with all other effects?",
        (
            *("acceleration", "acceleration_dead_time", "acceleration_near", "acceleration_docking"),
            *(REALISTIC, "random_mix"),
        ),
    ),
)


def pages(results: Results, bounds: Results | None = None) -> dict[str, str]:
    """Return the pages by their file names in docs/results/benchmark, that of the bounds only if there are any."""
    known = {name for page in CASE_PAGES for name in page.cases}
    further = [row for row in results["cases"] if row["name"] not in known]
    found = {"index.md": _index(results, bounds is not None), "method.md": method_page(results)}
    found |= {page.file: _case_page(results, page) for page in CASE_PAGES}
    found["targets.md"] = _targets_page(results, further)
    if bounds is not None:
        found["bounds.md"] = bound_section(bounds, results)
    return {name: "\n".join(lines) + "\n" for name, lines in found.items()}


def _index(results: Results, bounded: bool) -> list[str]:
    ahead = peers_ahead(results)
    return [
        "# The law and its peers",
        "",
        "Does the switching law bring a robot to a pose more reliably, faster and closer than other laws?",
        "",
        *_answer(results, ahead),
        "",
        "    diffbot benchmark              # --runs, --seed, --out; --law: a law of yours",
        "    make docs ARGS=--benchmark     # repeats it, and writes these pages",
        "",
        "How it was measured, the laws and their tuning are in [Method](method.md). All figures with their intervals: "
        "[benchmark.json](../data/benchmark.json).",
        "",
        "![Paths from one start, and distributions of answers, settling times and final errors](benchmark.png)",
        "",
        "*Above: runs of each law from one start. Below: share of all runs answered, settled or ended within.*",
        "",
        "## Where a peer is ahead",
        "",
        *_ahead_section(results, ahead),
        "",
        "## The switching law in every case",
        "",
        *_overview(results, ahead),
        "",
        "All laws in these cases: " + ", ".join(f"[{page.title}]({page.file})" for page in CASE_PAGES) + ". "
        "Promised figures and the cases of the switching law alone: [Targets](targets.md)."
        + (" What is possible at best: [Bounds](bounds.md)." if bounded else ""),
    ]


def _answer(results: Results, ahead: list[dict[str, Any]]) -> list[str]:
    more = len({one["case"] for one in ahead if one["figure"].startswith("share answered")}) or "none"
    rows = {(one["case"], one["figure"]) for one in ahead}
    slowest = len([figure for _, figure in rows if figure.endswith("99 %")])
    cases = len({one["case"] for one in ahead})
    compared = len([row for row in results["cases"] if len(row["laws"]) > 1])
    lines = [
        f"**In short:** of {compared} cases, a peer is answered more often in {more}. In {cases} of them at least one "
        f"peer is ahead in some figure: {len(rows)} rows below, {slowest} of them about the slowest runs (99 %).",
    ]
    own = figures_of_law(results, REALISTIC)
    if own is not None:
        answer, position = own["reached_time"], own["position"]
        lines.append(
            f"In the realistic case `{REALISTIC}` a client of the switching law is told `reached` in "
            f"{100.0 * answered(own):.2f} % of the runs, after {number(answer['median'], 1)} s (median; 99 %: "
            f"{number(answer['p99'], 1)} s), falsely in {100.0 * false_share(own):.2f} %; the robot ends "
            f"{number(position['p95'])} m from the goal (95 %)."
        )
    return lines


def _ahead_section(results: Results, ahead: list[dict[str, Any]]) -> list[str]:
    if ahead:
        lines = ["In shares answered and settled, their times (median, 99 %) and final position error (95 %):", ""]
        lines += _ahead_table(ahead)
        lines += ["", "Peers in *italics*: the 95 % intervals overlap."]
    else:
        lines = ["Nowhere: the switching law leads in shares, times and final position error."]
    if any(one["name"] == EQUAL_NAME for one in results["laws"]):
        cases = {one["case"] for one in ahead}
        equal = peers_ahead(results, EQUAL_NAME)
        lines += [
            "",
            "The preset had more work than the tuning that the peers had. With the same budget "
            f"(row *{_labels(results)[EQUAL_NAME]}*) peers are ahead in {len(equal)} figures instead of {len(ahead)}, "
            f"in {len({one['case'] for one in equal})} cases instead of {len(cases)}. "
            "Each peer and each figure is counted by itself.",
        ]
    return lines


def _labels(results: Results) -> dict[str, str]:
    return {one["name"]: one["label"] for one in results["laws"]}


def _ahead_table(ahead: list[dict[str, Any]]) -> list[str]:
    """One row for each case and figure, the peers in the order of the laws."""
    rows: dict[tuple[str, str], list[str]] = {}
    for one in ahead:
        peers, ours = figures_text(one)
        row = rows.setdefault((one["case"], one["figure"]), [ours])
        text = f"{one['peer']} {peers}"
        row.append(text if one["apart"] else f"*{text}*")
    cells = [(case, figure, own, "; ".join(peers)) for (case, figure), (own, *peers) in rows.items()]
    return markdown_table(("case", "figure", "ours", "peers ahead"), cells)


def _overview(results: Results, ahead: list[dict[str, Any]]) -> list[str]:
    rows = []
    for row in results["cases"]:
        own = figures_of_law(results, row["name"])
        if own is None:
            continue
        peers = len({one["peer"] for one in ahead if one["case"] == row["name"]})
        of = len([one for one in row["laws"] if one["name"] in _peers(results)])
        standing = f"{peers} of {of}" if of else "none was run"
        rows.append([f"`{row['name']}`: {row['text']}", *_law_row("", own)[1:_IN_OVERVIEW], standing])
    return [
        *markdown_table(("case", *_HEAD[1:_IN_OVERVIEW], "peers ahead"), rows),
        "",
        "*Peers ahead*: how many have at least one better figure, of those named above.",
    ]


def _peers(results: Results) -> set[str]:
    return {one["name"] for one in results["laws"] if not one["ours"] and not one["bound"]}


def _case_page(results: Results, page: CasePage) -> list[str]:
    rows = [row for row in results["cases"] if row["name"] in page.cases]
    lines = [f"# {page.title}", "", page.question, "", *_case_answer(results, rows), "", *_reading(results)]
    for row in rows:
        cells = [_law_row(_labels(results)[one["name"]], one) for one in row["laws"]]
        lines += ["", f"## `{row['name']}`: {row['text']}", "", *markdown_table(_HEAD, cells)]
    return lines


def _case_answer(results: Results, rows: list[Results]) -> list[str]:
    """One item for each case: the own law, and the peers that are ahead of it."""
    ahead = peers_ahead(results)
    lines = ["**In short**, the switching law, and the peers that are ahead of it in at least one figure:", ""]
    for row in rows:
        own = figures_of_law(results, row["name"])
        if own is None:
            continue
        answer, position = own["reached_time"], own["position"]
        names = dict.fromkeys(one["peer"] for one in ahead if one["case"] == row["name"])
        lines.append(
            f"- `{row['name']}`: {100.0 * answered(own):.2f} % answered, after {number(answer['median'], 1)} s "
            f"(median), {number(answer['p99'], 1)} s (99 %), {number(position['p95'])} m (95 %); "
            f"ahead: {'; '.join(names) if names else 'none'}."
        )
    return lines


def _reading(results: Results) -> list[str]:
    return [
        "*Answered*: told `reached`, by one rule for all laws: within the tolerances with a probability of 0.99 by the "
        "estimate and its covariance, at rest, five poses in a row; *falsely*: the true pose was outside then. "
        f"*Settled*: within {results['xy_tolerance']:g} m and {results['yaw_tolerance']:g} rad to the end. Shares are "
        "of all runs, times of those answered or settled. *Largest error*: of position and heading, over all runs. "
        "*Revolutions*: turned within 1 m of the goal. In square brackets: 95 % intervals. [Method](method.md) has the "
        "conditions.",
    ]


def _law_row(label: str, one: Results) -> list[str]:
    time, position = one["settling_time"], one["position"]
    answer = one["reached_time"]
    by = ", ".join(f"{100.0 * answered(one, time):.2f}" for time in ANSWER_TIMES)
    return [
        label,
        f"{by} {_percent(one['answered_interval'])}",
        f"{100.0 * false_share(one):.2f} {_percent(one['false_reached_interval'])}",
        with_interval(answer, "median", 1),
        with_interval(answer, "p99", 1),
        f"{100.0 * share(one):.2f} {_percent(one['settled_interval'])}",
        with_interval(time, "median", 1),
        with_interval(time, "p99", 1),
        with_interval(position, "p95", 3),
        f"{number(position['max'])}, {number(one['heading']['max'])}",
        f"{number(one['revolutions'], 2)} ({one['spinning']})",
    ]


def _percent(interval: list[float]) -> str:
    return f"[{100.0 * interval[0]:.2f}, {100.0 * interval[1]:.2f}]"


def _targets_page(results: Results, further: list[Results]) -> list[str]:
    found = targets(results)
    missed = [one for one in found if not one.met]
    lines = [
        "# Targets of the law",
        "",
        "Does the switching law keep what was promised, and does it also work at other rates, noises and tolerances?",
        "",
        f"**In short:** {len(found) - len(missed)} of {len(found)} targets are met; those in bold are not.",
        "",
        *target_table(found),
    ]
    if further:
        rows = [
            [f"`{row['name']}`: {row['text']}", *_law_row("", figures)[1:]]
            for row in further
            if (figures := figures_of_law(results, row["name"])) is not None
        ]
        lines += ["", "## The switching law in further cases", "", *_reading(results), ""]
        lines += markdown_table(("case", *_HEAD[1:]), rows)
    for row in further:
        if "moving" in row:
            lines += ["", f"`{row['name']}`: {row['moving']} runs are still commanded above 0.05 m/s at the end."]
    return lines
