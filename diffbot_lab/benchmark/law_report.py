"""The law's benchmark as text: tables for a terminal, and the page in docs/."""

from __future__ import annotations

from typing import Any

from diffbot_lab.benchmark.bound_report import bound_section
from diffbot_lab.benchmark.law_cases import ACCELERATION, OWN, SPEED
from diffbot_lab.benchmark.law_entries import EQUAL_NAME
from diffbot_lab.benchmark.law_targets import Results, peers_ahead, share, targets
from diffbot_lab.benchmark.targets import evaluate_targets, markdown_table, number, summary, target_table, with_interval

_TITLES = {
    SPEED: "Bounded speeds: 1.3 m/s at the rims, 2.6 rad/s",
    ACCELERATION: "Bounded accelerations, too: 0.5 m/s^2, 1.5 rad/s^2",
    OWN: "The switching law in further cases",
}
_HEAD = (
    *("law", "settled [%]", "settling time [s]: median", "99 %", "\\|position\\| [m]: 95 %", "max"),
    *("\\|theta\\| [rad]: max", "revolutions within 1 m: most", "> 1.5", "reached: reported", "false"),
)


def conclusions(results: Results) -> Results:
    """Return what follows from the figures, for results.json."""
    return {"targets": evaluate_targets(targets(results)), "ahead": peers_ahead(results)}


def table(results: Results) -> str:
    """Lay out all cases, the figures in which a peer is ahead, and the targets, for a terminal."""
    labels = {one["name"]: one["label"] for one in results["laws"]}
    head = f"{'':<42}{'settled':>9}{'time [s]: median':>18}{'99 %':>7}{'|pos| [m]: 95 %':>17}{'max':>7}"
    head += f"{'|theta|: max':>14}{'turns':>7}{'reached':>9}{'false':>7}"
    lines = _ahead_lines(peers_ahead(results))
    for row in results["cases"]:
        lines += ["", f"{row['name']}: {row['text']}", head, "-" * len(head)]
        lines += [_terminal_row(labels[one["name"]], one) for one in row["laws"]]
    return "\n".join([*lines, "", *summary(targets(results))])


def _terminal_row(label: str, one: Results) -> str:
    time, position = one["settling_time"], one["position"]
    return (
        f"{label:<42}{100.0 * share(one):>7.2f} %{number(time['median'], 1):>18}{number(time['p99'], 1):>7}"
        f"{number(position['p95']):>17}{number(position['max']):>7}{number(one['heading']['max']):>14}"
        f"{one['revolutions']:>7.2f}{one['reached']:>9}{one['false_reached']:>7}"
    )


def _ahead_lines(ahead: list[dict[str, Any]]) -> list[str]:
    if not ahead:
        return ["No peer is ahead of the switching law in share settled, settling time or final position error."]
    lines = ["Where a peer is ahead of the switching law:"]
    return lines + [f"  {one['case']}: {one['peer']}, {one['figure']} {_pair(one)}" for one in ahead]


def _pair(one: dict[str, Any]) -> str:
    peers, ours = _figures(one)
    sure = "" if one["apart"] or one["ours"] is None else " (intervals overlap)"
    return f"{peers}{_unit(one)}, ours {ours}{sure}"


def _figures(one: dict[str, Any]) -> tuple[str, str]:
    """Return the peer's figure, and this project's with its unit, with as many digits as show a difference."""
    ours, peers = one["ours"], one["peers"]
    if ours is None:
        return f"{peers:.3f}", "none"
    digits = next((d for d in (3, 4, 5) if f"{peers:.{d}f}" != f"{ours:.{d}f}"), 6)
    return f"{peers:.{digits}f}", f"{ours:.{digits}f}{_unit(one)}"


def _unit(one: dict[str, Any]) -> str:
    return f" {one['unit']}" if one["unit"] else ""


def page(results: Results, bounds: Results | None = None) -> str:
    """Return docs/benchmark.md: first where a peer is ahead, then the tables, and the bounds if there are any."""
    lines = ["# The law and its peers", "", *_ahead_section(results), "", *_introduction(results)]
    for kind, title in _TITLES.items():
        rows = [row for row in results["cases"] if row["table"] == kind]
        if rows:
            lines += ["", f"## {title}", *_table_section(results, rows)]
    if bounds is not None:
        lines += ["", *bound_section(bounds, results)]
    lines += ["", *_laws_section(results), "", *_tuning_section(results)]
    lines += ["", "## Targets", "", *target_table(targets(results))]
    return "\n".join(lines) + "\n"


def _ahead_section(results: Results) -> list[str]:
    lines = ["## Where a peer is ahead", ""]
    ahead = peers_ahead(results)
    if ahead:
        lines += ["In share settled, settling time of settled runs (median, 99 %) and final position error (95 %):", ""]
        lines += _ahead_table(ahead)
        lines += ["", "Peers in *italics*: the 95 % intervals overlap."]
    else:
        lines += ["Nowhere: the switching law leads in share settled, settling time and final position error."]
    if any(one["name"] == EQUAL_NAME for one in results["laws"]):
        cases = {one["case"] for one in ahead}
        equal = peers_ahead(results, EQUAL_NAME)
        lines += [
            "",
            "The preset had more work than the tuning that the peers had. With the same budget "
            f"(row *{_label(results, EQUAL_NAME)}*) peers are ahead in {len(equal)} figures instead of {len(ahead)}, "
            f"in {len({one['case'] for one in equal})} cases instead of {len(cases)}.",
        ]
    return lines


