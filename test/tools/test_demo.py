"""``diffbot demo``: the first tutorial, its results compared with the bag as rosbags reads it, its end by signals."""

import json
import math
import os
import signal
import sys
import time
from pathlib import Path

import graph
import pytest
import tutorial_run
from bag_makers import read
from robot import planar, stamp

from diffbot_core.geometry import Pose
from diffbot_tools import cli
from diffbot_tools.demo import make_room_for_bag
from diffbot_tools.plotting import draw_heading, new_figure
from diffbot_tools.view.bag_source import read_bag

pytestmark = pytest.mark.graph

COMMAND = (sys.executable, "-m", "diffbot_tools.cli", "demo")
GOALS = [(0.0, 0.0, 0.0), (3.0, 2.0, math.pi / 2), (1.0, -2.0, math.pi)]
TUTORIAL = Path(__file__).resolve().parents[2] / "docs" / "tutorials" / "first-drive.md"
CONTRACT = Path(__file__).resolve().parents[2] / "config" / "bag_contract.yaml"


def command(out, *arguments):
    return [*COMMAND, "--out", str(out), "--domain", os.environ["ROS_DOMAIN_ID"], *map(str, arguments)]


@pytest.mark.parametrize("theta", [0.0, 1.5, 3.1, -1.6])
def test_the_arrow_of_a_heading_is_inside_the_picture(theta):
    _, axes = new_figure(1, (3.0, 3.0))
    axes.plot([0.0, 1.0, 0.0], [0.0, 1.0, 1.0])
    draw_heading(axes, Pose(1.0 * (theta < 1.6), 1.0 * (theta > -1.0), theta), 0.5, "black")
    (arrow,) = axes.texts
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    assert left <= arrow.xy[0] <= right
    assert low <= arrow.xy[1] <= high


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """Run the first tutorial; return the folder of its demo, and its outputs with those on the page."""
    folder = tmp_path_factory.mktemp("demo")
    page = TUTORIAL.read_text()
    return folder / "out" / "demo", tutorial_run.outputs(page, tutorial_run.run(page, folder))


def test_the_bag_keeps_the_contract_of_the_demonstration(demo, capsys, kept_signal_handlers):
    status = cli.main(["bag", "check", str(demo[0] / "bag"), str(CONTRACT)])
    assert status == 0, capsys.readouterr().out


def test_the_summary_agrees_with_the_bag(demo):
    bag = read(demo[0] / "bag")
    summary = json.loads((demo[0] / "summary.json").read_text())
    truth = [(stamp(message), *planar(message.pose.pose)) for _, message in bag["/ground_truth"]]
    ends = {}
    for _, message in bag["/controller/goal_results"]:  # each message repeats the earlier results
        for status in message.status:
            elapsed = next(pair.value for pair in status.values if pair.key == "elapsed time [s]")
            ends.setdefault(status.name, (stamp(message), float(elapsed)))
    assert (summary["success"], summary["seed"], summary["clock"]) == (True, 1, "lockstep")
    assert (summary["messages"], summary["lost"]) == (sum(map(len, bag.values())), 0)
    assert summary["simulated_time"] == pytest.approx((truth[-1][0] - truth[0][0]) * 1e-9, abs=1e-6)
    assert len(summary["goals"]) == len(ends) == 3
    for goal, found, (ended, elapsed) in zip(GOALS, summary["goals"], sorted(ends.values()), strict=True):
        assert tuple(found["goal"].values()) == pytest.approx(goal, abs=1e-12)
        assert (found["end"], found["is_true"]) == ("reached", True)
        assert found["time"] == pytest.approx(elapsed)
        # The robot is nearly at rest, so one pose more or less does not matter.
        _, x, y, theta = max(pose for pose in truth if pose[0] <= ended)
        assert found["position_error"] == pytest.approx(math.hypot(x - goal[0], y - goal[1]), abs=0.01)
        assert found["heading_error"] == pytest.approx(abs(math.remainder(theta - goal[2], math.tau)), abs=0.02)


def test_table_summary_and_report_agree(demo):
    folder, shown = demo
    summary = json.loads((folder / "summary.json").read_text())
    rows = [line.split() for _, output in shown for line in output.splitlines() if " reached " in line]
    cards = read_bag(folder / "bag").robots[0].outcomes
    assert [float(row[5]) for row in rows] == pytest.approx([round(one.time, 1) for one in cards])
    assert [float(row[6]) for row in rows] == pytest.approx([round(one.position_error, 3) for one in cards])
    assert [one["position_error"] for one in summary["goals"]] == [one.position_error for one in cards]


