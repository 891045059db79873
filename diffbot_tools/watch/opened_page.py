"""Opens the page in a browser by a file: everyone on the machine can read the command line of a browser."""

from __future__ import annotations

import html
import os
import sys
import tempfile
import threading
import webbrowser
from pathlib import Path

from diffbot_core.private_folders import runtime_folder


class OpenedPage:
    """A file that only this user can read and that leads to the page; :meth:`close` deletes it."""

    def __init__(self, url: str) -> None:
        """Write the file and open it, where there is a screen: without one, a browser would start in the terminal."""
        self._path: Path | None = None
        if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            return
        redirection = f'<!doctype html>\n<meta http-equiv="refresh" content="0; url={html.escape(url)}">\n'
        try:
            # Of mode 0600.
            number, name = tempfile.mkstemp(".html", "page_", runtime_folder())
            self._path = Path(name)
            with open(number, "w", encoding="utf-8") as file:
                file.write(redirection)
        except OSError as error:
            print(f"The page is not opened: {error}", file=sys.stderr)
            return
        threading.Thread(target=webbrowser.open, args=(self._path.as_uri(),), daemon=True).start()

    def close(self) -> None:
        """Delete the file."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)
