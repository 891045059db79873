"""Conclusions of the law's benchmark: targets, figures in which a peer is better, tables, the page in docs/."""

from __future__ import annotations

from typing import Any

from diffbot_lab.benchmark.targets import Target, evaluate_targets, markdown_table, number, summary, target_table

Results = dict[str, Any]

ROBUSTNESS = (
    "ts_005",
    "ts_02",
    "fixes_2_hz",
    "noise_half",
    "noise_double",
    "calibrating",
    "radius_error",
    "wheels_limited",
    "fix_delay",
)
"""Challenges in which 99.5 % of the runs have to settle."""
_COMPARED = (
    ("position", "median", "final position error, median", "m"),
    ("position", "p95", "final position error, 95 %", "m"),
    ("position", "max", "final position error, largest", "m"),
    ("heading", "median", "final heading error, median", "rad"),
    ("heading", "p95", "final heading error, 95 %", "rad"),
    ("heading", "max", "final heading error, largest", "rad"),
    ("settling_time", "median", "settling time of settled runs, median", "s"),
    ("settling_time", "p99", "settling time of settled runs, 99 %", "s"),
)


def targets(results: Results) -> list[Target]:
    """Pair each promised figure of this project's law with its bound."""
    law = {one["name"]: one for one in results["laws"]}
    challenge = {one["name"]: one for one in results["challenges"]}
    tuned, paper, precise = law["tuned"], law["paper_covariance"], challenge["precise"]
    found = [
        Target("tuned", "share settled", _share(tuned), 1.0, True),
        Target("tuned", "settling time, median [s]", tuned["settling_time"]["median"], 11.7),
        Target("tuned", "settling time, 99 % [s]", tuned["settling_time"]["p99"], 14.5),
        Target("tuned", "final position error, 95 % [m]", tuned["position"]["p95"], 0.050),
        Target("tuned", "final position error, largest [m]", tuned["position"]["max"], 0.08),
        Target("tuned", "final heading error, largest [rad]", tuned["heading"]["max"], 0.03),
        Target("tuned", "share with one switch", tuned["one_switch"], 0.99, True),
        Target("precise", "final position error, 95 % [m]", precise["position"]["p95"], 0.030),
        Target("precise", "the same over the filter's", _ratio(precise), 1.3),
        Target("precise", "final heading error, largest [rad]", precise["heading"]["max"], 0.05),
        Target("precise", "runs still moving", precise["moving"], 0.0),
        Target("paper_covariance", "share settled", _share(paper), 1.0, True),
        Target("paper_covariance", "final heading error, largest [rad]", paper["heading"]["max"], 0.1),
        Target("paper_covariance", "final position error, 95 % [m]", paper["position"]["p95"], 0.06),
    ]
    for name in ("random_far", "random_near"):
        found += [
            Target(name, "share settled", _share(challenge[name]), 0.999, True),
            Target(name, "switches, 99 %", challenge[name]["switches"]["p99"], 4.0),
            Target(name, "final heading error, largest [rad]", challenge[name]["heading"]["max"], 0.1),
        ]
    return found + [Target(name, "share settled", _share(challenge[name]), 0.995, True) for name in ROBUSTNESS]


def _share(one: Results) -> float:
    return float(one["settled"] / one["runs"])


def _ratio(one: Results) -> float | None:
    return one["position"]["p95"] / one["filter"]["p95"] if one["filter"]["p95"] else None


def not_leading(results: Results) -> list[dict[str, Any]]:
    """List every figure in which a peer is better than the tuned law."""
    ours = next(one for one in results["laws"] if one["name"] == "tuned")
    found = []
    for peer in results["laws"]:
        if peer["ours"]:
            continue
        pairs = [("share settled", "", -_share(ours), -_share(peer))]
        pairs += [(text, unit, ours[part][key], peer[part][key]) for part, key, text, unit in _COMPARED]
        found += [
            {"peer": peer["label"], "figure": text, "unit": unit, "ours": abs(own), "peers": abs(other)}
            for text, unit, own, other in pairs
            if own is not None and other is not None and other < own
        ]
    return found


