"""The Python interface: lazy imports, examples of the docstrings, results, and errors in one line."""

import doctest
import json
import math
import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import bag_makers
import numpy as np
import pandas
import pytest
import view_bags
from matplotlib import pyplot

import diffbot
from diffbot_control.law import CONTACT_UNKNOWN, Observation, new_memory, step
from diffbot_core.geometry import Pose
from diffbot_core.installed import DISTRIBUTION
from diffbot_core.uncertainty import Estimate, Uncertainty

HEAVY = {"matplotlib", "numba", "numpy", "pandas", "rclpy", "scipy", "yaml"}


def loaded_after(program):
    code = f"{program}\nimport json, sys; print(json.dumps(sorted({{m.split('.')[0] for m in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100, check=True)
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_the_import_loads_no_library_and_a_drive_neither_ros_nor_matplotlib_nor_numba():
    assert loaded_after("import diffbot; diffbot.__version__") & HEAVY == set()
    used = loaded_after("import diffbot; diffbot.drive((0.2, 0.0, 0.0))")
    assert used & {"matplotlib", "numba", "pandas", "rclpy"} == set()


def test_every_public_name_can_be_imported_and_an_unknown_name_is_refused():
    for name in diffbot.__all__:
        assert getattr(diffbot, name) is not None
    assert diffbot.__version__ == version(DISTRIBUTION)
    with pytest.raises(AttributeError, match=r"no attribute 'Simulator'; it has .*Simulation"):
        _ = diffbot.Simulator


@pytest.mark.parametrize("module", ["arguments", "loop", "simulation"])
def test_the_examples_in_docstrings_give_the_results_shown(module):
    found = doctest.testmod(import_module(f"diffbot.{module}"))
    assert found.attempted > 0
    assert found.failed == 0


