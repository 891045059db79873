"""Trim, filter and merge bags: write selected messages of one or several bags to a new bag."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from diffbot_bag.bag import PARAMETERS, MergedBags
from diffbot_bag.metadata import LOST, BagMetadata, Topic, losses_of, without_losses
from diffbot_bag.metadata import read as read_metadata
from diffbot_bag.writer import new_bag
from diffbot_core.errors import DiffbotError, shown


def cut(
    bags: MergedBags,
    output: Path,
    *,
    start: int | None = None,
    end: int | None = None,
    keep: Callable[[Topic], bool] = lambda _: True,
    latched: bool = True,
    progress: Callable[[int], None] = lambda _: None,
) -> BagMetadata:
    """Write the messages with ``start <= log time < end`` to a new bag, in the order of log time.

    The parameters of the nodes are copied, too, and the numbers of lost messages are added up if all bags have them.

    Args:
        bags: open bags; for equal log times, messages of an earlier bag come first.
        output: folder of the new bag, which must not exist. It appears when the bag is complete.
        start: [ns] earliest log time; None: the log time of the first message.
        end: [ns] log time before which the new bag ends; None: include the last message.
        keep: returns True for a topic to keep.
        latched: begin with the last messages of latched topics before ``start``, with ``start`` as their log time.
        progress: called with 1 for each message.

    Raises:
        DiffbotError: if ``keep`` does not select any topic, the bags have different definitions of its type, a bag is
            damaged, or the new bag cannot be written.
    """
    topics = {name: topic for name, topic in bags.topics.items() if keep(topic)}
    if not topics:
        raise DiffbotError(shown(f"no topic of the bag is selected: select from {', '.join(bags.topics)}"))
    _check_definitions(bags, topics)
    with new_bag(output) as writer:
        channels = {}
        for name, topic in topics.items():
            schema = next(reader.schemas[name] for reader in bags.readers if name in reader.topics)
            channels[name] = writer.add_topic(
                name, topic.type, topic.qos, topic.type_hash, encoding=topic.encoding, schema=schema
            )
        parameters = {node: values for reader in bags.readers for node, values in reader.node_parameters().items()}
        if parameters:
            writer.attach(PARAMETERS, "application/json", json.dumps(parameters, indent=1).encode())
        if latched and start is not None:
            latched_topics = [name for name, topic in topics.items() if any(qos.is_latched for qos in topic.qos)]
            for message in bags.latched_before(start, latched_topics):
                writer.write(channels[message.topic], message.data, start, message.publish_time, message.sequence)
        last = None if end is None else end - 1
        for name, data, log_time, publish_time, sequence in bags.messages(topics, start, last):
            writer.write(channels[name], data, log_time, publish_time, sequence)
            progress(1)
        writer.custom_data = _join_custom_data([reader.custom_data for reader in bags.readers])
    return read_metadata(output)


def _check_definitions(bags: MergedBags, topics: Mapping[str, Topic]) -> None:
    """Refuse bags with different definitions of a type: with the one of the new bag, some messages cannot be read."""
    for name, topic in topics.items():
        hashes = {reader.topics[name].type_hash for reader in bags.readers if name in reader.topics}
        if len(hashes - {""}) > 1:
            raise DiffbotError(shown(f"{name}: the bags were recorded with different definitions of {topic.type}"))


def _join_custom_data(all_data: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Join the custom data of several bags: numbers of lost messages are added, other values are listed."""
    lost, losses = Counter[str](), [losses_of(data) for data in all_data]
    for one in losses:
        lost.update(one)
    joined = {name: str(count) for name, count in lost.items()} if all(LOST in one for one in losses) else {}
    others = [without_losses(data) for data in all_data]
    for name in dict.fromkeys(name for data in others for name in data):
        joined[name] = ", ".join(dict.fromkeys(data[name] for data in others if name in data))
    return joined
