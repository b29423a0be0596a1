"""Shapes of a wing measured in flight, with their covariance.

Submodules are imported on first use, so that ``import wingd`` does not load what a script does not need.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

#: Public name -> module that defines it (a module of the package if the names are equal).
_PUBLIC = {
    "backend": "wingd.backend",
    "cameras": "wingd.cameras",
    "compare": "wingd.comparison",
    "conditions": "wingd.conditions",
    "fleet": "wingd.fleet",
    "loads": "wingd.loads",
    "modes": "wingd.modes",
    "open": "wingd.store",
    "plot": "wingd.plot",
    "shapes": "wingd.shapes",
    "spectrum": "wingd.loads",
    "store": "wingd.store",
    "surfaces": "wingd.surfaces",
    "timecheck": "wingd.timecheck",
    "upload": "wingd.upload",
    "values": "wingd.values",
}

__all__ = ["WingdError", "WingdWarning", "__version__", *_PUBLIC]


class WingdError(Exception):
    """A wrong input: one sentence with file, key or line, value and remedy.

    Commands print it without a traceback and exit with status 1.
    """


class WingdWarning(UserWarning):
    """A fact that changes how a result is to be read."""


def __getattr__(name: str) -> Any:
    module = _PUBLIC.get(name)
    if module is None:
        raise AttributeError(f"module 'wingd' has no attribute {name!r}")
    loaded = importlib.import_module(module)
    return loaded if module == f"wingd.{name}" else getattr(loaded, name)


def __dir__() -> list[str]:
    return sorted(__all__)
