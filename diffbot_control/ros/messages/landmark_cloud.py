"""Landmark measurements in a sensor_msgs/PointCloud2, read and written; this module does not import ROS.

A point has the fields ``x`` and ``y`` [m] in the frame of the robot (float32 or float64) and ``id`` (any integer type).
The fields ``range_variance`` [m^2] and ``bearing_variance`` [rad^2] are optional; other fields are ignored. A variance
of NaN or infinity means that the range or the bearing was not measured. A range without a bearing is a point in any
direction, and a bearing without a range is a point at any distance.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import MAX_COORDINATE

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy names of the data types of a sensor_msgs/PointField."""
_MAX_POINTS, _MAX_POINT_STEP = 100, 65536
"""Largest number of points and largest size of a point [bytes]; a larger cloud does not contain landmarks."""
_WRITTEN = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z")]
    + [("id", "<i4"), ("range_variance", "<f4"), ("bearing_variance", "<f4")]
)
"""Layout of published clouds. RViz requires x, y and z in single precision."""


class LandmarkPoint(NamedTuple):
    """One point of a cloud."""

    number: int
    """id of the landmark"""
    range: float
    """[m]"""
    bearing: float
    """[rad]"""
    var_range: float
    """[m^2]; 0: unknown variance; not finite: the range was not measured"""
    var_bearing: float
    """[rad^2]; 0: unknown variance; not finite: the bearing was not measured"""


def landmark_points(message: Any) -> list[LandmarkPoint]:
    """Read the points of a cloud.

    Raises:
        BadMessageError: if the cloud does not have the required fields, its sizes contradict each other, it has more
            than 100 points or two points of one landmark, a coordinate is not finite, a variance is negative, or a
            range is 0 or larger than MAX_COORDINATE.
    """
    count = message.width * message.height
    if count > _MAX_POINTS:
        raise BadMessageError("too many points", f"{count} > {_MAX_POINTS}")
    points = _structured(message, count)
    columns = [points[name].astype(float).tolist() for name in ("x", "y")]
    for name in ("range_variance", "bearing_variance"):
        known = points.dtype.names is not None and name in points.dtype.names
        columns.append(points[name].astype(float).tolist() if known else [0.0] * count)
    found = []
    for number, x, y, var_range, var_bearing in zip(points["id"].tolist(), *columns, strict=True):
        if not math.isfinite(x + y):
            raise BadMessageError("point not finite", f"of landmark {number}")
        if var_range < 0.0 or var_bearing < 0.0:
            raise BadMessageError("variance negative", f"of landmark {number}")
        distance = math.hypot(x, y)
        if not 0.0 < distance <= MAX_COORDINATE:
            raise BadMessageError("range out of range" if distance else "range not positive", f"of landmark {number}")
        found.append(LandmarkPoint(number, distance, math.atan2(y, x), var_range, var_bearing))
    if len({point.number for point in found}) < len(found):
        raise BadMessageError("landmark twice in a cloud")
    return found


def _structured(message: Any, count: int) -> Any:
    """Return the data as a structured array (count,) with the accepted fields."""
    order = ">" if message.is_bigendian else "<"
    accepted = {"x": "f", "y": "f", "id": "iu", "range_variance": "f", "bearing_variance": "f"}
    if message.point_step > _MAX_POINT_STEP:
        raise BadMessageError("point_step too large", f"{message.point_step} > {_MAX_POINT_STEP}")
    names, formats, offsets = [], [], []
    for field in message.fields:
        kind = _TYPES.get(field.datatype, "")
        if field.name in accepted and field.name not in names and kind[:1] in accepted[field.name] and kind:
            if field.count not in (0, 1) or field.offset + int(kind[1]) > message.point_step:
                raise BadMessageError("point fields contradict point_step", field.name[:40])
            names.append(field.name)
            formats.append(order + kind)
            offsets.append(field.offset)
    missing = [name for name in ("x", "y", "id") if name not in names]
    if missing:
        raise BadMessageError("point fields missing", ", ".join(missing))
    if message.row_step != message.width * message.point_step or len(message.data) != message.row_step * message.height:
        raise BadMessageError("cloud sizes contradict each other", f"{len(message.data)} bytes for {count} points")
    layout = np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": max(int(message.point_step), 1)}
    )
    return np.frombuffer(bytes(message.data), layout, count)


def fill_landmark_points(message: Any, points: list[LandmarkPoint], field_type: Any) -> None:
    """Write landmarks into a cloud in place.

    Args:
        message: PointCloud2 whose header is not changed.
        points: measurements to write.
        field_type: class sensor_msgs/PointField.
    """
    rows = [
        (r * math.cos(bearing), r * math.sin(bearing), 0.0, number, var_r, var_bearing)
        for number, r, bearing, var_r, var_bearing in points
    ]
    names = {kind: number for number, kind in _TYPES.items()}
    message.fields = [
        field_type(name=name, offset=int(offset), datatype=names[kind.str[1:]], count=1)
        for name, (kind, offset, *_) in (_WRITTEN.fields or {}).items()
    ]
    message.height, message.width = 1, len(rows)
    message.point_step, message.row_step = _WRITTEN.itemsize, _WRITTEN.itemsize * len(rows)
    message.is_bigendian, message.is_dense = False, True
    message.data = np.array(rows, _WRITTEN).tobytes()
