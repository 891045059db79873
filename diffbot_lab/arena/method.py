"""The page on the method of the law's benchmark: conditions, laws and their tuning."""

from __future__ import annotations

from diffbot_lab.arena.report.targets import Results
from diffbot_lab.targets import markdown_table, number


def method_page(results: Results) -> list[str]:
    """Return the lines of the page."""
    return [
        "# Method of the law's benchmark",
        "",
        "Under which conditions do the laws compete, and is the comparison fair?",
        "",
        "**In short:** all laws have the same starts, noise, data sheet and limits, and the peers were tuned with the "
        "same optimiser and budget. The preset of the switching law had more work than that; "
        "[the row tuned like the peers](index.md#beside-the-best-peer) shows what this is worth.",
        "",
        *_conditions(results),
        "",
        "## Laws",
        "",
        *markdown_table(
            ("law", "source", "made for"), [(one["label"], one["source"], one["purpose"]) for one in results["laws"]]
        ),
        "",
        "Laws that follow a path have the straight line to the goal, since there is no planner here.",
        "",
        "## Tuning",
        "",
        *_tuning(results),
        "",
        "[Laws](../../how-to/own-law.md) has the commands of the full run, and how to enter a law of yours.",
    ]


def _conditions(results: Results) -> list[str]:
    runs = results["starts"] * results["runs_of_each_start"]
    own = results["starts"] * results["own_runs_of_each_start"]
    number_of_runs = f"{runs} runs in each case" + (f" ({own} of the switching law)" if own > runs else "")
    return [
        "## Conditions",
        "",
        f"- Starts: {results['starts']} (8 points of the 12 m circle with headings 0 and 220 deg, and the start of the "
        f"paper's simulation A), or as many random ones. {number_of_runs}, seed {results['seed']}.",
        "- Noise: run i has the same noise under every law. Fixes at 10 Hz with the paper's bounds (+-0.3 m, +-0.3 m, "
        "+-0.17 rad), +-5 % per wheel in drive and encoder.",
        "- Limits: 1.3 m/s at the rims and 2.6 rad/s in all cases; with bounded acceleration also "
        "0.5 m/s^2 and 1.5 rad/s^2.",
        f"- A run lasts {results['duration']:.0f} s with Ts = 0.1 s.",
        "- Every law has the same data sheet: limits, latency, lag and dead band where they are known.",
        "- Every law is given the pose in which the robot would come to rest, is brought within the limits, brakes "
        "within them, and may drive backwards.",
        "",
        "## What is counted",
        "",
        f"- *Settled*: the true pose ends within ({results['xy_tolerance']:g} m, {results['yaw_tolerance']:g} rad) of "
        "the goal. The *settling time* is the time of the last entry into this tolerance; only settled runs count.",
        "- *Answered*: the law said `reached`, by one rule for all: at rest, and within the tolerances by the estimate "
        "and its covariance with a probability of 0.99, in five poses in a row. The bound on the true pose knows its "
        "pose exactly. *Falsely*: the true pose was outside then.",
        "- *Revolutions*: all turning within 1 m of the goal, left and right added up.",
        "- 95 % intervals: Wilson's of shares, the bootstrap's of quantiles.",
    ]


def _tuning(results: Results) -> list[str]:
    tuning = results["tuning"]
    if not tuning["laws"]:
        return ["No law was tuned: all have their defaults."]
    rows = [
        (name, number(one["untuned_cost"]), number(one["cost"]), str(one["evaluations"]), _shown(one["values"]))
        for name, one in tuning["laws"].items()
    ]
    return [
        f"Each law has one set of parameters for all cases, found with {tuning['budget']} evaluations of the same "
        f"optimiser ({tuning['optimiser']}, seed {tuning['seed']}) on {tuning['runs_of_each_case']} runs from random "
        f"starts of each of the cases {', '.join(tuning['cases'])}; noise and starts are not those of the tables. The "
        "cost adds up median and 99 % of the settling time, 95 % of the position error, and the shares of runs that do "
        "not settle or spin.",
        "",
        *markdown_table(("law", "cost before", "after", "evaluations", "values"), rows),
    ]


def _shown(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in values.items())
