"""What an effect is: a name, where it acts, its numbers with priors, one sentence of physics and one of cure.

An effect says with plain functions what it changes; each function gets the effect's numbers last, as arrays that broadcast. A user
writes one in a few lines of their own Python (``--effects mine.py``) or installs it by the entry point ``towline.effects``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np

from ...record.errors import InputError
from ...record.own_code import run_own
from ...simulate.model import Array, Taut
from .members import Members

STAGES = ("camera", "clock", "line", "sway", "yaw")


SIZES = (1.0, 0.3, 0.1, 0.03)
"""An effect is as likely to be small as to be large, down to what nobody would see."""


SWINGS_S = (11.0, 15.0, 21.0, 30.0)
"""Periods from which what goes to and fro along the tank is sought; slower ones are drifts."""
MOST_FASTER = 0.5
"""No fit goes further from one of these, as a share of its frequency."""
LEAST_DAMPED = 0.02
"""No memory that swings is damped less, of the critical damping: it would swing for as long as the tow."""


SMALLEST_COSINE = 0.05
"""The cosine of alpha + beta, by which equations divide, is held above this."""


@dataclass(frozen=True)
class Parameter:
    """A number of an effect.

    Attributes
    ----------
    name, unit : as in gap.json
    sd : prior standard deviation about ``none``: how large the effect usually is where it exists
    none : value at which the effect is absent
    one_sided : physics lets it only be larger than ``none``
    apart : standard deviation to which it can be measured without a tow, as the effect's cure says; 0: it cannot
    """

    name: str
    unit: str
    sd: float
    none: float = 0.0
    one_sided: bool = False
    apart: float = 0.0


@dataclass(frozen=True)
class Situation:
    """The tow at one time, arrays that broadcast to (runs, columns).

    Attributes
    ----------
    t_s, y_m, beta_rad, v_m_s, r_rad_s, alpha_rad : state; t_s from the run's start
    speed_m_s, line_length_m, tow_point_m : of the tow
    tension_n : T without the effect. Of a line that keeps its length: the straight tow's R where a force is asked (T follows
        from the forces), what the line has where a change of T is, or a force that goes with it (``Effect.by_pull``)
    alpha_rate : rad/s
    length_pp_m, density_kg_m3, half_width_m : of model, water and tank (NaN: not given)
    v_lag, r_lag : v and r behind by the effect's lag (``Effect.lag_s``); else v and r themselves
    duration_s : of the run
    y_v, n_v, n_r : linear damping at this speed
    history : time -> tension over its mean, (runs, columns); 1 where it is constant
    beyond_n : of tension_n, what a line that keeps its length has beyond R; 0 elsewhere
    longer_m, longer_rate_m_s : of a line with a law of its own (``Effect.law``): than stated, and the rate of that; 0 elsewhere
    bend_rate, bend_rate2 : of alpha + beta, rad/s and rad/s2, where a change of T is asked
    gain : by how much faster the model goes for each newton more, m/s2 per N, where a change of T is asked on a line that keeps
        its length; inf elsewhere
    """

    t_s: Any
    y_m: Array
    beta_rad: Array
    v_m_s: Array
    r_rad_s: Array
    alpha_rad: Array
    speed_m_s: Any
    line_length_m: Any
    tow_point_m: Any
    tension_n: Any
    alpha_rate: Array
    length_pp_m: Any
    density_kg_m3: Any
    half_width_m: Any
    v_lag: Array
    r_lag: Array
    duration_s: Any
    y_v: Any
    n_v: Any
    n_r: Any
    history: Callable[[Any], Any]
    beyond_n: Any = 0.0
    longer_m: Any = 0.0
    longer_rate_m_s: Any = 0.0
    bend_rate: Any = 0.0
    bend_rate2: Any = 0.0
    gain: Any = np.inf

    @property
    def columns(self) -> tuple[str, ...]:
        """Fields that may have columns."""
        return tuple(f.name for f in fields(self) if f.name != "history")


def on_line(s: Situation, taut: Taut) -> Situation:
    """What is asked for a change of T, or for a force that goes with it, on a line that keeps its length.

    Parameters
    ----------
    s : at a straight tow's T
    taut : the tow without the effects that are asked
    """
    turn, _, v_rate, r_rate = taut.rates[:4]
    angle, bend = s.alpha_rad + s.beta_rad, turn + s.r_rad_s
    sine, cosine = np.sin(angle), np.clip(np.cos(angle), SMALLEST_COSINE, None)
    across = v_rate + s.tow_point_m * r_rate + s.speed_m_s * s.r_rad_s * np.cos(s.beta_rad)
    twice = (across / s.line_length_m + turn * bend * sine) / cosine + r_rate
    beyond = taut.tension_n - s.tension_n
    return replace(s, tension_n=taut.tension_n, beyond_n=beyond, bend_rate=bend, bend_rate2=twice, gain=taut.gain)


@dataclass(frozen=True)
class Seen:
    """What the camera would see of a simulated run, arrays (samples, runs, columns).

    Attributes
    ----------
    t_s : (samples, runs, 1)
    pose : x, y, beta
    rate : their rates per second
    side : line force over tension, sin(alpha + beta)
    alpha_rad : tow line angle
    tension_n : (runs, columns), of a straight tow
    shutter : (2, samples, runs, 4, 3): change of x, y, beta and marker distance by 1 s of readout over the picture's height, or its
        width, per rate
    beyond_n : (samples, runs, columns), what a line that keeps its length has beyond tension_n
    line_length_m : (runs, columns)
    speed_m_s : (runs, columns), of the carriage, from which ``pose`` and ``rate`` are seen
    length_pp_m, half_width_m, duration_s : (runs, 1), of model, tank (NaN: not given) and run
    """

    t_s: Array
    pose: tuple[Array, Array, Array]
    rate: tuple[Array, Array, Array]
    side: Array
    alpha_rad: Array
    tension_n: Any
    shutter: Array
    beyond_n: Any = 0.0
    line_length_m: Any = 0.0
    speed_m_s: Any = 0.0
    length_pp_m: Any = 1.0
    half_width_m: Any = np.nan
    duration_s: Any = 1.0

    @property
    def step_s(self) -> float:
        """Between two samples."""
        return float(self.t_s[1, 0, 0] - self.t_s[0, 0, 0])

    @property
    def through_water(self) -> tuple[Array, Array]:
        """The hull's own speeds u and v, ahead and to starboard."""
        x_rate, y_rate, _ = self.rate
        ahead, cosine, sine = self.speed_m_s + x_rate, np.cos(self.pose[2]), np.sin(self.pose[2])
        return ahead * cosine + y_rate * sine, y_rate * cosine - ahead * sine

    @property
    def pull(self) -> Array:
        """The line's side pull over a straight tow's tension: a line that keeps its length pulls with what the model asks of it."""
        return self.side * (1 + self.beyond_n / self.tension_n)

    @property
    def columns(self) -> tuple[str, ...]:
        """Fields that may have columns; ``shutter`` is the camera's, the same in all."""
        return tuple(f.name for f in fields(self) if f.name != "shutter")


