"""The moving picture: the typical run, the robots' outlines, and the file."""

import math

import matplotlib.image
import numpy as np

from diffbot_lab.arena.animation import Drive, typical_run, write_movie


def drive(label, settled, count=601):
    poses = np.zeros((count, 3))
    poses[:, 0] = np.linspace(-4.0, 0.0, count)
    return Drive(label, poses, settled)


def test_the_typical_run_is_near_the_median_of_every_law():
    settled = np.array([(9.0, 10.0, 11.0, 10.2, 30.0), (5.0, 20.0, 12.0, 12.5, 13.0)])
    assert typical_run(settled) == 3
    settled[0, 3] = math.nan
    assert typical_run(settled) == 2


def test_the_file_is_an_endless_picture_in_real_time(tmp_path):
    path = tmp_path / "run.gif"
    write_movie([drive("ours", 0.3, 5), drive("theirs", math.nan, 5)], 0.1, path)
    content = path.read_bytes()
    assert b"NETSCAPE2.0\x03\x01\x00\x00" in content
    # Each frame has a control block with its duration, here 10 hundredths of a second.
    assert content.count(b"\x21\xf9\x04") == 5
    first = content.index(b"\x21\xf9\x04")
    assert int.from_bytes(content[first + 4 : first + 6], "little") == 10
    assert matplotlib.image.imread(path, format="gif").std() > 0.0
