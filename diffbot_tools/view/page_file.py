"""Builds the page: one HTML file with style, script and data, which loads no other file and runs no other script.

The files in page/ are ES modules. A page that is opened from the disk cannot import modules, so the modules are joined
without ``import`` and ``export``. Therefore no two modules may define the same name.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from functools import cache
from importlib.resources import files
from typing import Any

MODULES = (
    "geometry.js",
    "store.js",
    "view.js",
    "map.js",
    "panels.js",
    "charts.js",
    "page.js",
    "report.js",
    "live.js",
    "main.js",
)
"""Each module imports only from modules earlier in this list."""
_IMPORT = re.compile(r"^import \{[^}]*\} from \"\./[\w.]+\";\n", re.MULTILINE)
_EXPORT = re.compile(r"^export (?=async |function |class |const |let )", re.MULTILINE)


def page_text(name: str) -> str:
    """Return a file of the page."""
    return files("diffbot_tools.view").joinpath("page", name).read_text(encoding="utf-8")


@cache
def script() -> str:
    """Return the joined modules."""
    return "\n" + "\n".join(_EXPORT.sub("", _IMPORT.sub("", page_text(name))) for name in MODULES)


def policy(connect: str = "'none'") -> str:
    """Return the content security policy: only this script, this style, and connections to ``connect`` are allowed."""
    return (
        f"default-src 'none'; script-src {_hash(script())}; style-src {_hash(page_text('style.css'))}; "
        f"img-src 'none'; connect-src {connect}; base-uri 'none'; form-action 'none'"
    )


def html(data: Any, connect: str = "'none'") -> str:
    """Return the page with ``data`` (JSON) inside."""
    parts = {
        "POLICY": policy(connect),
        "STYLE": page_text("style.css"),
        "DATA": embedded_json(data),
        "SCRIPT": script(),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], page_text("index.html"))


def embedded_json(data: Any) -> str:
    """Return ASCII JSON without ``<``, which cannot end a script element or begin a comment."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
