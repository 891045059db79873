"""SROS2 policies (format 0.2.0 of sros2's policy.xsd): the rights of nodes as XML; free of ROS.

A policy has an enclave, with keys of its own, for each process, and in it a profile for each node. What no profile
allows is denied. Names are relative to the profile's namespace, or begin with ~ (the node) or / (the graph).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from diffbot_core.files import write_text

VERSION = "0.2.0"
ALLOW = "ALLOW"
ROOT_ENCLAVE = "/diffbot"
"""Enclaves of this project are below it."""
COMMENT = (
    "Least privilege for the nodes of this package, written from their running graph by docs/generate.py.\n"
    "Not tried with real keys. What it covers and how to use it: docs/how-to/security.md"
)
"""Of the policy of this project; XML allows no double hyphen in it."""


class Rights(NamedTuple):
    """What a node does in the graph; names in the form of a policy."""

    publish: frozenset[str] = frozenset()
    """topics"""
    subscribe: frozenset[str] = frozenset()
    """topics"""
    reply: frozenset[str] = frozenset()
    """services it offers"""
    request: frozenset[str] = frozenset()
    """services it calls"""
    execute: frozenset[str] = frozenset()
    """actions it offers"""
    call: frozenset[str] = frozenset()
    """actions it calls"""

    def __or__(self, other: Rights) -> Rights:
        """Return the rights of both."""
        return Rights(*(mine | theirs for mine, theirs in zip(self, other, strict=True)))


GROUP_OF = {
    "publish": "topics",
    "subscribe": "topics",
    "reply": "services",
    "request": "services",
    "execute": "actions",
    "call": "actions",
}
"""Element of a policy that holds each right."""


def name_in_policy(name: str, node: str, namespace: str) -> str:
    """Return the full name of a topic or service as the profile of a node has it.

    Args:
        name: such as /robot/ekf/status.
        node: name of the node whose profile it is.
        namespace: of the node; must not be the root, in which relative names cannot be told from absolute ones.
    """
    for beginning, short in ((f"{namespace}/{node}/", "~/"), (f"{namespace}/", "")):
        if name.startswith(beginning):
            return short + name.removeprefix(beginning)
    return name


def to_xml(enclaves: Mapping[str, Mapping[str, Rights]], comment: str) -> str:
    """Return the policy of processes whose nodes have these rights.

    Args:
        enclaves: for the name of each process, the rights of its nodes by name.
        comment: stands before the policy.
    """
    policy = ET.Element("policy", version=VERSION)
    listed = ET.SubElement(policy, "enclaves")
    for process, nodes in sorted(enclaves.items()):
        profiles = ET.SubElement(ET.SubElement(listed, "enclave", path=f"{ROOT_ENCLAVE}/{process}"), "profiles")
        for node, rights in sorted(nodes.items()):
            profile = ET.SubElement(profiles, "profile", ns="/", node=node)
            for right, names in rights._asdict().items():
                _append(profile, right, names)
    ET.indent(policy)
    text = ET.tostring(policy, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<!--\n{comment}\n-->\n{text}\n'


def _append(profile: ET.Element, right: str, names: Iterable[str]) -> None:
    if not names:
        return
    group = GROUP_OF[right]
    element = ET.SubElement(profile, group, {right: ALLOW})
    for name in sorted(names):
        ET.SubElement(element, group.removesuffix("s")).text = name


def write_policy(path: Path, enclaves: Mapping[str, Mapping[str, Rights]], comment: str) -> None:
    """Write a policy, whole or not at all; see :func:`to_xml`.

    Raises:
        OSError: if it cannot be written.
    """
    write_text(path, to_xml(enclaves, comment))
