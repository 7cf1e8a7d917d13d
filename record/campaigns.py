"""What came of a campaign: its runs and fits, each with its numbers or the reason why there are none."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

TRIM = "trim"
"""Of the model, by the stern positive, rad; among a run's numbers where run.toml says it."""
Number = tuple[str, float, float | None, str]
"""Quantity, value, standard deviation, unit."""


@dataclass(frozen=True)
class Answer:
    """What a job found.

    Attributes
    ----------
    job : its name
    name : of the run, or of the group
    reason : why there is no result; empty where there is one
    wants : "derivatives", "steady", both ("derivatives, steady"), "free_run" or "" (motion alone): what the run is good for
    hull : length, mass and density that runs of one fit share
    numbers : what is tabulated
    failed : runs left out of a fit, and why
    wrote : files
    stamp : of what the results were made from
    redone : it was worked out now
    """

    job: str
    name: str = ""
    reason: str = ""
    wants: str = ""
    hull: tuple[float, ...] = ()
    numbers: tuple[Number, ...] = ()
    failed: dict[str, str] = field(default_factory=dict)
    wrote: tuple[str, ...] = ()
    stamp: str = ""
    redone: bool = True


@dataclass(frozen=True)
class Campaign:
    """What came of it.

    Attributes
    ----------
    folder : of the campaign
    out : of its results
    runs, fits : in order; failed ones with their reason
    wrote : files
    """

    folder: Path
    out: Path
    runs: list[Answer]
    fits: list[Answer]
    wrote: list[Path]

    @property
    def failed(self) -> dict[str, str]:
        """Run or fit -> why it has no result, and runs that a fit left out."""
        found = {a.job: a.reason for a in (*self.runs, *self.fits) if a.reason}
        for fit in self.fits:
            found |= {name: why for name, why in fit.failed.items() if name not in found}
        return found


__all__ = ["TRIM", "Answer", "Campaign", "Number"]
