"""Help of the command line: groups of commands, an example of each, and what a misspelt word may have meant."""

from __future__ import annotations

import argparse
import textwrap
from importlib.metadata import version
from typing import Any

from diffbot_core.distribution import DISTRIBUTION
from diffbot_core.errors import known_name

GROUPS = {
    "Drive": ("demo", "run", "goal", "watch"),
    "Your robot": ("robot", "calibrate"),
    "Bags": ("bag", "report", "replay", "refilter", "import"),
    "Studies": ("campaign", "benchmark", "experiment", "stability"),
}
"""Commands that belong together; all others are further ones."""
EXAMPLES: dict[str, tuple[str, ...]] = {
    "demo": ("demo", "demo --watch"),
    "run": ("run robot --with plant recorder", "run robot --ros-args --params-file my_robot.yaml"),
    "goal": ("goal 2 1 1.57", "goal 0.5 0 0 --namespace robot1 --timeout 60"),
    "dock": ("dock", "dock 3 1 0.5", "dock 3 1 0.5 --backward"),
    "undock": ("undock", "undock --distance 1"),
    "watch": ("watch --open", "watch --namespace robot1 robot2 --record bags"),
    "robot": ("robot new my_robot.yaml", "robot drive turtlebot4"),
    "robot new": ("robot new my_robot.yaml", "robot new agv.yaml --like warehouse_agv --max-velocity 0.8"),
    "robot check": ("robot check my_robot.yaml",),
    "robot drive": ("robot drive my_robot.yaml", "robot drive turtlebot3_burger --goals 50 --out burger.png"),
    "calibrate": ("calibrate first_drive --params my_robot.yaml --out calibrated.yaml",),
    "bag": ("bag info run1",),
    "bag info": ("bag info run1", "bag info run1 --json"),
    "bag check": ("bag check run1 contract.yaml", "bag check run1 --write contract.yaml"),
    "bag trim": ("bag trim run1 part --from 10s --to 20s",),
    "bag filter": ("bag filter run1 poses --topics /pose /odom",),
    "bag merge": ("bag merge run1 run2 both",),
    "bag split": ("bag split run1 pieces --duration 60s",),
    "bag repair": ("bag repair run1 saved",),
    "report": ("report run1", "report run1 -o run1.html --csv"),
    "replay": ("replay run1", "replay run1 --rate 2 --start-paused"),
    "refilter": ("refilter run1 --params my_robot.yaml --out run1_again --compare /ground_truth",),
    "import": ("import mrclam MRCLAM_Dataset1 --robot 3 --out mrclam_1_3",),
    "import mrclam": ("import mrclam MRCLAM_Dataset1 --robot 3 --out mrclam_1_3",),
    "import labyrinth": ("import labyrinth Labyrinth --out labyrinth",),
    "campaign": ("campaign --runs 500 --grid fix_delay=[0.0,0.2,0.4]", "campaign campaign.yaml --out out/mine"),
    "benchmark": ("benchmark --law polar --case nominal", "benchmark localization --runs 50"),
    "experiment": ("experiment a b",),
    "stability": ("stability certify",),
    "stability certify": ("stability certify",),
    "stability adversary": ("stability adversary out/stability/certificate.json",),
    "stability verify": ("stability verify out/stability/certificate.json",),
    "stability contract": ("stability contract --runs 100",),
    "interfaces": ("interfaces build",),
    "interfaces build": ("interfaces build",),
    "completion": ("completion bash >> ~/.bashrc", "completion zsh >> ~/.zshrc"),
}
"""By the words of the command; the first example of a group's command stands in the help of all."""


class CommandParser(argparse.ArgumentParser):
    """Says what a misspelt command or choice may have meant."""

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(
                action, f"{value!r}: must be {known_name(str(value), map(str, action.choices))}"
            )


class TopParser(CommandParser):
    """The parser of ``diffbot``: its help shows the commands in groups."""

    def __init__(self) -> None:
        """Make the parser without commands."""
        super().__init__(prog="diffbot", description="Go-to-pose stack for differential-drive robots.")
        self.add_argument("--version", action="version", version=f"%(prog)s {version(DISTRIBUTION)}")
        self.commands = self.add_subparsers(metavar="COMMAND", parser_class=CommandParser)

    def format_help(self) -> str:
        """Return usage, the commands in their groups, and an example of each group."""
        texts = {one.dest: one.help or "" for one in self.commands._get_subactions()}
        grouped = {name for names in GROUPS.values() for name in names}
        groups = {**GROUPS, "Further": tuple(name for name in texts if name not in grouped)}
        lines = [
            "usage: diffbot COMMAND ...    diffbot COMMAND --help    diffbot --version",
            "",
            self.description or "",
        ]
        for title, names in groups.items():
            present = [name for name in names if name in texts]
            examples = [EXAMPLES[name][0] for name in present[:1] if name in EXAMPLES]
            lines += ["", *(f"{title}, e.g.  diffbot {one}" for one in examples)] if present else []
            lines += [f"  {name:<12}{texts[name]}" for name in present]
        return "\n".join(lines) + "\n"


def add_examples(parser: argparse.ArgumentParser, words: tuple[str, ...] = ()) -> None:
    """Put the examples into the help of every command below ``parser``."""
    below = [one.choices for one in parser._actions if isinstance(one, argparse._SubParsersAction)]
    for name, command in (pair for choices in below for pair in choices.items()):
        here = (*words, name)
        if examples := EXAMPLES.get(" ".join(here)):
            text = "\n  diffbot ".join(("examples:", *examples))
            command.epilog = "\n\n".join(part for part in (textwrap.fill(command.epilog or "", 100), text) if part)
            command.description = textwrap.fill(command.description or "", 100)
            command.formatter_class = argparse.RawDescriptionHelpFormatter
        add_examples(command, here)