def test_the_tutorial_prints_what_it_shows_and_nothing_is_left_over(demo):
    folder, shown = demo
    for block, output in shown:
        assert tutorial_run.comparable(output, block.title) == tutorial_run.comparable(block.body, block.title)
    (table,) = (output for _, output in shown if "Graph on" in output)
    for words in ("(0.0, 0.0, 0 deg)", "(3.0, 2.0, 90 deg)", "(1.0, -2.0, 180 deg)", " 0 lost"):
        assert words in table
    logs = "".join(file.read_text() for file in (folder / "log").glob("*.log"))
    assert "Traceback" not in logs
    assert "[ERROR]" not in logs


def children(pid):
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        # ProcessLookupError if the process ends between opening and reading the file.
        return False


def logged(out, node, text, process, folder="log"):
    """Wait until a node has written this text to its log."""

    def is_there():
        assert process.popen.poll() is None, process.output
        log = out / folder / f"{node}.log"
        return log.is_file() and text in log.read_text()

    graph.wait_for(is_there, what=f"{text!r} of {node}")


def node_of(process, name):
    """Return the number of the process that runs a node of a demo."""
    nodes = children(process.popen.pid)
    return next(pid for pid in nodes if name.encode() in Path(f"/proc/{pid}/cmdline").read_bytes())


def test_a_suspended_recorder_loses_nothing_and_with_a_page_the_demo_runs_until_signals_end_all_processes(tmp_path):
    out = tmp_path / "out"
    program = "from diffbot_tools import cli, demo; demo.GOALS = demo.GOALS[:1]; raise SystemExit(cli.main())"
    with graph.process(sys.executable, "-c", program, *command(out, "--watch")[3:], cwd=tmp_path) as process:
        process.wait_for_output("Page: http://127.0.0.1:")
        logged(out, "controller", "driving", process)
        recorder = node_of(process, "recorder_node")
        os.kill(recorder, signal.SIGSTOP)
        time.sleep(1.5)
        os.kill(recorder, signal.SIGCONT)
        process.wait_for_output("Draw goals on the page", 200.0)
        assert (out / "report.html").is_file()
        summary = json.loads((out / "summary.json").read_text())
        assert (len(summary["goals"]), summary["lost"]) == (1, 0)
        nodes = children(process.popen.pid)
        assert len(nodes) >= 4
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGINT):
            before = sum(map(is_running, nodes))
            process.send(number)
            # The next signal arrives while the demo is ending its nodes.
            graph.wait_for(
                lambda before=before: process.popen.poll() is not None or sum(map(is_running, nodes)) < before
            )
            if process.popen.poll() is not None:
                break
        assert process.wait() == 0
        assert not any(map(is_running, nodes))
        assert "Traceback" not in process.output
    found = read(out / "bag")
    assert found["/ground_truth"]
    assert len(found["/goal_pose"]) == 1
    assert "Traceback" not in (out / "log" / "recorder.log").read_text()


def test_a_node_that_ends_ends_the_demo_without_results_of_an_earlier_run(tmp_path):
    out = tmp_path / "out"
    for name in ("bag/bag_0.mcap", "bag/metadata.yaml", "summary.json", "path.png", "report.html"):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text("old")
    with graph.process(*command(out, "--overwrite", "--real-time")) as process:
        logged(out, "plant", "]: ready", process)
        logged(out, "recorder", "]: ready", process)
        nodes = children(process.popen.pid)
        # Another program stops the plant, with status 0.
        os.kill(node_of(process, "plant_node"), signal.SIGINT)
        assert process.wait() == 1
        assert "diffbot: plant ended with status 0" in process.output
        assert not any(map(is_running, nodes))
    assert sorted(entry.name for entry in out.iterdir()) == ["bag", "log"]


STARTER = """
import os, sys, time
from pathlib import Path
from diffbot_tools.processes import NodeProcesses
with NodeProcesses(int(os.environ["ROS_DOMAIN_ID"]), Path(sys.argv[1])) as nodes:
    print(nodes.start("recorder", "diffbot_bag.recorder_node", {"uri": sys.argv[1] + "/bag"}).pid, flush=True)
    time.sleep(600.0)
"""


def test_nodes_end_with_a_process_that_is_killed_and_their_bag_can_be_replaced(tmp_path):
    with graph.process(sys.executable, "-c", STARTER, str(tmp_path)) as process:
        logged(tmp_path, "recorder", "]: ready", process, folder="")
        graph.wait_for(lambda: process.output.endswith("\n"), what="the number of its process")
        process.popen.kill()
        node = int(process.output)
        graph.wait_for(lambda: not is_running(node), what="the end of the node")
    (tmp_path / "bag" / "metadata.yaml").unlink(missing_ok=True)
    make_room_for_bag(tmp_path / "bag", overwrite=True)
    assert not (tmp_path / "bag").exists()
