"""Functions that a function can call, found by the names in its code: what a compiler has to know of a law."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

_LIBRARIES = ("builtins", "math", "numba", "numpy", "typing")
"""Top-level modules whose functions the compiler knows, or that are no functions of a law."""


def reachable_functions(*roots: Any) -> list[FunctionType]:
    """Return ``roots`` and all Python functions that they can call by a name, each once.

    Names are looked up in the module of each function and in its closure; ``module.function`` is followed, too. What is
    called as an attribute of an object is not found: laws are pure functions and have none.
    """
    found: dict[FunctionType, None] = {}
    waiting = [one for one in roots if isinstance(one, FunctionType)]
    while waiting:
        function = waiting.pop()
        if function not in found:
            found[function] = None
            waiting += [one for one in _called(function) if not _is_of_library(one)]
    return list(found)


def _called(function: FunctionType) -> Iterator[FunctionType]:
    names = _names(function.__code__)
    closure = function.__closure__ or ()
    values = [function.__globals__.get(name) for name in names] + [cell.cell_contents for cell in closure]
    for value in values:
        if isinstance(value, FunctionType):
            yield value
        elif isinstance(value, (ModuleType, type)):
            # vars(), not getattr: a module may import lazily.
            members = [vars(value).get(name) for name in names]
            members = [one.__func__ if isinstance(one, staticmethod) else one for one in members]
            yield from (one for one in members if isinstance(one, FunctionType))


def _names(code: CodeType) -> list[str]:
    """Return the names of globals and attributes in a function's code and in those defined inside it."""
    inner = [name for one in code.co_consts if isinstance(one, CodeType) for name in _names(one)]
    return [*code.co_names, *inner]


def _is_of_library(function: FunctionType) -> bool:
    return function.__module__.partition(".")[0] in _LIBRARIES


def source_files(functions: list[FunctionType]) -> list[Path]:
    """Return the files in which functions are defined, sorted; one without a file is left out."""
    files = {inspect.getsourcefile(one) for one in functions}
    return sorted(Path(one) for one in files if one is not None and Path(one).is_file())
