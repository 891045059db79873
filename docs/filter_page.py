"""The tables of docs/results/filter.md: the filter's benchmarks and its contract."""

from __future__ import annotations

from typing import Any

from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.filter_benchmark.report import targets
from diffbot_lab.filter_benchmark.states import table as table_of_states
from diffbot_lab.stability.contract.report import table as table_of_contract
from diffbot_lab.targets import markdown_table, number

Results = dict[str, Any]

RATES = ("10/1", "10/5", "50/10")
"""[Hz] Odometry and fixes in most cases; a case with other rates has rows of its own."""
MODES = {"off": "not looked for", "on": "detected (default)", "given": "given"}


def conditions(results: Results) -> str:
    """Return the sentences on the runs, and on the targets."""
    found = targets(results)
    missed = [f"{one.case}, {one.text}: {number(one.value)} instead of {one.bound:g}" for one in found if not one.met]
    lost = sum(case["filters"][results["default_filter"]]["lost"] for case in results["cases"])
    runs = results["runs"] * len(results["cases"])
    return (
        f"{results['runs']} runs of {results['duration']:.0f} s in each case, seed {results['seed']}; the first "
        f"{results['skipped']:.0f} s do not count. The filter is the default, `{results['default_filter']}`. "
        f"{lost} of {runs} runs are lost. {len(found) - len(missed)} of {len(found)} targets are met"
        + (f" (missed: {'; '.join(missed)})." if missed else ".")
    )


def overview(results: Results) -> str:
    """Return the tables of the default filter: a column for each pair of rates, then the cases with other rates."""
    cases: dict[str, dict[str, Results]] = {}
    for case in results["cases"]:
        rates = f"{case['odometry_rate']}/{case['fix_rate']}"
        cases.setdefault(case["text"], {})[rates] = case["filters"][results["default_filter"]]
    rows, others = [], []
    for text, found in cases.items():
        if tuple(found) == RATES:
            rows.append((text, *(_figures(found[rates]) for rates in RATES)))
        else:
            others += [(text, rates, _figures(one)) for rates, one in found.items()]
    lines = markdown_table(("case", *(f"{rates} Hz" for rates in RATES)), rows)
    return "\n".join([*lines, "", *markdown_table(("case", "Hz", "figures"), others)])


def _figures(one: Results) -> str:
    return f"{number(one['position']['rmse'])}; {number(one['heading']['rmse'])}; {number(one['nees'], 1)}"


def colour(results: Results) -> str:
    """Return the table of fixes whose errors are correlated."""
    rows = []
    for one in results["cells"]:
        low, high = (100.0 * bound for bound in wilson(one["alarms"], one["runs"]))
        alarms = f"{100.0 * one['alarms'] / one['runs']:.1f} % [{low:.1f}, {high:.1f}]"
        figures = (number(one["rmse"]), number(one["nees"], 2), alarms, number(one["alarm_median"], 0))
        rows.append((f"{one['c']:g}", MODES[one["mode"]], *figures))
    head = ("c", "correlation", "RMSE [m]", "NEES", "runs with an alarm", "first alarm, median [s]")
    return "\n".join(
        [
            f"{results['runs']} runs of {results['duration']:.0f} s at "
            f"{results['odometry_rate']}/{results['fix_rate']} Hz, seed {results['seed']}, without the first "
            f"{results['skipped']:.0f} s:",
            "",
            *markdown_table(head, rows),
        ]
    )


def states(results: Results) -> str:
    """Return the table of what estimated errors cost and gain."""
    last = results["seed"] + results["runs"] - 1
    return (
        f"{results['runs']} random drives of {results['duration']:.0f} s, seeds {results['seed']} to {last}; the first "
        f"{results['skipped']:.0f} s do not count. Odometry at {results['rate']} Hz, fixes at 1 Hz, landmarks at 5 Hz."
        f"\n\n{table_of_states(results)}"
    )


def contract(content: Results) -> str:
    """Return the tables of how often, and from when on, contracts are kept, and of bounds that would be."""
    first = content["contracts"][0]
    lines = [
        f"Runs of {first['cases'][0]['duration']:g} s with the default law and filter, seed {first['seed']} (not used "
        "for tuning). Share of the runs that keep all bounds in every step of a window, and the time from which a run "
        "keeps them to its end:"
    ]
    for results in content["contracts"]:
        bounds = results["contract"]
        slopes = "{position_slope:g} m, {theta_slope:g} rad and {sigma_slope:g} m".format(**bounds)
        more = f", each plus {slopes} per metre from the goal" if bounds["position_slope"] > 0.0 else ""
        lines += [
            "",
            f"**Within {bounds['eps_position']:g} m and {bounds['eps_theta']:g} rad, with a reported standard "
            f"deviation of the position of at most {bounds['sigma_max']:g} m{more}**; the base within "
            f"{bounds['eps_v']:g} m/s and {bounds['eps_omega']:g} rad/s:",
            "",
            *table_of_contract(results),
        ]
    return "\n".join(lines)
