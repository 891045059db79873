"""``diffbot refilter``: the filter over a bag; its estimates and innovations in a new bag."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from tqdm import tqdm

from diffbot_bag.bag.encoding import Encoder
from diffbot_bag.bag.new_bag import new_bag
from diffbot_bag.bag.reader import BagReader
from diffbot_control.ros.frames import robot_frame
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import shown
from diffbot_core.units import S_PER_NS
from diffbot_tools.bag.unfinished_bags import print_warning
from diffbot_tools.refilter.comparison import (
    consistency_of,
    describe_consistency,
    describe_figures,
    errors_of,
    figures_of,
    read_truth,
)
from diffbot_tools.refilter.filter_run import Answer, FilterRun, inputs_of
from diffbot_tools.refilter.output import OutputTopics
from diffbot_tools.refilter.parameters import read_config

PARAMETERS = "ekf.yaml"
"""Parameter file in the folder of a bag, for a bag without --params."""


def run(bag: Path, params: Path | None, out: Path, compare: str | None, remap: dict[str, str]) -> int:
    """Filter a bag, write the new one and print what was dropped, the consistency and, with ``compare``, the errors.

    Args:
        bag: folder, or an .mcap file.
        params: ROS parameter file; None for ``ekf.yaml`` in the folder of the bag.
        out: folder of the new bag.
        compare: topic of true poses in ``bag``.
        remap: topic in the bag for each of INPUTS that has another name there.

    Raises:
        DiffbotError: if a file or topic is missing, a parameter is not allowed, or ``out`` exists already.
    """
    if os.path.lexists(out):
        raise DiffbotError(f"{out} exists already: choose another name for the bag")
    check_exists(bag)
    config, text = read_config(parameter_file_of(bag) if params is None else params)
    with BagReader(bag) as reader:
        print_warning(reader)
        truth = None if compare is None else read_truth(reader, compare)
        with new_bag(out) as writer:
            (writer.folder / PARAMETERS).write_text(text, encoding="utf-8")
            topics = OutputTopics(writer, Encoder(), config.map_frame, robot_frame(config))
            estimates = []

            def write(answer: Answer, log_time: int) -> None:
                estimates.append(answer.estimate)
                topics.write(answer, log_time)
                topics.write_innovations(filtered.localization.innovations, log_time)

            filtered = filter_run(reader, config, remap)
            drive(filtered, reader, write)
    for (topic, kind), count in sorted(filtered.dropped.items()):
        print(f"{topic}: dropped {count}: {kind}")
    seconds = (estimates[-1].stamp - estimates[0].stamp) * S_PER_NS
    print(f"estimates             {len(estimates)} in {seconds:.1f} s")
    print(describe_consistency(consistency_of(filtered.localization.innovations)))
    if truth is not None:
        print(describe_figures(figures_of(errors_of(estimates, truth))))
    print(out)
    return 0


def filter_run(reader: BagReader, config: EkfNodeConfig, remap: dict[str, str]) -> FilterRun:
    """Return a filter for a bag; see :func:`topics_of`."""
    return FilterRun(config, topics_of(reader, config, remap))


def topics_of(reader: BagReader, config: EkfNodeConfig, remap: dict[str, str]) -> dict[str, str]:
    """Map the topics of a bag to :func:`inputs_of`; the further sources of fixes have to be in it, too.

    Raises:
        DiffbotError: if the bag has no odometry or source of fixes, a remapped topic is not in it, or one is of another
            type than the filter reads.
    """
    inputs = inputs_of(config)
    names = {name: "/" + name.lstrip("/") for name in inputs} | {
        name: "/" + topic.lstrip("/") for name, topic in remap.items()
    }
    found = reader.topics
    for name in (*remap, config.odometry_source, *config.localization.sources.pose_sources):
        if names[name] not in found:
            raise DiffbotError(
                f"{shown(reader.path)} has no topic {names[name]} for {name}: it has {shown(', '.join(sorted(found)))}"
            )
    for name, topic in names.items():
        if topic in found and found[topic].type != inputs[name]:
            kind = shown(found[topic].type)
            raise DiffbotError(f"{shown(reader.path)}: {topic} is of type {kind}, {name} must be {inputs[name]}")
    return {topic: name for name, topic in names.items() if topic in found}


def drive(filtered: FilterRun, reader: BagReader, on_answer: Callable[[Answer, int], None]) -> None:
    """Give the filter all messages in the order of their log times, with a progress bar on a terminal.

    Args:
        filtered: the filter.
        reader: the bag.
        on_answer: called with each answer and the log time [ns] of its odometry.

    Raises:
        DiffbotError: if the filter never started.
    """
    found = reader.topics
    total = sum(found[topic].message_count for topic in filtered.topics)
    messages = reader.decoded(filtered.topics)
    answers = 0
    for message in tqdm(messages, desc="refilter", total=total, unit="message", disable=None):
        answer = filtered.take(message)
        if answer is not None:
            answers += 1
            on_answer(answer, message.log_time)
    if not answers:
        reasons = "; ".join(f"{topic}: {kind} ({count})" for (topic, kind), count in filtered.dropped.most_common(3))
        raise DiffbotError(f"{reader.path}: no estimate: {reasons or 'no message'}")


def check_exists(bag: Path) -> None:
    """Refuse a bag that is not there, before anything else is looked for beside it.

    Raises:
        DiffbotError: if there is neither a folder nor a file.
    """
    if not bag.expanduser().exists():
        raise DiffbotError(f"no bag {bag}")


def parameter_file_of(bag: Path) -> Path:
    """Return the parameter file in the folder of a bag.

    Raises:
        DiffbotError: if there is none.
    """
    folder = bag.expanduser() if bag.is_dir() else bag.expanduser().parent
    path = folder / PARAMETERS
    if not path.is_file():
        raise DiffbotError(f"no {PARAMETERS} in {folder}: name a parameter file with --params")
    return path
