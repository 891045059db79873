"""The filter in the graph: what it fuses, what it says of itself, and what it keeps across a restart."""

import json
import math
from collections import Counter

import graph
import numpy as np
import pytest
from filter_input import fix, heading, odometry
from graph import values
from lockstep_drive import go
from nav_msgs.msg import Odometry
from robot import DEEP, distance, lockstep, planar, robot, stamp, turned
from sensor_msgs.msg import PointCloud2, PointField
from std_srvs.srv import Trigger

from diffbot_control.law.presets import PRESETS
from diffbot_core.geometry import Pose
from diffbot_core.schema import build
from diffbot_sim.model.simulator import WorldConfig
from diffbot_sim.reference_loop import simulate

LANDMARKS = {"landmark_ids": [7, 3, -2], "landmark_x": [3.0, -4.0, 0.5], "landmark_y": [2.0, 1.0, -3.0]}


def seen(number, pose):
    """x, y of a landmark as a robot at ``pose`` has it."""
    index = LANDMARKS["landmark_ids"].index(number)
    dx, dy = LANDMARKS["landmark_x"][index] - pose[0], LANDMARKS["landmark_y"][index] - pose[1]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return c * dx + s * dy, c * dy - s * dx


def cloud(time, points, names=("x", "y", "id"), frame="base_link"):
    """A cloud written with numpy alone: float64 x, y and whatever else, uint16 id, in any order, with gaps."""
    kinds = {"id": ("<u2", 4)}
    dtype = np.dtype([part for name in names for part in ((name, kinds.get(name, ("<f8", 8))[0]), (f"_{name}", "<u4"))])
    data = np.zeros(len(points), dtype)
    for name, column in zip(names, zip(*points, strict=True), strict=True):
        data[name] = column
    message = PointCloud2(height=1, width=len(points), point_step=dtype.itemsize, row_step=data.nbytes)
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(time * 1e9), 10**9)
    message.fields = [
        PointField(name=name, offset=dtype.fields[name][1], datatype=kinds.get(name, ("<f8", 8))[1], count=1)
        for name in names
    ]
    message.data = data.tobytes()
    return message


class Filter:
    """An ekf node alone, with the test as its sensors."""

    def __init__(self, running):
        self.running, self.peer = running, running.peer
        self.publishers = {}
        self.time = 1000.0

    def send(self, topic, message):
        if topic not in self.publishers:
            self.publishers[topic] = self.peer.publisher(type(message), topic, DEEP)
            self.peer.wait_for_subscribers(self.publishers[topic])
        self.publishers[topic].publish(message)

    def move(self, v=0.0, omega=0.0, dt=0.1):
        """Send the next odometry and return the pose that answers it."""
        self.time = round(self.time + dt, 6)
        self.send("odom", odometry(self.time, v, omega))
        when = round(self.time * 1e9)
        answer = self.peer.spin_until(
            lambda: next((one for one in reversed(self.running.poses) if stamp(one) == when), None), 5.0, "a pose"
        )
        return np.array(planar(answer.pose.pose)), np.array(answer.pose.covariance).reshape(6, 6)[:2, :2]

    def status(self):
        self.running.catch_up()
        before = len(self.running.ekf_states)
        self.peer.spin_until(lambda: len(self.running.ekf_states) > before, 5.0, "a status")
        return values(self.running.ekf_states[-1])


def alone(parameters=None):
    return robot(ekf={"reliable_inputs": True, **(parameters or {})}, only=("ekf",))


def settle(subject, x=1.0, y=2.0, theta=0.5):
    """Give the filter its first fix and have it answer."""
    subject.send("global_pose", fix(subject.time, x, y, theta))
    subject.peer.spin_until(lambda: tried(subject), 10.0, "the first pose")


def tried(subject):
    subject.time = round(subject.time + 0.01, 6)
    before = len(subject.running.poses)
    subject.send("odom", odometry(subject.time, 0.0, 0.0))
    subject.peer.spin_for(0.05)
    return len(subject.running.poses) > before


def test_landmarks_in_the_graph_do_what_they_do_without_ros():
    goal = (0.0, 0.0, 0.0)
    plant = {"seed": 8, "fix_rate": 1.0, "landmark_rate": 5.0, **LANDMARKS}
    with lockstep(plant, ekf=LANDMARKS) as running:
        clouds = running.peer.subscribe(PointCloud2, "landmarks", DEEP)
        path = go(running, goal, 150)
        count = running.peer.spin_until(
            lambda: int(running.diagnosis("ekf").get("landmarks received", 0)), 5.0, "landmarks on /diagnostics"
        )
    assert count >= 75
    assert clouds[0].header.frame_id == "base_link"
    reference = simulate(build(WorldConfig, plant), PRESETS["tuned"], Pose(*goal), 150).truth
    without = simulate(build(WorldConfig, {"seed": 8, "fix_rate": 1.0}), PRESETS["tuned"], Pose(*goal), 150).truth
    seen = sorted(step for step in path if step <= 150)
    here = np.array([path[step] for step in seen])
    # Points come in single precision: 1e-7 of some metres, and what the loop makes of it.
    assert np.abs(here[:, :2] - reference[seen][:, :2]).max() < 1e-5
    assert np.abs(here[:, :2] - without[seen][:, :2]).max() > 0.01