def share_since(t_s: Any, since_s: Any, over_s: float) -> Any:
    """How far a change that takes ``over_s`` about ``since_s`` has come, 0 to 1: of a mean over as long, what is after a jump.

    Examples
    --------
    >>> share_since(np.array([9.0, 10.0, 11.0]), 10.5, 2.0)
    array([0.  , 0.25, 0.75])
    """
    return np.clip((t_s - since_s) / over_s + 0.5, 0.0, 1.0)


def along_the_run(s: Situation, straight: Any, bent: Any, twice: Any) -> Any:
    """What changes slowly over a run: Legendre's polynomials of the first to the third order, -1 to 1 from its begin to its end.

    Parameters
    ----------
    s : situation
    straight, bent, twice : sizes of the three
    """
    at = 2 * s.t_s / s.duration_s - 1
    return straight * at + bent * (1.5 * at**2 - 0.5) + twice * (2.5 * at**3 - 1.5 * at)


def paced(faster: Any) -> Any:
    """By what a frequency is multiplied.

    Parameters
    ----------
    faster : by how much it is higher, as a share, MOST_FASTER at most
    """
    return 1 + np.clip(faster, -MOST_FASTER, MOST_FASTER)


def swinging(s: Situation, period_s: float, sine: Any, cosine: Any, faster: Any) -> Any:
    """What goes to and fro over a run, about once in a period.

    Parameters
    ----------
    s : situation
    period_s : from which a fit begins
    sine, cosine : sizes
    faster : by how much its frequency is higher, as a share
    """
    phase = 2 * np.pi / period_s * paced(faster) * s.t_s
    return sine * np.sin(phase) + cosine * np.cos(phase)


