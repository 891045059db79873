"""The page docs/results/benchmark.md from the JSON files of the law's benchmark, its bounds and its changed parameters."""

from __future__ import annotations

from itertools import groupby
from typing import Any

from diffbot_lab.arena.effects import UNCHANGED
from diffbot_lab.arena.entries import EQUAL_NAME, OWN_NAME
from diffbot_lab.arena.report.targets import answered, false_share, figures_of_law, peers_ahead, targets
from diffbot_lab.targets import markdown_table, number

Results = dict[str, Any]

REALISTIC = "mix"
"""The case with all the plant's effects at once."""
MIN_EFFECT_TIME, MIN_EFFECT_ERROR = 1.0, 0.01
"""Changes of the median settling time [s] and of the error [m] from which on a parameter is listed."""
COLUMNS: tuple[tuple[str, str, str, int], ...] = (
    ("answer [s]: median", "reached_time", "median", 1),
    ("99 %", "reached_time", "p99", 1),
    ("settling [s]: 99 %", "settling_time", "p99", 1),
    ("\\|position\\| [m]: 95 %", "position", "p95", 3),
)


def page(results: Results, bounds: Results, effects: Results) -> str:
    """Return the page; the arguments are what the JSON files hold."""
    return (
        "\n\n".join(
            [
                "# The law and its peers",
                "Does the switching law bring a robot to a pose more reliably, faster and closer than other laws?",
                _answer(results),
                "    diffbot benchmark              # --runs, --seed, --out; --law: a law of yours\n"
                "    diffbot benchmark bound        # needs CasADi (extra `bound`)\n"
                "    make docs ARGS=--benchmark     # repeats it, writes this page",
                "All figures with 95 % intervals: [benchmark.json](data/benchmark.json), "
                "[benchmark_bound.json](data/benchmark_bound.json), [effects.json](data/effects.json).",
                "![Paths from one start, and distributions over all runs](figures/benchmark.png)",
                "*Above: runs of each law from one start. Below: share of all runs answered, settled or ended within.*",
                "## Beside the best peer",
                "Each cell: switching law/best peer in this figure, in bold where a peer is better.",
                "\n".join(beside_peers(results)),
                _with_equal_budget(results),
                "## Switching law alone",
                "\n".join(_alone(results)),
                "## Missed targets",
                _missed(results),
                "## Conditions",
                _conditions(results),
                "## Bounds",
                _bounds_text(bounds),
                "\n".join(_bounds_table(results, bounds)),
                "## Effect of each parameter",
                _effects_text(effects),
                "\n".join(_effects_table(effects)),
            ]
        )
        + "\n"
    )


def _answer(results: Results) -> str:
    ahead = peers_ahead(results)
    more = len({one["case"] for one in ahead if one["figure"].startswith("share answered")}) or "none"
    rows = {(one["case"], one["figure"]) for one in ahead}
    slowest = len([figure for _, figure in rows if figure.endswith("99 %")])
    compared = len([row for row in results["cases"] if _peers_in(results, row)])
    own = figures_of_law(results, REALISTIC)
    assert own is not None
    return (
        f"**In short:** of {compared} cases, a peer is answered more often in {more}. In "
        f"{len({one['case'] for one in ahead})} of them at least one peer is ahead in some figure: {len(rows)} figures, "
        f"{slowest} of them about the slowest runs (99 %). In the realistic case `{REALISTIC}` a client of the switching "
        f"law gets the answer `reached` in {100.0 * answered(own):.2f} % of the runs, after "
        f"{number(own['reached_time']['median'], 1)} s (median; 99 %: {number(own['reached_time']['p99'], 1)} s), falsely "
        f"in {100.0 * false_share(own):.2f} %; the robot ends {number(own['position']['p95'])} m from the goal (95 %)."
    )


def _peers_in(results: Results, row: Results) -> list[Results]:
    peers = {one["name"] for one in results["laws"] if not one["ours"] and not one["bound"]}
    return [one for one in row["laws"] if one["name"] in peers]


