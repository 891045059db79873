"""What is measured of the pose: one class each, which the filter uses by the interface of :class:`Measurement` alone.

A new sensor is a new module here; gate, NIS, whiteness and fusion by stamps stay as they are.
"""

from diffbot_control.filter.measurements.fix import FIXES, PoseFix, PositionFix
from diffbot_control.filter.measurements.heading import HEADINGS, Heading
from diffbot_control.filter.measurements.landmark import LANDMARKS, LandmarkMeasurement
from diffbot_control.filter.measurements.measurement import Array, Innovation, Measurement, Source, States

__all__ = [
    "FIXES",
    "HEADINGS",
    "LANDMARKS",
    "Array",
    "Heading",
    "Innovation",
    "LandmarkMeasurement",
    "Measurement",
    "PoseFix",
    "PositionFix",
    "Source",
    "States",
]
