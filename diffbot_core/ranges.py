"""Ranges that several parameters share, as (minimum, maximum).

They are wide enough for any wheeled robot, and so narrow that every formula stays finite in float64 whatever values are
combined. A bound such as "finite and > 0" would not do: 1e308 squared is infinite, and so is 1 / 5e-324.
"""

from __future__ import annotations

Range = tuple[float, float]

WHEEL_SIZE: Range = 1e-3, 10.0
"""[m] radius of a wheel, distance of the wheels"""
LENGTH: Range = 1e-6, 1e6
"""[m] that must not be zero"""
DISTANCE: Range = 0.0, 1e6
"""[m] that may be zero"""
ANGLE: Range = 1e-6, 1e3
"""[rad] that must not be zero; larger than a turn: any heading will do"""
POSITION: Range = -1e6, 1e6
"""[m] coordinate of a pose"""
HEADING: Range = -1e3, 1e3
"""[rad] of a pose, not wrapped"""
SPEED: Range = 1e-6, 1e3
"""[m/s] that must not be zero"""
TURN_RATE: Range = 1e-6, 1e3
"""[rad/s] of the body, likewise"""
WHEEL_SPEED: Range = 1e-6, 1e6
"""[rad/s] of a wheel: SPEED on the smallest one"""
ACCELERATION: Range = 1e-6, 1e3
"""[m/s^2]"""
ANGULAR_ACCELERATION: Range = 1e-6, 1e4
"""[rad/s^2] of the body"""
WHEEL_ACCELERATION: Range = 1e-6, 1e7
"""[rad/s^2] of a wheel"""
TIMEOUT: Range = 1e-3, 1e6
"""[s] that must not be zero; the longest are eleven days"""
TIME: Range = 0.0, 1e6
"""[s] that may be zero"""
GAIN: Range = 1e-6, 1e3
"""[1/s] or [-], that must not be zero"""
SIGMAS: Range = 0.0, 1e3
"""[-] number of standard deviations"""
SHARE: Range = 1e-3, 1.0
"""[-] that must not be zero"""
