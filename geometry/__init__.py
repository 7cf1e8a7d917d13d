"""Pixel <-> tank: camera, datum planes, deck height, rigid markers -> motion."""

from .camera import Camera, Lens
from .datum import DatumFit, fit_datum
from .mapping import Mapping, Places, ProjectiveMapping
from .motion import METHODS, Motion, motion_from_tracks, run_datum, run_mapping
from .rigid import RigidFit, fit_rigid
from .trapezoid import Trapezoid, TrapezoidMapping, trapezoid_from_datum

__all__ = [
    "METHODS",
    "Camera",
    "DatumFit",
    "Lens",
    "Mapping",
    "Motion",
    "Places",
    "ProjectiveMapping",
    "RigidFit",
    "Trapezoid",
    "TrapezoidMapping",
    "fit_datum",
    "fit_rigid",
    "motion_from_tracks",
    "run_datum",
    "run_mapping",
    "trapezoid_from_datum",
]
