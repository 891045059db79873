"""The record button: its answers agree with the files, and a recorder that fails is reported."""

import queue
import sys

import graph
import pytest

from diffbot_bag.bag import BagReader
from diffbot_tools.watch.recording import RECORDER, PageRecording

FAKE = """
import json, pathlib, signal, sys, time
bag = pathlib.Path(json.loads(sys.argv[-1].partition(":=")[2]))
def make():
    bag.mkdir()
    (bag / "bag_0.mcap").touch()
"""
"""First lines of a program that replaces the recorder."""


@pytest.fixture
def folder(tmp_path):
    return tmp_path / 'it\'s a "bag" \U0001f916'


class Button:
    def __init__(self, folder, command):
        self._answers = queue.Queue()
        self.recording = PageRecording(folder, lambda: None, command)

    def press(self, is_on):
        self.recording.add(is_on, lambda *answer: self._answers.put(answer))

    def answer(self):
        return self._answers.get(timeout=graph.PATIENCE)


@pytest.fixture
def button(folder):
    made = []

    def make(program=None, command=RECORDER):
        made.append(Button(folder, command if program is None else (sys.executable, "-c", FAKE + program)))
        return made[-1]

    yield make
    for one in made:
        one.recording.close()


@pytest.mark.graph
def test_on_and_off_at_once_writes_a_complete_bag_into_a_folder_of_any_name(button, folder):
    on_off = button()
    on_off.press(True)
    on_off.press(False)
    (first, level), second = on_off.answer(), on_off.answer()
    (bag,) = folder.iterdir()
    assert (first, level) == (f"recording to {bag}", 0)
    assert second == (f"recorded {bag}", 0)
    with BagReader(bag) as reader:
        assert "/rosout" in reader.topics
    assert on_off.recording.problem == ""


@pytest.mark.graph
def test_a_recorder_outlives_the_request_and_is_closed_with_the_page(button, folder):
    """The system ends a bound process together with the thread that started it."""
    closed = button()
    closed.press(True)
    closed.answer()
    (bag,) = folder.iterdir()
    graph.wait_for(lambda: next(bag.glob("*.mcap")).stat().st_size > 1000, what="a flush")
    assert closed.recording.is_on
    closed.recording.close()
    assert (bag / "metadata.yaml").is_file()


def test_a_recorder_that_cannot_start_is_reported_with_its_error(button):
    broken = button("print('error: no space', file=sys.stderr); print('bye'); sys.exit(3)")
    broken.press(True)
    text, level = broken.answer()
    assert level == 2
    assert text.startswith("cannot record to ")
    assert text.endswith("no bag, the recorder ended with status 3: error: no space")
    assert broken.recording.problem == text
    broken.press(False)
    assert broken.answer() == (text, 2)


def test_a_bag_that_the_recorder_did_not_close_is_not_complete(button, folder):
    one = button("signal.signal(signal.SIGINT, lambda *_: sys.exit(0)); make()\nwhile True: time.sleep(600)")
    one.press(True)
    one.answer()
    (bag,) = folder.iterdir()
    one.press(False)
    words = f"the bag {bag} is not complete: the recorder ended with status 0: it logged nothing"
    assert one.answer() == (words, 2)
