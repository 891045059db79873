"""Bags as other makers write them, in rosbag2's layout: by the mcap library in many chunks, by rosbags."""

import math
import random
from collections import Counter

import bag_makers
import yaml
from bag_makers import BEGIN
from view_bags import command, data_of, estimate, odometry

QOS = """\
- history: 1
  depth: 10
  reliability: {reliability}
  durability: {durability}
  deadline: {{sec: 9223372036, nsec: 854775807}}
  lifespan: {{sec: 9223372036, nsec: 854775807}}
  liveliness: 1
  liveliness_lease_duration: {{sec: 9223372036, nsec: 854775807}}
  avoid_ros_namespace_conventions: false
"""


def qos(reliability=1, durability=2, publishers=1):
    """Text of rosbag2 up to version 8, with numbers for policies; 1, 2: reliable, volatile."""
    return QOS.format(reliability=reliability, durability=durability) * publishers


def irregular(seconds=20.0, seed=3):
    """Topic, log time, sequence, (type, message): late stamps, one gap, one stamp before the last, lost numbers."""
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


def write_mcap(path, rows, offers=None, **options):
    """Write one file with the mcap library."""
    rows = list(rows)
    topics = {
        topic: (kind, {"offered_qos_profiles": (offers or {}).get(topic, qos())}) for topic, _, _, (kind, _) in rows
    }
    messages = ((topic, time, data_of(message), time, sequence) for topic, time, sequence, message in rows)
    bag_makers.write_mcap(path, topics, messages, chunk_size=20_000, **options)


def write_folder(folder, rows, compression="zstd", files=1, custom_data=None, offers=None):
    """Write a folder of rosbag2 with the mcap library, the messages cut into this many files."""
    folder.mkdir()
    rows = list(rows)
    size = -(-len(rows) // files)
    names = [f"{folder.name}_{number}.mcap" for number in range(files)]
    for number, name in enumerate(names):
        write_mcap(folder / name, rows[number * size : (number + 1) * size], compression=compression, offers=offers)
    topics = {topic: kind for topic, _, _, (kind, _) in rows}
    start, end = (pick(row[1] for row in rows) for pick in (min, max))
    offered = {topic: (offers or {}).get(topic, qos()) for topic in topics}
    described = {
        topic: {
            "name": topic, "type": kind, "serialization_format": "cdr", "offered_qos_profiles": offered[topic],
            "type_description_hash": "",
        }
        for topic, kind in topics.items()
    }  # fmt: skip
    counts = Counter(topic for topic, *_ in rows)
    inner = {
        "version": 8, "storage_identifier": "mcap", "message_count": len(rows), "custom_data": custom_data,
        "duration": {"nanoseconds": end - start}, "starting_time": {"nanoseconds_since_epoch": start},
        "topics_with_message_count": [
            {"topic_metadata": described[topic], "message_count": counts[topic]} for topic in topics
        ],
        "compression_format": "", "compression_mode": "", "relative_file_paths": names, "files": [],
        "ros_distro": "jazzy",
    }  # fmt: skip
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": inner}))
    return folder
