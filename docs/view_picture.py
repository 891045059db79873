"""The picture of a report, docs/view.png: ``python docs/view_picture.py [REPORT.html]``, after ``make demo``."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "test" / "support"))

import browser

ROOT = Path(__file__).parents[1]
SIZE = (1200, 840)
TIME = 12.5
"""[s] on the way to the second goal"""


def main(report: Path, picture: Path) -> None:
    """Draw a report at TIME."""
    with browser.chromium() as new_page:
        page = new_page(SIZE).open(report.resolve().as_uri())
        page.get(f"diffbotPage.player.go({TIME})")
        page.next_frame()
        page.tab.screenshot(path=picture)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "out/demo/report.html", ROOT / "docs" / "view.png")
