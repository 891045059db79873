"""Select topics by name and by regular expression, as rosbag2 does."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from diffbot_core.errors import InvalidValueError


class TopicSelection(NamedTuple):
    """Selection by name, or by a regular expression that matches the whole name.

    Without ``topics`` and ``regex``, all topics are selected. An exclusion takes precedence.
    """

    topics: Sequence[str] = ()
    regex: str = ""
    exclude_topics: Sequence[str] = ()
    exclude_regex: str = ""
    include_hidden_topics: bool = False

    def selects(self, topic: str) -> bool:
        """Return True if a topic, given by its absolute name, is selected."""
        if topic in self.exclude_topics or (self.exclude_regex and re.fullmatch(self.exclude_regex, topic)):
            return False
        if topic in self.topics:
            return True
        if is_hidden(topic) and not self.include_hidden_topics:
            return False
        if self.regex:
            return re.fullmatch(self.regex, topic) is not None
        return not self.topics


def selection_of(config: Any, namespace: str, include_hidden_topics: bool) -> TopicSelection:
    """Return the selection that the parameters of a node define; relative names are in the node's namespace."""
    return TopicSelection(
        [absolute(name, namespace) for name in config.topics],
        config.regex,
        [absolute(name, namespace) for name in config.exclude_topics],
        config.exclude_regex,
        include_hidden_topics,
    )


def check_regex(**patterns: str) -> None:
    """Raise InvalidValueError, naming the parameter, if a regular expression is invalid."""
    for name, pattern in patterns.items():
        try:
            re.compile(pattern)
        except re.error as error:
            raise InvalidValueError(name, pattern, f"a regular expression ({error})") from error


def is_hidden(name: str) -> bool:
    """Return True if a part of the name of a topic or node begins with an underscore."""
    return "/_" in f"/{name}"


def absolute(topic: str, namespace: str = "/") -> str:
    """Return the absolute form of a topic name that is given in a namespace."""
    return topic if topic.startswith("/") else f"{namespace.rstrip('/')}/{topic}"
