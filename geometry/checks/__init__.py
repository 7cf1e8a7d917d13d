"""Is the camera right? Datum, marker distances and taut line in one fit; faults tried one by one."""

from .check import Check, check_geometry

__all__ = ["Check", "check_geometry"]
