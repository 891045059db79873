"""filterpy's extended Kalman filter, imported without scipy.stats.

filterpy needs two distributions of scipy.stats, for the likelihood of an innovation and for functions that nothing here
calls; loading them takes longer, and more memory, than the rest of the filter's imports together. So while filterpy is
imported, stand-ins take their place, which load scipy.stats when they are first used. Everything in filterpy works as
before, only later.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

_DEFERRED = "scipy.stats"
_NAMES = ("norm", "multivariate_normal")


class _Distribution:
    """Stands for a distribution of scipy.stats, which it loads at its first use."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        """Return the attribute of the distribution itself."""
        module = sys.modules.get(_DEFERRED)
        if isinstance(module, _StandIn):
            # filterpy asks at its import whether logpdf takes allow_singular, as it has done since scipy 0.14.
            return lambda *_args, **_options: None
        return getattr(getattr(importlib.import_module(_DEFERRED), self._name), attribute)

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Freeze the distribution, as calling it does."""
        return self.__getattr__("__call__")(*args, **options)


class _StandIn(ModuleType):
    """Stands for scipy.stats while filterpy is imported."""

    def __init__(self) -> None:
        super().__init__(_DEFERRED)
        for name in _NAMES:
            setattr(self, name, _Distribution(name))


@contextmanager
def _without_scipy_stats() -> Iterator[None]:
    """Put the stand-in into the place of scipy.stats, unless that is loaded already."""
    if _DEFERRED in sys.modules:
        yield
        return
    sys.modules[_DEFERRED] = _StandIn()
    try:
        yield
    finally:
        del sys.modules[_DEFERRED]


with _without_scipy_stats():
    from filterpy.kalman import ExtendedKalmanFilter

__all__ = ["ExtendedKalmanFilter"]
