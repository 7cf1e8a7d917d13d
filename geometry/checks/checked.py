"""One camera set-up, checked: what the page shows."""

from __future__ import annotations

from dataclasses import dataclass

from ...record.check_file import CheckFile
from ...record.run import Run
from ..datum import DatumFit
from ..poses import Poses
from .check import Check


@dataclass(frozen=True)
class Checked:
    """One camera set-up, checked.

    Attributes
    ----------
    file : check.json
    check : the fits behind it
    runs, poses : of this set-up
    datum : its fit
    """

    file: CheckFile
    check: Check
    runs: list[Run]
    poses: list[Poses]
    datum: DatumFit


__all__ = ["Checked"]
