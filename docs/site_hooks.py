"""Hooks of mkdocs: of Sphinx's roles in docstrings the name is shown alone; long types of messages may be broken."""

from __future__ import annotations

import re
from typing import Any

_ROLE = re.compile(r":(?:attr|class|data|func|meth|mod):(<code[^>]*>)~?")
_TYPE_IN_TABLE = re.compile(r"(<td>\w+_(?:msgs|srvs|interfaces)/)")


def on_page_content(html: str, **_: Any) -> str:
    """Return a page without the roles, whose tables fit although types of messages have long names."""
    return _TYPE_IN_TABLE.sub(r"\1<wbr>", _ROLE.sub(r"\1", html))
