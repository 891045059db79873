"""Making the pure functions callable from compiled code, from outside: they themselves know nothing of numba.

``numba.extending.register_jitable`` tells the compiler about each pure function; the functions stay what they are for
everybody else.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from diffbot_control.filter import adaptation, gate, models
from diffbot_control.law import controller, goal_checker, limits, lyapunov_law, polar_coordinates, reapproach, regions
from diffbot_core import geometry, kinematics, uncertainty
from diffbot_core.errors import DiffbotError
from diffbot_sim.compiled import closed_loop, open_loop, peer_laws, scalar_belief, scalar_ekf, scalar_filter, sensing
from diffbot_sim.model import philox, plant, sensors

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
    plant,
    sensors,
    gate,
    adaptation,
    scalar_belief,
    scalar_ekf,
    scalar_filter,
    sensing,
    peer_laws,
    closed_loop,
    open_loop,
)
"""Modules whose functions compiled code may call."""


def _functions(module: ModuleType) -> list[Any]:
    return [one for one in vars(module).values() if inspect.isfunction(one) and one.__module__ == module.__name__]


def _hash_of_sources() -> str:
    own = sorted(path for name in ("batch*.py", "jit.py") for path in Path(__file__).parent.glob(name))
    paths = [*(Path(inspect.getfile(module)) for module in MODULES), *own]
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()[:16]


SOURCES_HASH = _hash_of_sources()
"""Names the code that decides the results of a run."""


try:
    import numba
    from numba.extending import register_jitable
except ImportError as error:
    raise DiffbotError("compiled simulation needs numba: pip install 'numba>=0.60'") from error


def _cache_of_these_sources() -> str:
    """Return a folder named after the sources.

    numba looks only at the file of the function that it compiles; a change in a function which that one calls would go
    unseen, and the old code would run on.
    """
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "diffbot"
    try:
        base.mkdir(parents=True, exist_ok=True)
    except OSError:
        base = Path(tempfile.gettempdir()) / f"diffbot-{os.getuid()}"
    return str(Path(_settings.CACHE_DIR or base) / SOURCES_HASH)


_settings: Any = numba.config


def make_callable(function: Any, *, inline: bool = True) -> None:
    """Let compiled code call a pure function.

    Args:
        function: to be called.
        inline: put it into its callers: the parts of a case stay in registers, which more than doubles the speed of the
            loop. It gets no wrappers, since nobody but compiled code calls it.
    """
    register_jitable(forceinline=inline, no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)


for _module in MODULES:
    for _function in _functions(_module):
        # A peer's constants would come along, and a power of 2.0 become a product: another last bit now and then.
        make_callable(_function, inline=_module is not peer_laws)


def compile_kernel(function: Any) -> Any:
    """Compile a function that calls the pure ones; it runs without the interpreter's lock: threads run in parallel."""
    # Set here and not in the environment, which numba reads when it is imported first, by whomever.
    usual, _settings.CACHE_DIR = _settings.CACHE_DIR, _cache_of_these_sources()
    try:
        return numba.njit(
            function,
            nogil=True,
            cache=True,
            error_model="numpy",
        )
    finally:
        _settings.CACHE_DIR = usual
