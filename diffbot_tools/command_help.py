"""Examples in the help of each command."""

from __future__ import annotations

import argparse
import textwrap

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
    "bag repair": ("bag repair run1 saved",),
    "report": ("report run1", "report run1 -o run1.html --csv"),
    "replay": ("replay run1", "replay run1 --rate 2 --start-paused"),
    "refilter": ("refilter run1 --params my_robot.yaml --out run1_again --compare /ground_truth",),
    "campaign": ("campaign --runs 500 --grid fix_delay=[0.0,0.2,0.4]", "campaign campaign.yaml --out out/mine"),
    "benchmark": ("benchmark switching --case nominal",),
    "benchmark switching": ("benchmark switching --law graceful --case nominal",),
    "benchmark localization": ("benchmark localization --runs 50",),
    "benchmark docking": ("benchmark docking --runs 170 --case docking_no_loss",),
    "benchmark tune": ("benchmark tune --law graceful --budget 120",),
    "experiment": ("experiment a b",),
    "stability": ("stability certify",),
    "stability certify": ("stability certify",),
    "stability adversary": ("stability adversary out/stability/certificate.json",),
    "stability verify": ("stability verify out/stability/certificate.json",),
    "stability contract": ("stability contract --runs 100",),
}
"""By the words of the command."""


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
