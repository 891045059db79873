"""Angles, poses and frames against exact fractions, homogeneous matrices and scipy's rotations."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from diffbot_core.geometry import (
    TWO_PI,
    Pose,
    into_frame,
    origin_of_frame,
    out_of_frame,
    quaternion_of_yaw,
    wrap_angle,
    yaw_of_quaternion,
)

CHECK = settings(max_examples=100)
ANY_ANGLE = st.floats(allow_nan=False, allow_infinity=False)
COORDINATES = st.floats(-1e4, 1e4)
POSES = st.builds(Pose, COORDINATES, COORDINATES, st.floats(-10.0, 10.0))


def matrix(pose):
    """Return the homogeneous matrix of a planar pose."""
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    return np.array([[c, -s, pose.x], [s, c, pose.y], [0.0, 0.0, 1.0]])


def assert_same_pose(pose, homogeneous, tolerance):
    assert -math.pi < pose.theta <= math.pi
    np.testing.assert_allclose(matrix(pose), homogeneous, rtol=0.0, atol=tolerance)


@CHECK
@example(math.pi)
@example(-math.pi)
@example(math.nextafter(math.pi, 4.0))
@example(math.nextafter(-math.pi, -4.0))
@given(ANY_ANGLE)
def test_wrapping_subtracts_whole_turns_exactly(angle):
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    turns = (Fraction(angle) - Fraction(wrapped)) / Fraction(TWO_PI)
    assert turns.denominator == 1


@CHECK
@given(POSES, POSES)
def test_changes_of_frame_are_products_of_homogeneous_matrices(one, other):
    first, second = matrix(one), matrix(other)
    assert_same_pose(origin_of_frame(one, other), second @ np.linalg.inv(first), 1e-7)
    assert_same_pose(into_frame(one, other), np.linalg.inv(second) @ first, 1e-8)
    assert_same_pose(out_of_frame(one, other), second @ first, 1e-8)


@CHECK
@given(
    st.floats(-math.pi, math.pi),
    st.floats(-1.5, 1.5),
    st.floats(-3.0, 3.0),
    st.sampled_from((1.0, -1.0, 1e-3, 1e3, -1e50, 1e-50)),
)
def test_the_yaw_of_a_quaternion_of_any_length_is_that_of_scipy(yaw, pitch, roll, length):
    rotation = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    found = yaw_of_quaternion(*(length * rotation.as_quat()))
    expected = rotation.as_euler("ZYX")[0]
    assert wrap_angle(found - expected) == pytest.approx(0.0, abs=1e-9)


@CHECK
@given(st.floats(-1e9, 1e9))
def test_the_quaternion_of_a_yaw_rotates_about_z(yaw):
    z, w = quaternion_of_yaw(yaw)
    assert math.hypot(z, w) == pytest.approx(1.0, abs=1e-12)
    turned = Rotation.from_quat([0.0, 0.0, z, w]).apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(turned, [math.cos(yaw), math.sin(yaw), 0.0], atol=1e-6)
