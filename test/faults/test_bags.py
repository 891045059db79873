"""Hostile and damaged bags: every command that reads a bag ends in bounded time and memory, and changes nothing."""

import gc
import random
import shutil

import bag_commands
import hostile_bags
import pytest
from repeated import tried

from diffbot_bag.bag.writer import BagWriter

NAMES = sorted(bag_commands.bag_commands() - set(bag_commands.GRAPH))
TOGETHER = 10
"""mutated bags read in one forked process: to fork takes as long as three commands"""
REPLAYED = ("other_type_rosout", "topic_0", "indexed", "extreme_7")


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Write the inputs besides the bag, and let every command run once, so that all is imported before a fork."""
    folder = hostile_bags.given_files(
        tmp_path_factory.mktemp("bags") / "given", bag_commands.CONTRACT, bag_commands.PARAMETERS
    )
    found = bag_commands.problems_of(folder / "other", folder, NAMES, folder.parent / "warm")
    assert [one for one in found if one[1]] == []
    # What the garbage collector touches is copied in each fork.
    gc.freeze()
    yield folder
    gc.unfreeze()


def test_every_command_on_bags_is_known():
    """A new command is added to ARGUMENTS, and is then tried on all bags."""
    assert bag_commands.bag_commands() == set(bag_commands.ARGUMENTS)


def complaints(bags, given, folder):
    """Run all commands on bags in one fork; return what is wrong."""
    found = bag_commands.in_fork(
        lambda: [bag_commands.problems_of(bag, given, NAMES, folder / str(n)) for n, bag in enumerate(bags)],
        len(bags) * len(NAMES) * 2 * bag_commands.CPU,
    )
    shutil.rmtree(folder, ignore_errors=True)
    if isinstance(found, str):
        return [f"{[bag.name[:60] for bag in bags]}: {found}"]
    both = zip(bags, found, strict=True)
    return [f"{bag.name[:60]}: {one}" for bag, problems in both for one in problems if one[1]]


def mutated(path, number, originals):
    """Write a damaged bag."""
    rng = random.Random(number)
    path.write_bytes(hostile_bags.mutated(rng, rng.choice(originals)))
    return path


@tried(10_000, once=15)
def test_mutated_bags(given, trials, tmp_path):
    originals = hostile_bags.seeds(tmp_path)
    for begin in range(0, trials.count, TOGETHER):
        numbers = range(begin, min(begin + TOGETHER, trials.count))
        bags = [mutated(tmp_path / f"mutated_{number}.mcap", number, originals) for number in numbers]
        assert complaints(bags, given, tmp_path / "work") == []
        for bag in bags:
            bag.unlink()


@pytest.mark.parametrize("full", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_crafted_bags(full, given, tmp_path):
    (tmp_path / "crafted").mkdir()
    for bag in hostile_bags.crafted(tmp_path / "crafted", full=full):
        assert complaints([bag], given, tmp_path / "work") == []


def test_a_bag_that_is_being_recorded(given, tmp_path):
    writer = BagWriter(tmp_path / "live")
    channel = writer.add_topic("/odom", "nav_msgs/msg/Odometry")
    for time in range(5):
        writer.write(channel, bytes(100), time, time)
    writer.flush()
    assert complaints([tmp_path / "live"], given, tmp_path / "work") == []
    status, _, error, _ = bag_commands.run(["bag", "repair", str(tmp_path / "live"), "--in-place"])
    assert (status, error.count("\n")) == (1, 1)
    assert "is being recorded" in error
    writer.close()


@tried(100, once=2)
def test_replayed_bags(trials, tmp_path):
    folder = tmp_path / "crafted"
    folder.mkdir()
    made = {bag.stem: bag for make in (hostile_bags.evil_names, hostile_bags.extreme_values) for bag in make(folder)}
    originals = hostile_bags.seeds(tmp_path)
    chosen = [made[name] for name in REPLAYED if name in made]
    for number in trials:
        bag = chosen[number] if number < len(chosen) else mutated(tmp_path / "mutated.mcap", number, originals)
        complaint, _ = bag_commands.replayed(bag)
        assert not complaint
