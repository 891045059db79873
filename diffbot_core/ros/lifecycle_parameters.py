"""Parameters of every managed node; free of ROS."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.schema import Spec


class LifecycleConfig(NamedTuple):
    """Who takes a managed node through its states."""

    autostart: Annotated[
        bool, Spec("the node configures and activates itself; false: a lifecycle manager does", read_only=True)
    ] = True
