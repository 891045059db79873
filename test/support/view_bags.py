"""Bags for the report, written by rosbags: a robot on a circle of 1 m radius, with selectable topics."""

import math
import random
from types import SimpleNamespace

import numpy as np
from bag_makers import BEGIN, data_of, write_rosbags

from diffbot_bag.messages import make

LABELS = ("stamp", "rho", "alpha", "beta", "theta", "eps_P", "region", "V")
SIGMA = 0.05
"""[m], [rad] of the estimate"""
SPEED = 0.5
"""[m/s]"""
HOSTILE = '</script><script>globalThis.broken = 1</script><img src=x onerror="globalThis.broken = 1">\u2028'
DELAY = 2_000_000
"""[ns] between stamp and log time"""


def header(time, frame="map"):
    return {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}, "frame_id": frame}


def quaternion(yaw):
    return {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}


def pose(x, y, yaw):
    return {"position": {"x": x, "y": y}, "orientation": quaternion(yaw)}


def twist(v, omega):
    return {"linear": {"x": v}, "angular": {"z": omega}}


def covariance(sigma):
    return np.diag([sigma**2] * 6).ravel()


def message(kind, /, **fields):
    """Return type and message; fields that are not given are zero or empty."""
    return kind, make(kind, **fields)


def estimate(time, x, y, yaw, sigma=SIGMA):
    place = {"pose": pose(x, y, yaw), "covariance": covariance(sigma)}
    return message("geometry_msgs/msg/PoseWithCovarianceStamped", header=header(time), pose=place)


def odometry(time, x, y, yaw, v=SPEED, omega=SPEED, frame="map"):
    moving = {"twist": twist(v, omega), "covariance": covariance(0.01)}
    fields = {"header": header(time, frame), "child_frame_id": "base_link", "pose": {"pose": pose(x, y, yaw)}}
    return message("nav_msgs/msg/Odometry", **fields, twist=moving)


def goal(time, x, y, yaw):
    return message("geometry_msgs/msg/PoseStamped", header=header(time), pose=pose(x, y, yaw))


def command(v, omega):
    return message("geometry_msgs/msg/Twist", **twist(v, omega))


def law(time, rho, region):
    dims = [{"label": label, "size": 1, "stride": 1} for label in LABELS]
    data = [time * 1e-9, rho, 0.1, 0.2, 0.3, 0.4, region, rho**2]
    return message("std_msgs/msg/Float64MultiArray", layout={"dim": dims}, data=data)


def status(name, text, level=0, **values):
    pairs = [{"key": key.replace("_", " "), "value": value} for key, value in values.items()]
    return message("diagnostic_msgs/msg/DiagnosticStatus", level=level, name=name, message=text, values=pairs)


def statuses(time, *parts):
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    return message(kind, header=header(time, ""), status=[part for _, part in parts])


def log(time, name, text, level=40):
    stamp = header(time)["stamp"]
    return message("rcl_interfaces/msg/Log", stamp=stamp, level=level, name=name, msg=text, line=1)


def transforms(time, *edges):
    """Return a TFMessage of (parent, child, x, y, yaw)."""
    made = [
        {
            "header": header(time, parent),
            "child_frame_id": child,
            "transform": {"translation": {"x": x, "y": y}, "rotation": quaternion(yaw)},
        }
        for parent, child, x, y, yaw in edges
    ]
    return message("tf2_msgs/msg/TFMessage", transforms=made)


def path(time, *points, frame="map"):
    """Return a Path through points (x, y), whose poses do not have stamps."""
    poses = [{"pose": pose(*point, 0.0)} for point in points]
    return message("nav_msgs/msg/Path", header=header(time, frame), poses=poses)


def cloud(time, *landmarks, frame="base_link"):
    """Return a PointCloud2 of landmarks (number, x, y) or (number, x, y, variance of the range)."""
    layout = [("id", "<u2"), ("x", "<f8"), ("y", "<f8"), ("range_variance", "<f4")]
    data = np.array([(*one, 0.01)[:4] for one in landmarks], layout)
    fields = [
        {"name": name, "offset": offset, "datatype": number, "count": 1}
        for (name, _), offset, number in zip(layout, (0, 2, 10, 18), (4, 8, 8, 7), strict=True)
    ]
    sizes = {"height": 1, "width": len(data), "point_step": 22, "row_step": 22 * len(data), "is_dense": True}
    content = np.frombuffer(data.tobytes(), np.uint8)
    return message("sensor_msgs/msg/PointCloud2", header=header(time, frame), fields=fields, data=content, **sizes)


