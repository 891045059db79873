"""Messages to CDR and back by rosbags' type system, without ROS.

A decoded message has its fields as attributes with the names of ROS: ``message.header.stamp.sec``. Arrays are NumPy
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
"""types of all definitions that agree with each other, so that their common parts are compiled once"""


@functools.cache
def _jazzy() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


@functools.lru_cache(maxsize=1024)
def _store(type_name: str, definition: str | None) -> Typestore:
    """Return a store of the type; the arguments, and the error without a definition, are those of :func:`decode`."""
    if definition is None:
        if type_name in _jazzy().types:
            return _jazzy()
        definition = schema_text(type_name)
    try:
        types = get_types_from_msg(definition, type_name)
        try:
            _shared.register(types)
            store = _shared
        except TypesysError:  # another bag has the same name for another type
            store = Typestore()
            store.register(types)
        store.get_msgdef(type_name)
    except Exception as error:  # the parser and the generated code of a foreign definition raise any
        raise DiffbotError(f"the definition of {shown(type_name)} cannot be parsed") from error
    return store


def decode(type_name: str, data: bytes, definition: str | None = None) -> Any:
    """Return the message that these CDR bytes contain.

    Args:
        type_name: ``pkg/msg/Type``.
        data: CDR with its encapsulation header.
        definition: .msg text of the type, as a bag contains it; None: of ROS 2 Jazzy or of an installed package.

    Raises:
        DiffbotError: if there is no usable definition, or the bytes are not a message of this type.
    """
    store = _store(type_name, definition)
    try:
        return store.deserialize_cdr(data, type_name)
    except Exception as error:  # struct.error, IndexError, MemoryError ... of the generated code
        raise DiffbotError(f"{len(data)} bytes are not a {shown(type_name)}") from error


def encode(type_name: str, message: Any) -> bytes:
    """Return the CDR bytes of a message, which has its fields as attributes.

    Raises:
        DiffbotError: if there is no usable definition, or the message is not of this type.
    """
    store = _store(type_name, None)
    try:
        return bytes(store.serialize_cdr(message, type_name))
    except Exception as error:  # AttributeError, struct.error ... of the generated code
        raise DiffbotError(f"cannot encode a {shown(type_name)}: {shown(error)}") from error


def make(type_name: str, /, **fields: Any) -> Any:
    """Return a new message; fields that are not given are zero, empty or false.

    Args:
        type_name: ``pkg/msg/Type`` of ROS 2 Jazzy or of an installed package.
        fields: values by name; a mapping stands for a nested message.

    Raises:
        DiffbotError: if there is no usable definition, or no such field.
    """
    return _made(_store(type_name, None), type_name, fields)


def _made(store: Typestore, type_name: str, fields: Mapping[str, Any]) -> Any:
    names = store.fielddefs[type_name][1]
    if unknown := set(fields) - {name for name, _ in names}:
        raise DiffbotError(f"{type_name} has no field {shown(min(unknown))}")
    return store.types[type_name](**{name: _value(store, kind, fields.get(name)) for name, kind in names})


def _value(store: Typestore, kind: Any, given: Any) -> Any:
    """Return the value of a field; ``kind``: its description in the store."""
    node, detail = kind
    if node == Nodetype.NAME:
        return _made(store, detail, given or {}) if given is None or isinstance(given, Mapping) else given
    if node == Nodetype.BASE:
        defaults: dict[str, Any] = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}
        return defaults.get(detail[0], 0) if given is None else given
    element, count = detail
    count = count if node == Nodetype.ARRAY else 0
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        dtype = {"byte": "uint8", "char": "uint8"}.get(element[1][0], element[1][0])
        return np.zeros(count, dtype) if given is None else np.asarray(given, dtype)
    return [_value(store, element, one) for one in ([None] * count if given is None else given)]
