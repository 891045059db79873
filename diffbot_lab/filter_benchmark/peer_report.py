"""Table of the comparison with robot_localization, for a terminal and for the documentation."""

from __future__ import annotations

from typing import Any

from diffbot_lab.targets import markdown_table, number

Results = dict[str, Any]

NAMES = {"diffbot": "diffbot, defaults", "tuned": "peer, tuned", "default": "peer, default noise"}


def rows_of(results: Results) -> list[tuple[str, ...]]:
    """Return a row for each case: errors of position and heading and NEES of all filters, and ours over the tuned."""
    rows = []
    for case in results["cases"]:
        figures = (errors_text(case["filters"][name]) for name in NAMES)
        rows.append((case["text"], *figures, *(ratio_text(case["ratio"][name]) for name in ("position", "heading"))))
    return rows


HEAD = ("case", *NAMES.values(), "position, ours / tuned", "heading, ours / tuned")


def errors_text(one: Results) -> str:
    """Return the errors of position and heading and the NEES of a filter."""
    position, heading, nees = (one[name][0] for name in ("position", "heading", "nees"))
    return f"{number(position)}; {number(heading)}; {number(nees, 1)}"


def ratio_text(interval: list[float]) -> str:
    """Return a ratio with its interval."""
    mean, low, high = interval
    return f"{mean:.2f} [{low:.2f}, {high:.2f}]"


def conditions(results: Results) -> str:
    """Return the sentences on the runs."""
    counts = ", ".join(str(seed) for seed in results["training_seeds"])
    last = results["seed"] + results["runs"] - 1
    return (
        f"{results['peer']}; {results['runs']} drives of {results['duration']:.0f} s for each case, seeds "
        f"{results['seed']} to {last}; the first {results['skipped']:.0f} s do not count. The peer is tuned for each "
        f"case on the drives of seeds {counts}. Odometry at {results['rate']} Hz."
    )


def table(results: Results) -> str:
    """Lay the figures out."""
    return "\n".join(markdown_table(HEAD, rows_of(results)))
