"""The filter's benchmark as tables for the pages of docs/results/filter."""

from __future__ import annotations

from diffbot_lab.filter_benchmark.report import Results, targets
from diffbot_lab.targets import markdown_table, number, target_table

_ACCURACY = (
    *("Hz", "filter", "\\|position\\| [m]: RMSE", "95 % of the runs", "largest"),
    *("\\|theta\\| [rad]: RMSE", "95 % of the runs", "lost"),
)
_CONSISTENCY = ("Hz", "filter", "NIS (95 % bounds)", "runs inside", "NEES (95 % bounds)", "rejected", "relocations")
_BACK = "back [s]: median, max"
_OVERVIEW = ("case", "Hz", "\\|position\\| [m]: RMSE", "\\|theta\\| [rad]: RMSE", "NEES", "runs lost")


def conditions(results: Results) -> str:
    """Return the sentence on the runs, and on the targets."""
    found = targets(results)
    missed = [one for one in found if not one.met]
    return (
        f"{results['runs']} runs of {results['duration']:.0f} s in each case, seed {results['seed']}; the first "
        f"{results['skipped']:.0f} s do not count. The default is `{results['default_filter']}`. "
        f"{len(found) - len(missed)} of {len(found)} [targets](targets.md) are met."
    )


def overview(results: Results) -> str:
    """Return the table of the default filter: a row for each case at each pair of rates."""
    rows = []
    for case in results["cases"]:
        one = case["filters"][results["default_filter"]]
        figures = (number(one["position"]["rmse"]), number(one["heading"]["rmse"], 4), number(one["nees"], 2))
        rows.append((case["text"], _rates(case), *figures, str(one["lost"])))
    return "\n".join(markdown_table(_OVERVIEW, rows))


def targets_part(results: Results) -> str:
    """Return the table of the targets."""
    return "\n".join(target_table(targets(results)))


def cases_part(results: Results, *sections: str) -> str:
    """Return two tables for each case of these sections: its accuracy, and the consistency of the filter."""
    lines: list[str] = []
    for text in dict.fromkeys(one["text"] for one in results["cases"] if one["section"] in sections):
        cases = [one for one in results["cases"] if one["text"] == text]
        every = [(case, name, one) for case in cases for name, one in case["filters"].items()]
        back = any(one["back_max"] is not None for _, _, one in every)
        lines += ["", f"## {text[0].upper()}{text[1:]}", ""]
        lines += markdown_table(_ACCURACY, [_accuracy(*one) for one in every])
        head = (*_CONSISTENCY, _BACK) if back else _CONSISTENCY
        lines += ["", *markdown_table(head, [_rest(*one, back) for one in every])]
    return "\n".join(lines[1:])


def _rates(case: Results) -> str:
    return f"{case['odometry_rate']}/{case['fix_rate']}"


def _accuracy(case: Results, name: str, one: Results) -> list[str]:
    position, heading = one["position"], one["heading"]
    return [
        *(_rates(case), f"`{name}`", number(position["rmse"]), number(position["p95"]), number(one["largest"], 2)),
        *(number(heading["rmse"], 4), number(heading["p95"], 4), str(one["lost"])),
    ]


def _rest(case: Results, name: str, one: Results, back: bool) -> list[str]:
    inside = one["nis_inside"]
    cells = [_rates(case), f"`{name}`", _bounded(one, "nis"), "-" if inside is None else f"{100.0 * inside:.0f} %"]
    cells += [_bounded(one, "nees"), f"{100.0 * one['rejected']:.2f} %", number(one["relocations"], 2)]
    return [*cells, f"{number(one['back_median'], 1)}, {number(one['back_max'], 1)}"] if back else cells


def _bounded(one: Results, name: str) -> str:
    if one[name] is None:
        return "-"
    return f"{one[name]:.2f} ({one[f'{name}_low']:.2f} .. {one[f'{name}_high']:.2f})"
