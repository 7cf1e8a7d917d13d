"""What a fit asks of a simulator: any that can be run with numbers and effects will do. ``diagnosable`` asks more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from ...simulate.model import Array
from ..effects import Effect
from .apart import Apart
from .hypothesis import Hypothesis, Slopes
from .noise import Noise


class SimulatedRun(Protocol):
    """A measured run: evenly spaced values."""

    @property
    def name(self) -> str:
        """Of the run."""
        ...

    @property
    def centre_s(self) -> Array:
        """(n,) times from its start."""
        ...

    @property
    def values(self) -> Array:
        """(n, c) measured; NaN where not."""
        ...

    @property
    def covariance(self) -> Array:
        """(c, n, n) measurement noise of each channel."""
        ...


class Simulator(Protocol):
    """A simulator of all runs of a campaign.

    Attributes
    ----------
    step_s : between values
    shared_names : of the numbers that all runs share
    shared_prior : mean and standard deviation of those; None: fitted freely
    shared_bounds : (2, s), the least and the most that they may be; None: anything
    stated, own_sd : (runs, own): each run's own numbers as stated, and how sure they are
    free : how many of a run's own numbers its data decide (its start)
    modes : per run (n, c, k): common errors of unit variance
    gone : a simulation this far from the measurement has grown beyond bounds
    least : size below which a shared number counts as small; one for all or (s,)
    most_force : random forces above this are a gap, not noise
    half_sure, sure_width : ``inexact``: an effect that takes this share of a gap is as likely itself, in another form, as something
        else, and how fast that goes over
    noise_known : whether the runs' noise is known well enough to say that they disagree about shared numbers; not where it is
        the scatter of a few points
    force_scale : unit of the random forces' sizes
    apart : effect.number -> what was measured of it apart from the runs
    """

    step_s: float
    shared_names: tuple[str, ...]
    shared_prior: tuple[Array, Array] | None
    shared_bounds: Array | None
    stated: Array
    own_sd: Array
    free: int
    modes: list[Array]
    gone: float
    least: float | Array
    most_force: float
    half_sure: float
    sure_width: float
    noise_known: bool
    force_scale: float
    apart: Mapping[str, Apart]

    @property
    def runs(self) -> Sequence[SimulatedRun]:
        """Measured runs."""
        ...

    def starts(self) -> Sequence[Hypothesis]:
        """Where the fit without effects may begin; the best end counts."""
        ...

    def linear(self, hypotheses: Sequence[Hypothesis], closings: int) -> list[Slopes]:
        """Residuals and slopes of hypotheses; ``closings`` 0: a motion may be left open (lifted) where the simulator can."""
        ...

    def noise(self, hypothesis: Hypothesis) -> Noise:
        """Of the measurement, and of random forces about this hypothesis."""
        ...

    def usable(self, library: Sequence[Effect]) -> tuple[list[Effect], dict[str, str]]:
        """Effects that these runs can show, and why the others cannot be judged."""
        ...


__all__ = ["SimulatedRun", "Simulator"]
