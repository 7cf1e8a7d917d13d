"""Ground floor: the run folder, its tables and its result files. Every room reads and writes through here."""

from .errors import EstimationError, GeometryError, InputError, TowlineError, TrackingError, VideoError
from .priors import Priors
from .results import Derivative, DerivativesFile, SteadyFile, read_result, write_result
from .run import Run, read_run
from .schema import CameraTable, DatumPoint, Marker, ModelTable, NoiseTable, RunFile, SourceTable, TowTable, WaterTable
from .tables import (
    read_history,
    read_motion,
    read_table,
    read_tracks,
    write_table,
)

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
