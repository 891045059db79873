"""Schemas of the types in one bag, numbered in the order in which they appear."""

from __future__ import annotations

from mcap.records import Schema
from mcap.well_known import SchemaEncoding

from diffbot_bag.bag.message_definitions import DefinitionNotFoundError, MessageDefinitions


class Schemas:
    """Schemas made from the installed definitions; one without any where a type has none."""

    def __init__(self, definitions: MessageDefinitions) -> None:
        """Start without a type."""
        self._definitions = definitions
        self._numbers: dict[str, int] = {}

    def add(self, type_name: str) -> tuple[int, Schema | None]:
        """Return the number of a type's schema, and the schema itself if the type is new."""
        if type_name in self._numbers:
            return self._numbers[type_name], None
        number = self._numbers[type_name] = len(self._numbers) + 1
        try:
            text = self._definitions.schema_text(type_name).encode()
        except DefinitionNotFoundError:
            return number, Schema(id=number, name=type_name, encoding=SchemaEncoding.SelfDescribing, data=b"")
        return number, Schema(id=number, name=type_name, encoding=SchemaEncoding.ROS2, data=text)

    def type_hash(self, type_name: str) -> str:
        """Return the hash of the installed type; empty if there is none."""
        try:
            return self._definitions.type_hash(type_name)
        except DefinitionNotFoundError:
            return ""
