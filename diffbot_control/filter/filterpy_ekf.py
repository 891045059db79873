"""filterpy's extended Kalman filter, imported without scipy.

filterpy loads large parts of scipy for functions that nothing here calls; that takes longer, and more memory, than
all other imports of a filter together. So while filterpy is imported, stand-ins take the place of scipy's modules; they
load the real ones when something of them is used. Everything in filterpy works as before, only later.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

_SLOWEST = "scipy.stats"
_DEFERRED = ("scipy", "scipy.linalg", "scipy.ndimage", "scipy.sparse", "scipy.sparse.linalg", _SLOWEST)
"""All that filterpy imports of scipy."""


class _Object:
    """Stands for a function or a distribution of a module, which is loaded at its first use."""

    def __init__(self, module: str, name: str) -> None:
        self._module, self._name = module, name

    def __getattr__(self, attribute: str) -> Any:
        """Return the attribute of the object itself."""
        if isinstance(sys.modules.get(self._module), _StandIn):
            # filterpy asks at its import whether logpdf takes allow_singular, as it has done since scipy 0.14.
            return lambda *_args, **_options: None
        return getattr(getattr(importlib.import_module(self._module), self._name), attribute)

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Call the object itself."""
        return getattr(importlib.import_module(self._module), self._name)(*args, **options)


class _StandIn(ModuleType):
    """Stands for a module of scipy while filterpy is imported; filterpy's modules keep it, and use it later."""

    def __getattr__(self, name: str) -> Any:
        """Return what ``name`` stands for in the module."""
        if name.startswith("__"):
            raise AttributeError(name)
        if sys.modules.get(self.__name__) is not self:
            return getattr(importlib.import_module(self.__name__), name)
        part = sys.modules.get(f"{self.__name__}.{name}")
        return _Object(self.__name__, name) if part is None else part


@contextmanager
def _without_scipy() -> Iterator[None]:
    """Put stand-ins into the places of scipy's modules; of a scipy that is loaded already, only of scipy.stats."""
    wanted = [_SLOWEST] if "scipy" in sys.modules else _DEFERRED
    names = [name for name in wanted if name not in sys.modules]
    sys.modules.update({name: _StandIn(name) for name in names})
    try:
        yield
    finally:
        for name in names:
            del sys.modules[name]


with _without_scipy():
    from filterpy.kalman import ExtendedKalmanFilter

__all__ = ["ExtendedKalmanFilter"]
