"""The command ``diffbot bag``: info, check, repair, trim, filter and merge."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diffbot_bag.topic_selection import TopicSelection, check_regex
from diffbot_core.errors import DiffbotError, shown
from diffbot_core.files import json_text
from diffbot_tools.bag.times import FORMS, parse_duration, parse_time, resolve_time

if TYPE_CHECKING:
    from diffbot_bag.bag import MergedBags

_BAG = "folder of the bag, or an .mcap file"


def add_bag(commands: Any) -> None:
    """Add ``diffbot bag`` to the subparsers of the command line."""
    bag = commands.add_parser("bag", help="inspect, check, cut, merge and repair bags (docs/reference/bags.md)")
    verbs = bag.add_subparsers(required=True, metavar="VERB", dest="verb")
    for add in (_add_info, _add_check, _add_repair, _add_trim, _add_filter, _add_merge):
        add(verbs)


def _add_info(verbs: Any) -> None:
    info = verbs.add_parser("info", help="show files, times and topics, with rates, gaps, losses and latencies")
    info.add_argument("bag", type=Path, help=_BAG)
    info.add_argument("--quick", action="store_true", help="read only the index, without figures of topics")
    info.add_argument("--json", action="store_true", help="print JSON (docs/reference/bags.md)")
    info.set_defaults(call=_info)


def _info(options: argparse.Namespace) -> int:
    from diffbot_bag.info import info_as_plain, info_of  # noqa: PLC0415 - only the called command is imported
    from diffbot_tools.bag.info_text import info_text  # noqa: PLC0415
    from diffbot_tools.opened_bag import open_bag  # noqa: PLC0415

    with open_bag(options.bag, decodes=False) as reader, _bar("info", reader.message_count) as progress:
        info = info_of(reader, quick=options.quick, progress=progress)
    print(json_text(info_as_plain(info)) if options.json else info_text(info))
    return 0


def _add_check(verbs: Any) -> None:
    check = verbs.add_parser(
        "check",
        help="check a bag against a contract: topics, rates, gaps ...",
        epilog="exit status: 0 if all rules hold, 1 if not, 2 if the bag or the contract cannot be read",
    )
    check.add_argument("bag", type=Path, help=_BAG)
    check.add_argument(
        "contract", type=Path, metavar="CONTRACT.yaml", help="rules for the bag (docs/reference/bag-check.md)"
    )
    check.add_argument("--json", action="store_true", help="print the results as JSON")
    # Status 1 means that a rule does not hold.
    check.set_defaults(call=_check, error_status=2)


def _check(options: argparse.Namespace) -> int:
    from diffbot_bag.check import check_bag, read_contract  # noqa: PLC0415 - only the called command is imported
    from diffbot_bag.info import info_of  # noqa: PLC0415
    from diffbot_tools.bag.consistency import nis_shares  # noqa: PLC0415
    from diffbot_tools.opened_bag import open_bag  # noqa: PLC0415

    contract = read_contract(options.contract)
    with open_bag(options.bag, decodes=False) as reader, _bar("check", reader.message_count) as progress:
        names = [name for name, rules in contract.topics.items() if "min_nis_inside" in rules]
        results = check_bag(contract, info_of(reader, progress=progress), nis_shares(reader, names))
    failed = sum(not result.passed for result in results)
    if options.json:
        plain = {
            "schema_version": 1,
            "bag": str(options.bag),
            "contract": str(options.contract),
            "passed": not failed,
            "results": [result._asdict() for result in results],
        }
        print(json_text(plain))
    else:
        print(*(result.line() for result in results), f"{len(results) - failed} of {len(results)} rules hold", sep="\n")
    return 1 if failed else 0


def _add_repair(verbs: Any) -> None:
    repair = verbs.add_parser("repair", help="write the intact messages of a damaged or unfinished bag to a new bag")
    _add_paths(repair)
    repair.set_defaults(call=_repair)


def _repair(options: argparse.Namespace) -> int:
    from diffbot_bag.repair import repair_bag  # noqa: PLC0415 - only the called command is imported
    from diffbot_tools.bag.info_text import repair_text  # noqa: PLC0415

    with _bar("repair", unit="B") as progress:
        repaired = repair_bag(options.bag, options.out, progress)
    print(repair_text(options.out, repaired))
    return 0


def _add_trim(verbs: Any) -> None:
    trim = verbs.add_parser("trim", help="write a span of time of a bag to a new bag")
    _add_paths(trim)
    trim.add_argument("--from", dest="begin", type=parse_time, metavar="TIME", help=f"earliest log time ({FORMS})")
    trim.add_argument("--to", dest="end", type=parse_time, metavar="TIME", help="log time at which the new bag ends")
    trim.add_argument(
        "--last", type=parse_duration, metavar="DURATION", help="duration to keep at the end of the bag, e.g. 30s"
    )
    trim.add_argument(
        "--no-latched",
        dest="latched",
        action="store_false",
        help="do not copy the messages of latched topics from before --from",
    )
    trim.set_defaults(call=_trim, parser=trim)


def _trim(options: argparse.Namespace) -> int:
    begin_time, end_time = options.begin, options.end
    if options.last is not None:
        if begin_time or end_time:
            options.parser.error("--last cannot be combined with --from or --to")
        begin_time = ("end", -options.last)
    elif not begin_time and not end_time:
        options.parser.error("give at least one of --from, --to and --last")

    with _open_bags([options.bag]) as bags:
        start = resolve_time(begin_time, bags.start, bags.end) if begin_time else bags.start
        end = resolve_time(end_time, bags.start, bags.end) if end_time else bags.end + 1
        if start >= end or start > bags.end or end <= bags.start:
            span = f"{bags.start * 1e-9:.9f} to {bags.end * 1e-9:.9f} s since 1970"
            raise DiffbotError(f"--from, --to: must select a part of the bag, which lasts from {span}")
        return _cut(bags, options.out, start=start if start > bags.start else None, end=end, latched=options.latched)


def _add_filter(verbs: Any) -> None:
    select = verbs.add_parser("filter", help="write selected topics of a bag to a new bag")
    _add_paths(select)
    select.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="topics to keep")
    select.add_argument("--regex", default="", help="also keep topics whose whole name matches")
    select.add_argument("--exclude", nargs="+", default=[], metavar="TOPIC", help="topics to exclude")
    select.add_argument("--exclude-regex", default="", metavar="REGEX", help="exclude topics whose whole name matches")
    select.add_argument(
        "--types", nargs="+", default=[], metavar="TYPE", help="keep only topics of these types, e.g. nav_msgs/msg/Path"
    )
    select.set_defaults(call=_filter, parser=select)


def _filter(options: argparse.Namespace) -> int:
    selection = TopicSelection(
        topics=tuple(options.topics),
        regex=options.regex,
        exclude_topics=tuple(options.exclude),
        exclude_regex=options.exclude_regex,
        include_hidden_topics=True,
    )
    if selection == TopicSelection(include_hidden_topics=True) and not options.types:
        options.parser.error("give at least one of --topics, --regex, --exclude, --exclude-regex and --types")
    check_regex(regex=options.regex, exclude_regex=options.exclude_regex)
    types = options.types
    with _open_bags([options.bag]) as bags:
        known = {*bags.topics, *(topic.type for topic in bags.topics.values())}
        if missing := [name for name in (*options.topics, *options.exclude, *types) if name not in known]:
            raise DiffbotError(shown(f"{missing[0]} is not in the bag, which contains {', '.join(sorted(known))}"))
        return _cut(
            bags,
            options.out,
            keep=lambda topic: selection.selects(topic.name) and (not types or topic.type in types),
        )


def _add_merge(verbs: Any) -> None:
    merge = verbs.add_parser("merge", help="merge several bags into a new bag, in the order of log time")
    merge.add_argument("bags", type=Path, nargs="+", metavar="IN", help="folders of bags, or .mcap files; two or more")
    merge.add_argument("out", type=Path, metavar="OUT", help="folder of the new bag, which must not exist")
    merge.set_defaults(call=_merge, parser=merge)


def _merge(options: argparse.Namespace) -> int:
    if len(options.bags) < 2:
        options.parser.error("give at least two bags and the name of the new bag")
    with _open_bags(options.bags) as bags:
        return _cut(bags, options.out)


def _add_paths(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bag", type=Path, metavar="IN", help=_BAG)
    parser.add_argument("out", type=Path, metavar="OUT", help="folder of the new bag, which must not exist")


@contextmanager
def _open_bags(paths: Sequence[Path]) -> Iterator[MergedBags]:
    from diffbot_bag.bag import MergedBags  # noqa: PLC0415 - only the called command is imported

    with closing(MergedBags(paths)) as bags:
        for warning in bags.warnings:
            print(f"diffbot: warning: {warning}", file=sys.stderr)
        yield bags


def _cut(bags: MergedBags, out: Path, **options: Any) -> int:
    from diffbot_bag.cut import cut  # noqa: PLC0415 - only the called command is imported

    with _bar(out.name) as progress:
        written = cut(bags, out, progress=progress, **options)
    seconds = written.duration * 1e-9
    print(f"{out}: {written.message_count} messages of {len(written.topics)} topics, {seconds:.3f} s")
    return 0


@contextmanager
def _bar(name: str, total: int | None = None, unit: str = "message") -> Iterator[Callable[[int], None]]:
    """Show a progress bar on a terminal if the work takes longer than a second; yield its update function."""
    from tqdm import tqdm  # noqa: PLC0415 - only the called command is imported

    with tqdm(desc=name, total=total, unit=unit, unit_scale=True, disable=None, delay=1.0, leave=False) as bar:
        yield bar.update
