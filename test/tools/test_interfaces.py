"""The command ``diffbot interfaces build``: what it refuses, and that an older build survives a failed one.

That what it builds works is shown by the tests of the actions (graph/test_nav2_actions.py).
"""

import os

import pytest

from diffbot_core.errors import DiffbotError
from diffbot_tools.interfaces import build
from diffbot_tools.interfaces.build import build_interfaces


def test_without_a_compiler_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(DiffbotError, match=r"no C and C\+\+ compiler: install gcc and g\+\+"):
        build_interfaces(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_failed_compilation_is_an_error_in_one_line_and_keeps_the_older_build(tmp_path, monkeypatch):
    older = tmp_path / "out" / "nav2_msgs" / "old"
    older.mkdir(parents=True)
    monkeypatch.setattr(build, "_FLAGS", ("--no-such-flag",))
    monkeypatch.setattr(build, "GENERATORS", build.GENERATORS[:1])
    with pytest.raises(DiffbotError, match=r"^(gcc|cc) failed: .*no-such-flag") as failed:
        build_interfaces(tmp_path / "out")
    assert "\n" not in str(failed.value)
    assert older.is_dir()
    assert os.listdir(tmp_path / "out") == ["nav2_msgs"], "nothing else is left behind"