@dataclass(frozen=True, order=True)
class Late:
    """How ``v_lag`` and ``r_lag`` follow v and r: behind a lag of first order, or swinging about them.

    Attributes
    ----------
    time_s : time constant; of a swing its period without damping
    damping : of the swing, of the critical one; 0: a lag of first order
    fitted : both are where a fit begins (``Effect.lagging``)
    """

    time_s: float
    damping: float = 0.0
    fitted: bool = False

    @property
    def size(self) -> int:
        """States: what is held back, and of a swing its rates."""
        return 4 if self.damping else 2

    def rates(self, held: Array, v: Array, r: Array, faster: Any = 0.0, damped: Any = 0.0) -> list[Array]:
        """Of the states (size, ...).

        Parameters
        ----------
        held, v, r : states, sway velocity and yaw rate
        faster, damped : of the columns, by how much it is faster, as a share, and more damped
        """
        pace = paced(faster)
        if not self.damping:
            return [(v - held[0]) * pace / self.time_s, (r - held[1]) * pace / self.time_s]
        w = 2 * np.pi / self.time_s * pace
        damping = np.maximum(self.damping + damped, LEAST_DAMPED)
        swung = [
            w * (now - x) - 2 * damping * w * rate for now, x, rate in zip((v, r), held[:2], held[2:], strict=True)
        ]
        return [w * held[2], w * held[3], *swung]


