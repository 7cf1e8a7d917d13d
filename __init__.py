"""towline: from a camera recording of a towed ship model to its hydrodynamic derivatives.

The front door, a flat list; each name is loaded when it is first asked for:

- ``read_run``: a run folder
- ``track``, ``compute_motion``, ``check_camera``: video to marks, marks to motion, is the camera right?
- ``identify``, ``steady``, ``diagnose``: motion to derivatives, to the neutral point; why the simulator still differs
- ``budget``: the uncertainty budget of the derivatives and of the neutral point
- ``gap``: what a model of your own, a Python file or an FMU, misses
- ``simulate``, ``render``: a scenario to its motion, to a film with its truth

    import towline
    towline.identify("run-1", "run-2").derivatives["y_v"]
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from .__version__ import __version__

if TYPE_CHECKING:
    from .pipeline.front import (
        budget,
        check_camera,
        compute_motion,
        diagnose,
        gap,
        identify,
        render,
        simulate,
        steady,
        track,
    )
    from .record.run import read_run

__all__ = [
    "__version__",
    "budget",
    "check_camera",
    "compute_motion",
    "diagnose",
    "gap",
    "identify",
    "read_run",
    "render",
    "simulate",
    "steady",
    "track",
]


def _front() -> ModuleType:
    return import_module(".pipeline.front", __name__)


class _CalledRoom(ModuleType):
    """A room whose name is a function's, too: ``towline.identify(...)`` beside ``from towline.identify import RunData``."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return getattr(_front(), self.__name__.rpartition(".")[2])(*arguments, **options)


class _House(ModuleType):
    """The package itself: Python hangs every room that is imported on it, and this sees it."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in __all__ and type(value) is ModuleType:
            value.__class__ = _CalledRoom
        super().__setattr__(name, value)


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(_front(), name)
    # of a room that is a function, too, the room stands here
    return getattr(sys.modules[__name__], name) if f"{__name__}.{name}" in sys.modules else found


def __dir__() -> list[str]:
    return sorted(__all__)


sys.modules[__name__].__class__ = _House
