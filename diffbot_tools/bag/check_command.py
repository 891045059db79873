"""``diffbot bag check``: a bag against its contract, with an exit status for CI."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diffbot_core.errors import DiffbotError

if TYPE_CHECKING:
    from diffbot_bag.tools.bag_info import BagInfo
    from diffbot_bag.tools.contract_check import Consistency, Result

_HELP = """\
exit status: 0 if every rule holds, 1 if one does not, 2 for a bag or contract that cannot be read and for wrong usage
"""


def add_check(verbs: Any) -> None:
    """Add ``diffbot bag check`` to the subparsers of ``diffbot bag``."""
    check = verbs.add_parser("check", help="compare a bag with a contract of topics, rates, gaps ...", epilog=_HELP)
    check.add_argument("bag", type=Path, help="folder of the bag, or an .mcap file")
    check.add_argument(
        "contract", type=Path, nargs="?", metavar="CONTRACT.yaml", help="its rules (docs/reference/bag-check.md)"
    )
    check.add_argument("--write", type=Path, metavar="NEW.yaml", help="draft a contract from a good bag instead")
    check.add_argument("--json", action="store_true", help="print the results as JSON")
    # 1 means that a rule does not hold.
    check.set_defaults(call=_call, error_status=2)


def _call(options: argparse.Namespace) -> int:
    if (options.contract is None) == (options.write is None):
        raise DiffbotError("bag check takes a CONTRACT.yaml to check with, or --write to draft one")
    if options.write is not None:
        if options.json:
            raise DiffbotError("--json shows the results of a check: not together with --write")
        return _write(options.bag, options.write)
    return _check(options)


def _check(options: argparse.Namespace) -> int:
    from diffbot_bag.tools.contract import read_contract  # noqa: PLC0415 - only the called command is imported
    from diffbot_bag.tools.contract_check import check_bag  # noqa: PLC0415

    contract = read_contract(options.contract.expanduser())
    results = check_bag(contract, *_measure(options.bag))
    failed = sum(not one.passed for one in results)
    if options.json:
        json.dump(results_as_plain(options.bag, options.contract, results), sys.stdout, indent=1)
        print()
    else:
        for one in results:
            print(one.line())
        print(f"{len(results) - failed} of {len(results)} rules hold")
    return 1 if failed else 0


def _measure(bag: Path) -> tuple[BagInfo, dict[str, Consistency]]:
    from diffbot_bag.tools.bag_info import read_info  # noqa: PLC0415
    from diffbot_tools.bag.consistency import observers_for  # noqa: PLC0415
    from diffbot_tools.bag.info_command import read_with_bar  # noqa: PLC0415

    observers = observers_for({topic.name: topic.type for topic in read_info(bag, quick=True).topics})
    info = read_with_bar(bag, observers={name: one.add for name, one in observers.items()})
    return info, {name: one.result() for name, one in observers.items()}


def results_as_plain(bag: Path, contract: Path, results: list[Result]) -> dict[str, Any]:
    """Return the content of ``--json``; docs/reference/bag-check.md describes it."""
    return {
        "schema_version": 1,
        "bag": str(bag),
        "contract": str(contract),
        "passed": all(one.passed for one in results),
        "results": [one._asdict() for one in results],
    }


def _write(bag: Path, path: Path) -> int:
    from diffbot_bag.tools.contract_draft import draft_contract  # noqa: PLC0415
    from diffbot_core.files import write_text  # noqa: PLC0415

    path = path.expanduser()
    if path.exists() or path.is_symlink():
        raise DiffbotError(f"{path} exists already: choose another name for the contract")
    text = draft_contract(*_measure(bag))
    try:
        write_text(path, text)
    except OSError as error:
        raise DiffbotError(f"cannot write {path}: {error.strerror}") from error
    print(path)
    return 0