@dataclass(frozen=True)
class Effect:
    """Something reality has and the simulator does not know.

    Attributes
    ----------
    name : as in gap.json
    stage : one of STAGES; hull effects are told "sway" or "yaw" by where their force works
    parameters : its numbers
    physics, source, cure : a sentence, where it stands, what to do about it
    title : what is missing, in words; default: the name
    force : (situation, *numbers) -> (Y N, N N m); a line that keeps its length answers it by its tension
    by_pull : its force goes with what the line pulls with: ``tension_n`` is that then, without the effect itself
    ahead : (situation, *numbers) -> X, N, beside the resistance of a straight tow; a line that keeps its length answers it by its
        tension, on one that keeps its tension it does nothing
    tension : (situation, *numbers) -> change of T, N, whatever a line that keeps its length asks
    keeps : (*numbers) -> how far the line keeps its tension instead of its length, 0..1
    law : (situation, *numbers) -> what the line pulls with, N, by its length: this and the model's surge are states then. Such an
        effect is never absent, whatever its numbers; it begins at the measured motion
    coupling : (*numbers) -> (Y_rdot, N_vdot), kg m
    speed : (situation, *numbers) -> change of U, m/s, by the time alone
    length : (tension N, line length m, *numbers) -> how much longer the line is than stated, m, at that tension
    offset : (*numbers) -> tow point's offset to starboard beyond what is stated, m
    stretch : (seen, *numbers) -> how much the line lengthens as the model swings, m
    clock : (t_s, *numbers) -> change of time, s
    cell : (run's name, t_s, *numbers) -> change of the time of what a load cell said at t_s, s; of lines that keep their length
    observe : (seen, *numbers) -> change of measured x, y, beta, marker distance
    correct : (run, datum fit, *numbers) -> (run, mapping) as they would be without the fault
    shift : (*numbers) -> change of measured y, beta, line radius and marker distance when the fault is taken out of a run that came
        as motion, without pixels; None: such a run cannot show it
    remembers : what ``observe`` gives at one time depends on the motion before it
    when : (run's name, (n,) s, *its ``timed`` last numbers) -> (n,) share of that fault at work; None: always and in all runs
    timed : how many of its numbers, the last ones, are of ``when`` and not of ``correct``
    lag_s : time constant of ``v_lag``, ``r_lag``; where they swing, their period
    swings : damping of that swing, of the critical one; 0: they follow without swinging
    lagging : how many of its numbers, the last ones, are of how they follow: by how much faster, as a share, and more damped
    variant : tells effects of one name apart
    bound : it belongs to the runs made (windows, bounces), and says nothing of another
    form : share of what it explains that its own form may leave over; small for geometry, whose form is exact
    second : share of it that another effect of the library may take of that; None: all of it
    cost : log evidence that is taken off: numbers found beforehand, in a residual
    sizes : shares of the parameters' standard deviations that are as likely: how small the effect may be where it exists
    members : names of the numbers that each member of it has, all as likely (``effects.members``); empty: all its numbers
    needs : (run) -> why it cannot be judged with this run, or ""
    reach : (variable of the dimensionless state, smallest, largest value) that it was found in; empty: it is physics, not a find
    moved : (numbers, step) -> numbers after a step of a fit, their sum to the first order; None: that sum
    """

    name: str
    stage: str
    parameters: tuple[Parameter, ...]
    physics: str
    cure: str
    source: str = ""
    force: Callable[..., tuple[Any, Any]] | None = None
    by_pull: bool = False
    ahead: Callable[..., Any] | None = None
    tension: Callable[..., Any] | None = None
    keeps: Callable[..., Any] | None = None
    law: Callable[..., Any] | None = None
    coupling: Callable[..., tuple[Any, Any]] | None = None
    speed: Callable[..., Any] | None = None
    length: Callable[..., Any] | None = None
    offset: Callable[..., Any] | None = None
    stretch: Callable[..., Any] | None = None
    clock: Callable[..., Any] | None = None
    cell: Callable[..., Any] | None = None
    observe: Callable[..., tuple[Any, Any, Any, Any]] | None = None
    correct: Callable[..., tuple[Any, Any]] | None = None
    shift: Callable[..., tuple[Any, Any, Any, Any]] | None = None
    remembers: bool = False
    when: Callable[..., Array] | None = None
    timed: int = 0
    lag_s: float = 0.0
    swings: float = 0.0
    lagging: int = 0
    variant: str = ""
    bound: bool = False
    form: float = 0.03
    second: float | None = None
    cost: float = 0.0
    sizes: tuple[float, ...] = SIZES
    members: Members = ()
    needs: Callable[[Any], str] = field(default=lambda _: "")
    title: str = ""
    reach: tuple[tuple[str, float, float], ...] = ()
    moved: Callable[[Array, Array], Array] | None = None

    @property
    def late(self) -> Late | None:
        """How its velocities are held back; None: they are not."""
        return Late(self.lag_s, self.swings, self.lagging > 0) if self.lag_s else None

    def __post_init__(self) -> None:
        names = {p.name for p in self.parameters}
        for member in self.members:
            if not names.issuperset(member) or not (member or self.law):
                raise ValueError(f"{self.name}: member {member}: expected some of its numbers, {sorted(names)}")

    @property
    def label(self) -> str:
        """Name and variant: effects with a number that is searched on a grid come as several."""
        return f"{self.name}/{self.variant}" if self.variant else self.name

    @property
    def rules_line(self) -> bool:
        """Whether it says what the line keeps instead of its length: one line cannot keep two things."""
        return self.keeps is not None or self.law is not None


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """Effects of a user's own Python file: every ``Effect`` it defines at its top level.

    Parameters
    ----------
    path : of the Python file

    Raises
    ------
    InputError : the file cannot be run, or defines none
    """
    module = run_own(path)
    found = tuple(value for value in vars(module).values() if isinstance(value, Effect))
    if not found:
        raise InputError(Path(path), "", "defines no Effect at its top level")
    return found


def installed_effects() -> tuple[Effect, ...]:
    """Effects that other packages bring by the entry point ``towline.effects``."""
    return tuple(effect for entry in entry_points(group="towline.effects") for effect in _several(entry.load()))


def _several(found: Any) -> Sequence[Effect]:
    return (found,) if isinstance(found, Effect) else tuple(found)
