"""Encode and decode CDR messages with rosbags, without ROS.

A decoded message has its fields as attributes, such as ``message.header.stamp.sec``. Arrays of numbers are NumPy
arrays.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from diffbot_bag.definitions import schema_text
from diffbot_core.errors import DiffbotError, shown

_shared = Typestore()
"""Types of all definitions that do not contradict each other, so that nested types are compiled once."""


@functools.cache
def _jazzy() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


@functools.lru_cache(maxsize=1024)
def _store(type_name: str, definition: str | None) -> Typestore:
    """Return a typestore with the type; without a definition, it is from ROS 2 Jazzy or an installed package."""
    if definition is None:
        if type_name in _jazzy().types:
            return _jazzy()
        definition = schema_text(type_name)
    try:
        types = get_types_from_msg(definition, type_name)
        try:
            _shared.register(types)
            store = _shared
        except TypesysError:  # another bag defines a different type with this name
            store = Typestore()
            store.register(types)
        store.get_msgdef(type_name)
    except Exception as error:  # the parser and the generated code raise errors of many types
        raise DiffbotError(f"the definition of {shown(type_name)} cannot be parsed") from error
    return store


def decode(type_name: str, data: bytes, definition: str | None = None) -> Any:
    """Decode a message.

    Args:
        type_name: ``pkg/msg/Type``.
        data: CDR bytes with encapsulation header.
        definition: .msg text of the type from a bag; None: the type of ROS 2 Jazzy or of an installed package.

    Raises:
        DiffbotError: if the definition is missing or invalid, or the bytes are not a message of this type.
    """
    store = _store(type_name, definition)
    try:
        return store.deserialize_cdr(data, type_name)
    except Exception as error:  # struct.error, IndexError, MemoryError ... of the generated code
        raise DiffbotError(f"cannot decode {len(data)} bytes as {shown(type_name)}") from error


def encode(type_name: str, message: Any) -> bytes:
    """Encode a message, whose fields are attributes, as CDR bytes.

    Raises:
        DiffbotError: if the definition is missing, or the message is not of this type.
    """
    store = _store(type_name, None)
    try:
        return bytes(store.serialize_cdr(message, type_name))
    except Exception as error:  # AttributeError, struct.error ... of the generated code
        raise DiffbotError(f"cannot encode the message as {shown(type_name)}: {shown(error)}") from error


def make(type_name: str, /, **fields: Any) -> Any:
    """Create a message. Fields that are not given are zero, empty or false.

    Args:
        type_name: ``pkg/msg/Type`` of ROS 2 Jazzy or of an installed package.
        fields: values by name; a mapping gives the fields of a nested message.

    Raises:
        DiffbotError: if the definition is missing, or the type does not have a given field.
    """
    return _make(_store(type_name, None), type_name, fields)


def _make(store: Typestore, type_name: str, fields: Mapping[str, Any]) -> Any:
    names = store.fielddefs[type_name][1]
    if unknown := set(fields) - {name for name, _ in names}:
        raise DiffbotError(f"{type_name} does not have a field {shown(min(unknown))}")
    return store.types[type_name](**{name: _value(store, kind, fields.get(name)) for name, kind in names})


def _value(store: Typestore, kind: Any, given: Any) -> Any:
    """Return the value of a field that ``kind`` describes, or its default if none is given."""
    node, detail = kind
    if node == Nodetype.NAME:
        return _make(store, detail, given or {}) if given is None or isinstance(given, Mapping) else given
    if node == Nodetype.BASE:
        defaults: dict[str, Any] = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}
        return defaults.get(detail[0], 0) if given is None else given
    element, count = detail
    count = count if node == Nodetype.ARRAY else 0
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        dtype = {"byte": "uint8", "char": "uint8"}.get(element[1][0], element[1][0])
        return np.zeros(count, dtype) if given is None else np.asarray(given, dtype)
    return [_value(store, element, item) for item in ([None] * count if given is None else given)]
