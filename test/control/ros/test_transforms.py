"""Poses in other frames, compared with scipy, and lookups of transforms."""

import math
import types

import hypothesis.strategies as st
import numpy as np
import pytest
from geometry_msgs.msg import Pose, Transform, TransformStamped
from hypothesis import given
from nav_msgs.msg import Path
from rclpy.time import Time
from robot import pose_stamped
from scipy.spatial.transform import Rotation

from diffbot_control.ros.messages.conversions import path_from
from diffbot_control.ros.tf import Tf2Transforms
from diffbot_control.ros.transforms import StaticTransforms, transformed
from diffbot_core.errors import BadMessageError

SECOND = 10**9


def filled(message, translation, rotation, place="translation", turn="rotation"):
    x, y, z = translation
    where, how = getattr(message, place), getattr(message, turn)
    where.x, where.y, where.z = float(x), float(y), float(z)
    how.x, how.y, how.z, how.w = rotation.as_quat().tolist()
    return message


def matrix(translation, rotation):
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rotation.as_matrix(), translation
    return result


VECTORS = st.tuples(*[st.floats(-100.0, 100.0)] * 3)
TILTED = st.tuples(*[st.floats(-1.2, 1.2)] * 3).map(lambda angles: Rotation.from_euler("ZYX", angles))
"""Tilted frames, such as the optical frame of a camera, for which yaws cannot be added."""


@given(VECTORS, VECTORS, TILTED, TILTED)
def test_a_transformed_pose_is_the_product_of_homogeneous_matrices(t, p, q, pose):
    expected = matrix(t, q) @ matrix(p, pose)
    found = transformed(filled(Pose(), p, pose, "position", "orientation"), filled(Transform(), t, q))
    assert found[:2] == pytest.approx(expected[:2, 3], abs=1e-9)
    assert math.remainder(found.theta - math.atan2(expected[1, 0], expected[0, 0]), math.tau) == pytest.approx(
        0.0, abs=1e-9
    )


def test_static_transforms_are_composed_through_their_common_ancestor():
    known, turns = StaticTransforms(), [Rotation.from_euler("ZYX", angles) for angles in np.eye(3) + 0.3]
    chain = [
        ("base_footprint", "base_link", (0.0, 0.0, 0.1), turns[0]),
        ("base_link", "mast", (0.2, 0.1, 0.5), turns[1]),
        ("mast", "imu_link", (0.0, -0.3, 0.2), turns[2]),
    ]
    for parent, child, t, q in reversed(chain):
        known.add(parent, child, filled(Transform(), t, q))
    steps = [matrix(t, q) for _, _, t, q in chain]
    found = known.lookup("imu_link", "base_link", 0)
    expected = np.linalg.inv(steps[1] @ steps[2])
    r, t = found.rotation, found.translation
    np.testing.assert_allclose(Rotation.from_quat([r.x, r.y, r.z, r.w]).as_matrix(), expected[:3, :3], atol=1e-12)
    np.testing.assert_allclose((t.x, t.y, t.z), expected[:3, 3], atol=1e-12)
    assert known.lookup("base_link", "base_link", 0).rotation.w == pytest.approx(1.0)
    with pytest.raises(BadMessageError, match="no transform: 'camera' to 'base_link'"):
        known.lookup("base_link", "camera", 0)
    known.add("imu_link", "base_footprint", filled(Transform(), (0.0, 0.0, 0.0), turns[0]))  # a loop
    with pytest.raises(BadMessageError, match="no transform"):
        known.lookup("camera", "imu_link", 0)


class Known:
    """Transforms from one frame only; records the lookups."""

    available = True

    def __init__(self, source, transform):
        self.source, self.transform, self.lookups = source, transform, []

    def lookup(self, target, source, stamp):
        self.lookups.append((target, source, stamp))
        if source != self.source:
            raise BadMessageError("no transform", f"{source!r} to {target!r}")
        return self.transform


QUARTER = filled(Transform(), (10.0, 0.0, 0.0), Rotation.from_euler("z", math.pi / 2))
"""Transform from odom to map: by 10 m along x, and a quarter turn."""


def test_poses_of_a_path_have_the_frame_and_time_of_the_path_unless_they_have_a_frame():
    path = Path()
    path.header.frame_id, path.header.stamp.sec = "odom", 5
    bare, own = pose_stamped(1.0, 0.0, 0.0, ""), pose_stamped(4.0, 5.0, 0.0, "map")
    bare.header.stamp.sec = 99
    path.poses = [bare, own]
    known = Known("odom", QUARTER)
    found = path_from(path, "map", known)
    assert found[0] == pytest.approx((10.0, 1.0, math.pi / 2))
    assert found[1] == pytest.approx((4.0, 5.0, 0.0))
    # The path and the pose without a frame need the same transform.
    assert known.lookups == [("map", "odom", 5 * SECOND)]


class FakeTf2(types.SimpleNamespace):
    """The used part of tf2_ros, with one transform from odom to map at a known time."""

    class TransformException(Exception):  # noqa: N818 - its name in tf2
        pass

    class ExtrapolationException(TransformException):
        pass

    def __init__(self, newest):
        self.newest, self.listeners = newest, []
        super().__init__(Buffer=lambda: self, TransformListener=self.listen)

    def listen(self, buffer, node):
        self.listeners.append((buffer, node))

    def lookup_transform(self, target, source, time):
        assert isinstance(time, Time)
        if (target, source) != ("map", "odom"):
            raise self.TransformException(f'"{source}" passed to lookupTransform does not exist.\n')
        if time.nanoseconds > self.newest:
            raise self.ExtrapolationException("Lookup would require extrapolation into the future.\n Details")
        found = TransformStamped(transform=QUARTER)
        found.header.stamp.sec, found.header.stamp.nanosec = divmod(self.newest, SECOND)
        return found


@pytest.mark.parametrize(("late", "is_found"), [(-1.0, True), (0.0, True), (0.29, True), (0.31, False)])
def test_the_newest_transform_may_be_older_than_the_goal_by_the_tolerance(late, is_found):
    newest = 50 * SECOND
    transforms = Tf2Transforms(FakeTf2(newest), "node", 0.3)
    stamp = newest + round(late * SECOND)
    if is_found:
        assert transforms.lookup("map", "odom", stamp) is QUARTER
        return
    with pytest.raises(BadMessageError, match=r"^no transform: 'odom' to 'map': Lookup .* future\. Details$"):
        transforms.lookup("map", "odom", stamp)
