"""The page as one HTML file that contains style, modules and data, loads nothing, and runs only its own script.

The modules in page/ are plain ES modules. A file that is opened from the disk cannot import others, so the modules are
joined without their imports and the word ``export``. Therefore no two modules may define the same name.
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
    "theme.js",
    "store.js",
    "view.js",
    "map.js",
    "charts.js",
    "panels.js",
    "player.js",
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
    """Return the modules, joined."""
    return "\n" + "\n".join(_EXPORT.sub("", _IMPORT.sub("", page_text(name))) for name in MODULES)


def policy(connect: str = "'none'") -> str:
    """Return the content security policy: this script and this style by their hashes, connections to ``connect``."""
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
    """Return JSON that cannot end a script element or begin a comment, since it contains no ``<``.

    It is ASCII, so U+2028 is escaped, too.
    """
    return json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
