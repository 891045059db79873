"""Write the generated parts of docs/: ``python docs/build.py [--check] [--tables]``.

They are the lists of parameters in reference/parameters/ and of bag rules in reference/bag-check.md, which follow the
configuration types, and what the commands of the tutorials print. ``--tables`` leaves the tutorials out, which take
minutes. ``--check`` writes nothing and fails if a page is out of date.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import tutorial_run
from parameter_tables import with_parameters

from diffbot_bag.tools.contract import BagRules, TopicRules
from diffbot_core.schema import Spec, parameters_of

DOCS = Path(__file__).parent
_RULES = re.compile(r"(<!--rules-->\n).*?(\n<!--/rules-->)", re.DOTALL)


def tables() -> dict[Path, str]:
    """Return the pages of the reference with current lists of parameters and rules."""
    found = {}
    for path in sorted((DOCS / "reference").rglob("*.md")):
        found[path] = _RULES.sub(lambda block: block[1] + rules() + block[2], with_parameters(path.read_text()))
    return found


def rules() -> str:
    """Return the rules of a contract: first those for the whole bag, then those for a topic."""
    parts = []
    for title, config in (("For the whole bag:", BagRules), ("For a topic:", TopicRules)):
        entries = [f"- `{one.name}`: {_meaning(one.spec)}" for one in parameters_of(config)]
        parts.append("\n".join([title, "", *entries]))
    return "\n\n".join(parts)


def _meaning(spec: Spec) -> str:
    choices = f": {' or '.join(spec.choices)}" if spec.choices else ""
    return spec.text + choices + (f" [{spec.unit}]" if spec.unit not in ("", "-") else "")


def main() -> int:
    """Write or check the pages; return 1 if a check finds a page out of date."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing, fail on a difference")
    parser.add_argument("--tables", action="store_true", help="leave out the tutorials")
    options = parser.parse_args()
    stale = {path: text for path, text in tables().items() if path.read_text() != text}
    if not options.tables:
        stale |= {path: text for path in tutorial_run.pages() if (text := tutorial_run.fresh(path))}
    for path, text in stale.items():
        if not options.check:
            path.write_text(text)
        print(f"{path.relative_to(DOCS.parent)} {'is out of date: run `make docs`' if options.check else 'written'}")
    return 1 if options.check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
