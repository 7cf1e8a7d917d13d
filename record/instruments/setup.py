"""setup.toml: what each channel of the tank's instruments measures, on which clock, and where the lamps stand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..schema import Length, Name, Number, Positive, PositiveLength
from ..toml import Table, read_toml

Measures = Literal["y", "x", "alpha", "alpha_beta", "beta", "lvdt", "tension"]
PITCH_M = 0.0508
"""Holes of the thesis's bars are 2 inches apart."""


class BarTable(Table):
    """The tow bar with its holes (7.5), (7.6), (7.10), (7.11); hole 0 is the tow point, hole 1 the first behind it."""

    lcg_m: Length = Field(description="LCG behind midship, as the thesis counts it (MARINER 0.0421, BOMBARDIER -0.035)")
    station_m: PositiveLength = Field(description="from midship to the screw (MARINER 1.099, BOMBARDIER 1.1875)")
    hole: int = Field(description="n, the hole that the screw holds")
    pitch_m: PositiveLength = Field(default=PITCH_M, description="from hole to hole")

    def ahead_m(self, hole: int) -> float:
        """Place of a hole ahead of LCG, m: LCG + station + pitch (n - hole)."""
        return self.lcg_m + self.station_m + self.pitch_m * (self.hole - hole)


class LineTable(Table):
    """Tow line and tow point."""

    line_length_m: PositiveLength = Field(description="L")
    tow_point_m: Length | None = Field(default=None, description="X_T ahead of LCG; default: hole 0 of the bar")
    tow_point_offset_m: Length = Field(default=0.0, description="Y_T, to starboard")
    post_m: tuple[Length, Length] = Field(default=(0.0, 0.0), description="tow post in tank axes")


class ClockTable(Table):
    """A clock other than the reference: events seen on both, or a channel that a reference channel measures too."""

    name: Name = Field(description="as the channels call it")
    events_s: tuple[tuple[Number, Number], ...] = Field(default=(), description="[own time, reference time] of events")
    event_sd_s: Positive = Field(default=0.01, description="standard deviation of an event's time difference")
    match: Name | None = Field(default=None, description="channel on this clock that the reference measures as well")
    against: Name | None = Field(default=None, description="the reference's channel; default: its motion")
    search_s: tuple[Number, Number] = Field(default=(-60.0, 60.0), description="match: where the offset is looked for")
    detail_s: Positive = Field(
        default=0.5, description="match: knots of the common curve; the motion is smooth over it"
    )
    drift_sd: Positive = Field(default=1e-4, description="what is known of the rate beforehand, s/s")

    @model_validator(mode="after")
    def _one_way(self) -> ClockTable:
        if bool(self.events_s) == (self.match is not None):
            raise ValueError("events_s or match is expected, one of them")
        if not self.search_s[0] < self.search_s[1]:
            raise ValueError(f"search_s = {list(self.search_s)} must rise")
        return self


class ChannelTable(Table):
    """A channel: value = scale (reading - zero) in m, rad or N."""

    name: Name = Field(description="its column, unless column is given")
    measures: Measures = Field(
        description="y, x: a lamp's place in the tank; alpha, alpha_beta, beta: angles; lvdt: what the pulley at the post pays "
        "out; tension"
    )
    sd: Positive = Field(description="standard deviation of a reading, after scale, m, rad or N")
    column: str | None = Field(default=None, description="its column")
    time: str = Field(default="t_s", description="the column of its times, s, on its clock")
    file: str | None = Field(default=None, description="another CSV, from setup.toml's folder")
    clock: str | None = Field(default=None, description="a [[clock]]; default: the reference")
    hole: int | None = Field(default=None, description="y, x: the lamp's hole in the bar")
    ahead_m: Length | None = Field(default=None, description="y, x: the lamp's place ahead of LCG instead of hole")
    side_m: Length = Field(default=0.0, description="y, x: the lamp's place to starboard")
    scale: Number = Field(default=1.0, description="to m, rad or N; negative turns the sign")
    zero: Number = Field(default=0.0, description="reading at 0")
    pulley_m: Annotated[Positive | None, Field(description="lvdt: the pulley's diameter (7.12)")] = None

    @model_validator(mode="after")
    def _whole(self) -> ChannelTable:
        if self.scale == 0:
            raise ValueError("scale = 0 leaves nothing of the channel")
        if self.measures in ("x", "y") and (self.hole is None) == (self.ahead_m is None):
            raise ValueError("hole or ahead_m is expected, one of them: where the lamp stands")
        if self.measures == "lvdt" and self.pulley_m is None:
            raise ValueError("pulley_m is missing: the diameter that turns its way into an angle (7.12)")
        return self


class SetupFile(Table):
    """setup.toml."""

    tow: LineTable = Field(description="tow line and tow point")
    bar: BarTable | None = Field(default=None, description="the bar with holes")
    clock: tuple[ClockTable, ...] = Field(default=(), description="clocks other than the reference")
    channel: tuple[ChannelTable, ...] = Field(description="the channels")
    times: Name | None = Field(
        default=None, description="channel whose times the motion takes; default: the slowest of the reference clock"
    )

    @model_validator(mode="after")
    def _names(self) -> SetupFile:
        names = [channel.name for channel in self.channel]
        clocks = [clock.name for clock in self.clock]
        for kind, found in (("channel", names), ("clock", clocks)):
            twice = next((name for name in found if found.count(name) > 1), None)
            if twice is not None:
                raise ValueError(f"{kind}: two are called {twice!r}")
        for channel in self.channel:
            if channel.clock is not None and channel.clock not in clocks:
                raise ValueError(f"channel {channel.name!r}: clock {channel.clock!r} is no [[clock]]")
            if channel.hole is not None and self.bar is None:
                raise ValueError(f"channel {channel.name!r}: hole = {channel.hole} needs [bar]")
        if self.tow.tow_point_m is None and self.bar is None:
            raise ValueError("tow.tow_point_m: missing key; or [bar] whose hole 0 it is")
        reference = [channel.name for channel in self.channel if channel.clock is None]
        if not reference:
            raise ValueError("channel: none is on the reference clock")
        if sum(channel.measures == "tension" for channel in self.channel) > 1:
            raise ValueError("channel: two measure the tension; one is expected")
        if self.times is not None and self.times not in reference:
            raise ValueError(f"times = {self.times!r} is no channel of the reference clock")
        for clock in self.clock:
            own = [channel.name for channel in self.channel if channel.clock == clock.name]
            if clock.match is not None and clock.match not in own:
                raise ValueError(f"clock {clock.name!r}: match = {clock.match!r} is no channel on it")
            if clock.against is not None and clock.against not in reference:
                raise ValueError(
                    f"clock {clock.name!r}: against = {clock.against!r} is no channel of the reference clock"
                )
        return self

    @property
    def tow_point_m(self) -> float:
        """X_T ahead of LCG (7.5), (7.11)."""
        if self.tow.tow_point_m is not None:
            return self.tow.tow_point_m
        assert self.bar is not None
        return self.bar.ahead_m(0)

    def place_m(self, channel: ChannelTable) -> float:
        """Where a lamp stands ahead of LCG."""
        if channel.ahead_m is not None:
            return channel.ahead_m
        assert self.bar is not None
        assert channel.hole is not None
        return self.bar.ahead_m(channel.hole)


def read_setup(path: str | Path) -> SetupFile:
    """Read setup.toml.

    Parameters
    ----------
    path : of the file

    Raises
    ------
    InputError : names the key that is missing, unknown, out of range or at odds with another
    """
    return read_toml(path, SetupFile)
