"""The executable of this room; this module is light, since it decides what a signal does while others are imported."""

from __future__ import annotations

from functools import partial

from diffbot_core.launcher import launch

INTERRUPTED = 130
"""Exit status of a command that was interrupted."""

diffbot = partial(launch, "diffbot_tools.cli", status=INTERRUPTED)
