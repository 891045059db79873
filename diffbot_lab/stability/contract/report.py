"""Tables of how often the filter keeps the contract."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from diffbot_lab.targets import markdown_table

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
