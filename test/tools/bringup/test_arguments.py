"""Arguments of the launch files: what is passed on, and the one line for what is refused."""

import pytest

from diffbot_core.errors import InvalidValueError
from diffbot_tools.bringup.arguments import ROBOT, SIMULATION, parse


def test_texts_become_the_types_of_the_parameters():
    values = parse(SIMULATION, {"x": "1", "yaw": " -0.5", "seed": "7", "publish_clock": "False", "preset": "paper"})
    given = {"x": 1.0, "yaw": -0.5, "seed": 7, "publish_clock": False, "preset": "paper"}
    assert {name: values[name] for name in given} == given
    assert [type(values[name]) for name in ("x", "seed")] == [float, int]


@pytest.mark.parametrize(
    ("texts", "line"),
    [
        ({"preset": "fast"}, "preset = 'fast': must be one of tuned, precise, paper_covariance, paper"),
        ({"yaw": "north"}, "yaw = 'north': must be a number, >= -1000 and <= 1000"),
        ({"namespace": "my robot"}, "namespace = 'my robot': must be words of letters, digits and _ with / between"),
        ({"frame_prefix": "/r1/"}, "frame_prefix = '/r1/': must be letters, digits, _, - and /, without a leading /"),
        ({"parameters": "none.yaml"}, "parameters = 'none.yaml': must be an existing file"),
        ({"composed": "true", "localization": "false"}, "composed = True: must be false with localization:=false"),
    ],
)
def test_refusals_name_argument_value_and_bound(texts, line):
    with pytest.raises(InvalidValueError) as refused:
        parse(SIMULATION, texts)
    assert str(refused.value).startswith(line)
    assert "\n" not in str(refused.value)


def test_a_bag_is_a_new_folder_in_that_of_the_launch(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert parse(ROBOT, {"bag": "run"})["bag"] == str(tmp_path / "run")
    assert parse(ROBOT, {"bag": "~/run"})["bag"] == str(tmp_path / "home" / "run")
    (tmp_path / "folder").mkdir()
    (tmp_path / "broken link").symlink_to(tmp_path / "none")
    for name in ("folder", "broken link"):
        with pytest.raises(InvalidValueError, match=r"^bag = .*: must be a folder that does not exist yet$"):
            parse(ROBOT, {"bag": name})
