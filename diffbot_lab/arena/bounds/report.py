"""The bounds of the arena as text: for a terminal, and as the page docs/results/benchmark/bounds.md."""

from __future__ import annotations

from diffbot_lab.arena.report.targets import Results, figures_of_law, share
from diffbot_lab.targets import markdown_table, number, with_interval

_FIGURES = (
    ("settling time, median", "s", 1, "settling_time", "median"),
    ("settling time, 99 %", "s", 1, "settling_time", "p99"),
    ("final position error, 95 %", "m", 3, "position", "p95"),
)
"""Text, unit, digits, and where the figure is."""
_INTO = "into the tolerance"
_TIME_HEAD = ("case", "target", "starts confirmed", "least time [s]: median", "largest")
_NMPC_HEAD = (
    *("case", "NMPC with the true model, on", "settled [%]", "settling time [s]: median", "99 %"),
    *("\\|position\\| [m]: 95 %", "reached (falsely)"),
)


def table(bounds: Results) -> str:
    """Lay out the least times and the figures of NMPC for a terminal."""
    lines = [f"{'':<14}{'least time into / at':<24}{'starts':>7}{'median [s]':>12}{'largest':>9}"]
    for row in _time_rows(bounds):
        lines.append(f"{row[0]:<14}{row[1]:<24}{row[2]:>7}{row[3]:>12}{row[4]:>9}")
    lines += ["", f"{'':<14}{'':<40}{'settled':>9}{'time [s]: median':>18}{'99 %':>7}{'|pos| [m]: 95 %':>17}"]
    for case in bounds["cases"]:
        for one in case["nmpc"]:
            figures = [number(one[part][key], digits) for _, _, digits, part, key in _FIGURES]
            settled = f"{one['settled']}/{one['runs']}"
            widths = zip(figures, (18, 7, 17), strict=True)
            cells = "".join(f"{text:>{width}}" for text, width in widths)
            lines.append(f"{case['name']:<14}{one['label']:<40}{settled:>9}{cells}")
    return "\n".join(lines)


def bound_section(bounds: Results, results: Results) -> list[str]:
    """Return the lines of the page.

    Args:
        bounds: content of docs/results/data/benchmark_bound.json.
        results: content of docs/results/data/benchmark.json, for the laws that NMPC is compared with.
    """
    lines = ["# Bounds", "", "How much faster could any law be?", "", *_answer(bounds, results), ""]
    lines += [*_meaning(bounds), ""]
    lines += [*markdown_table(_TIME_HEAD, _time_rows(bounds)), "", *_nmpc_text(bounds), ""]
    cells = [_nmpc_row(case["name"], one) for case in bounds["cases"] for one in case["nmpc"]]
    lines += [*markdown_table(_NMPC_HEAD, cells), "", "## Laws that are ahead of NMPC on the estimate", ""]
    rows = laws_ahead(bounds, results)
    if not rows:
        return [*lines, "No law of the benchmark is ahead of NMPC on the estimate in any of these figures."]
    return [
        *lines,
        "NMPC on the estimate is no bound of what a law reaches on the estimate. Laws of the benchmark that are "
        "ahead of it, with all their runs:",
        "",
        *markdown_table(("case", "law", "figure", "the law's, NMPC's"), rows),
    ]


def _answer(bounds: Results, results: Results) -> list[str]:
    found = []
    for case in bounds["cases"]:
        own = figures_of_law(results, case["name"])
        least = next((one for one in case.get("least_time", []) if one["target"] == _INTO), None)
        if own is not None and least is not None and least["median"] is not None:
            settling = own["settling_time"]["median"]
            found.append(
                f"in the case `{case['name']}` the fastest drives into the tolerance take {least['median']:.2f} s "
                f"(median over the starts), the switching law {number(settling, 1)} s with noise and an estimate"
            )
    return [f"**In short:** {'; '.join(found)}."] if found else []


def laws_ahead(bounds: Results, results: Results) -> list[list[str]]:
    """Return where a law on the estimate has a better figure than NMPC on the estimate: case, law, figure, both."""
    laws = {one["name"]: one["label"] for one in results["laws"] if not one["bound"]}
    arena = {row["name"]: row["laws"] for row in results["cases"]}
    rows = []
    for case in bounds["cases"]:
        nmpc = next(one for one in case["nmpc"] if one["name"] == "nmpc_ekf")
        for one in (one for one in arena.get(case["name"], []) if one["name"] in laws):
            rows += [[case["name"], laws[one["name"]], *cells] for cells in _ahead(one, nmpc)]
    return rows


