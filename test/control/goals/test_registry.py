"""Laws by name and by place; what is refused, and why."""

import sys
import textwrap

import pytest

from diffbot_control.goals.registry import resolve_law
from diffbot_core.errors import InvalidValueError

GOOD = """
from typing import NamedTuple

class Config(NamedTuple):
    gain: float = 1.0

class Memory(NamedTuple):
    reached: bool = False

class Law:
    name = "mine"
    Config = Config
    new_memory = staticmethod(lambda config: Memory())
    step = staticmethod(lambda memory, estimate, goal, dt, config: (memory, None, None))
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Return a function that writes a module and resolves its Law."""
    monkeypatch.syspath_prepend(tmp_path)
    names = []

    def resolve(text, attribute="Law"):
        names.append(f"brought_along_{len(names)}")
        (tmp_path / f"{names[-1]}.py").write_text(textwrap.dedent(text))
        return resolve_law(f"{names[-1]}:{attribute}")

    yield resolve
    for name in names:
        sys.modules.pop(name, None)


@pytest.mark.parametrize("text", ["", "a.b:", ":Law"])
def test_what_is_no_place_names_the_registered_laws(text):
    with pytest.raises(InvalidValueError, match=r"package\.module:Class or one of aicardi, .*switching$"):
        resolve_law(text)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('name = "mine"', 'name = ""', "a text 'name'"),
        ("Config = Config", "Config = dict", "a NamedTuple type 'Config'"),
        ("lambda config: Memory()", "lambda: Memory()", "'new_memory' takes 1 arguments"),
        ("goal, dt, config:", "goal, dt:", "'step' takes 5 arguments"),
        ("lambda config: Memory()", "lambda config: config.missing", "AttributeError"),
        ("reached: bool", "arrived: bool", "a field 'reached'"),
        ("from typing", "from typing (", "SyntaxError"),
    ],
)
def test_a_law_that_lacks_something_is_refused_in_one_line(module, old, new, reason):
    assert old in GOOD
    with pytest.raises(InvalidValueError, match=r"^law = 'brought_along_0:Law': must be ") as refused:
        module(GOOD.replace(old, new))
    assert reason in str(refused.value)
    assert "\n" not in str(refused.value)
