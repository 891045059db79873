"""Compile pure functions with numba. The functions themselves do not import numba.

``numba.extending.register_jitable`` registers a function with the compiler; Python code still calls the plain function.
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
from diffbot_sim.references import borrowed, reference_to

try:
    import numba
    from numba.extending import overload, register_jitable
except ImportError as error:
    raise DiffbotError("compiled simulation needs numba: pip install 'numba>=0.60'") from error

PACKAGES = ("diffbot_core", "diffbot_control", "diffbot_sim")
"""Packages whose code determines the results of a run."""
LIBRARIES = ("llvmlite", "numba", "numpy")
"""Libraries whose versions may change the results."""
_settings: Any = numba.config
_REPLACEMENTS: dict[Any, Any] = {
    **compiled_kalman.LOOPS,
    fusion.borrowed: borrowed,
    fusion.reference_to: reference_to,
}
"""Functions that compiled code replaces, and their replacements."""
_registered: set[Any] = set()
"""Functions that compiled code may call."""


def reachable_functions(*roots: Any) -> list[FunctionType]:
    """Return ``roots`` and all Python functions that they call by name, directly or indirectly, each once.

    The search looks up names in the module and in the closure of each function, and follows ``module.function``. It
    does not find methods of objects, which pure functions do not call.
    """
    found: dict[FunctionType, None] = {}
    waiting = [one for one in roots if isinstance(one, FunctionType)]
    while waiting:
        function = waiting.pop()
        if function not in found:
            found[function] = None
            if function not in _REPLACEMENTS:
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
    """Return the names of globals and attributes in a function's code and in the functions defined inside it."""
    return [*code.co_names, *(name for one in code.co_consts if isinstance(one, CodeType) for name in _names(one))]


def _is_of_library(function: FunctionType) -> bool:
    return function.__module__.partition(".")[0] in ("builtins", "collections", "math", "numba", "numpy", "typing")


def source_hash(*roots: Any, name: str = "") -> str:
    """Return a hash of a name and of the source files of ``roots`` and all functions that they call."""
    files = {inspect.getsourcefile(one) for one in reachable_functions(*roots)}
    texts = [(Path(one).name, Path(one).read_bytes()) for one in files if one and Path(one).is_file()]
    digest = hashlib.sha256(name.encode())
    for file_name, text in sorted(texts):
        digest.update(f"{file_name}\n".encode() + text)
    return digest.hexdigest()[:DIGITS]


def law_version(law: type[Law]) -> str:
    """Return a hash of a law's name and of the source files of its functions and its configuration."""
    config = inspect.getsourcefile(law.Config)
    text = Path(config).read_text() if config else ""
    return source_hash(law.new_memory, law.step, name=law.name + text)


@functools.cache
def code_version() -> str:
    """Return the hash of the code that determines a run."""
    return hash_of_code(PACKAGES, LIBRARIES)


@functools.cache
def _cache_folder() -> Path:
    """Return the folder of numba's cache, named after the code.

    Numba checks only the file of the compiled function. It would not notice a change in a called function, and run the
    old code.
    """
    try:
        folder = Path(_settings.CACHE_DIR or cache_folder()) / code_version()
        folder.mkdir(parents=True, exist_ok=True)
        return folder
    except (DiffbotError, OSError) as error:
        logging.getLogger("diffbot").warning("no cache for compiled code, each process compiles again: %s", error)
        made = Path(tempfile.mkdtemp(prefix="diffbot-"))
        atexit.register(shutil.rmtree, made, ignore_errors=True)
        return made


@contextlib.contextmanager
def _numba_settings(version: str = "") -> Iterator[None]:
    """Set numba's cache folder and level of optimisation within the ``with`` block only."""
    # Level 1 compiles in 0.7 of the time of the highest level, and the loops are equally fast.
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
def _one_compiler() -> Iterator[None]:
    """Let only one process at a time compile. The others wait, and then load the result from the cache.

    There is one lock for all kernels, since different kernels share functions, which are compiled once.
    """
    with (_cache_folder() / "compiling.lock").open("w") as lock, _numba_settings():
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def register(*roots: Any) -> None:
    """Register functions, and all functions that they call, with the compiler."""
    for function in reachable_functions(*roots):
        if function not in _registered:
            _registered.add(function)
            if function in _REPLACEMENTS:
                _replace(function, _REPLACEMENTS[function])
                continue
            options = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "error_model": "numpy"}
            register_jitable(**options, forceinline=_is_inlined(function), cache=function in _CACHED)(function)


def _replace(function: Any, replacement: Any) -> None:
    """Make compiled code call ``replacement`` instead of ``function``."""
    register(*reachable_functions(replacement))

    def chosen(*_: Any) -> Any:
        return replacement

    overload(function, strict=False, jit_options={"error_model": "numpy"})(chosen)


_CACHED = (fusion.estimate,)
"""Functions that take long to compile and do not depend on the law. Numba caches them separately."""


def _is_inlined(function: FunctionType) -> bool:
    """Return True if a function is inlined into its callers.

    Inlining keeps the states of robot and law in registers, which more than doubles the speed of the loop. The filter
    works on arrays: inlining does not make it faster, but takes minutes to compile.
    """
    return not function.__module__.startswith(("diffbot_control.filter", "diffbot_sim.fusion", "diffbot_sim.compiled"))


def compile_kernel(function: Any, version: str = "") -> Any:
    """Return a function that is compiled at its first call, together with all functions that it calls.

    The compiled function releases the interpreter's lock, so threads run in parallel.

    Args:
        function: the function to compile.
        version: hash of code outside of this package; each version has its own cache folder.
    """
    register(*(one for one in reachable_functions(function) if one is not function))
    with _numba_settings(version):
        kernel = numba.njit(function, nogil=True, cache=True, error_model="numpy")
    compile_or_load = kernel.compile

    def alone(signature: Any) -> Any:
        with _one_compiler():
            return compile_or_load(signature)

    kernel.compile = alone
    return kernel