def test_a_landmark_is_fused_by_its_number_and_strangers_are_counted():
    with alone({**LANDMARKS, "landmark_range_sigma": 0.02, "landmark_bearing_sigma": 0.01}) as running:
        subject = Filter(running)
        settle(subject, 1.1, 2.1, 0.05)
        truth = (1.0, 2.0, 0.0)
        for _ in range(20):
            points = [(*seen(number, truth), number) for number in (7, 3)]
            subject.send("landmarks", cloud(subject.time + 0.05, [*points, (1.0, 1.0, 99)]))
            subject.peer.spin_for(0.02)
            pose, P = subject.move()
        assert distance(pose, truth) < 0.02
        assert turned(pose, truth) < 0.02
        assert np.linalg.eigvalsh(P).max() < 0.02**2
        notes = running.diagnosis("ekf")
        assert int(notes["landmarks of unknown number"]) == 20
        assert "landmarks dropped" not in str(notes)


def bad_clouds(time):
    good = [(2.0, 0.5, 7)]
    lonely = cloud(time, good)
    lonely.fields = lonely.fields[:2]
    short = cloud(time, good)
    short.data = bytes(short.data)[:-1]
    wide = cloud(time, good)
    wide.width = 2**32 - 1
    tall = cloud(time, good)
    tall.height = 2
    outside = cloud(time, good)
    outside.fields[0].offset = outside.point_step - 4
    bare = PointCloud2(height=1, width=1)
    bare.header.frame_id = "base_link"
    variance = ("x", "y", "id", "range_variance", "bearing_variance")
    return [
        (cloud(time, good, frame="map"), "wrong frame_id"),
        (cloud(time, [(math.nan, 0.5, 7)]), "point not finite"),
        (cloud(time, [(2.0, math.inf, 7)]), "point not finite"),
        (cloud(time, [(0.0, 0.0, 7)]), "range not positive"),
        (cloud(time, [(2.0, 0.5, 7, -1.0, 1.0)], variance), "variance negative"),
        (lonely, "point fields missing"),
        (short, "cloud sizes contradict each other"),
        (tall, "cloud sizes contradict each other"),
        (wide, "too many points"),
        (outside, "point fields contradict point_step"),
        (bare, "point fields missing"),
    ]


def test_bad_clouds_are_dropped_and_change_nothing():
    with alone(LANDMARKS) as running:
        subject = Filter(running)
        settle(subject)
        before, P = subject.move()
        clouds = bad_clouds(subject.time)
        sent = Counter()
        # No more at a time than the queue holds.
        for part in (clouds[:6], clouds[6:]):
            for message, kind in part:
                subject.send("landmarks", message)
                sent[f"landmarks dropped: {kind}"] += 1

            def counted():
                notes = running.diagnosis("ekf")
                return {key: int(notes.get(key, 0)) for key in sent} == sent

            subject.peer.spin_until(counted, 10.0, f"the drops {sent}")
        after, P_after = subject.move()
        assert after == pytest.approx(before, abs=1e-9)
        np.testing.assert_allclose(P_after, P, atol=1e-4)


def test_variances_of_the_message_count_before_those_of_the_parameters():
    names = ("x", "y", "id", "range_variance", "bearing_variance")
    widths = []
    for variance in (1e-4, 1.0):
        with alone(LANDMARKS) as running:
            subject = Filter(running)
            settle(subject)
            for _ in range(5):
                points = [(*seen(number, (1.0, 2.0, 0.5)), number, variance, variance) for number in (7, 3)]
                subject.send("landmarks", cloud(subject.time + 0.05, points, names))
                subject.peer.spin_for(0.02)
                _, P = subject.move()
            widths.append(math.sqrt(np.linalg.eigvalsh(P).max()))
    assert widths[0] < 0.03
    assert widths[1] > 0.08


def without_covariance(message):
    message.pose.covariance[:] = 0.0
    return message