def conclusions(results: Results) -> Results:
    """Return what follows from the figures, for results.json."""
    return {"targets": evaluate_targets(targets(results)), "not_leading": not_leading(results)}


def table(results: Results) -> str:
    """Lay out laws, challenges, targets, and the figures in which a peer is better, for a terminal."""
    head = f"{'':<30}{'settled':>9}{'time [s]: median':>18}{'99 %':>7}{'|pos| [m]: median':>19}{'95 %':>7}{'max':>7}"
    head += f"{'|theta| [rad]: median':>23}{'95 %':>7}{'max':>7}{'path':>7}{'effort':>8}{'switches':>10}"
    rows = [head, "-" * len(head)]
    rows += [_terminal_row(one["label"], one) for one in results["laws"]]
    rows += ["", "the tuned law in harder cases", "-" * len(head)]
    rows += [_terminal_row(one["name"], one) for one in results["challenges"]]
    rows += ["", *summary(targets(results))]
    lost = not_leading(results)
    rows += ["", "Where a peer is better than the tuned law:" if lost else "No peer is better than the tuned law."]
    rows += [f"  {one['peer']}: {one['figure']} {_pair(one)}" for one in lost]
    return "\n".join(rows)


def _terminal_row(label: str, one: Results) -> str:
    time, position, heading = one["settling_time"], one["position"], one["heading"]
    return (
        f"{label:<30}{100.0 * _share(one):>7.2f} %{number(time['median'], 1):>18}{number(time['p99'], 1):>7}"
        f"{number(position['median']):>19}{number(position['p95']):>7}{number(position['max']):>7}"
        f"{number(heading['median']):>23}{number(heading['p95']):>7}{number(heading['max']):>7}"
        f"{number(one['path_ratio']['median'], 2):>7}{number(one['effort']['median'], 0):>8}"
        f"{number(one['switches']['p99'], 0):>10}"
    )


def _pair(one: dict[str, Any]) -> str:
    # As many digits as show a difference.
    digits = next((d for d in (3, 4, 5) if f"{one['peers']:.{d}f}" != f"{one['ours']:.{d}f}"), 6)
    unit = f" {one['unit']}" if one["unit"] else ""
    return f"{one['peers']:.{digits}f}{unit}, ours {one['ours']:.{digits}f}{unit}"


def page(results: Results) -> str:
    """Return docs/benchmark.md."""
    lines = [*_introduction(results), "", *_laws_section(results)]
    lines += ["", "## Where a peer is better than the tuned law", "", *_lost_text(not_leading(results))]
    lines += ["", *_challenges_section(results), "", "## Targets", "", *target_table(targets(results))]
    return "\n".join(lines) + "\n"


def _introduction(results: Results) -> list[str]:
    tolerance = f"({results['xy_tolerance']:g} m, {results['yaw_tolerance']:g} rad)"
    return [
        "# The law and its peers",
        "",
        "Generated by `make docs` from docs/benchmark.json; `make docs ARGS=--benchmark` also repeats the benchmark. "
        "`diffbot benchmark` runs it on its own.",
        "",
        f"Every law has the same {results['starts']} starts (8 points of the 12 m circle with headings 0 and 220 deg, "
        f"and the start of the paper's simulation A), {results['runs_of_each_start']} runs of each, seed "
        f"{results['seed']}. Run i has the same noise under every law: fixes at 10 Hz with the paper's bounds "
        "(+-0.3 m, +-0.3 m, +-0.17 rad), +-5 % per wheel in drive and encoder. A run lasts "
        f"{results['duration']:.0f} s with Ts = 0.1 s. "
        "The law receives the estimate of the filter `ekf`, since the wheels are as configured; the cases "
        "`calibrating` and `radius_error` use the default filter.",
        "",
        f"- *Settled*: the true pose ends within {tolerance} of the goal. The *settling time* is the time of the last "
        "entry into this tolerance; only settled runs count.",
        "- *Over bound*: settling time divided by distance / v_max, the least time without a tolerance.",
        "- *Effort*: integral of v^2 + omega^2. The speed limit preserves the curvature for every law.",
        "",
        "![Paths from one start, and distributions of settling time and final errors](benchmark.png)",
    ]


