"""The launcher reports in one line that ROS is missing, and does not hide other missing modules."""

import pytest

from diffbot_core.launcher import launch


@pytest.fixture
def program(tmp_path, monkeypatch, kept_signal_handlers):
    """Return a function that writes a module whose main imports another module."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def write(name, missing):
        (tmp_path / f"{name}.py").write_text(f"def main():\n    import {missing}\n")
        return name

    return write


@pytest.mark.parametrize("missing", ["absent_msgs.msg", "absent_interfaces", "absent_srvs.srv"])
def test_without_ros_a_program_prints_one_line_and_ends(program, missing, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["/somewhere/bin/some_node"])
    assert launch(program(f"needs_{missing.partition('.')[0]}", missing)) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"some_node: needs ROS 2 (no module {missing.partition('.')[0]})")


def test_another_missing_module_raises_its_error(program):
    with pytest.raises(ModuleNotFoundError, match="absent_library"):
        launch(program("needs_library", "absent_library"))
