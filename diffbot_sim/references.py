"""References to named tuples of arrays, for compiled code.

Numba copies a named tuple at each call. A reference has the same fields, but is passed as one pointer. Its
arrays are views without reference counting, since counting at each call takes as long as a step of the plant.
"""

from __future__ import annotations

from typing import Any

import numba
from numba.core import cgutils
from numba.experimental import structref
from numba.extending import intrinsic

from diffbot_control.filter.state import FilterState, Options
from diffbot_sim.fusion import RunBuffers, SimulatedRobot


class _Type(numba.types.StructRef):
    """Base of the references' types."""

    def preprocess_fields(self, fields: Any) -> Any:
        """Return the fields without literal types."""
        return tuple((name, numba.types.unliteral(kind)) for name, kind in fields)  # type: ignore[no-untyped-call]


# Each type needs a class of its own, which numba's cache finds by its name in this module.
@structref.register
class FilterType(_Type):
    """Type of :class:`FilterReference`."""


@structref.register
class OptionsType(_Type):
    """Type of :class:`OptionsReference`."""


@structref.register
class SimulatedRobotType(_Type):
    """Type of :class:`SimulatedRobotReference`."""


@structref.register
class RunBuffersType(_Type):
    """Type of :class:`RunBuffersReference`."""


class FilterReference(structref.StructRefProxy):
    """Reference to a :class:`FilterState`."""


class OptionsReference(structref.StructRefProxy):
    """Reference to :class:`Options`."""


class SimulatedRobotReference(structref.StructRefProxy):
    """Reference to a :class:`SimulatedRobot`."""


class RunBuffersReference(structref.StructRefProxy):
    """Reference to :class:`RunBuffers`."""


_define: Any = structref.define_constructor
_define(FilterReference, FilterType, list(FilterState._fields))
_define(OptionsReference, OptionsType, list(Options._fields))
_define(SimulatedRobotReference, SimulatedRobotType, list(SimulatedRobot._fields))
_define(RunBuffersReference, RunBuffersType, list(RunBuffers._fields))
_intrinsic: Any = intrinsic


@_intrinsic  # type: ignore[untyped-decorator]
def _borrowed(typing_context: Any, array: Any) -> Any:

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        view = context.make_array(array)(context, builder, values[0])
        view.meminfo = cgutils.get_null_value(view.meminfo.type)  # type: ignore[no-untyped-call]
        return view._getvalue()

    return array(array), code


def borrowed(array: Any) -> Any:
    """Return a view of an array without reference counting: the array must outlive the view."""
    return _borrowed(array)


def reference_to(buffers: Any) -> Any:
    """Return a reference to the buffers of a run."""
    robot, f = buffers.robot, buffers.filter
    options = OptionsReference(*robot.filter)  # type: ignore[no-untyped-call]
    own = SimulatedRobotReference(robot.plant, robot.sensors, options, borrowed(robot.landmarks))  # type: ignore[no-untyped-call]
    filter_ = FilterReference(  # type: ignore[no-untyped-call]
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
    return RunBuffersReference(  # type: ignore[no-untyped-call]
        own,
        borrowed(buffers.commands),
        borrowed(buffers.steps),
        borrowed(buffers.landmark_readings),
        borrowed(buffers.memory),
        borrowed(buffers.stamps),
        filter_,
    )