def test_a_fix_without_covariance_takes_the_parameters_if_there_are_some():
    with alone() as running:
        subject = Filter(running)
        subject.send("global_pose", without_covariance(fix(subject.time)))
        subject.peer.spin_until(
            lambda: "global_pose dropped: covariance is zero" in running.diagnosis("ekf"), 5.0, "the drop"
        )
    with alone({"global_pose_sigma_xy": 0.3, "global_pose_sigma_yaw": 0.1}) as running:
        subject = Filter(running)
        subject.send("global_pose", without_covariance(fix(subject.time)))
        subject.peer.spin_until(lambda: tried(subject), 10.0, "a pose")
        _, P = subject.move()
        np.testing.assert_allclose(P, np.diag([0.09, 0.09]), atol=0.002)
        assert running.diagnosis("ekf")["global_pose with the covariance of the parameters"] == "1"


def test_the_parameters_override_what_a_fix_claims_if_asked_to():
    parameters = {"global_pose_sigma_xy": 2.0, "global_pose_sigma_yaw": 0.1, "override_covariance": True}
    with alone(parameters) as running:
        subject = Filter(running)
        settle(subject)
        _, P = subject.move()
        np.testing.assert_allclose(P, np.diag([4.0, 4.0]), atol=0.01)


def test_status_tells_innovations_rejections_relocations_wheels_and_ages():
    with alone() as running:
        subject = Filter(running)
        settle(subject)
        for _ in range(10):
            subject.send("global_pose", fix(subject.time + 0.05))
            subject.peer.spin_for(0.02)
            subject.move()
        calm = subject.status()
        assert calm["filter"] == "ekf_calibrating"
        assert calm["fixes rejected"] == calm["relocations by fixes"] == "0"
        # The same fix again and again: innovations far smaller than their covariances.
        assert float(calm["NIS per number"]) < 0.05
        low, high = map(float, calm["NIS 95 % bounds"].split())
        assert 0.2 < low < 1.0 < high < 2.5
        assert calm["left wheel radius error"] == calm["right wheel radius error"] == "+0.0000 +- 0.0100"
        assert float(calm["odom age [s]"]) < float(calm["global_pose age [s]"]) + 1.0 < 30.0
        # Carried away: two fixes are rejected, the third is believed.
        for number in range(3):
            subject.send("global_pose", fix(subject.time + 0.05, 6.0, -2.0, 1.5 + 0.01 * number))
            subject.peer.spin_for(0.02)
            pose, _ = subject.move()
        assert pose == pytest.approx([6.0, -2.0, 1.51], abs=0.02)
        lost = subject.status()
        assert (lost["fixes rejected"], lost["relocations by fixes"]) == ("2", "1")
        subject.send("heading", heading(subject.time + 0.05, -1.0))
        subject.peer.spin_for(0.02)
        subject.move()
        assert subject.status()["headings rejected"] == "1"


def test_state_is_kept_across_a_restart_and_a_broken_file_is_set_aside(tmp_path):
    path = tmp_path / "state" / "ekf.json"
    parameters = {"state_file": str(path)}
    with alone(parameters) as running:
        subject = Filter(running)
        settle(subject, 3.0, -1.0, 2.0)
        # The right wheel is 2 % larger than thought: it drives a circle that odometry takes for a straight line.
        x, y, theta = 3.0, -1.0, 2.0
        for _ in range(150):
            v, omega = 1.01, 0.02 / 0.6
            x += 0.1 * v * math.cos(theta + 0.05 * omega)
            y += 0.1 * v * math.sin(theta + 0.05 * omega)
            theta += 0.1 * omega
            subject.send("global_pose", fix(round(subject.time + 0.1, 6), x, y, theta))
            pose, _ = subject.move(1.0, 0.0)
        subject.peer.spin_until(lambda: "state_file" not in running.processes["ekf"].output, 1.0, "no error")
        assert running.processes["ekf"].stop() == 0
    saved = json.loads(path.read_text())
    assert saved["wheels"][1] - saved["wheels"][0] == pytest.approx(0.02, abs=0.01)
    assert saved["pose"][:2] == pytest.approx(pose[:2], abs=0.2)
    assert sorted(one.name for one in path.parent.iterdir()) == ["ekf.json"]
    with alone(parameters) as running:
        subject = Filter(running)
        subject.time += 100.0
        subject.peer.spin_until(lambda: tried(subject), 10.0, "a pose without any fix")
        again, _ = subject.move()
        assert again == pytest.approx(saved["pose"], abs=1e-6)
        assert "state restored" in running.processes["ekf"].output
        assert subject.status()["right wheel radius error"].startswith(f"{saved['wheels'][1]:+.4f}")
    path.write_text('{"version": 1, "pose": [1, 2, "here"]}')
    with alone(parameters) as running:
        assert "state not restored" in running.processes["ekf"].output
        assert "pose holds no numbers" in running.processes["ekf"].output
        assert (path.parent / "ekf.json.bad").exists()


