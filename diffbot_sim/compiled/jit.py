"""Makes the pure functions callable from compiled code, from outside: they themselves know nothing of numba.

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
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from diffbot_control.filter import (
    adaptation,
    averaging,
    correlation,
    dock,
    fix_correlation,
    gate,
    landmark_calibration,
    landmark_correlation,
    models,
    slip,
)
from diffbot_control.goals.protocol import Law
from diffbot_control.law import (
    braking_step,
    configuration,
    controller,
    docking,
    docking_axis,
    finish,
    goal_checker,
    latency,
    limits,
    lyapunov_law,
    polar_coordinates,
    regions,
    speed_profile,
    steering,
)
from diffbot_control.law.paper import reapproach
from diffbot_control.law.paper import step as paper_step
from diffbot_core import data_sheet, geometry, kinematics, uncertainty
from diffbot_core.code_hash import DIGITS, hash_of_code
from diffbot_core.errors import DiffbotError
from diffbot_core.private_folders import cache_folder, private_folder
from diffbot_sim.compiled import closed_loop, ekf, gated_filter, late_fusion, open_loop, sensing, stepping
from diffbot_sim.compiled.reachable import reachable_functions, source_files
from diffbot_sim.model import actuators, detector, outcome, philox, plant, sensors

MODULES = (
    geometry,
    kinematics,
    models,
    landmark_calibration,
    uncertainty,
    polar_coordinates,
    lyapunov_law,
    regions,
    limits,
    goal_checker,
    reapproach,
    data_sheet,
    speed_profile,
    steering,
    latency,
    finish,
    configuration,
    paper_step,
    braking_step,
    controller,
    docking,
    docking_axis,
    philox,
    actuators,
    plant,
    detector,
    sensors,
    outcome,
    gate,
    adaptation,
    averaging,
    correlation,
    dock,
    fix_correlation,
    landmark_correlation,
    slip,
    gated_filter,
    sensing,
    late_fusion,
    closed_loop,
    open_loop,
    stepping,
)
"""Modules whose functions compiled code may call."""


def _functions(module: ModuleType) -> list[Any]:
    return [one for one in vars(module).values() if inspect.isfunction(one) and one.__module__ == module.__name__]


PACKAGES = ("diffbot_core", "diffbot_control", "diffbot_sim")
"""Packages that decide the results of a run."""
LIBRARIES = ("llvmlite", "numba", "numpy")
"""Libraries that compile it and compute with it."""


@functools.cache
def code_version() -> str:
    """Return the hash that names the code of a run."""
    return hash_of_code(PACKAGES, LIBRARIES)


try:
    import numba
    from numba.extending import register_jitable
except ImportError as error:
    raise DiffbotError("compiled simulation needs numba: pip install 'numba>=0.60'") from error


def _name_by_value(kind: Any) -> None:
    """Name compiled functions by the content of types of a kind, not by a number that is another one in each process.

    Of two functions with the same name the one that is loaded first runs, even if the cache has them from two
    processes in which two types had one number; and the type of an array in a record is named without its shape.
    """

    def mangling_args(self: Any) -> tuple[str, tuple[str]]:
        return kind.__name__, (hashlib.sha256(self.name.encode()).hexdigest()[:DIGITS],)

    kind.mangling_args = property(mangling_args)


for _kind in (numba.types.Record, numba.types.NestedArray):
    _name_by_value(_kind)


def _cache_folder() -> Path:
    """Return the folder of the cache, named after the code.

    numba looks only at the file of the function it compiles; it would miss a change in a function called from there
    and run the old code. What it finds there it runs: a folder that others can write to is not used.
    """
    return _folder_in(_settings.CACHE_DIR)


@functools.cache
def _folder_in(given: str) -> Path:
    """Return the folder below a given one, or below this user's cache; where it is not this user's alone, a new one."""
    try:
        return private_folder(Path(given or cache_folder()) / code_version())
    except DiffbotError as error:
        logging.getLogger("diffbot").warning("compiling anew, without a cache: %s", error)
        made = Path(tempfile.mkdtemp(prefix="diffbot-"))
        atexit.register(shutil.rmtree, made, ignore_errors=True)
        return made


_settings: Any = numba.config
if "NUMBA_OPT" not in os.environ:
    # One level for all of a process. The loops are as fast as with the highest one, and compile in 0.7 of the time.
    _settings.OPT = type(_settings.OPT)(1)


@contextlib.contextmanager
def one_compiler(version: str) -> Iterator[None]:
    """Let one process at a time into the ``with`` block, where it compiles; the next ones find the result in the cache.

    Args:
        version: of what is compiled, as for :func:`compile_kernel`; different versions do not wait for each other.
    """
    with _locked(version), _cache_in(str(_cache_folder())):
        yield


@contextlib.contextmanager
def _cache_in(folder: str) -> Iterator[None]:
    """Have numba use a cache folder in the ``with`` block."""
    # Set here and not in the environment, which numba reads only at its first import, possibly by other code.
    usual, _settings.CACHE_DIR = _settings.CACHE_DIR, folder
    try:
        yield
    finally:
        _settings.CACHE_DIR = usual


@contextlib.contextmanager
def _locked(version: str) -> Iterator[None]:
    folder = _cache_folder() / version
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / "compiling.lock").open("w")
    except OSError:  # no cache to share
        yield
        return
    with lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def make_callable(function: Any, *, inline: bool = True, kept: bool = False) -> None:
    """Let compiled code call a pure function.

    Args:
        function: to be called. It gets no wrappers, since only compiled code calls it.
        inline: put it into its callers: the parts of a case stay in registers, which more than doubles the speed of the
            loop.
        kept: keep what is compiled for other kernels and processes; its callers must be compiled by
            :func:`one_compiler`, which sets the folder for that.
    """
    if function not in _registered:
        _registered.add(function)
        register_jitable(forceinline=inline, no_cpython_wrapper=True, no_cfunc_wrapper=True, cache=kept)(function)


_registered: set[Any] = set()
"""functions that compiled code may call"""
KEPT = (closed_loop.next_feedback, controller.SwitchingLaw.step)
"""Functions that take most of the time to compile and are the same in the kernels of many laws or configurations."""

for _module in MODULES:
    for _function in _functions(_module):
        make_callable(_function, kept=_function in KEPT)
_IN_EVERY_STEP = (ekf.predict, ekf.corrected_twist, ekf.propagate, ekf.pose_of)
for _function in _functions(ekf):
    make_callable(_function, inline=_function in _IN_EVERY_STEP)  # the loops of the others gain nothing from it


def make_law_callable(law: Law) -> str:
    """Let compiled code call a law: its functions and all that they call.

    Returns:
        A hash of the law's name and source files, for the cache of what is compiled with it.
    """
    functions = reachable_functions(law.new_memory, law.step)
    for function in functions:
        make_callable(function)
    return law_version(law)


def law_version(law: Law) -> str:
    """Return a hash of a law's name and of the files that its functions and its configuration are in."""
    files = source_files(reachable_functions(law.new_memory, law.step))
    config = inspect.getsourcefile(law.Config)
    digest = hashlib.sha256(law.name.encode())
    for path in sorted({*files, *([Path(config)] if config else [])}, key=lambda one: one.name):
        digest.update(f"{path.name}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:DIGITS]


def compile_kernel(function: Any, version: str = "") -> Any:
    """Compile a function that calls the pure ones; it releases the interpreter's lock, so threads run in parallel.

    Args:
        function: to be compiled, at its first call.
        version: hash of code that is not of this package; the cache is in a folder of its own.
    """
    with _cache_in(str(_cache_folder() / version)):
        return numba.njit(function, nogil=True, cache=True, error_model="numpy")
