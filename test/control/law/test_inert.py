"""Parameters that are said to be without effect have none, and those that the presets differ by have one."""

import numpy as np
import pytest

from diffbot_control.law.inert import inert_parameters
from diffbot_control.law.presets import PRESETS
from diffbot_core.geometry import Pose
from diffbot_core.schema import build, parameters_of, to_dict
from diffbot_sim.model.simulator import StartPose, WorldConfig
from diffbot_sim.reference_loop import simulate

WORLD = WorldConfig(start=StartPose(-1.5, 0.8, 2.0), seed=5)


def path_of(config):
    return simulate(WORLD, config, Pose(0.0, 0.0, 0.0), 150).truth


def other_value(parameter, value):
    spec = parameter.spec
    if spec.choices:
        return next(one for one in spec.choices if one != value)
    if parameter.type is bool:
        return not value
    changed = value + 1 if parameter.type is int else 1.5 * value + 0.01
    return min(max(changed, spec.minimum), spec.maximum)


@pytest.mark.parametrize("preset", PRESETS)
def test_an_inert_parameter_changes_nothing(preset):
    base = PRESETS[preset]
    expected, values, kinds = path_of(base), to_dict(base), {one.name: one for one in parameters_of(type(base))}
    inert = inert_parameters(base)
    assert inert
    changed = {name: other_value(kinds[name], values[name]) for name in inert}
    assert np.array_equal(path_of(build(type(base), changed, base)), expected)


@pytest.mark.parametrize(
    ("preset", "name", "value"), [("tuned", "react", 1.0), ("paper", "k", 3.0), ("paper", "eps_P", 0.2)]
)
def test_a_parameter_that_acts_is_not_called_inert(preset, name, value):
    base = PRESETS[preset]
    assert name not in inert_parameters(base)
    assert not np.array_equal(path_of(build(type(base), {name: value}, base)), path_of(base))
