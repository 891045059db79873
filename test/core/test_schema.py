"""Configuration types: every parameter has a description and bounds, and a value that is not allowed is refused."""

import importlib
import inspect
import math
from pathlib import Path
from typing import Annotated, NamedTuple, get_args

import pytest

import diffbot_core
from diffbot_control.law.configuration import PaperConfig, PaperGains, SwitchingConfig
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.schema import Parameter, Spec, build, checked, parameters_of, to_dict


class Inner(NamedTuple):
    words: Annotated[tuple[str, ...], Spec("some words")] = ()
    numbers: Annotated[tuple[float, ...], Spec("some numbers", minimum=0.0)] = ()


class Checking(NamedTuple):
    value: Annotated[float, Spec("value")] = 0.0

    def check(self):
        if self.value > 1.0:
            raise ValueError("too\nlarge")


def is_config(thing):
    hints = getattr(thing, "__annotations__", {}).values()
    return inspect.isclass(thing) and hasattr(thing, "_fields") and any("Spec(" in str(h) for h in hints)


def all_configs():
    """Return the configuration types of the modules that contain ``Spec(``; importing all modules takes seconds."""
    site, found = Path(diffbot_core.__file__).parents[1], {}
    for path in sorted(site.glob("diffbot_*/**/*.py")):
        if "Spec(" in path.read_text():
            module = ".".join(path.relative_to(site).with_suffix("").parts)
            things = vars(importlib.import_module(module)).items()
            found |= {f"{module}.{name}": one for name, one in things if is_config(one) and one.__module__ == module}
    return found


CONFIGS = all_configs()
ALL = [(name, parameter) for name, one in sorted(CONFIGS.items()) for parameter in parameters_of(one)]


def test_every_parameter_has_a_text_a_unit_finite_bounds_and_an_allowed_default():
    assert len(CONFIGS) > 30
    for place, parameter in ALL:
        name, spec, kind = f"{place}: {parameter.name}", parameter.spec, parameter.type
        assert spec.text.strip(), name
        assert spec.unit.strip(), name
        assert checked(parameter, parameter.default) == parameter.default, name
        assert kind is not float or isinstance(parameter.default, float), name
        item = (get_args(kind) or (kind,))[0]
        assert item in (float, int, bool, str), name
        if item in (float, int):
            # Squares and reciprocals of such values, and their products, are finite.
            assert -1e10 <= spec.minimum < spec.maximum <= (1e10 if item is float else 2**63), name
            assert spec.minimum <= 0.0 or spec.minimum >= 1e-12, name


def refusals(parameter):
    """Return values that are not allowed for a parameter."""
    spec, kind = parameter.spec, parameter.type
    if kind in (float, int):
        step = 1 if kind is int else 1e-9
        beyond = [spec.minimum - step * (1 + abs(spec.minimum)), spec.maximum + step * (1 + abs(spec.maximum))]
        return [*beyond, *([] if spec.allow_inf else [math.inf]), math.nan, -math.inf, 10**400, "many", None, True, 1j]
    if kind is bool:
        return [0, 1, "true", None, 1.0]
    if kind is str:
        return [0, 1.5, True, None, b"map", *(f"{word} " for word in spec.choices)]
    return ["a", b"a", 5, None, [object()]]


def test_every_parameter_allows_its_bounds_and_words_and_refuses_other_values_and_types():
    for place, parameter in ALL:
        for value in refusals(parameter):
            with pytest.raises(InvalidValueError) as caught:
                checked(parameter, value)
            assert caught.value.name == parameter.name, (place, value)
        spec, kind = parameter.spec, parameter.type
        bounds = [kind(spec.minimum), kind(spec.maximum)] if kind in (float, int) else []
        for value in (*bounds, *spec.choices, *([math.inf] if spec.allow_inf else [])):
            assert checked(parameter, value) == value, (place, parameter.name)


def test_build_and_to_dict_are_inverse_for_the_defaults_of_every_configuration():
    for name, config_type in CONFIGS.items():
        values = to_dict(config_type())
        assert list(values) == [parameter.name for parameter in parameters_of(config_type)], name
        assert build(config_type, values) == build(config_type, {}) == config_type(), name


@pytest.mark.parametrize(
    ("config", "values", "message"),
    [
        (PaperGains, {"gamma": -1.5}, "gamma = -1.5: must be >= 1e-06 and <= 1000"),
        (PaperGains, {"h": "big"}, "h = 'big': must be a number"),
        (SwitchingConfig, {"settling_steps": 2.0}, "settling_steps = 2.0: must be a whole number"),
        (SwitchingConfig, {"allow_backward": 1}, "allow_backward = 1: must be true or false"),
        (PaperConfig, {"eps_P": 0.8}, "eps_P_leave = 0.6: must be >= eps_P = 0.8"),
        (PaperGains, {"gama": 1.0}, "gama = 1.0: must be a known name (gamma, h, k, k_2)"),
        # The field a_max has another name as a parameter.
        (DataSheet, {"a_max": 1.0}, "a_max = 1.0: must be a known name ("),
        (DataSheet, {"linear.x.max_velocity": 0.1, "min_velocity": 0.2}, "min_velocity = 0.2: must be "),
        (DataSheet, {"min_rotation": 2.7}, "min_rotation = 2.7: must be "),
        (Inner, {"numbers": [1.0, -1.0]}, "numbers = -1.0: must be "),
        (Inner, {"words": ["a", 3]}, "words = 3: must be a text"),
        (Checking, {"value": 2.0}, "Checking: too large"),
    ],
)
def test_an_error_names_parameter_value_and_bound_in_one_line(config, values, message):
    with pytest.raises(DiffbotError) as caught:
        build(config, values)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_other_values_come_from_the_base_and_integers_become_floats():
    base = build(PaperConfig, {"gamma": 1.0, "eps_P": 0.3, "allow_backward": False})
    found = build(PaperConfig, {"k": 2, "eps_P_leave": 0.35}, base)
    assert repr(build(Inner, {"words": ["a"], "numbers": [1, 2.5]}).numbers) == "(1.0, 2.5)"
    assert found.gains == PaperGains(gamma=1.0, k=2.0)
    assert isinstance(found.gains.k, float)
    assert (found.eps_P, found.eps_P_leave, found.allow_backward) == (0.3, 0.35, False)


def test_only_numbers_that_yaml_reads_as_texts_are_converted_to_floats():
    parameter = Parameter("limit", (), float, 1.0, Spec("a limit", allow_inf=True))
    for text, value in (("1e-06", 1e-6), ("2.5E+3", 2500.0), ("inf", math.inf), (".INF", math.inf)):
        assert checked(parameter, text) == value
    for text in ("2", "nan", "1e", "-inf"):
        with pytest.raises(InvalidValueError, match=r"limit = .*: must be "):
            checked(parameter, text)


def test_an_unknown_field_of_a_configuration_is_refused_with_similar_names():
    for given in (DataSheet, DataSheet()._replace):
        with pytest.raises(InvalidValueError, match=r"^omega_mx = 1: .*did you mean omega_max"):
            given(omega_mx=1)
