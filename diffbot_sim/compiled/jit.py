"""Makes the pure functions callable from compiled code, from outside: they themselves know nothing of numba.

``numba.extending.register_jitable`` registers each pure function with the compiler; all other callers still get the
plain Python function.
"""

from __future__ import annotations

import functools
import inspect
import os
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from diffbot_control.filter import adaptation, gate, models
from diffbot_control.law import controller, goal_checker, limits, lyapunov_law, polar_coordinates, reapproach, regions
from diffbot_core import geometry, kinematics, uncertainty
from diffbot_core.code_hash import hash_of_code
from diffbot_core.errors import DiffbotError
from diffbot_sim.compiled import (
    closed_loop,
    late_fusion,
    open_loop,
    peer_laws,
    scalar_belief,
    scalar_ekf,
    scalar_filter,
    sensing,
)
from diffbot_sim.model import actuators, outcome, philox, plant, sensors

MODULES = (
    geometry,
    kinematics,
    models,
    uncertainty,
    polar_coordinates,
    lyapunov_law,
    regions,
    limits,
    goal_checker,
    reapproach,
    controller,
    philox,
    actuators,
    plant,
    sensors,
    outcome,
    gate,
    adaptation,
    scalar_belief,
    scalar_ekf,
    scalar_filter,
    sensing,
    late_fusion,
    peer_laws,
    closed_loop,
    open_loop,
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


def _cache_folder() -> str:
    """Return a cache folder named after the code.

    numba looks only at the file of the function it compiles; it would miss a change in a function called from there
    and run the old code.
    """
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "diffbot"
    try:
        base.mkdir(parents=True, exist_ok=True)
    except OSError:
        base = Path(tempfile.gettempdir()) / f"diffbot-{os.getuid()}"
    return str(Path(_settings.CACHE_DIR or base) / code_version())


_settings: Any = numba.config


def make_callable(function: Any, *, inline: bool = True) -> None:
    """Let compiled code call a pure function.

    Args:
        function: to be called. It gets no wrappers, since only compiled code calls it.
        inline: put it into its callers: the parts of a case stay in registers, which more than doubles the speed of the
            loop.
    """
    register_jitable(forceinline=inline, no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)


for _module in MODULES:
    for _function in _functions(_module):
        # Inlined, a peer's law would be specialised for its constants, and ** 2.0 become a product: other last bits.
        make_callable(_function, inline=_module is not peer_laws)


def compile_kernel(function: Any) -> Any:
    """Compile a function that calls the pure ones; it releases the interpreter's lock, so threads run in parallel."""
    # Set here and not in the environment, which numba reads only at its first import, possibly by other code.
    usual, _settings.CACHE_DIR = _settings.CACHE_DIR, _cache_folder()
    try:
        return numba.njit(
            function,
            nogil=True,
            cache=True,
            error_model="numpy",
        )
    finally:
        _settings.CACHE_DIR = usual
