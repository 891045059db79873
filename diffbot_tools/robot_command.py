"""The command ``diffbot robot``: describe a robot, check the description, drive the robot in the simulation."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.files import write_text
from diffbot_core.schema import Parameter, build, checked, parameters_of
from diffbot_tools.arguments import MAX_SEED, add_flags, whole, yaml_value
from diffbot_tools.robot_description import PRESETS, RobotDescription, file_of_robot

_YES_NO = {"y": True, "yes": True, "n": False, "no": False}


def add_robot(commands: Any) -> None:
    """Add ``diffbot robot`` to the subparsers of the command line."""
    robot = commands.add_parser("robot", help="describe your own robot, check it, drive it in the simulation")
    verbs = robot.add_subparsers(required=True, metavar="VERB")
    new = verbs.add_parser("new", help="write the parameter file of a robot; ask for the values that are not given")
    new.add_argument("out", type=Path, metavar="FILE", help="parameter file to write, which must not exist")
    new.add_argument("--like", choices=tuple(PRESETS), help="use the values of this robot instead of asking")
    add_flags(new, RobotDescription)
    new.set_defaults(call=_new)
    check = verbs.add_parser(
        "check",
        help="check a description by simulated drives; status 1 if it is incomplete or contradictory, or misses a goal",
    )
    drive = verbs.add_parser(
        "drive", help="simulate drives to random goals, far and near; status 3 if a goal is not reached"
    )
    for one in (check, drive):
        one.add_argument("robot", help=f"parameter file, or one of {', '.join(PRESETS)}")
    drive.add_argument("--goals", type=whole(1, 10_000), default=20, help="number of goals (default: %(default)s)")
    drive.add_argument(
        "--seed", type=whole(0, MAX_SEED), default=1, help="seed of goals and noise (default: %(default)s)"
    )
    drive.add_argument(
        "--out", type=Path, default=Path("out/robot/drives.png"), help="file of the picture (default: %(default)s)"
    )
    check.set_defaults(call=_check)
    drive.set_defaults(call=_drive)


def _new(options: argparse.Namespace) -> int:
    path = options.out
    if path.exists():
        raise DiffbotError(f"{path} already exists: choose another name")
    parameters = parameters_of(RobotDescription)
    given = {one.name: getattr(options, one.name) for one in parameters if hasattr(options, one.name)}
    base = PRESETS.get(options.like, RobotDescription())
    build(RobotDescription, given, base)  # refuse a bad value before the first question
    if options.like is None:
        missing = [one for one in parameters if one.name not in given]
        if missing and not sys.stdin.isatty():
            flags = ", ".join("--" + one.name.replace("_", "-").replace(".", "-") for one in missing)
            raise DiffbotError(f"robot new cannot ask, since its input is not a terminal: give --like, or {flags}")
        given |= _ask(missing)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, file_of_robot(build(RobotDescription, given, base), path.name))
    except OSError as error:
        raise DiffbotError(f"cannot write to {path}: {error.strerror}") from None
    print(f"{path}\nNext: diffbot robot check {path}, then diffbot robot drive {path}")
    return 0


def _ask(parameters: list[Parameter]) -> dict[str, Any]:
    print("Press Return for the value in brackets, ? for an explanation, or Ctrl-C to end without a file.")
    values: dict[str, Any] = {}
    for one in parameters:
        unit = "" if one.spec.unit == "-" else f" [{one.spec.unit}]"
        default = "ny"[one.default] if one.type is bool else one.default
        while one.name not in values:
            try:
                text = input(f"{one.spec.text}{unit} ({default}): ").strip()
                if text == "?":
                    print(f"  {_explanation(one, default)}")
                else:
                    values[one.name] = _answer(one, text) if text else one.default
            except EOFError:
                raise DiffbotError(f"robot new: the input ended before {one.name} was given") from None
            except (DiffbotError, argparse.ArgumentTypeError) as error:
                print(f"  {error}")
    return values


def _explanation(parameter: Parameter, default: Any) -> str:
    """Return the meaning, the unit, the range and the default of a parameter in words."""
    spec = parameter.spec
    if parameter.type is bool:
        return f"{parameter.name}: y if the robot has {spec.text}, n if not; Return answers {default}"
    unit = "" if spec.unit == "-" else f" in {spec.unit}"
    return f"{parameter.name}: {spec.text}{unit}, {spec.bound()}; Return keeps {default}, the value of a small robot"


def _answer(parameter: Parameter, text: str) -> Any:
    if parameter.type is not bool:
        return checked(parameter, yaml_value(text))
    if text.lower() not in _YES_NO:
        raise InvalidValueError(parameter.name, text, "y or n")
    return _YES_NO[text.lower()]


def _check(options: argparse.Namespace) -> int:
    from diffbot_tools.robot import read_robot  # noqa: PLC0415 - only the called command is loaded
    from diffbot_tools.robot_trial import check  # noqa: PLC0415

    return check(read_robot(options.robot))


def _drive(options: argparse.Namespace) -> int:
    from tqdm import tqdm  # noqa: PLC0415

    from diffbot_tools.robot import read_robot  # noqa: PLC0415
    from diffbot_tools.robot_trial import save_picture, summary, trials  # noqa: PLC0415

    robot = read_robot(options.robot)
    drives = trials(robot, options.goals, options.seed)
    found = list(tqdm(drives, total=options.goals, unit="goal", leave=False, disable=None, file=sys.stderr))
    print(summary(robot, found))
    try:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        save_picture(found, options.out)
    except (OSError, ValueError) as error:  # ValueError: a suffix that matplotlib cannot write
        raise DiffbotError(f"cannot write to {options.out}: {getattr(error, 'strerror', error)}") from None
    print(f"picture {options.out}")
    return 0 if all(drive.is_reached for _, drive in found) else 3
