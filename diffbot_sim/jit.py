"""Makes pure functions callable from compiled code, from outside: they themselves know nothing of numba.

``numba.extending.register_jitable`` registers each pure function with the compiler; all other callers still get the
plain Python function.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import functools
import hashlib
import inspect
import logging
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

from diffbot_control.law.law import Law
from diffbot_core.errors import DiffbotError
from diffbot_core.files import cache_folder
from diffbot_core.installed import DIGITS, hash_of_code
from diffbot_sim import compiled_kalman, fusion
from diffbot_sim.references import borrowed, referred

try:
    import numba
    from numba.extending import overload, register_jitable
except ImportError as error:
    raise DiffbotError("compiled simulation needs numba: pip install 'numba>=0.60'") from error

PACKAGES = ("diffbot_core", "diffbot_control", "diffbot_sim")
"""Packages that decide the results of a run."""
LIBRARIES = ("llvmlite", "numba", "numpy")
"""Libraries that compile it and compute with it."""
_settings: Any = numba.config
_REPLACED: dict[Any, Any] = {
    **compiled_kalman.LOOPS,
    fusion.borrowed: borrowed,
    fusion.referred: referred,
}
"""Functions for which compiled code calls others."""
_registered: set[Any] = set()
"""functions that compiled code may call"""


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
            if function not in _REPLACED:
                waiting += [one for one in _called(function) if not _is_of_library(one)]
    return list(found)


def _called(function: FunctionType) -> Iterator[FunctionType]:
    names = _names(function.__code__)
    values = [function.__globals__.get(name) for name in names]
    for value in values + [cell.cell_contents for cell in function.__closure__ or ()]:
        if isinstance(value, FunctionType):
            yield value
        elif isinstance(value, (ModuleType, type)):
            # vars(), not getattr: a module may import lazily.
            members = [vars(value).get(name) for name in names]
            members = [one.__func__ if isinstance(one, staticmethod) else one for one in members]
            yield from (one for one in members if isinstance(one, FunctionType))


def _names(code: CodeType) -> list[str]:
    """Return the names of globals and attributes in a function's code and in those defined inside it."""
    return [*code.co_names, *(name for one in code.co_consts if isinstance(one, CodeType) for name in _names(one))]


def _is_of_library(function: FunctionType) -> bool:
    return function.__module__.partition(".")[0] in ("builtins", "collections", "math", "numba", "numpy", "typing")


def source_hash(*roots: Any, name: str = "") -> str:
    """Return a hash of a name and of the source files of all functions that ``roots`` can call."""
    files = {inspect.getsourcefile(one) for one in reachable_functions(*roots)}
    digest = hashlib.sha256(name.encode())
    for path in sorted((Path(one) for one in files if one and Path(one).is_file()), key=lambda one: one.name):
        digest.update(f"{path.name}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:DIGITS]


def law_version(law: type[Law]) -> str:
    """Return a hash of a law's name and of the files that its functions and its configuration are in."""
    config = inspect.getsourcefile(law.Config)
    text = Path(config).read_text() if config else ""
    return source_hash(law.new_memory, law.step, name=law.name + text)


@functools.cache
def code_version() -> str:
    """Return the hash that names the code of a run."""
    return hash_of_code(PACKAGES, LIBRARIES)


@functools.cache
def _cache_folder() -> Path:
    """Return the folder of the cache, named after the code.

    numba looks only at the file of the function it compiles; it would miss a change in a function called from there
    and run the old code.
    """
    try:
        folder = Path(_settings.CACHE_DIR or cache_folder()) / code_version()
        folder.mkdir(parents=True, exist_ok=True)
        return folder
    except (DiffbotError, OSError) as error:
        logging.getLogger("diffbot").warning("compiling without a cache: %s", error)
        made = Path(tempfile.mkdtemp(prefix="diffbot-"))
        atexit.register(shutil.rmtree, made, ignore_errors=True)
        return made


@contextlib.contextmanager
def _numba_settings(version: str = "") -> Iterator[None]:
    """Let numba use this project's cache and its level of optimisation in the ``with`` block, and nowhere else."""
    # The loops are as fast as with the highest level of optimisation, and compile in 0.7 of the time.
    changed = {"CACHE_DIR": str(_cache_folder() / version), "OPT": type(_settings.OPT)(1)}
    usual = {name: getattr(_settings, name) for name in changed}
    try:
        for name, value in changed.items():
            setattr(_settings, name, value)
        yield
    finally:
        for name, value in usual.items():
            setattr(_settings, name, value)


@contextlib.contextmanager
def one_compiler(version: str) -> Iterator[None]:
    """Let one process at a time into the ``with`` block, where it compiles; the next ones find the result in the cache.

    Args:
        version: of what is compiled, as for :func:`compile_kernel`; different versions do not wait for each other.
    """
    folder = _cache_folder() / version
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "compiling.lock").open("w") as lock, _numba_settings():
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def register(*roots: Any) -> None:
    """Let compiled code call functions, and all that they call."""
    for function in reachable_functions(*roots):
        if function not in _registered:
            _registered.add(function)
            if function in _REPLACED:
                _replace(function, _REPLACED[function])
                continue
            options = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "error_model": "numpy"}
            register_jitable(**options, forceinline=_is_inlined(function), cache=function in _KEPT)(function)


def _replace(function: Any, loop: Any) -> None:
    """Let compiled code call ``loop`` where it says ``function``."""
    register(*reachable_functions(loop))

    def chosen(*_: Any) -> Any:
        return loop

    overload(function, strict=False, jit_options={"error_model": "numpy"})(chosen)


_KEPT = (fusion.estimate,)
"""Functions that take long to compile and are the same under all laws: they are compiled once."""


def _is_inlined(function: FunctionType) -> bool:
    """Return True for a function to be put into its callers.

    Robot and law are then kept in registers, which more than doubles the speed of the loop. The filter works on arrays:
    it gains nothing from it, and takes minutes to compile.
    """
    return not function.__module__.startswith(("diffbot_control.filter", "diffbot_sim.fusion", "diffbot_sim.compiled"))


def compile_kernel(function: Any, version: str = "") -> Any:
    """Compile a function and all that it calls, at its first call.

    It releases the interpreter's lock, so threads run in parallel.

    Args:
        function: to be compiled.
        version: hash of code that is not of this package; the cache is in a folder of its own.
    """
    register(*(one for one in reachable_functions(function) if one is not function))
    with _numba_settings(version):
        return numba.njit(function, nogil=True, cache=True, error_model="numpy")