def beside_peers(results: Results) -> list[str]:
    """Return the table of this project's law beside the best peer in each figure, in bold where that is better."""
    rows = []
    for row in results["cases"]:
        own, peers = figures_of_law(results, row["name"]), _peers_in(results, row)
        if own is None or not peers:
            continue
        most = max(map(answered, peers))
        shares = f"{100.0 * answered(own):.2f}/" + _bold(f"{100.0 * most:.2f}", most > answered(own))
        cells = [shares, f"{100.0 * false_share(own):.2f}"]
        for _, part, key, digits in COLUMNS:
            ours = own[part][key]
            best = min((one[part][key] for one in peers if one[part][key] is not None), default=None)
            is_better = best is not None and (ours is None or best < ours)
            cells.append(f"{number(ours, digits)}/" + _bold(number(best, digits), is_better))
        rows.append([f"`{row['name']}`: {row['text']}", *cells])
    return markdown_table(("case", "answered [%]", "falsely [%]", *(one[0] for one in COLUMNS)), rows)


def _bold(text: str, is_better: bool) -> str:
    return f"**{text}**" if is_better else text


def _with_equal_budget(results: Results) -> str:
    ahead, equal = peers_ahead(results), peers_ahead(results, EQUAL_NAME)
    return (
        "The preset had more work than the tuning of the peers. With the same budget peers are ahead in "
        f"{len(equal)} figures instead of {len(ahead)} (each peer counts by itself), in "
        f"{len({one['case'] for one in equal})} cases instead of {len({one['case'] for one in ahead})}."
    )


def _alone(results: Results) -> list[str]:
    rows = []
    for row in results["cases"]:
        own = figures_of_law(results, row["name"])
        if own is None or _peers_in(results, row):
            continue
        shares = [100.0 * answered(own), 100.0 * false_share(own)]
        figures = [number(own[part][key], digits) for _, part, key, digits in COLUMNS]
        rows.append([f"`{row['name']}`: {row['text']}", *(f"{one:.2f}" for one in shares), *figures])
    return markdown_table(("case", "answered [%]", "falsely [%]", *(one[0] for one in COLUMNS)), rows)


def _missed(results: Results) -> str:
    found = targets(results)
    missed = [one for one in found if not one.met]
    lines = [f"{len(found) - len(missed)} of {len(found)} targets are met. The others, with their bounds:", ""]
    for case, ones in groupby(missed, key=lambda one: one.case):
        lines.append(f"- {case}: " + "; ".join(f"{one.text} {number(one.value)} ({one.condition})" for one in ones))
    return "\n".join(lines)


def _conditions(results: Results) -> str:
    runs = results["starts"] * results["runs_of_each_start"]
    own = results["starts"] * results["own_runs_of_each_start"]
    tuning = results["tuning"]
    peers = [one for one in results["laws"] if one["tuned"] and not one["ours"] and not one["bound"]]
    return "\n".join(
        [
            f"- {results['starts']} starts: 8 points of the 12 m circle with headings 0 and 220 deg, and that of the "
            f"paper's simulation A; or as many random ones. {runs} runs in each case ({own} of the switching law), seed "
            f"{results['seed']}, {results['duration']:.0f} s each, Ts = 0.1 s. Run i has the same noise under every law.",
            "- Fixes at 10 Hz with the paper's bounds (+-0.3 m, +-0.3 m, +-0.17 rad); +-5 % per wheel in drive and "
            "encoder; 1.3 m/s at the rims and 2.6 rad/s, with bounded acceleration also 0.5 m/s^2 and 1.5 rad/s^2.",
            "- Every law has the same data sheet and limits, gets the pose in which the robot would come to rest, and may "
            "drive backwards. Laws that follow a path get the straight line.",
            "- But Nav2's graceful controller (`nav2_graceful`) is as it is: forwards only, without a look ahead over latencies, "
            "with a plan each second and its own goal checker, after which it stops for good. Tuned: speeds of the case, the "
            "rest by the optimiser. The other two graceful laws are this project's: they turn and brake by the data sheet.",
            f"- *Settled*: the true pose ends within ({results['xy_tolerance']:g} m, {results['yaw_tolerance']:g} rad). The "
            "*settling time* is that of the last entry; only settled runs count.",
            "- *Answered*: the law said `reached` within 60 s, by one rule for all: at rest, and within the tolerances by the "
            "estimate with a probability of 0.99, in five poses in a row. *Falsely*: the true pose was outside then.",
            f"- Tuning: one set of parameters for each law, {tuning['budget']} evaluations of the same optimiser "
            f"({tuning['optimiser']}) on {tuning['runs_of_each_case']} runs of each of {len(tuning['cases'])} cases, with "
            "noise and starts that are not those of the tables.",
            "- Peers: " + "; ".join(one["label"] for one in peers) + ". Most were made for other tasks than a pose in "
            "open space with a noisy estimate. Their sources and tuned values are in benchmark.json.",
            "- A law of yours takes part as in [A law of your own](../how-to/own-law.md).",
        ]
    )


