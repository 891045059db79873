"""``diffbot bag repair``: a complete bag of everything that is intact in a truncated, unfinished or damaged one."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diffbot_bag.mcap.format import MAX_TIME
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import shown
from diffbot_core.units import S_PER_NS

if TYPE_CHECKING:
    from diffbot_bag.tools.loss import Loss, Span
    from diffbot_bag.tools.repair import Repaired

MAX_SPANS = 10
"""Spans of time that are listed for a file; the others are counted."""


def add_repair(verbs: Any) -> None:
    """Add ``diffbot bag repair`` to the subparsers of ``diffbot bag``."""
    repair = verbs.add_parser("repair", help="save what is intact of a truncated, unfinished or damaged bag")
    repair.add_argument("bag", type=Path, metavar="IN", help="folder of the bag, or an .mcap file")
    repair.add_argument("out", type=Path, metavar="OUT", nargs="?", help="folder of the new bag, which must not exist")
    repair.add_argument("--in-place", action="store_true", help="replace the files of IN instead")
    repair.set_defaults(call=_call)


def _call(options: argparse.Namespace) -> int:
    # Only the called command loads what it needs.
    from tqdm import tqdm  # noqa: PLC0415

    from diffbot_bag.tools.repair import PASSES, repair_bag, repair_in_place, size_of  # noqa: PLC0415

    bag, out = options.bag, options.out
    if (out is None) != options.in_place:
        raise DiffbotError("bag repair: either OUT or --in-place must be given")
    total = PASSES * size_of(bag)
    with tqdm(desc=bag.name, total=total, unit="B", unit_scale=True, unit_divisor=1024, disable=None, delay=1.0) as bar:
        progress = bar.update
        if options.in_place:
            repaired = repair_in_place(bag, progress=progress)
        else:
            repaired = repair_bag(bag, out, progress=progress)
    print(repair_text(repaired))
    return 0


def repair_text(repaired: Repaired) -> str:
    """Return what was saved and what was lost, in lines of plain text."""
    duration = (repaired.end - repaired.start) * S_PER_NS
    topics = sum(topic.message_count > 0 for topic in repaired.topics.values())
    lines = [f"{shown(repaired.path)}: {repaired.message_count} messages of {topics} topics in {duration:.3f} s"]
    if repaired.note:
        lines.append(f"written anew: {repaired.note}")
    lines += [f"lost: the whole file {shown(name)}, which is missing" for name in repaired.missing]
    for file in repaired.files:
        lines += [f"{shown(file.source.name)}: {line}" for line in _loss_lines(file.salvaged.loss, repaired.start)]
    if not repaired.missing and not any(_is_lossy(file.salvaged.loss) for file in repaired.files):
        lines.append("nothing that was written is lost")
    return "\n".join(lines)


def _is_lossy(loss: Loss) -> bool:
    return bool(loss.bytes or loss.messages or loss.beyond or loss.doubtful or loss.without_qos or loss.unknown)


def _loss_lines(loss: Loss, start: int) -> list[str]:
    """Return one line for each thing that is missing of a file; times are counted from ``start`` [ns]."""
    lines = []
    if loss.is_cut:
        lines.append("had no valid index, since it was cut off, not finished or damaged at its end")
    if loss.bytes:
        chunks = f"{loss.chunks} damaged chunk{'s' if loss.chunks > 1 else ''}, " if loss.chunks else ""
        lines.append(f"lost: {chunks}{loss.bytes} bytes that cannot be read")
    if loss.messages:
        topics = shown(", ".join(f"{topic} {count}" for topic, count in sorted(loss.messages.items())))
        total = sum(loss.messages.values())
        lines.append(f"lost: {'' if loss.is_exact else 'at least '}{total} messages ({topics})")
    lines += [f"lost: messages {_span_text(span, start)}" for span in loss.spans[:MAX_SPANS]]
    if len(loss.spans) > MAX_SPANS:
        lines.append(f"lost: messages in {len(loss.spans) - MAX_SPANS} more spans of time")
    if loss.unverified:
        lines.append(f"{loss.unverified} messages are from the incomplete last chunk, which no checksum verifies")
    if loss.beyond:
        lines.append(f"left out: {loss.beyond} messages with a log time beyond {MAX_TIME} ns")
    if loss.doubtful:
        lines.append(f"names and types from a damaged chunk, check them: {shown(', '.join(loss.doubtful))}")
    if loss.without_qos:
        lines.append(f"their QoS cannot be read and is left out: {shown(', '.join(loss.without_qos))}")
    if loss.unknown:
        lines.append(f"nothing describes their topics or types any more: {shown(', '.join(loss.unknown))}")
    return lines


def _span_text(span: Span, start: int) -> str:
    ends = [None if time is None else f"{(time - start) * S_PER_NS:.3f} s" for time in span]
    if ends[0] and ends[1]:
        return f"between {ends[0]} and {ends[1]}"
    if ends[0]:
        return f"after {ends[0]}"
    return f"before {ends[1]}" if ends[1] else "at an unknown time"
