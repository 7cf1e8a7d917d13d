"""Ground floor: the run folder, its tables and its result files. Every room reads and writes through here.

Names are loaded when they are first asked for: what reads no run (``towline --help``) waits for nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .errors import EstimationError, GeometryError, InputError, TowlineError, TrackingError, VideoError
    from .priors import Priors
    from .results import Derivative, DerivativesFile, SteadyFile, read_result, write_result
    from .run import Run, read_run
    from .schema import (
        CameraTable,
        DatumPoint,
        Marker,
        ModelTable,
        NoiseTable,
        RunFile,
        SourceTable,
        TowTable,
        WaterTable,
    )
    from .tables import read_history, read_motion, read_table, read_tracks, write_table

_PLACES = {
    "CameraTable": ".schema",
    "DatumPoint": ".schema",
    "Derivative": ".results",
    "DerivativesFile": ".results",
    "EstimationError": ".errors",
    "GeometryError": ".errors",
    "InputError": ".errors",
    "Marker": ".schema",
    "ModelTable": ".schema",
    "NoiseTable": ".schema",
    "Priors": ".priors",
    "Run": ".run",
    "RunFile": ".schema",
    "SourceTable": ".schema",
    "SteadyFile": ".results",
    "TowTable": ".schema",
    "TowlineError": ".errors",
    "TrackingError": ".errors",
    "VideoError": ".errors",
    "WaterTable": ".schema",
    "read_history": ".tables",
    "read_motion": ".tables",
    "read_result": ".results",
    "read_run": ".run",
    "read_table": ".tables",
    "read_tracks": ".tables",
    "write_result": ".results",
    "write_table": ".tables",
}

__all__ = [
    "CameraTable",
    "DatumPoint",
    "Derivative",
    "DerivativesFile",
    "EstimationError",
    "GeometryError",
    "InputError",
    "Marker",
    "ModelTable",
    "NoiseTable",
    "Priors",
    "Run",
    "RunFile",
    "SourceTable",
    "SteadyFile",
    "TowTable",
    "TowlineError",
    "TrackingError",
    "VideoError",
    "WaterTable",
    "read_history",
    "read_motion",
    "read_result",
    "read_run",
    "read_table",
    "read_tracks",
    "write_result",
    "write_table",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_PLACES[name], __name__), name)