def _bounds_text(bounds: Results) -> str:
    nmpc = bounds["nmpc"]
    runs = bounds["starts"] * bounds["runs_of_each_start"]
    return (
        "*Least time*: the fastest drive into the tolerance without noise, dead time or lag, by direct multiple shooting, "
        "confirmed by the simulated plant. It is a local optimum: a faster drive is not excluded. *NMPC* plans with the "
        f"true model over {nmpc['periods']} periods. Its weights were chosen by hand, so it is no lower bound. {runs} runs of "
        f"each, seed {bounds['seed']}, CasADi {bounds['casadi']}. Median settling time [s], 95 % of \\|position\\| [m]:"
    )


def _bounds_table(results: Results, bounds: Results) -> list[str]:
    rows = []
    for case in bounds["cases"]:
        own = figures_of_law(results, case["name"], OWN_NAME)
        assert own is not None
        least = [number(one["median"], 2) for one in case.get("least_time", [])[:1]] or ["-"]
        pairs = [
            f"{number(one['settling_time']['median'], 1)}, {number(one['position']['p95'])}"
            for one in (*case["nmpc"], own)
        ]
        rows.append([case["name"], *least, *pairs])
    return markdown_table(("case", "least time", "NMPC, true pose", "NMPC, estimate", "switching law"), rows)


def _effects_text(effects: Results) -> str:
    runs = effects["runs_of_each_start"] * effects["starts"]
    fewest = min(100.0 * one["settled"] / one["runs"] for one in effects["rows"])
    return (
        "Each parameter of the default law, and each number of the data sheet of an unchanged robot, was halved and "
        f"doubled; {runs} runs of each, seed {effects['seed']}. At least {fewest:.1f} % of the runs settle whichever is "
        f"changed. Listed is what changes the median settling time of `{REALISTIC}` by {MIN_EFFECT_TIME:g} s or its position "
        f"error (95 %) by {MIN_EFFECT_ERROR:g} m; all others change less."
    )


def _effects_table(effects: Results) -> list[str]:
    rows = [one for one in effects["rows"] if one["case"] == REALISTIC]
    (base,) = (one for one in rows if one["parameter"] == UNCHANGED)
    shown = [["as it is", "", *_effect(base)]]
    for one in rows:
        time = abs(one["settling_time"]["median"] - base["settling_time"]["median"])
        error = abs(one["position"]["p95"] - base["position"]["p95"])
        if time >= MIN_EFFECT_TIME or error >= MIN_EFFECT_ERROR:
            shown.append([f"`{one['parameter']}`", f"{one['value']:g}", *_effect(one)])
    return markdown_table(("parameter", "value", "median [s]", "95 % [m]"), shown)


def _effect(one: Results) -> tuple[str, str]:
    return number(one["settling_time"]["median"], 1), number(one["position"]["p95"])
