"""Selection of topics by name and regular expression, with rosbag2's defaults for hidden topics."""

from __future__ import annotations

import re
from typing import NamedTuple

from diffbot_core.errors import InvalidValueError


class TopicSelection(NamedTuple):
    """Topics by name and by regular expression of the whole name; if neither is given, all match. Exclusions win."""

    topics: tuple[str, ...] = ()
    regex: str = ""
    exclude_topics: tuple[str, ...] = ()
    exclude_regex: str = ""
    include_hidden_topics: bool = False

    def check(self) -> None:
        """Raise InvalidValueError if a regular expression is invalid."""
        for name in ("regex", "exclude_regex"):
            pattern = getattr(self, name)
            try:
                re.compile(pattern)
            except re.error as error:
                raise InvalidValueError(name, pattern, f"a regular expression ({error})") from error

    def selects(self, topic: str) -> bool:
        """Return whether a topic (absolute name) is selected.

        A hidden topic is selected only if it is named or ``include_hidden_topics`` is set.
        """
        if topic in self.exclude_topics:
            return False
        if self.exclude_regex and re.fullmatch(self.exclude_regex, topic):
            return False
        if topic in self.topics:
            return True
        if is_hidden(topic) and not self.include_hidden_topics:
            return False
        if self.regex:
            return re.fullmatch(self.regex, topic) is not None
        return not self.topics


def is_hidden(topic: str) -> bool:
    """Return whether a part of the name begins with an underscore."""
    return "/_" in f"/{topic}"


def absolute(topic: str, namespace: str = "/") -> str:
    """Return the absolute form of a topic name given in a namespace."""
    return topic if topic.startswith("/") else f"{namespace.rstrip('/')}/{topic}"
