"""Hostile and damaged bags: every command that reads a bag ends in bounded time and memory, and changes nothing."""

import gc
import random
import shutil

import bag_commands
import hostile_bags
import pytest

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


def add_trials(running, bags, given, folder):
    """Run all commands on bags in one fork; add the longest processor time of each, and keep the complaints."""
    found = bag_commands.in_fork(
        lambda: [bag_commands.problems_of(bag, given, NAMES, folder / str(n)) for n, bag in enumerate(bags)],
        len(bags) * len(NAMES) * 2 * bag_commands.CPU,
    )
    shutil.rmtree(folder, ignore_errors=True)
    if isinstance(found, str):
        running.add(None, kept=False, count=len(bags))
        return [f"{[bag.name[:60] for bag in bags]}: {found}"]
    complaints = []
    for bag, problems in zip(bags, found, strict=True):
        wrong = [f"{bag.name[:60]}: {one}" for one in problems if one[1]]
        running.add(max(seconds for *_, seconds in problems), kept=not wrong)
        complaints += wrong
    return complaints


def test_mutated_bags(given, trials, tmp_path):
    originals = hostile_bags.seeds(tmp_path)
    complaints = []
    with trials("mutated bags") as running:
        numbers = list(running)
        for begin in range(0, len(numbers), TOGETHER):
            bags = []
            for number in numbers[begin : begin + TOGETHER]:
                rng = random.Random(number)
                bags.append(tmp_path / f"mutated_{number}.mcap")
                bags[-1].write_bytes(hostile_bags.mutated(rng, rng.choice(originals)))
            complaints += add_trials(running, bags, given, tmp_path / "work")
            for bag in bags:
                bag.unlink()
        assert complaints == []


def test_crafted_bags(given, trials, tmp_path, pytestconfig):
    full = pytestconfig.getoption("--faults") == "full"
    (tmp_path / "crafted").mkdir()
    complaints = []
    with trials("crafted bags") as running:
        for bag in hostile_bags.crafted(tmp_path / "crafted", full=full):
            complaints += add_trials(running, [bag], given, tmp_path / "work")
        assert complaints == []


def test_a_bag_that_is_being_recorded(given, trials, tmp_path):
    writer = BagWriter(tmp_path / "live")
    channel = writer.add_topic("/odom", "nav_msgs/msg/Odometry")
    for time in range(5):
        writer.write(channel, bytes(100), time, time)
    writer.flush()
    with trials("recorded bag") as running:
        assert add_trials(running, [tmp_path / "live"], given, tmp_path / "work") == []
    status, _, error, _ = bag_commands.run(["bag", "repair", str(tmp_path / "live"), "--in-place"])
    assert (status, error.count("\n")) == (1, 1)
    assert "is being recorded" in error
    writer.close()


def test_replayed_bags(trials, tmp_path):
    (tmp_path / "crafted").mkdir()
    wanted = {}
    for bag in (*hostile_bags.evil_names(tmp_path / "crafted"), *hostile_bags.extreme_values(tmp_path / "crafted")):
        wanted[bag.stem] = bag
    originals = hostile_bags.seeds(tmp_path)
    chosen = [wanted[name] for name in REPLAYED if name in wanted]
    complaints = []
    with trials("replayed bags") as running:
        for number in running:
            bag = chosen[number] if number < len(chosen) else tmp_path / "mutated.mcap"
            if number >= len(chosen):
                rng = random.Random(number)
                bag.write_bytes(hostile_bags.mutated(rng, rng.choice(originals)))
            complaint, seconds = bag_commands.replayed(bag)
            complaints += [complaint] if complaint else []
            running.measure(seconds, kept=not complaint)
        assert complaints == []
