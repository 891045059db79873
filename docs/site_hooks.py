"""Hooks of mkdocs: docstrings name other objects by Sphinx's roles, of which the site shows the name alone."""

from __future__ import annotations

import re
from typing import Any

_ROLE = re.compile(r":(?:attr|class|data|func|meth|mod):(<code[^>]*>)~?")


def on_page_content(html: str, **_: Any) -> str:
    """Return a page without the roles."""
    return _ROLE.sub(r"\1", html)
