"""Hooks of mkdocs: show Sphinx roles in docstrings as plain code, and let long message types wrap in tables."""

from __future__ import annotations

import re
from typing import Any

_ROLE = re.compile(r":(?:attr|class|data|func|meth|mod):(<code[^>]*>)~?")
_TYPE_IN_TABLE = re.compile(r"(<td>\w+_(?:msgs|srvs|interfaces)/)")


def on_page_content(html: str, **_: Any) -> str:
    """Return the page without Sphinx roles and with break points in message types."""
    return _TYPE_IN_TABLE.sub(r"\1<wbr>", _ROLE.sub(r"\1", html))
