"""Scalar options of a campaign. This module does not import the filter, so that the command line starts fast."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.errors import InvalidValueError, known_name
from diffbot_core.schema import Spec


class CampaignOptions(NamedTuple):
    """Scalar options of a campaign, with the same names in YAML and as flags."""

    runs: Annotated[int, Spec("runs of each cell", minimum=1, maximum=10**9)] = 1000
    seed: Annotated[int, Spec("seed of all noise", minimum=0, maximum=2**63 - 1)] = 1
    duration: Annotated[float, Spec("length of each run", "s", minimum=1e-3, maximum=1e5)] = 60.0
    feedback: Annotated[str, Spec("pose that the controller receives: ekf, raw or truth")] = "ekf"
    law: Annotated[str, Spec("law that drives the robot: a registered name, or package.module:Class")] = "switching"

    def check(self) -> None:
        """Raise InvalidValueError if the feedback is unknown."""
        from diffbot_sim.robot_step import FEEDBACKS  # noqa: PLC0415 - imports the filter

        if self.feedback not in FEEDBACKS:
            raise InvalidValueError("feedback", self.feedback, known_name(self.feedback, FEEDBACKS))
