"""Parameters of the law that cannot act, because of others: to refuse a study that varies them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from diffbot_control.law.configuration import AUTO, BRAKING, TANH, ControllerConfig
from diffbot_control.law.finish import FinishConfig
from diffbot_control.law.lyapunov_law import Gains
from diffbot_control.law.paper.reapproach import ReapproachConfig
from diffbot_control.law.regions import COVARIANCE, CovarianceRegionPolicy, FixedRegionPolicy
from diffbot_control.law.speed_profile import ProfileGains
from diffbot_core.schema import parameters_of


def inert_parameters(config: ControllerConfig) -> dict[str, str]:
    """Return the parameters that change no command under a configuration, and with what they would."""
    braking, tanh = "speed_profile: braking (preset tuned)", "speed_profile: tanh (preset paper)"
    found: dict[str, str] = {}
    if config.profile == TANH:
        of_braking = (*_names(ProfileGains, FinishConfig), "gains", "symmetric_yaw_tolerance")
        found |= dict.fromkeys((*of_braking, "command_latency", "drive_time_constant"), braking)
    if config.profile == BRAKING:
        found |= dict.fromkeys(_names(Gains, ReapproachConfig), tanh)
        if config.gain_source == AUTO:
            found |= dict.fromkeys(_names(ProfileGains), "gains: preset")
    if config.region_policy.kind == COVARIANCE:
        found |= dict.fromkeys(_names(FixedRegionPolicy), "region_policy: fixed (preset paper)")
    else:
        # The prediction over a latency works with eps_P_speed_error under any policy.
        kept = {"eps_P_speed_error"} if config.profile == BRAKING else set()
        of_covariance = set(_names(CovarianceRegionPolicy, ReapproachConfig)) - kept
        found |= dict.fromkeys(sorted(of_covariance), "region_policy: covariance")
    return found


def _names(*groups: type[Any]) -> Iterable[str]:
    return [one.name for group in groups for one in parameters_of(group)]