@pytest.mark.study
def test_mypy_checks_the_program_of_a_user(tmp_path):
    program = tmp_path / "user.py"
    program.write_text(
        "import diffbot\n"
        "run: diffbot.Recording = diffbot.drive((1.0, 2.0, 0.0), robot=diffbot.robot('turtlebot4', use_gyro=False))\n"
        "print(run.position_error + 1.0, run.to_numpy().shape[0])\n"
        "run.plto()\n"
    )
    cache = Path(__file__).parents[2] / ".mypy_cache" / "facade"
    command = ["-m", "mypy", "--strict", "--follow-imports=silent", "--cache-dir", str(cache), str(program)]
    checked = subprocess.run([sys.executable, *command], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert checked.stdout.splitlines()[0].endswith('Recording" has no attribute "plto"  [attr-defined]')
    assert "Found 1 error" in checked.stdout


@pytest.fixture(scope="module")
def run():
    return diffbot.drive([1.0, 1.0, 1.5], robot="warehouse_agv", start=(0.0, -1.0, 0.0), seed=4)


def test_a_recording_has_the_true_poses_and_errors_and_the_commands(run):
    assert run.is_reached
    x, y, theta = run.truth[-1]
    assert run.position_error == pytest.approx(math.hypot(x - 1.0, y - 1.0))
    assert abs(run.error.theta) == pytest.approx(abs(theta - 1.5))
    assert run.truth[0] == pytest.approx([0.0, -1.0, 0.0])
    assert repr(run) == (
        f"<Recording: (1, 1, 1.5) reached after {run.time[-1] - run.time[0]:.1f} s,"
        f" {run.position_error:.3f} m and {abs(theta - 1.5):.3f} rad away>"
    )
    moved = np.hypot(*np.diff(run.truth[:, :2], axis=0).T)
    assert moved.sum() == pytest.approx(np.abs(run.command[:, 0]).sum() * 0.05, rel=0.05)


def test_arrays_and_tables_have_the_documented_columns(run):
    rows, table = run.to_numpy(), run.to_pandas()
    assert isinstance(table, pandas.DataFrame)
    assert list(table.columns) == list(run.COLUMNS[1:])
    assert table.index.to_numpy() == pytest.approx(run.time)
    assert table[["x", "y", "theta"]].to_numpy() == pytest.approx(run.truth)
    assert table[["estimate_x", "estimate_y", "estimate_theta"]].to_numpy() == pytest.approx(run.estimate, nan_ok=True)
    assert table[["v", "omega"]].to_numpy() == pytest.approx(run.command)
    assert rows[:, run.COLUMNS.index("reached")].tolist() == [0.0] * (len(rows) - 1) + [1.0]
    assert set(rows[:, run.COLUMNS.index("region")]) == {0.0, 1.0}
    assert 0.001 < rows[-1, run.COLUMNS.index("sigma")] < 0.05


def test_a_plot_shows_the_true_path_and_is_written_to_the_file(run, tmp_path):
    figure = run.plot(str(tmp_path / "drive.png"))
    truth = next(line for line in figure.axes[0].get_lines() if line.get_label() == "truth")
    assert np.column_stack(truth.get_data()) == pytest.approx(run.truth[:, :2])
    assert pyplot.imread(tmp_path / "drive.png").std() > 0.01
    with pytest.raises(diffbot.DiffbotError, match="cannot write to"):
        run.plot(tmp_path / "missing" / "drive.png")
    pyplot.close("all")


def test_a_controller_returns_the_commands_of_the_law_and_reports_the_end_of_the_goal():
    controller, memory = diffbot.Controller(xy_goal_tolerance=0.2), new_memory()
    config = controller.config.controller
    assert config.tolerance.xy_goal_tolerance == 0.2
    goal, pose = Pose(1.0, 0.5, 0.3), Pose(0.0, 0.0, 0.0)
    controller.go_to(goal)
    for number in range(400):
        estimate = Estimate(pose, Uncertainty(0.01, 0.01))
        observation = Observation(estimate, 0.1 if number else 0.0, 0.1, CONTACT_UNKNOWN)
        memory, command, _ = step(memory, observation, goal, config)
        assert controller.step(0.1 * number, tuple(pose), sigma=(0.01, 0.01)) == pytest.approx(command, abs=1e-9)
        x, y, theta = pose
        pose = Pose(
            x + 0.1 * command.v * math.cos(theta), y + 0.1 * command.v * math.sin(theta), theta + 0.1 * command.omega
        )
        if controller.end:
            break
    assert (controller.end, controller.status, controller.reason) == ("reached", "goal reached", "")
    assert math.hypot(pose.x - 1.0, pose.y - 0.5) < 0.2
    controller.go_to((5.0, 0.0, 0.0))
    assert (controller.goal, controller.end) == (Pose(5.0, 0.0, 0.0), "")
    controller.on_cancel()
    assert controller.step(60.0, pose) == (0.0, 0.0)


def test_a_filter_averages_two_equally_certain_fixes():
    ekf = diffbot.Filter(detect_correlation=False)
    ekf.fix(0.0, (0.0, 0.0, 0.0), sigma=(0.1, 0.01))
    for number in range(11):
        ekf.odometry(0.1 * number, v=0.0, omega=0.0, sigma=(1e-3, 1e-3))
    ekf.fix(1.0, (0.2, 0.0, 0.0), sigma=(0.1, 0.01))
    assert ekf.odometry(1.1, 0.0, 0.0, sigma=(1e-3, 1e-3)).x == pytest.approx(0.1, abs=2e-3)
    assert ekf.sigma.xy == pytest.approx(0.1 / math.sqrt(2.0), rel=0.02)


@pytest.mark.parametrize("sigma", [(0.05, 0.0), (0.0, 0.05)])
def test_odometry_of_which_one_deviation_is_unknown_is_not_exact(sigma):
    one, other = diffbot.Filter(), diffbot.Filter()
    for ekf, given in ((one, sigma), (other, (0.0, 0.0))):
        ekf.fix(0.0, (0.0, 0.0, 0.0), sigma=(0.1, 0.01))
        for number in range(1, 11):
            ekf.odometry(0.1 * number, 0.5, 0.1, given)
    assert one.sigma == other.sigma


def step_back(controller):
    for time in (1.0, 0.9):
        controller.step(time, (0.0, 0.0, 0.0))


REFUSED = {
    "two numbers": (lambda: diffbot.drive((1.0, 2.0)), r"goal = \(1.0, 2.0\): must be three numbers: x"),
    "nan": (lambda: diffbot.drive((math.nan, 0.0, 0.0)), "goal = .*finite"),
    "robot": (lambda: diffbot.drive((1, 0, 0), robot="turtelbot4"), "did you mean turtlebot4"),
    "file": (lambda: diffbot.drive((1, 0, 0), robot="none.yaml"), "none.yaml"),
    "field": (lambda: diffbot.robot(linear_x_max_velocty=1.0), "did you mean linear_x_max_velocity"),
    "range": (lambda: diffbot.robot(linear_x_max_velocity=-1.0), "linear.x.max_velocity = -1.0: must be >= 1e-06"),
    "parameter": (lambda: diffbot.Controller(max_velocity=1.0), "did you mean .*linear_x_max_velocity"),
    "filter": (lambda: diffbot.Filter(gate_probabilty=0.9), "did you mean gate_probability"),
    "no robot": (lambda: diffbot.drive((1, 0, 0), robot=None), "robot = None: must be a parameter file, a name"),
    "seed": (lambda: diffbot.drive((1, 0, 0), seed="a"), "seed = 'a': must be a whole number"),
    "degrees": (lambda: diffbot.drive((1, 0, 90)), r"goal = 90.0: .* write math.radians\(90\)"),
    "sigma": (lambda: diffbot.Controller().step(0.0, (0, 0, 0), (-1.0, 0.0)), r"sigma = \(-1.0, 0.0\): must be two"),
    "a fix without error": (lambda: diffbot.Filter().fix(0.0, (0, 0, 0), (0.0, 0.0)), "sigma = .*two finite numbers"),
    "time running back": (lambda: step_back(diffbot.Controller()), "time = 0.9: must be > 1, the previous time"),
    "time beyond the stamps": (lambda: diffbot.Controller().step(1e300, (0, 0, 0)), "time = 1e.300: must be a finite"),
    "velocity": (lambda: diffbot.Filter().odometry(0.0, math.nan, 0.0), "v = nan: must be a finite number .m/s."),
    "turn rate": (lambda: diffbot.Filter().odometry(0.0, 0.0, "a"), "omega = 'a': must be a finite number .rad/s."),
    "bag": (lambda: diffbot.Bag("none"), "no bag none"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_an_invalid_argument_is_refused_in_one_line(name):
    call, text = REFUSED[name]
    with pytest.raises(diffbot.DiffbotError, match=text) as refused:
        call()
    assert "\n" not in str(refused.value)


def test_numbers_of_numpy_are_numbers():
    ekf = diffbot.Filter()
    ekf.fix(np.int64(0), np.zeros(3), np.full(2, 0.1))
    assert ekf.odometry(np.float32(0.5), np.float32(0.5), np.int64(0)).x == pytest.approx(0.25, abs=0.01)
    assert diffbot.drive((0.3, 0.0, 0.0), seed=np.int64(2)).end == diffbot.drive((0.3, 0.0, 0.0), seed=2).end


def test_a_bag_can_be_given_as_a_text_or_a_path(tmp_path):
    folder = bag_makers.write_folder(tmp_path / "bag", view_bags.irregular(0.5))
    with diffbot.Bag(str(folder)) as one, diffbot.Bag(Path(folder)) as other:
        assert sum(1 for _ in one.messages()) == sum(1 for _ in other.messages()) > 0


def test_without_ros_the_navigator_names_the_missing_module():
    program = (
        "import sys, diffbot\n"
        "sys.modules['geometry_msgs'] = None\n"
        "try: diffbot.Navigator\n"
        "except diffbot.DiffbotError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("Navigator needs ROS 2 (no module ")
