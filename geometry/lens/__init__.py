"""Lens calibration from boards: corners, joint fit of lens, poses and the board's shape, covariance, coverage."""

from .boards import Board, BoardView, find_board, other_size
from .calibrate import Calibration, ViewFit, calibrate
from .coverage import Coverage, coverage, differ_px, uncovered
from .model import PARAMETERS

__all__ = [
    "PARAMETERS",
    "Board",
    "BoardView",
    "Calibration",
    "Coverage",
    "ViewFit",
    "calibrate",
    "coverage",
    "differ_px",
    "find_board",
    "other_size",
    "uncovered",
]
