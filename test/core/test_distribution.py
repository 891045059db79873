"""The names of the installed package, and of what it registers."""

import subprocess
import sys
from importlib.metadata import version

import pytest

from diffbot_core.distribution import DISTRIBUTION, entry_points_by_name, install_hint


def test_the_hint_installs_the_project_itself():
    assert version(DISTRIBUTION)
    assert install_hint("pandas") == "pip install 'diffbot-ros[pandas]'"


@pytest.fixture
def earlier(tmp_path):
    """What an installation under the earlier name leaves behind."""
    folder = tmp_path / "diffbot-0.0.9.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: diffbot\nVersion: 0.0.9\n")
    commands = "[diffbot.commands]\ncampaign = earlier:add\nearlier = earlier:add\n"
    (folder / "entry_points.txt").write_text(f"{commands}[diffbot.controllers]\nswitching = earlier:Law\n")
    return tmp_path


def test_of_two_entry_points_with_one_name_the_first_on_the_path_counts(earlier, monkeypatch):
    own = entry_points_by_name("diffbot.commands")
    assert list(own) == sorted(own)
    assert own["campaign"].value.startswith("diffbot_lab.")
    monkeypatch.syspath_prepend(str(earlier))
    found = entry_points_by_name("diffbot.commands")
    assert set(found) == {*own, "earlier"}
    assert found["campaign"].value == "earlier:add"
    monkeypatch.undo()
    monkeypatch.setattr(sys, "path", [*sys.path, str(earlier)])
    assert entry_points_by_name("diffbot.commands")["campaign"] == own["campaign"]


def test_the_command_works_beside_an_earlier_installation(earlier):
    program = f"import sys; sys.path.append({str(earlier)!r}); from diffbot_tools.cli import main; main(['--version'])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == f"diffbot {version(DISTRIBUTION)}\n"
