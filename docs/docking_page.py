"""The page docs/results/docking.md from the JSON file of the docking study."""

from __future__ import annotations

from typing import Any

from diffbot_lab.arena.docking.report import LABELS, ahead_lines, share_text, spread_text, table, targets
from diffbot_lab.arena.docking.study import OWN, PEER
from diffbot_lab.targets import markdown_table, number

Results = dict[str, Any]

METHOD = """\
    diffbot benchmark docking      # --runs, --seed, --case, --out
    make docs ARGS="--benchmark docking"

All figures with 95 % intervals: [docking.json](data/docking.json)."""
CONDITIONS = """\
Contact is the first time that the true pose crosses x = 0 of the dock's frame going in, in whichever try; errors and
time are those at contact. A run without contact within {duration:.0f} s counts as not docked. {runs} runs of each law
in each case, seed {seed}, which was not used in development; run i has the same start and noise under both laws.
Starts are uniform: 0.5 to 3 m before the dock, up to 0.5 m beside its axis, +-45 degrees. The dock is detected at 10 Hz
and 0.1 s late, with a deviation of 1 cm and 1 % of the distance, and of 0.02 rad and 0.01 rad for each metre, but not
within 0.3 m; 20 % of the detections are lost. The actuators have the realistic mix of the
[benchmark of the law](benchmark.md): dead time and lag of 0.1 s each, bounded accelerations, dead band, a wheel's
radius 2 % and the separation 3 % wrong. Control at 10 Hz. A case says what is different in it. Both laws know the
data sheet, and have their default parameters.

Nav2's docking server is a law after its published source (release Jazzy): a staging pose 0.7 m before the dock, skipped
within 0.5 m of it, then the graceful law with the docking server's gains and speeds; an approach that takes more than
30 s begins again, three times at most. What differs from Nav2:

- It receives the estimate of this project's filter (`ekf_calibrating`, `wheels_as_configured` 0), as docking does, not
  its own exponential filter of the detections. So no try fails because a detection is lost.
- This project's switching law drives it to the staging pose.
- Nav2 ends within 0.05 m of the dock. Here the robot goes straight on from there at 0.1 m/s until contact.
- It controls at 10 Hz as docking does; Nav2's default is 50 Hz (`docking_50_hz`).

As in Nav2, its approach does not look ahead over latencies, which docking does; `docking_no_mix` has none."""


def page(results: Results) -> str:
    """Return the page; ``results`` is what the JSON file holds."""
    parts = [
        "# Docking",
        "How accurately and how fast does a robot dock that sees its dock, and is Nav2's docking server better?",
        _answer(results),
        METHOD,
        "![Paths before the dock, and errors and times at contact](figures/docking.png)",
        "*Above: paths of the first runs. Below: share of all runs with contact within an error or a time.*",
        "## Where Nav2's docking server is ahead",
        _ahead(results),
        "## Targets",
        _targets(results),
        "## All cases",
        "Lateral and heading error at contact, and times: quantiles. *Beside* is contact outside 2 cm or 2 degrees.",
        "\n".join(table(results)),
        "## Run by run",
        "Both laws have the same runs. Docked within 2 cm and 2 degrees was:",
        "\n".join(_pairs(results)),
        "## Conditions",
        CONDITIONS.format(**results),
    ]
    return "\n\n".join(parts) + "\n"


def _answer(results: Results) -> str:
    row = results["cases"][0]
    own, peer = row["laws"][OWN], row["laws"][PEER]
    faster = [one for one in ahead_lines(results) if one.startswith("time")]
    first = (
        f"Nav2's docking server is faster: contact after {spread_text(peer, 'time', ('median', 'p99'))} s "
        f"(median/99 %) instead of {spread_text(own, 'time', ('median', 'p99'))} s. "
        if faster
        else ""
    )
    missed, ideal = [one for one in targets(results) if not one.met], _peer_in(results, "docking_no_mix")
    return (
        f"**In short:** {first}Docking arrives within 2 cm and 2 degrees in {share_text(own)} % of the runs, Nav2's "
        f"docking server in {share_text(peer)} % (`{row['name']}`: {row['text']}). Lateral error at contact "
        f"(50/95/99 %) {spread_text(own, 'lateral')} cm, Nav2's {spread_text(peer, 'lateral')} cm; heading error "
        f"{spread_text(own, 'heading')} degrees, Nav2's {spread_text(peer, 'heading')} degrees. "
        f"With ideal actuators, which have no latency, Nav2's docking server arrives in {share_text(ideal)} %. "
        f"{len(targets(results)) - len(missed)} of {len(targets(results))} targets are met."
    )


def _peer_in(results: Results, name: str) -> Results:
    found: Results = next(row["laws"][PEER] for row in results["cases"] if row["name"] == name)
    return found


def _ahead(results: Results) -> str:
    compared = (
        "Compared are, in each case, the shares docked and without contact, lateral and heading error (95 %), and the "
        "time (median, 99 %)."
    )
    lines = [f"- {line}" for line in ahead_lines(results)]
    return "\n".join([compared, "", *(lines or ["It is ahead in none of them."])])


def _targets(results: Results) -> str:
    """Return the targets as a table: a row for each, a column for each case, in bold where it is missed."""
    names = [row["name"] for row in results["cases"]]
    rows: dict[str, list[str]] = {}
    for one in targets(results):
        text = number(one.value, 2)
        rows.setdefault(f"{one.text} {one.condition}", []).append(text if one.met else f"**{text}**")
    head = ["target", *(f"`{name}`" for name in names)]
    table_lines = markdown_table(head, [[name, *cells] for name, cells in rows.items()])
    return "\n".join(["Missed ones are in bold.", "", *table_lines])


def _pairs(results: Results) -> list[str]:
    head = ("case", f"only {LABELS[OWN]}", f"only {LABELS[PEER]}", "runs")
    rows = []
    for row in results["cases"]:
        cells = (str(row["only_own_docked"]), str(row["only_peer_docked"]), str(row["laws"][OWN]["runs"]))
        rows.append((f"`{row['name']}`", *cells))
    return markdown_table(head, rows)