def write(folder, messages):
    """Write messages (topic, log time [ns], (type, message)) in this order."""
    messages = list(messages)
    kinds = {topic: kind for topic, _, (kind, _) in messages}
    return write_rosbags(folder, ((topic, time, data_of(one)) for topic, time, one in messages), kinds)


def at(step, rate=50):
    """Return stamp [ns] and true pose of a step on the circle."""
    angle = SPEED * step / rate
    return BEGIN + step * 10**9 // rate, math.cos(angle), math.sin(angle), angle + math.pi / 2


def drive(steps=500, rate=50, namespace="", error=(0.03, -0.02, 0.01)):
    """Yield the messages of a drive: two goals, a switch of the region, a rejected fix, the end of the first goal."""
    robot = SimpleNamespace(**{name: f"{namespace}/{name}" for name in ("pose", "odom", "cmd_vel", "ground_truth")})
    half, end = steps // 2, steps - 1
    for step in range(steps):
        time, x, y, yaw = at(step, rate)
        later = time + DELAY
        yield robot.ground_truth, later, odometry(time, x, y, yaw)
        yield robot.pose, later, estimate(time, x + error[0], y + error[1], yaw + error[2])
        yield f"{namespace}/controller/navigation", later, law(time, 2.0 - step / steps, float(half <= step < end))
        yield robot.odom, later, odometry(time, x - 1.0, y, yaw, frame="odom")
        yield robot.cmd_vel, later, command(SPEED, SPEED)
        if step in (0, half):
            number = 1 if step == 0 else 2
            yield f"{namespace}/goal_pose", later, goal(0 if step == 0 else time, float(number), 0.5, 0.25)
            yield f"{namespace}/ekf/status", later, filter_status(f"{namespace}/ekf", number)
            values = {"goal": f"{number} 0.5 0.25", "goal_id": ("a", "b")[number - 1] * 32}
            yield f"{namespace}/controller/status", later + 1, status(f"{namespace}/controller", "driving", **values)
    ends = [
        status("a" * 32, "reached", source="goal_pose"),
        status("b" * 32, "not reached", 1, reason=HOSTILE, source="goal_pose"),
    ]
    yield f"{namespace}/controller/goal_results", BEGIN + half * 10**9 // rate - 1, statuses(0, ends[0])
    yield f"{namespace}/controller/goal_results", BEGIN + steps * 10**9 // rate, statuses(0, *ends)


def filter_status(name, number):
    values = {
        "NIS per number": f"{0.9 + 0.1 * number:.3f}",
        "NIS 95 % bounds": "0.700 1.300",
        "autocorrelation of fixes": "0.020",
        "autocorrelation of fixes, 95 % bound": "0.150",
        "left wheel radius error": "+0.0100 +- 0.0020",
        "right wheel radius error": "-0.0200 +- 0.0020",
        "fixes rejected": str(number - 1),
    }
    return status(name, "running", **values)


def irregular(seconds=20.0, seed=3):
    """Return topic, log time, sequence and (type, message), with late stamps, a gap, a decreasing stamp and losses."""
    chance = random.Random(seed)
    rows = []
    for number in range(int(seconds * 50)):
        if 200 <= number < 230:
            continue  # a gap of 0.62 s
        time = BEGIN + number * 20_000_000 + chance.randrange(1_000_000)
        delay = int(1e6 * chance.lognormvariate(1.0, 0.8))
        back = 60_000_000 if number == 500 else 0
        rows.append(("/odom", time, number + 1, odometry(time - delay - back, 1.0, 2.0, 0.3)))
        if number % 5 == 0:
            rows.append(("/pose", time + 7, number // 5, estimate(0 if number < 10 else time + 3_000_000, 1, 2, 3)))
        if number % 2:
            rows.append(("/cmd_vel", time + 9, 0, command(0.1, math.sin(number))))
    return sorted(rows, key=lambda row: row[1])
