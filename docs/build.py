"""Write the generated parts of docs/: ``python docs/build.py [--check] [--tables]``.

They follow the code: the Python interface in reference/python.md, the arguments in reference/launch.md, the lists of
parameters in reference/parameters/ and of bag rules in reference/bag-check.md, the table of states in
reference/goals.md, and what the commands of the tutorials print.
``--tables`` leaves the tutorials out, which take minutes. ``--check`` writes nothing and fails on an outdated page.
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
_RULES = re.compile(r"(<!--rules-->\n).*?(\n<!--/rules-->)", re.DOTALL)
_PYTHON = re.compile(r"(<!--python-->\n).*?(\n<!--/python-->)", re.DOTALL)
_LAUNCH = re.compile(r"(<!--launch-->\n).*?(\n<!--/launch-->)", re.DOTALL)
_STATES = re.compile(r"(<!--states-->\n).*?(\n<!--/states-->)", re.DOTALL)


def tables() -> dict[Path, str]:
    """Return the pages of the reference with current lists of parameters and rules."""
    found = {}
    for path in sorted((DOCS / "reference").rglob("*.md")):
        page = _RULES.sub(lambda block: block[1] + rules() + block[2], with_parameters(path.read_text()))
        for pattern, content in ((_STATES, states), (_PYTHON, python_api), (_LAUNCH, launch_arguments)):
            page = pattern.sub(lambda block, content=content: block[1] + content() + block[2], page)  # type: ignore[misc]
        found[path] = page
    return found


def states() -> str:
    """Return the table of the controller's states: what each event leads to."""
    lines = ["| event | " + " | ".join(state.value for state in State) + " |", "|---" * (len(State) + 1) + "|"]
    for event in GoalEvent:
        cells = []
        for state in State:
            found = TABLE[state].get(event)
            parts = (
                [] if found is None else [found.state.value if found.state is not state else "", found.command.value]
            )
            answer = f"**{found.answer}**" if found is not None and found.answer else ""
            cells.append("; ".join(part for part in (*parts, answer) if part))
        lines.append(f"| {event.value} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def launch_arguments() -> str:
    """Return the table of the arguments of both launch files."""
    lines = ["| argument | default | values | meaning |", "|---|---|---|---|"]
    robot, simulation = ({one.name: one for one in arguments} for arguments in (ROBOT, SIMULATION))
    for name, one in (robot | simulation).items():
        defaults = dict.fromkeys(found[name].default for found in (robot, simulation) if name in found)
        default = " in the simulation, else ".join(f"`{text}`" for text in reversed(defaults) if text)
        only = "robot.launch.py only: " if name not in simulation else ""
        only = only or ("simulation.launch.py only: " if name not in robot else "")
        values = "number" if one.is_number else ", ".join(f"`{word}`" for word in one.choices)
        lines.append(f"| `{name}` | {default} | {values} | {only}{one.text} |")
    return "\n".join(lines)


def rules() -> str:
    """Return the rules of a contract: first those for the whole bag, then those for a topic."""
    parts = []
    for title, config in (("For the whole bag:", BagRules), ("For a topic:", TopicRules)):
        entries = [f"- `{one.name}`: {_meaning(one.spec)}" for one in parameters_of(config)]
        parts.append("\n".join([title, "", *entries]))
    return "\n\n".join(parts)


def _meaning(spec: Spec) -> str:
    choices = f": {' or '.join(spec.choices)}" if spec.choices else ""
    return spec.text + choices + (f" [{spec.unit}]" if spec.unit not in ("", "-") else "")


def main() -> int:
    """Write or check the pages; return 1 if a check finds a page out of date."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing, fail on a difference")
    parser.add_argument("--tables", action="store_true", help="leave out the tutorials")
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
