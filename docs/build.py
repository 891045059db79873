"""Write the generated parts of docs/: ``python docs/build.py [--check] [--tables]``.

These parts are the Python interface in reference/python.md, the launch arguments in reference/launch.md, the parameters
in reference/parameters/, the bag rules in reference/bag-check.md, the table of states in reference/goals.md, and the
output of the commands in the tutorials and how-to pages.

``--tables`` skips the output of commands, which takes minutes. ``--check`` does not write, and fails if a page is out
of date.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import tutorial_run
from parameter_tables import with_parameters
from python_api import python_api

from diffbot_bag.check import BagRules, TopicRules
from diffbot_control.goals import TABLE, GoalEvent, State
from diffbot_core.schema import Spec, parameters_of
from diffbot_tools.bringup import ROBOT, SIMULATION

DOCS = Path(__file__).parent
_BLOCK = re.compile(r"(<!--(launch|python|rules|states)-->\n).*?(\n<!--/\2-->)", re.DOTALL)


def tables() -> dict[Path, str]:
    """Return the current text of each page of the reference."""
    parts = {"launch": launch_arguments, "python": python_api, "rules": rules, "states": states}

    def fresh(block: re.Match[str]) -> str:
        return block[1] + parts[block[2]]() + block[3]

    pages = sorted((DOCS / "reference").rglob("*.md"))
    return {path: _BLOCK.sub(fresh, with_parameters(path.read_text())) for path in pages}


def states() -> str:
    """Return the table of transitions: for each event and state, the next state, the command and the answer."""
    lines = ["| event | " + " | ".join(state.value for state in State) + " |", "|---" * (len(State) + 1) + "|"]
    for event in GoalEvent:
        cells = []
        for state in State:
            parts: list[str] = []
            if found := TABLE[state].get(event):
                next_state = found.state.value if found.state is not state else ""
                parts = [next_state, found.command.value, f"**{found.end}**" if found.end else ""]
            cells.append("; ".join(part for part in parts if part))
        lines.append(f"| {event.value} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def launch_arguments() -> str:
    """Return the arguments of the launch files: those of both files, then those of one file only."""
    robot, simulation = ({one.name: one for one in arguments} for arguments in (ROBOT, SIMULATION))
    groups: dict[str, list[str]] = {"Both files:": [], "Only robot.launch.py:": [], "Only simulation.launch.py:": []}
    for name, one in (robot | simulation).items():
        both = name in robot and name in simulation
        title = "Both files:" if both else f"Only {'robot' if name in robot else 'simulation'}.launch.py:"
        defaults = dict.fromkeys(found[name].default for found in (robot, simulation) if name in found)
        default = " in the simulation, else ".join(text for text in reversed(defaults) if text)
        values = "" if set(one.choices) == {"true", "false"} else "|".join(one.choices)
        notes = "; ".join(filter(None, (default and f"default {default}", values)))
        groups[title].append(f"- `{name}`: {one.text}{f' ({notes})' if notes else ''}")
    return "\n\n".join("\n".join([title, "", *lines]) for title, lines in groups.items())


def rules() -> str:
    """Return the rules of a contract: the rules for the whole bag, then the rules for a topic."""
    parts = []
    for title, config in (("For the whole bag:", BagRules), ("For a topic:", TopicRules)):
        names: dict[str, list[str]] = {}
        for one in parameters_of(config):
            names.setdefault(_meaning(one.spec), []).append(f"`{one.name}`")
        entries = [f"- {', '.join(same)}: {meaning}" for meaning, same in names.items()]
        parts.append("\n".join([title, "", *entries]))
    return "\n\n".join(parts)


def _meaning(spec: Spec) -> str:
    choices = f": {' or '.join(spec.choices)}" if spec.choices else ""
    return spec.text + choices + (f" [{spec.unit}]" if spec.unit not in ("", "-") else "")


def main() -> int:
    """Write or check the pages; return 1 if ``--check`` finds a page that is out of date."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="do not write, and fail if a page is out of date")
    parser.add_argument("--tables", action="store_true", help="skip the output of commands")
    options = parser.parse_args()
    stale = {path: text for path, text in tables().items() if path.read_text() != text}
    if not options.tables:
        stale |= {path: text for path in tutorial_run.pages() if (text := tutorial_run.fresh(path))}
    for path, text in stale.items():
        if not options.check:
            path.write_text(text)
        print(f"{path.relative_to(DOCS.parent)} {'is out of date: run `make docs`' if options.check else 'written'}")
    return 1 if options.check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
