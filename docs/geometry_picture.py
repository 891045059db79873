"""The figure docs/explanation/geometry.svg: rho, alpha, beta and theta of one pose, and both regions."""

from __future__ import annotations

import math

from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_core.geometry import Pose

ROBOT = Pose(-3.4, -2.1, -0.35)
RADIUS = 0.9
"""[m] eps_P, larger than it usually is"""
SCALE, LEFT, TOP, WIDTH, HEIGHT = 100.0, 450.0, 130.0, 640, 440
"""[px/m], place of the goal [px], size [px]"""
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#777777"


def geometry_picture() -> str:
    """Return the figure."""
    _, alpha, beta = navigation_variables(ROBOT)
    at_robot, goal = (ROBOT.x, ROBOT.y), (0.0, 0.0)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        'font-family="sans-serif" font-size="17">',
        "<title>rho, alpha, beta and theta</title>",
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
        f'<circle cx="{LEFT:.0f}" cy="{TOP:.0f}" r="{RADIUS * SCALE:.0f}" fill="{GREEN}" fill-opacity="0.15" '
        f'stroke="{GREEN}"/>',
        _line(goal, (1.6, 0.0), GREY),
        _line(goal, (0.0, 1.15), GREY),
        _line(at_robot, (ROBOT.x + 2.1, ROBOT.y), GREY, "5 5"),
        _line(at_robot, goal, BLUE),
        _line((0.0, 0.0), (0.8 * math.cos(beta), 0.8 * math.sin(beta)), BLUE, "5 5"),
        _line(at_robot, _point(at_robot, ROBOT.theta, 1.9), ORANGE),
        _arc(at_robot, 1.55, 0.0, beta, BLUE),
        _arc(at_robot, 1.1, ROBOT.theta, ROBOT.theta + alpha, ORANGE),
        _arc(at_robot, 1.8, ROBOT.theta, 0.0, GREY),
        f'<g transform="translate({_x(ROBOT.x):.0f} {_y(ROBOT.y):.0f}) rotate({-math.degrees(ROBOT.theta):.1f})">'
        '<rect x="-22" y="-18" width="44" height="36" rx="8" fill="#dddddd" stroke="black"/>'
        '<rect x="-13" y="-24" width="26" height="7"/><rect x="-13" y="17" width="26" height="7"/></g>',
        f'<circle cx="{LEFT:.0f}" cy="{TOP:.0f}" r="5"/>',
        _text((-1.9, -0.85), "rho", BLUE),
        _text(_point(at_robot, 0.5 * beta, 1.63), "beta", BLUE),
        _text((ROBOT.x + 0.58, ROBOT.y + 0.07), "alpha", ORANGE),
        _text(_point(at_robot, 0.5 * ROBOT.theta, 1.88), "theta &lt; 0", GREY),
        _text((1.45, 0.1), "x", GREY),
        _text((0.08, 1.05), "y", GREY),
        _text((-0.05, -0.3), "goal", "black"),
        _text((0.4, -1.1), "Omega_L", GREEN),
        _text((-4.3, 0.9), "Omega_G", "black"),
        _text((-4.0, -2.6), "robot", "black"),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _x(x: float) -> float:
    return LEFT + SCALE * x


def _y(y: float) -> float:
    return TOP - SCALE * y


def _point(start: tuple[float, float], angle: float, length: float) -> tuple[float, float]:
    return start[0] + length * math.cos(angle), start[1] + length * math.sin(angle)


def _line(start: tuple[float, float], end: tuple[float, float], colour: str, dashes: str = "none") -> str:
    places = f'x1="{_x(start[0]):.1f}" y1="{_y(start[1]):.1f}" x2="{_x(end[0]):.1f}" y2="{_y(end[1]):.1f}"'
    return f'<line {places} stroke="{colour}" stroke-width="2" stroke-dasharray="{dashes}"/>'


def _arc(centre: tuple[float, float], radius: float, start: float, end: float, colour: str) -> str:
    (x1, y1), (x2, y2) = _point(centre, start, radius), _point(centre, end, radius)
    size = SCALE * radius
    path = f"M {_x(x1):.1f} {_y(y1):.1f} A {size:.1f} {size:.1f} 0 0 0 {_x(x2):.1f} {_y(y2):.1f}"
    return f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="2"/>'


def _text(place: tuple[float, float], text: str, colour: str) -> str:
    return f'<text x="{_x(place[0]):.0f}" y="{_y(place[1]):.0f}" fill="{colour}">{text}</text>'
