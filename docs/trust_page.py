"""The page docs/results/trust.md from data/trust.json: both are written by ``make trust``."""

from __future__ import annotations

import statistics
from collections import Counter
from typing import Any

from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.targets import markdown_table

QUESTION = """\
# Tests

Do all tests pass every time, also on a busy machine?"""
METHOD = """\
    make trust                       # 20 runs of a fresh clone; writes this page
    make trust ARGS="--runs 4"

A fresh clone of the commit gets its environment once, and then the runs, one after the other. Every second run has
{loops} busy loops beside it. A run passes if all its tests pass. All figures: [trust.json](data/trust.json)."""


def page(content: dict[str, Any]) -> str:
    """Return the page; ``content`` is what the JSON file holds."""
    runs = content["runs"]
    rows = []
    for name, busy in (("without busy loops", False), (f"{content['loops']} busy loops", True)):
        rows.append(_row(name, [one for one in runs if one["busy"] == busy]))
    rows.append(_row("all", runs))
    passed = sum(one["ok"] for one in runs)
    loads = [one["load"][0] for one in runs]
    stopped = "" if len(runs) == content["planned"] else f" ({content['planned']} were planned)"
    command = " ".join(["make test", *content["variables"]])
    parts = [
        QUESTION,
        f"**In short:** {passed} of {len(runs)} runs of `{command}` passed{stopped}.",
        METHOD.format(loops=content["loops"]),
        f"Commit {content['commit']}, {content['date']}, {content['cores']} cores, Python {content['python']}; load "
        f"average before the runs {min(loads):.1f} to {max(loads):.1f}; "
        f"{max(one['passed'] + one['failed'] for one in runs)} tests.",
        "\n".join(markdown_table(("machine", "runs", "passed", "95 % interval", "median", "longest"), rows)),
    ]
    failing = Counter(name for one in runs for name in one["failing"])
    if failing:
        table = markdown_table(("failed test", "runs"), [(f"`{name}`", str(n)) for name, n in failing.most_common()])
        parts.append("\n".join(table))
    return "\n\n".join(parts) + "\n"


def _row(name: str, runs: list[dict[str, Any]]) -> list[str]:
    if not runs:
        return [name, "0", "", "", "", ""]
    passed, seconds = sum(one["ok"] for one in runs), [one["seconds"] for one in runs]
    low, high = wilson(passed, len(runs))
    interval = f"{100 * low:.0f} to {100 * high:.0f} %"
    return [name, str(len(runs)), str(passed), interval, f"{statistics.median(seconds):.0f} s", f"{max(seconds):.0f} s"]