_LAW_HEAD = (
    *("law", "settled", "settling time [s]: median", "99 %", "over bound", "\\|position\\| [m]: median", "95 %", "max"),
    *("\\|theta\\| [rad]: median", "95 %", "max", "path / distance", "effort", "switches, 99 %"),
)


def _laws_section(results: Results) -> list[str]:
    laws = results["laws"]
    own = laws[0]["filter"]
    return [
        "## Laws",
        "",
        *markdown_table(_LAW_HEAD, map(_law_row, laws)),
        "",
        f"The filter's own position error at the end of the tuned law's runs: median {own['median']:.3f} m, "
        f"95 % {own['p95']:.3f} m, largest {own['max']:.3f} m.",
        "",
        *markdown_table(("law", "source", "made for"), ((one["label"], one["source"], one["purpose"]) for one in laws)),
        "",
        "All peers but the last stop and hold still once their estimate is within a tolerance of position and heading. "
        "Each has the pair out of 0.02, 0.03 and 0.05 (m, rad) with which most of its runs settle, and *Nav2 graceful, "
        "1.3 m/s* has the options that perform best. Nav2's controller follows a path; there is no planner here, so "
        "its path is the straight line to the goal. The polar law and Aicardi's are designed for exact poses: near the "
        "goal, noise makes the bearing jump, and they turn after it until the estimate happens to be within the "
        "tolerance.",
    ]


def _law_row(one: Results) -> list[str]:
    time, position, heading = one["settling_time"], one["position"], one["heading"]
    cells = [one["label"], f"{100.0 * _share(one):.2f} %", number(time["median"], 1), number(time["p99"], 1)]
    cells += [number(one["over_bound"]["median"], 2)]
    cells += [number(part[key]) for part in (position, heading) for key in ("median", "p95", "max")]
    cells += [number(one["path_ratio"]["median"], 2), number(one["effort"]["median"], 0)]
    return [*cells, number(one["switches"]["p99"], 0) if one["ours"] else "-"]


_CHALLENGE_HEAD = (
    *("case", "runs", "settled", "settling time [s]: median", "99 %", "\\|position\\| [m]: median", "95 %", "max"),
    *("the filter's: 95 %", "\\|theta\\| [rad]: 95 %", "max", "switches, 99 %"),
)


def _challenges_section(results: Results) -> list[str]:
    challenges = results["challenges"]
    late = next(one["runs"] for one in challenges if one["name"] == "fix_delay")
    moving = next(one["moving"] for one in challenges if one["name"] == "precise")
    return [
        "## The tuned law in harder cases",
        "",
        *markdown_table(_CHALLENGE_HEAD, map(_challenge_row, challenges)),
        "",
        f"With xy_goal_tolerance 0.03 m, {moving} runs are still commanded more than 0.05 m/s in their last second. "
        "The tolerance is 0.1 m unless the case names another. Late fixes need the filter's history, which only the "
        f"uncompiled loop keeps, hence {late} runs.",
    ]


def _challenge_row(one: Results) -> list[str]:
    time, position, heading = one["settling_time"], one["position"], one["heading"]
    cells = [f"`{one['name']}`: {one['text']}", str(one["runs"]), f"{100.0 * _share(one):.2f} %"]
    cells += [number(time["median"], 1), number(time["p99"], 1)]
    cells += [number(position[key]) for key in ("median", "p95", "max")]
    cells += [number(one["filter"]["p95"]), number(heading["p95"]), number(heading["max"])]
    return [*cells, number(one["switches"]["p99"], 0)]


def _lost_text(lost: list[dict[str, Any]]) -> list[str]:
    if not lost:
        return ["Nowhere: it leads every peer in share settled, final errors and settling time."]
    lines = ["In share settled, final errors, and settling time of settled runs:", ""]
    return lines + [f"- {one['peer']}: {one['figure']} {_pair(one)}" for one in lost]
