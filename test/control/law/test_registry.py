"""Laws by name and by ``package.module:Class``, and the reasons of refusals."""

import pytest

from diffbot_control.law.registry import resolve_law
from diffbot_core.errors import InvalidValueError

GOOD = """
from typing import NamedTuple
from diffbot_control import law as laws
from diffbot_core.data_sheet import DataSheet

class Config(NamedTuple):
    gain: float = 1.0
    data_sheet: DataSheet = DataSheet()
    tolerance: laws.GoalTolerance = laws.GoalTolerance()

class Memory(NamedTuple):
    reached: bool = False

class Law(laws.Law):
    name = "mine"
    Config = Config
    new_memory = staticmethod(lambda config: Memory())
    step = staticmethod(lambda memory, observation, goal, config: (memory, None, None))
"""


@pytest.mark.parametrize("text", ["", "a.b:", ":Law"])
def test_a_name_that_is_not_registered_is_refused_with_the_registered_laws(text):
    with pytest.raises(InvalidValueError, match=r"Class or a registered law: docking, .*switching$"):
        resolve_law(text)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('name = "mine"', 'name = ""', "whose name is a string"),
        ("Config = Config", "Config = dict", "whose Config is a NamedTuple type"),
        ("class Law(laws.Law)", "class Law", "a class derived from diffbot_control.law.Law"),
        ("lambda config: Memory()", "lambda: Memory()", "takes 0 positional arguments but 1 was given"),
        ("data_sheet: DataSheet = DataSheet()", "data_sheet: int = 1", "data_sheet(config) is a DataSheet"),
        ("lambda config: Memory()", "lambda config: config.missing", "AttributeError"),
        ("reached: bool", "arrived: bool", "whose memory has the field reached"),
        ("from typing", "from typing (", "SyntaxError"),
    ],
)
def test_a_law_that_lacks_something_is_refused_in_one_line(old, new, reason, tmp_path, monkeypatch):
    assert old in GOOD
    monkeypatch.syspath_prepend(tmp_path)
    # A unique name, because Python does not read a module again after it was imported.
    (tmp_path / f"{tmp_path.name}.py").write_text(GOOD.replace(old, new))
    with pytest.raises(InvalidValueError, match=rf"^law = '{tmp_path.name}:Law': must be ") as refused:
        resolve_law(f"{tmp_path.name}:Law")
    assert reason in str(refused.value)
    assert "\n" not in str(refused.value)
