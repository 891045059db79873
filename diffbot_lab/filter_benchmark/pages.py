"""The filter's benchmark as tables for the pages of docs/results/filter."""

from __future__ import annotations

from diffbot_lab.filter_benchmark.report import Results, targets
from diffbot_lab.targets import Target, markdown_table, number

_OVERVIEW = ("case", "Hz", "\\|position\\| [m]: RMSE", "\\|theta\\| [rad]: RMSE", "NEES", "runs lost")


def conditions(results: Results) -> str:
    """Return the sentence on the runs, and on the targets."""
    found = targets(results)
    missed = [one for one in found if not one.met]
    return (
        f"{results['runs']} runs of {results['duration']:.0f} s in each case, seed {results['seed']}; the first "
        f"{results['skipped']:.0f} s do not count. The default is `{results['default_filter']}`. "
        f"{len(found) - len(missed)} of {len(found)} promised figures are met" + _named(missed) + "."
    )


def _named(missed: list[Target]) -> str:
    """Name the figures that are missed."""
    texts = [f"{one.case}, {one.text}: {number(one.value)} instead of {one.bound:g}" for one in missed]
    return f" (missed: {'; '.join(texts)})" if texts else ""


def overview(results: Results) -> str:
    """Return the table of the default filter: a row for each case at each pair of rates."""
    rows = []
    for case in results["cases"]:
        one = case["filters"][results["default_filter"]]
        figures = (number(one["position"]["rmse"]), number(one["heading"]["rmse"], 4), number(one["nees"], 2))
        rows.append((case["text"], _rates(case), *figures, str(one["lost"])))
    return "\n".join(markdown_table(_OVERVIEW, rows))


def _rates(case: Results) -> str:
    return f"{case['odometry_rate']}/{case['fix_rate']}"