@pytest.mark.parametrize(("side", "seed"), [("left", 1), ("right", 2)])
def test_scenario_a_ends_inside_the_tolerances_with_a_wheel_that_is_two_percent_too_large(side, seed):
    goal = (0.0, 0.0, 0.0)
    with lockstep({"seed": seed, f"{side}_radius_error": 0.02}) as running:
        path = go(running, goal, 300)
        running.peer.spin_until(lambda: running.ekf_states, 5.0, "the filter's status")
        status = values(running.ekf_states[-1])
    last = path[max(path)]
    assert distance(last, goal) < 0.1
    assert abs(last[2]) < 0.1
    assert status["filter"] == "ekf_calibrating"


def test_initialpose_keeps_what_is_known_of_the_wheels(tmp_path):
    path = tmp_path / "ekf.json"
    P = [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]]
    content = {"version": 1, "pose": [0, 0, 0], "P": P, "wheels": [0.01, -0.01], "wheels_P": [[1e-6, 0], [0, 1e-6]]}
    content["geometry"] = [0.05, 0.6]
    path.write_text(json.dumps(content))
    with alone({"state_file": str(path)}) as running:
        subject = Filter(running)
        subject.send("initialpose", fix(subject.time, 4.0, 5.0, -1.0))
        running.processes["ekf"].wait_for_output("initialised at x 4.000")
        subject.peer.spin_until(lambda: tried(subject), 10.0, "a pose")
        pose, _ = subject.move()
        assert pose == pytest.approx([4.0, 5.0, -1.0], abs=1e-6)
        assert subject.status()["left wheel radius error"] == "+0.0100 +- 0.0010"


def test_a_restored_filter_waits_for_odometry_and_a_reset_is_not_undone_by_a_restart(tmp_path):
    path = tmp_path / "ekf.json"
    P = [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]]
    content = {"version": 1, "pose": [2, 1, 0.5], "P": P, "geometry": [0.05, 0.7], "wheels": [0.01, 0.0]}
    path.write_text(json.dumps({**content, "wheels_P": [[1e-6, 0], [0, 1e-6]]}))
    with alone({"state_file": str(path)}) as running:
        subject = Filter(running)
        # Found with another separation: the pose is taken, the wheels are not.
        assert "wheel errors not restored" in running.processes["ekf"].output
        assert subject.status()["left wheel radius error"] == "+0.0000 +- 0.0100"
        assert running.ekf_states[-1].message == "no odometry"
        subject.peer.spin_until(lambda: tried(subject), 10.0, "a pose without any fix")
        assert subject.peer.call(Trigger, "ekf/reset").success
        assert not path.exists()
        assert running.processes["ekf"].stop() == 0
    assert not path.exists()


def test_a_state_file_that_is_a_folder_is_refused_and_left_alone(tmp_path):
    (tmp_path / "maps").mkdir()
    with graph.node("diffbot_control.ekf_node", {"state_file": str(tmp_path / "maps")}) as process:
        assert process.wait() == 1
        assert process.output.strip().splitlines()[-1].startswith("error: state_file = ")
    assert [one.name for one in tmp_path.iterdir()] == ["maps"]


def test_initialpose_counts_as_it_says_whatever_is_overridden():
    parameters = {"global_pose_sigma_xy": 0.01, "global_pose_sigma_yaw": 0.01, "override_covariance": True}
    with alone(parameters) as running:
        subject = Filter(running)
        subject.send("initialpose", fix(subject.time))
        running.processes["ekf"].wait_for_output("initialised at")
        subject.peer.spin_until(lambda: tried(subject), 10.0, "a pose")
        _, P = subject.move()
        np.testing.assert_allclose(P, np.diag([0.03, 0.03]), atol=0.002)


def test_the_filtered_twist_is_that_of_the_wheels_as_they_are(tmp_path):
    path = tmp_path / "ekf.json"
    P = [[1e-4, 0, 0], [0, 1e-4, 0], [0, 0, 1e-4]]
    content = {"version": 1, "pose": [0, 0, 0], "P": P, "geometry": [0.05, 0.6], "wheels": [0.02, 0.02]}
    path.write_text(json.dumps({**content, "wheels_P": [[1e-8, 0], [0, 1e-8]]}))
    with alone({"state_file": str(path)}) as running:
        filtered = running.peer.subscribe(Odometry, "odometry/filtered", DEEP)
        subject = Filter(running)
        subject.peer.spin_until(lambda: tried(subject), 10.0, "a pose without any fix")

        def heard():
            subject.move(0.5)
            return filtered

        subject.peer.spin_until(heard, 5.0, "odometry/filtered")
        before, _ = subject.move(0.5)
        after, _ = subject.move(0.5)
        subject.peer.spin_until(lambda: stamp(filtered[-1]) == round(subject.time * 1e9), 5.0, "its twist")
        moved = math.hypot(after[0] - before[0], after[1] - before[1])
        assert moved == pytest.approx(0.051, abs=1e-4)
        assert filtered[-1].twist.twist.linear.x == pytest.approx(0.51, abs=1e-3)
