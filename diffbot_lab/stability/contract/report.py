"""Tables and the page of how often the filter keeps the contract."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from diffbot_lab.targets import markdown_table

_QUESTION = """\
# The filter and its contract

How often does the filter keep the contract that the certificate of the tuned law assumes?"""
_READING = """\
## How to read it

- *Errors within*: the distance of the estimated from the true position and the heading's error are within their bounds.
- *Sigma within*: the standard deviation of the position that the filter reports is within its bound.
- *All three*: the contract as the certificate assumes it, but for the deviation of the heading, which is not looked at.
- Steps of one run depend on each other: the interval of a share of steps is that of the mean over the runs, that of a
  share of runs is Wilson's. A share of steps without an interval is the same in every run.

The [certificate](../../explanation/stability-tuned.md) says nothing about the time before the contract holds. Its time
begins where the contract does, not where the run does. It covers law and robot of all cases but `mix`, which has
limited accelerations, dead time and lag. That the contract is kept to the end of a run is observed, not proved."""
_KEPT = (
    *("case", "since the start", "errors within: steps", "errors within: runs"),
    *("sigma within: steps", "all three: runs"),
)
_TIMES = ("case", "errors: median", "errors: 95 %", "all three: median", "all three: 95 %", "runs outside at the end")


def table(results: Mapping[str, Any]) -> list[str]:
    """Lay out the shares of all cases, then the times from which the contract holds, as Markdown tables."""
    return [*_kept_table(results), "", *_times_table(results)]


def _kept_table(results: Mapping[str, Any]) -> list[str]:
    rows = []
    for case in results["cases"]:
        name = f"`{case['name']}`: {case['text']} ({case['runs']} runs)"
        for window in case["windows"]:
            errors, sigma, both = window["errors"], window["sigma"], window["all"]
            cells = [_share(errors, "steps"), _share(errors, "runs"), _share(sigma, "steps"), _share(both, "runs")]
            rows.append([name, f"{window['from']:g} to {window['to']:g} s", *cells])
            name = ""
    return markdown_table(_KEPT, rows)


def _times_table(results: Mapping[str, Any]) -> list[str]:
    return markdown_table(_TIMES, [_times(case) for case in results["cases"]])


def page(results: Mapping[str, Any]) -> str:
    """Return docs/results/filter/contract.md; ``results`` is what results.json holds."""
    contract = results["contract"]
    bounds = f"{contract['eps_position']:g} m for the position and {contract['eps_theta']:g} rad for the heading"
    parts = [
        _QUESTION,
        _answer(results),
        "    diffbot stability contract            # --eps-position, --eps-theta, --sigma-max, --runs, --seed, --out\n"
        "    make docs ARGS=--benchmark=contract   # repeats it, writes this page",
        f"The compiled loop with the default law and the default filter, `{results['filter']}`, in cases of "
        "[the arena](../benchmark/method.md), which itself has another filter in some. "
        f"Bounds: {bounds}; {contract['sigma_max']:g} m for the reported standard deviation. Runs of "
        f"{results['cases'][0]['duration']:g} s, seed {results['seed']} (not used for tuning), intervals of 95 %. All "
        "figures: [contract.json](../data/contract.json).",
        "\n".join(_kept_table(results)),
        "## From when on it holds",
        "Time since the start from which on every step until the end of the run is within the bounds, over all runs of "
        "a case. A run that is outside in its last step has no such time.",
        "\n".join(_times_table(results)),
        _READING,
    ]
    return "\n\n".join(parts) + "\n"


def _answer(results: Mapping[str, Any]) -> str:
    """Return the answer in short: the first case in its first window, all in the last, and the times of the first."""
    cases = results["cases"]
    first, last = cases[0]["windows"][0], cases[0]["windows"][-1]
    ends = ", ".join(f"{_whole_runs(case['windows'][-1])} (`{case['name']}`)" for case in cases)
    found = cases[0]["all_hold_from"]
    return (
        f"**In short:** from {first['from']:g} to {first['to']:g} s after the start, {_whole_runs(first)} of the runs "
        f"of `{cases[0]['name']}` keep all three bounds in every step. From {last['from']:g} to {last['to']:g} s these "
        f"are {ends}. The time from which on the contract holds to the end of the run has a median of "
        f"{_time(found['median'])} in the case `{cases[0]['name']}` and a 95 % quantile of {_time(found['p95'])}."
    )


def _whole_runs(window: Mapping[str, Any]) -> str:
    return f"{_percent(window['all']['runs'], 1)} %"


def _share(kept: Mapping[str, float], of: str) -> str:
    """Return a share with its interval; without one if that has no width."""
    digits = 2 if of == "steps" else 1
    share, low, high = kept[of], kept[f"{of}_low"], kept[f"{of}_high"]
    if low == high:
        return f"{_percent(share, digits)} %"
    return f"{_percent(share, digits)} % [{', '.join(_percent(one, digits) for one in (low, high))}]"


def _percent(share: float, digits: int) -> str:
    """Return a share in percent; only one of 1 is shown as 100."""
    if share == 1.0:
        return "100"
    text = f"{100.0 * share:.{digits}f}"
    return f"> {100.0 - 10.0**-digits:.{digits}f}" if float(text) == 100.0 else text


def _times(case: Mapping[str, Any]) -> list[str]:
    errors, both = case["errors_hold_from"], case["all_hold_from"]
    times = [_time(one[name]) for one in (errors, both) for name in ("median", "p95")]
    return [f"`{case['name']}`", *times, f"{both['not_at_end']} of {case['runs']}"]


def _time(seconds: float | None) -> str:
    return "none" if seconds is None else f"{seconds:.1f} s"
