"""Tables of how often a contract is kept."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from diffbot_lab.stability.contract.deviations import BOUNDED
from diffbot_lab.tables import markdown_table


def table(results: Mapping[str, Any]) -> list[str]:
    """Lay out shares and times of all cases, and the bounds that nearly all runs keep, as Markdown tables."""
    windows = [f"{one['from']:g} to {one['to']:g} s" for one in results["cases"][0]["windows"]]
    head = ("case", "runs", *(f"{one} [%]" for one in windows), "holds from [s]: median", "95 %", "not at the end")
    kept = markdown_table(head, [_row(case) for case in results["cases"]])
    bounds = [[f"`{one['name']}`", *(f"{one['fitted'][name]:g}" for name in BOUNDED)] for one in results["cases"]]
    last = windows[-1]
    return [*kept, "", *markdown_table((f"99.9 % of the runs keep, {last}", *BOUNDED), bounds)]


def _row(case: Mapping[str, Any]) -> list[str]:
    since = case["holds_from"]
    times = ["none" if since[name] is None else f"{since[name]:.1f}" for name in ("median", "p95")]
    shares = [f"{_percent(one['runs'])} [{_percent(one['low'])}, {_percent(one['high'])}]" for one in case["windows"]]
    return [f"`{case['name']}`: {case['text']}", str(case["runs"]), *shares, *times, str(since["not_at_end"])]


def _percent(share: float) -> str:
    """Return a share in percent; only one of 1 is shown as 100."""
    text = f"{100.0 * share:.1f}"
    return text if share == 1.0 or text != "100.0" else "> 99.9"
