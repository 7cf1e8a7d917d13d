"""out/gap.json: the sim-to-real gap (formats.md)."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .results import Measured, ResultFile, _Part

LEAST_SHRINK = 0.005
"""A smaller shrink reads 0.00."""


class Where(_Part):
    """Where the gap lies."""

    stage: str = Field(
        description="camera, clock, line, sway or yaw: the one with most of the probability; empty: no gap"
    )
    share: dict[str, float] = Field(description="probability by stage, summed over effects")
    runs: dict[str, float] = Field(description="share of each run in the drop of chi-square by the headline")
    span_s: list[float] = Field(description="from, to: the time that holds most of the drop, from each run's start")
    band_hz: list[float] = Field(description="from, to: the frequencies of what the headline changes")
    when: str = Field(default="", description="in words: at which speed, angle or place it shows")


class RankedEffects(_Part):
    """One effect or a pair."""

    effects: list[str] = Field(description="names")
    titles: list[str] = Field(default_factory=list, description="the same in words; empty: the names")
    probability: float = Field(description="posterior, of the effects in the form that the library has")
    probability_inexact: float = Field(
        default=0.0, description="that they are there in another form, and leave something over"
    )
    form: str = Field(default="", description="which of their forms fits best; empty: they have one each")
    forms: dict[str, float] = Field(
        default_factory=dict,
        description="other forms that were fitted -> log evidence against this one's; below -3: excluded",
    )
    parameters: dict[str, Measured] = Field(description="numbers, as effect.number; SI")
    units: dict[str, str] = Field(default_factory=dict, description="of the parameters; absent: a plain number")
    gap_before: float = Field(description="rms whitened residual of y and beta on runs kept aside, without")
    gap_after: float = Field(description="with; 1 = noise")
    shrink: float = Field(description="1 - excess_after/excess_before, excess = gap^2 - 1 floored at 0")
    shrink_interval: tuple[float, float] = Field(description="90 % interval of shrink")
    log_evidence: float = Field(default=0.0, description="against no effect, natural logarithm")
    cure: str = Field(default="", description="what to do about it")

    @property
    def words(self) -> str:
        """What is missing, in words."""
        return " + ".join(self.titles or self.effects)

    @property
    def shrinks(self) -> bool | None:
        """Whether the gap gets smaller with the effects by a share that two decimals show; None: it is noise without them."""
        return None if self.gap_before <= 1 else self.shrink >= LEAST_SHRINK

    @property
    def named(self) -> float:
        """Probability that the effects are there, whatever their form."""
        return self.probability + self.probability_inexact


class NextRun(_Part):
    """The run that would tell most."""

    tow_point_m: float = Field(description="X_T")
    line_length_m: float = Field(description="L")
    speed_m_s: float = Field(description="U")
    y_release_m: float = Field(description="y_CG at release")
    beta_release_rad: float = Field(description="heading at release")
    distance: float = Field(description="expected D between the best two hypotheses on that run")
    why: str = Field(description="in words")


class NextMeasurement(_Part):
    """What, measured without a tow, would tell most."""

    effect: str = Field(description="of which effect")
    numbers: dict[str, float] = Field(description="effect.number -> standard deviation to which it is to be measured")
    distance: float = Field(description="expected D between the best two hypotheses by it")
    why: str = Field(description="in words")


class Experiment(_Part):
    """A record that could be made next with a model of one's own."""

    name: str = Field(description="a table's, or what is done, in words")
    settings: dict[str, float] = Field(
        description="input.amplitude, input.from_hz, input.to_hz, state.start; empty: a table"
    )
    told: float = Field(
        description="expected probability that it tells the true hypothesis from the others that are open"
    )
    distance: float = Field(description="expected D between them")


class NextExperiment(_Part):
    """Of the records that could be made next, which would best tell what is open."""

    open: list[list[str]] = Field(description="hypotheses that are told apart: [] is no gap, [unknown] a free form")
    tried: list[Experiment] = Field(description="what was tried, the best first")
    why: str = Field(description="in words")


class GapFile(ResultFile):
    """out/gap.json."""

    schema_name: Literal["towline/gap"] = Field(default="towline/gap", alias="schema", description="this file")
    version: int = Field(default=1, description="of the schema")
    verdict: Literal["no_gap", "effect", "form_not_exact", "unknown", "not_converged"] = Field(description="formats.md")
    where: Where = Field(description="stage, runs, time, band")
    ranking: list[RankedEffects] = Field(
        description="effects and pairs, best first; probabilities with the rest sum to 1"
    )
    indistinguishable: list[list[str]] = Field(
        description="effects that these runs do not tell apart; exact symmetries"
    )
    promised: float = Field(
        default=0.0,
        description="log evidence that one more step of the fits behind the verdict promises: 0 at an optimum",
    )
    p_no_gap: float = Field(description="probability that nothing is missing")
    p_unknown: float = Field(description="probability that something in no library is missing")
    set95: list[list[str]] = Field(description="hypotheses that hold 95 %: [] is no gap, [unknown] unknown")
    next_run: NextRun | None = Field(description="null: nothing is left to tell apart")
    next_measurement: NextMeasurement | None = Field(
        default=None, description="null: neither of the best two can be measured without a tow"
    )
    next_experiment: NextExperiment | None = Field(
        default=None,
        description="of a model of one's own: what to record next; null: nothing was given to choose from, or one holds 95 %",
    )
    kept_aside: bool = Field(
        default=True,
        description="false: no run was left to keep aside; gaps and shrinks are those of the runs that were fitted",
    )
    derivatives: dict[str, dict[str, Measured]] = Field(
        default_factory=dict, description="the six, before (no effect) and after (the headline)"
    )
    noise: dict[str, float] = Field(
        default_factory=dict, description="random forces of the headline (else of no gap): side_n, moment_n_m, time_s"
    )
    noise_without: dict[str, float] = Field(default_factory=dict, description="the same where nothing is added")
    lasting_px: float | None = Field(
        default=None,
        description="errors of a film's marks that last, as granted to every mark's place, px: as the distance between two marks "
        "shows them; null: not filmed, or beside a static record without a film",
    )
    runs: list[str] = Field(default_factory=list, description="their names")
    excluded: dict[str, str] = Field(default_factory=dict, description="effects that could not be judged, and why")
    sentences: list[str] = Field(default_factory=list, description="in plain words")
