"""Point tracks of other programs: trackpy, DLTdv (and Argus), Kinovea, Tracker. How they count pixels: docs/import.md."""

from .convention import Convention
from .points import Imported, Points, Wanted, tracks_table
from .read import PROGRAMS, import_tracks, program_of

__all__ = [
    "PROGRAMS",
    "Convention",
    "Imported",
    "Points",
    "Wanted",
    "import_tracks",
    "program_of",
    "tracks_table",
]