def _label(results: Results, name: str) -> str:
    return next(str(one["label"]) for one in results["laws"] if one["name"] == name)


def _ahead_table(ahead: list[dict[str, Any]]) -> list[str]:
    """One row for each case and figure, the peers in the order of the laws."""
    rows: dict[tuple[str, str], list[str]] = {}
    for one in ahead:
        peers, ours = _figures(one)
        row = rows.setdefault((one["case"], one["figure"]), [ours])
        text = f"{one['peer']} {peers}"
        row.append(text if one["apart"] else f"*{text}*")
    cells = [(case, figure, own, "; ".join(peers)) for (case, figure), (own, *peers) in rows.items()]
    return markdown_table(("case", "figure", "ours", "peers ahead"), cells)


def _introduction(results: Results) -> list[str]:
    tolerance = f"({results['xy_tolerance']:g} m, {results['yaw_tolerance']:g} rad)"
    runs = results["starts"] * results["runs_of_each_start"]
    own = results["starts"] * results["own_runs_of_each_start"]
    number_of_runs = f"{runs} runs in each case" + (f" ({own} of the switching law)" if own > runs else "")
    return [
        "## Conditions",
        "",
        "Generated by `make docs` from docs/benchmark.json; `make docs ARGS=--benchmark` also repeats the benchmark. "
        "`diffbot benchmark` runs it on its own, and `--law package.module:Class` compares "
        "another law with these ([A law of your own](how-to/own-law.md)).",
        "",
        f"Every law has the same {results['starts']} starts (8 points of the 12 m circle with headings 0 and 220 deg, "
        f"and the start of the paper's simulation A) or as many random ones, {number_of_runs}, seed "
        f"{results['seed']}, and run i has the same noise under every law: fixes at 10 Hz with the paper's bounds "
        "(+-0.3 m, +-0.3 m, +-0.17 rad), +-5 % per wheel in drive and encoder. A run lasts "
        f"{results['duration']:.0f} s with Ts = 0.1 s. Every law has the same data sheet: limits, latency, lag and "
        "dead band where they are known. Every law is given the pose in which the robot would come to rest, is brought "
        "within the limits, brakes within them, and may drive backwards.",
        "",
        f"- *Settled*: the true pose ends within {tolerance} of the goal. The *settling time* is the time of the last "
        "entry into this tolerance; only settled runs count.",
        "- *Reached*: runs in which the law reported the goal as reached; *false*: the true pose was outside then.",
        "- *Revolutions*: all turning within 1 m of the goal, left and right added up.",
        "- In brackets 95 % intervals: Wilson's of shares, the bootstrap's of quantiles.",
        "",
        "![Paths from one start, and distributions of settling time and final errors](benchmark.png)",
        "",
        "*Above: runs of each law from one start. Below: share of all runs within a settling time or a final error.*",
    ]


def _table_section(results: Results, rows: list[Results]) -> list[str]:
    labels = {one["name"]: one["label"] for one in results["laws"]}
    lines = []
    for row in rows:
        cells = [_law_row(labels[one["name"]], one) for one in row["laws"]]
        lines += ["", f"### `{row['name']}`: {row['text']}", "", *markdown_table(_HEAD, cells)]
        if "moving" in row:
            lines += ["", f"{row['moving']} runs are still commanded more than 0.05 m/s in their last second."]
    return lines


def _law_row(label: str, one: Results) -> list[str]:
    time, position = one["settling_time"], one["position"]
    low, high = one["settled_interval"]
    return [
        label,
        f"{100.0 * share(one):.2f} [{100.0 * low:.2f}, {100.0 * high:.2f}]",
        with_interval(time, "median", 1),
        with_interval(time, "p99", 1),
        with_interval(position, "p95", 3),
        number(position["max"]),
        number(one["heading"]["max"]),
        number(one["revolutions"], 2),
        str(one["spinning"]),
        str(one["reached"]),
        str(one["false_reached"]),
    ]


def _laws_section(results: Results) -> list[str]:
    rows = [(one["label"], one["source"], one["purpose"]) for one in results["laws"]]
    return [
        "## Laws",
        "",
        *markdown_table(("law", "source", "made for"), rows),
        "",
        "Laws that follow a path have the straight line to the goal, since there is no planner here.",
    ]


def _tuning_section(results: Results) -> list[str]:
    tuning = results["tuning"]
    lines = ["## Tuning", ""]
    if not tuning["laws"]:
        return [*lines, "No law was tuned: all have their defaults.", *_full_run()]
    lines += [
        f"Each law has one set of parameters for all cases, found with {tuning['budget']} evaluations of the same "
        f"optimiser ({tuning['optimiser']}, seed {tuning['seed']}) on {tuning['runs_of_each_case']} runs from random "
        f"starts of each of the cases {', '.join(tuning['cases'])}; noise and starts are not those of the tables. The "
        "cost adds up median and 99 % of the settling time, 95 % of the position error, and the shares of runs that do "
        "not settle or spin.",
        "",
    ]
    rows = [
        (name, number(one["untuned_cost"]), number(one["cost"]), str(one["evaluations"]), _shown(one["values"]))
        for name, one in tuning["laws"].items()
    ]
    return [*lines, *markdown_table(("law", "cost before", "after", "evaluations", "values"), rows), *_full_run()]


def _full_run() -> list[str]:
    return ["", "[A law of your own](how-to/own-law.md) has the commands of the full run."]


def _shown(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in values.items())
