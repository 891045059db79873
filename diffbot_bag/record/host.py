"""What a bag was recorded with: package, interpreter, libraries, operating system and processor. No environment."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
from pathlib import Path
from typing import Any

from diffbot_core.distribution import DISTRIBUTION

_VARIABLES = ("ROS_DISTRO", "RMW_IMPLEMENTATION", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_DOMAIN_ID")
"""The only environment variables recorded: what else is in the environment may be secret."""


def host_facts() -> dict[str, Any]:
    """Return versions and facts of this host as plain values; what cannot be found out is left out."""
    system = platform.uname()
    return {
        "package": {"diffbot": _version(DISTRIBUTION)},
        "python": platform.python_version(),
        "dependencies": {name: version for name in _dependencies() if (version := _version(name))},
        "ros": {name: os.environ[name] for name in _VARIABLES if name in os.environ},
        "host": {
            "system": system.system,
            "release": system.release,
            "machine": system.machine,
            "distribution": _distribution(),
            "processor": _processor(),
            "cores": os.cpu_count(),
            "memory": _memory(),
        },
    }


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return ""


def _dependencies() -> list[str]:
    try:
        requirements = importlib.metadata.requires(DISTRIBUTION) or []
    except importlib.metadata.PackageNotFoundError:
        requirements = []
    names = (re.match(r"[A-Za-z0-9._-]+", one) for one in requirements)
    return sorted({match.group() for match in names if match} | {"rclpy", "mcap"})


def _distribution() -> str:
    try:
        return str(platform.freedesktop_os_release().get("PRETTY_NAME", ""))
    except OSError:
        return ""


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return platform.processor()
    found = re.search(r"^(?:model name|Model)\s*:\s*(.+)$", text, re.MULTILINE)
    return found.group(1).strip() if found else platform.processor()


def _memory() -> int:
    """Return the size of the main memory [bytes]; 0 if it is unknown."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError):
        return 0