def _ahead(law: Results, nmpc: Results) -> list[list[str]]:
    found = []
    if share(law) > share(nmpc):
        found.append(["share settled", f"{100.0 * share(law):.2f} %, {100.0 * share(nmpc):.2f} %"])
    # The settling time of a few settled runs says nothing: only a law that settles as often is compared in the others.
    if share(law) < share(nmpc):
        return found
    for text, unit, digits, part, key in _FIGURES:
        ours, theirs = law[part], nmpc[part]
        if ours[key] is not None and (theirs[key] is None or ours[key] < theirs[key]):
            apart = theirs[key] is None or ours[f"{key}_interval"][1] < theirs[f"{key}_interval"][0]
            pair = f"{number(ours[key], digits)} {unit}, {number(theirs[key], digits)} {unit}"
            found.append([text, pair if apart else f"{pair} (intervals overlap)"])
    return found


def _meaning(bounds: Results) -> list[str]:
    return [
        f"    {bounds['command']}     # with CasADi {bounds['casadi']}",
        "",
        "It needs CasADi (extra `bound`). All figures: [benchmark_bound.json](../data/benchmark_bound.json).",
        "",
        "## Least time",
        "",
        f"The fastest drive of the robot from rest, without noise, from each of the {bounds['starts']} starts. "
        "*Into the tolerance*: the robot may still brake, but stays inside; this is what the settling time measures. "
        "*At rest at the pose*: it has stopped at the goal.",
        "",
        "- The drives are found by direct multiple shooting from three first guesses. A drive counts where the "
        "simulated plant, driven by its commands, confirms it with all limits kept.",
        "- Each is a local optimum, the best of those found. It is no proof that there is none faster.",
        "- No estimate, dead time or lag is in it: a dead time d adds d.",
        "- Noise of the drives may help a run by a little, and settling times are whole steps of 0.1 s.",
        "- Commands are held over periods of about 0.1 s as in the arena, and may change at the start of the first "
        "one: with bounded acceleration a drive is one period shorter than a continuous one.",
    ]


def _nmpc_text(bounds: Results) -> list[str]:
    nmpc = bounds["nmpc"]
    first, growth, periods = nmpc["period"], nmpc["growth"], nmpc["periods"]
    length = first * (growth**periods - 1.0) / (growth - 1.0) if growth > 1.0 else first * periods
    runs = bounds["starts"] * bounds["runs_of_each_start"]
    return [
        "## NMPC with the true model",
        "",
        "Nonlinear model predictive control solves an optimal control problem to the goal anew in each step. It runs "
        "in the arena's world: same plant, sensors, filter, starts, noise and data sheet; dead time and lag are "
        "bridged by the coasted pose, as for every law.",
        "",
        f"- The horizon has {periods} periods that grow by {growth:g} from {first:g} s, {length:.1f} s together.",
        f"- The cost is distance + {nmpc['heading_weight']:g} m/rad * heading error, integrated over time. The first "
        "guess of a step is the solution of the step before.",
        f"- It holds still within {nmpc['stop_distance']:g} m and {nmpc['stop_angle']:g} rad.",
        "- Its weights were chosen by hand after a few trials, not tuned with the budget of the laws.",
        "",
        "On the true pose it shows what planning with the right model reaches under the noise of the drives. On the "
        "estimate it shows what is left of that. Its coarse horizon, its weights and the noise make it slower than the "
        f"least time, so its settling time is no lower bound. {runs} runs of each kind, seed {bounds['seed']}: with so "
        "few, the 99 % quantile is about the largest value.",
    ]


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


def _nmpc_row(case: str, one: Results) -> list[str]:
    low, high = one["settled_interval"]
    return [
        case,
        one["label"].removeprefix("NMPC with the true model, "),
        f"{100.0 * share(one):.2f} [{100.0 * low:.2f}, {100.0 * high:.2f}]",
        with_interval(one["settling_time"], "median", 1),
        with_interval(one["settling_time"], "p99", 1),
        with_interval(one["position"], "p95", 3),
        f"{one['reached']} ({one['false_reached']})",
    ]
