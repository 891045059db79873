"""Convert a drive of the MR.CLAM data set to a bag, for ``diffbot refilter``, ``calibrate`` and ``report``.

    python examples/import_mrclam.py FOLDER ROBOT BAG

FOLDER contains the text files of a set, e.g. MRCLAM_Dataset7; ROBOT is 1 to 5. The data set is described in Leung,
Halpern, Barfoot, Liu, Int. J. Robotics Research 30 (2011) 969-974, and the bag in docs/how-to/calibrate.md.
"""

import sys
from decimal import Decimal
from functools import partial
from pathlib import Path

import numpy as np
import yaml

from diffbot_bag.messages import encode, make
from diffbot_bag.qos import Qos
from diffbot_bag.writer import new_bag
from diffbot_control.filter.models import move
from diffbot_control.ros.messages.fields import fill_pose, fill_twist, fill_unestimated, set_stamp
from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint, fill_landmark_points
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_tools.filter_statistics import Trajectory, poses_at

# Messages with equal stamps are written in this order. Odometry is last, because the filter publishes a pose after it.
ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped"
CLOUD, FIELD = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/PointField"
TOPICS = {"/initialpose": POSE, "/landmarks": CLOUD, "/ground_truth": ODOMETRY, "/odom": ODOMETRY}
PARAMETERS = {  # of the node ekf, for all robots
    "wheel_separation": 0.26, "wheel_radius": 0.033, "wheels_as_configured": 0.0,  # [m] of the iRobot Create
    # The data set has velocity commands in place of odometry, with scale errors of about 10 % and a dead time.
    "wheel_radius_sigma": 0.1, "wheel_separation_sigma": 0.1, "odometry_delay": 0.25,
    # The errors of the camera are correlated in time, and some markers are misread.
    "landmark_range_offset": 0.04, "landmark_range_scale": 0.025, "correlation_times": [0.0, 0.0, 1.0],
    "gate_probability": 0.99,
}  # fmt: skip
SIGMA, SIGMA_PER_METRE, BEARING_SIGMA = 0.03, 0.025, 0.02  # [m], [m/m], [rad] errors of the camera


def number(word, low=-1e4, high=1e4):
    """Convert a word to a number; raise ValueError if the number is out of range."""
    if low <= (value := float(word)) <= high:
        return value
    raise ValueError


def stamp(word):
    """Convert a time [s] to [ns] without the rounding of a float."""
    return round(Decimal(word) * 10**9) if number(word, 0.0, 2.0**31 - 1.0) else 0


def rows(path, *columns):
    """Yield the values of each line; each column has a function that converts its words. # begins a comment."""
    for count, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
        try:
            if words := line.partition("#")[0].split():
                yield tuple(convert(word) for convert, word in zip(columns, words, strict=True))
        except ValueError:
            allowed = f"must be {len(columns)} numbers within their allowed ranges"
            raise DiffbotError(f"{path}, line {count}: {line[:80]!r} {allowed}") from None


def clouds_of(measured, subjects, landmarks):
    """Return stamp and points of each cloud. A second measurement of a landmark at the same time begins a new cloud."""
    clouds = []
    for time, barcode, depth, bearing in sorted(dict.fromkeys(measured), key=lambda row: row[0]):
        if (subject := subjects.get(barcode)) in landmarks:  # otherwise the barcode is of another robot, or misread
            if not clouds or clouds[-1][0] != time or subject in {point.number for point in clouds[-1][1]}:
                clouds.append((time, []))
            # The range in the file is the depth along the axis of the camera.
            distance = depth / np.cos(bearing)
            variance = (SIGMA + SIGMA_PER_METRE * distance) ** 2
            clouds[-1][1].append(LandmarkPoint(subject, distance, bearing, variance, BEARING_SIGMA**2))
    return clouds


def messages(clouds, truth, commands):
    """Yield stamp, index of the topic in TOPICS, and CDR bytes of each message, not sorted by stamp."""
    initial = make(POSE, header={"frame_id": "map"})
    true, driven = (make(ODOMETRY, header={"frame_id": frame}, child_frame_id="base_link") for frame in ("map", "odom"))
    initial.pose.covariance[[0, 7, 35]], true.pose.covariance[[0, 7, 35]] = 1e-4, 1e-6
    true.twist.covariance[::7] = 1e6
    fill_unestimated(initial.pose.covariance)
    fill_unestimated(true.pose.covariance)

    def encoded(topic, message, time, pose):
        set_stamp(message.header.stamp, time)
        fill_pose(message.pose.pose, Pose(*pose))
        return time, topic, encode([*TOPICS.values()][topic], message)

    times, poses = sorted(commands), np.array(list(truth.values())).reshape(-1, 3)
    poses[:, 2] = np.unwrap(poses[:, 2])
    first_poses = poses_at(np.array(times), Trajectory(np.array(list(truth)), poses))
    known = np.isfinite(first_poses[:, 0])
    if not known.any():
        raise DiffbotError("the times of odometry and ground truth do not overlap")
    start, last = times[known.argmax()], times[0]
    yield encoded(0, initial, start, first_poses[known.argmax()])
    for time, points in clouds:
        message = make(CLOUD, header={"frame_id": "base_link"})
        set_stamp(message.header.stamp, time)
        fill_landmark_points(message, points, partial(make, FIELD))
        message.data = np.frombuffer(message.data, np.uint8)
        yield time, 1, encode(CLOUD, message)
    yield from (encoded(2, true, time, pose) for time, pose in truth.items())
    # A command holds until the next command, so the mean twist before each time is the previous command.
    pose = Pose(0.0, 0.0, 0.0)
    for time in times:
        if time >= start:
            pose = move(pose, commands[last], (time - max(last, start)) * 1e-9)
            fill_twist(driven.twist.twist, commands[last])
            yield encoded(3, driven, time, pose)
        last = time


folder, robot, out = sys.argv[1:] if len(sys.argv) == 4 else sys.exit(__doc__)
measured, true, driven = (f"Robot{robot}_{name}.dat" for name in ("Measurement", "Groundtruth", "Odometry"))
try:
    landmarks = {subject: xy for subject, *xy in rows(Path(folder, "Landmark_Groundtruth.dat"), int, *[number] * 4)}
    subjects = {barcode: subject for subject, barcode in rows(Path(folder, "Barcodes.dat"), int, int)}
    depth, bearing = (lambda word: number(word, 1e-3)), (lambda word: number(word, -1.5, 1.5))
    clouds = clouds_of(rows(Path(folder, measured), stamp, int, depth, bearing), subjects, landmarks)
    truth = {time: pose for time, *pose in sorted(rows(Path(folder, true), stamp, *[number] * 3))}
    # If several commands have the same time, the first one is used.
    commands = {time: Twist(*twist) for time, *twist in reversed([*rows(Path(folder, driven), stamp, number, number)])}
    ekf = PARAMETERS | {"landmark_ids": [*landmarks], "landmark_x": [x for x, *_ in landmarks.values()]}
    ekf["landmark_y"] = [y for _, y, *_ in landmarks.values()]
    with new_bag(Path(out)) as writer:
        (writer.folder / "ekf.yaml").write_text(yaml.safe_dump({"/**/ekf": {"ros__parameters": ekf}}))
        channels = [writer.add_topic(name, kind, (Qos(),)) for name, kind in TOPICS.items()]
        for time, topic, data in sorted(messages(clouds, truth, commands), key=lambda one: one[:2]):
            writer.write(channels[topic], data, time, time)
except (DiffbotError, OSError) as error:
    sys.exit(f"import_mrclam: {error}")
