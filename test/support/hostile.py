"""Hostile input from a seed: messages with bad values and parameter calls."""

import copy
import math
import string

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)

NAN, INF, HUGE = math.nan, math.inf, 1e308
SPECIAL = [NAN, INF, -INF, HUGE, -HUGE, 1e-320, -0.0, 0.0, 1e9, -1e5, 1e-9, 0.5, -1.0, 2.0]
INTEGERS = [0, 1, 10**9 - 1, 10**9, 2**31 - 1]
TEXTS = ["", "map", "odom", "base_link", "\x00\n{}%s", "é" * 50]
PARAMETER_NUMBERS = [NAN, INF, -INF, HUGE, -HUGE, 5e-324, 1e-160, -1.0, 0.0, 1e12]
PARAMETER_INTEGERS = [0, -1, 1, 2**63 - 1, -(2**63), 10**9]
PARAMETER_TEXTS = ["", "nan", "../../etc/passwd", "x" * 100_000, "%s%n{}", "os:system"]
NO_TYPE = 10
"""Not a type of ParameterValue."""


def spoiled(rng, message):
    """Return a copy with one to three changed numbers or texts anywhere in the message."""
    message = copy.deepcopy(message)
    for _ in range(rng.randint(1, 3)):
        target = message
        while True:
            name = rng.choice(list(target.get_fields_and_field_types()))
            value = getattr(target, name)
            if hasattr(value, "get_fields_and_field_types"):
                target = value
                continue
            break
        if isinstance(value, float):
            setattr(target, name, rng.choice(SPECIAL))
        elif isinstance(value, int):
            setattr(target, name, rng.choice(INTEGERS))
        elif isinstance(value, str):
            setattr(target, name, rng.choice(TEXTS))
        elif len(value) and isinstance(value[0], float):
            value[rng.randrange(len(value))] = rng.choice(SPECIAL)
    return message


def parameter(rng, names):
    """Return a parameter with a hostile type or value, or with an unknown name."""
    number, whole, text = rng.choice(PARAMETER_NUMBERS), rng.choice(PARAMETER_INTEGERS), rng.choice(PARAMETER_TEXTS)
    values = [
        ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=number),
        ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=whole),
        ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text),
        ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[number] * rng.randint(0, 9)),
        ParameterValue(type=ParameterType.PARAMETER_BYTE_ARRAY, byte_array_value=[bytes([rng.randrange(256)])]),
        ParameterValue(type=ParameterType.PARAMETER_NOT_SET),
        ParameterValue(type=NO_TYPE),
    ]
    odd = "".join(rng.choices(string.printable, k=rng.randint(0, 40)))
    return Parameter(name=rng.choice(names) if rng.random() < 0.9 else odd, value=rng.choice(values))


def parameter_call(rng, names):
    """Return the type of a service, the last part of its name, and a hostile request."""
    some = [rng.choice([*names, "", "no.such.parameter", "x" * 10_000]) for _ in range(rng.randint(0, 3))]
    changes = [parameter(rng, names) for _ in range(rng.randint(1, 3))]
    return rng.choice(
        [
            (SetParameters, "set_parameters", SetParameters.Request(parameters=changes)),
            (SetParameters, "set_parameters", SetParameters.Request(parameters=changes[:1])),
            (SetParametersAtomically, "set_parameters_atomically", SetParametersAtomically.Request(parameters=changes)),
            (GetParameters, "get_parameters", GetParameters.Request(names=some)),
            (GetParameterTypes, "get_parameter_types", GetParameterTypes.Request(names=some)),
            (DescribeParameters, "describe_parameters", DescribeParameters.Request(names=some)),
            (ListParameters, "list_parameters", ListParameters.Request(prefixes=some, depth=rng.choice([0, 2**63]))),
        ]
    )
