"""References to records of arrays, for compiled code.

A named tuple of arrays is copied at each call. A reference has the same fields and is one pointer. Its arrays are
borrowed: compiled code counts who uses an array at each call otherwise, which takes as long as a step of the plant.
"""

from __future__ import annotations

from typing import Any

import numba
from numba.core import cgutils
from numba.experimental import structref
from numba.extending import intrinsic

from diffbot_control.filter.state import FilterState, Options
from diffbot_sim.fusion import Recent, Robot


class _Reference(numba.types.StructRef):
    """Type of a reference."""

    def preprocess_fields(self, fields: Any) -> Any:
        """Return the fields without literal types."""
        return tuple((name, numba.types.unliteral(kind)) for name, kind in fields)  # type: ignore[no-untyped-call]


@structref.register
class FilterType(_Reference):
    """Of the filter's arrays."""


@structref.register
class RecentType(_Reference):
    """Of the arrays of a run."""


@structref.register
class OptionsType(_Reference):
    """Of the filter's options."""


@structref.register
class RobotType(_Reference):
    """Of the configuration of a robot."""


class FilterReference(structref.StructRefProxy):
    """The filter's arrays."""


class RecentReference(structref.StructRefProxy):
    """The arrays of a run."""


class OptionsReference(structref.StructRefProxy):
    """The filter's options."""


class RobotReference(structref.StructRefProxy):
    """The configuration of a robot."""


_define: Any = structref.define_constructor
_intrinsic: Any = intrinsic
_define(FilterReference, FilterType, list(FilterState._fields))
_define(RecentReference, RecentType, list(Recent._fields))
_define(OptionsReference, OptionsType, list(Options._fields))
_define(RobotReference, RobotType, list(Robot._fields))


@_intrinsic  # type: ignore[untyped-decorator]
def _borrowed(typing_context: Any, array: Any) -> Any:

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        view = context.make_array(array)(context, builder, values[0])
        view.meminfo = cgutils.get_null_value(view.meminfo.type)  # type: ignore[no-untyped-call]
        return view._getvalue()

    return array(array), code


def borrowed(array: Any) -> Any:
    """Return an array with the same elements that does not keep them: the given array has to outlive it."""
    return _borrowed(array)


def referred(recent: Any) -> Any:
    """Return a reference to what a run works with."""
    robot, o, f = recent.robot, recent.robot.filter, recent.filter
    options = OptionsReference(  # type: ignore[no-untyped-call]
        o.size,
        o.separation,
        o.gates,
        o.relocation_fixes,
        o.errors,
        o.variances,
        o.wheel_walk,
        o.bias_walk,
        o.max_radius_error,
        o.max_separation_error,
        o.wheels_as_configured,
        o.fuzzy,
        o.finds_noise,
        o.times,
    )
    own = RobotReference(robot.plant, robot.sensors, options, borrowed(robot.landmarks))  # type: ignore[no-untyped-call]
    kept = FilterReference(  # type: ignore[no-untyped-call]
        borrowed(f.memory),
        borrowed(f.x),
        borrowed(f.P),
        borrowed(f.candidate),
        borrowed(f.candidate_P),
        borrowed(f.gate),
        borrowed(f.travelled),
        borrowed(f.shift),
        borrowed(f.noise),
        borrowed(f.last),
    )
    return RecentReference(  # type: ignore[no-untyped-call]
        own,
        borrowed(recent.commands),
        borrowed(recent.steps),
        borrowed(recent.seen),
        borrowed(recent.memory),
        borrowed(recent.stamps),
        kept,
    )
