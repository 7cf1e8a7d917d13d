"""Measured against simulated."""

from .compare import MotionError, motion_error

__all__ = ["MotionError", "motion_error"]
