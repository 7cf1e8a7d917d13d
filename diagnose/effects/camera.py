"""What is wrong with camera and clock rather than with the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from .base import SWINGS_S, Effect, Parameter, Seen, Situation, along_the_run, share_since, swinging
from .members import any_of, with_some
from .swing import rolled

EXACT = 0.003
"""Share of what a fault of geometry explains that may be left over: its form is known, its time to a part of a block."""
LENS_FORM = 0.01
"""The same of a lens, whose bend is smooth."""
ROLL_FORM = 0.01
"""Of a roll with its own period, damping and mark heights."""
ROLLS_S = (0.6, 0.8, 1.0, 1.25, 1.55, 1.9, 2.4)
"""Roll periods where a fit may begin; models of 1 to 4 m have these."""
RAMPS, RAMP_S, SHORTEST_RAMP_S = (0.25, 0.5, 0.75), 3.0, 0.3
"""Shares of a run about which a fit of a ramp may begin, half its length there, and the shortest a fit may make of it."""
RULE_M = 1e-3
"""How well a height or a place is measured by rule."""
PICKED_RAD = 2e-4
"""How well a camera's turn is known from the datum picked again: four points, a sixth of a pixel, 1000 px of focal length."""


def _changed(run, **tables):
    return replace(run, file=run.file.model_copy(update=tables))


@lru_cache(maxsize=256)
def _datum(camera, points, depths):
    from ...geometry import fit_datum

    return fit_datum(points, camera, depths).mapping


def _fitted(run, fit):
    """Runs of one camera share the fit of their datum."""
    return run, _datum(run.file.camera, run.file.datum, tuple(m.depth_m for m in run.file.marker))


def _lens(run, fit, k1, k2=0.0, p1=0.0, p2=0.0):
    camera = run.file.camera
    wrong = (k1, k2, p1, p2, 0.0)
    bent = tuple(stated + float(more) for stated, more in zip(camera.distortion, wrong, strict=True))
    return _fitted(_changed(run, camera=camera.model_copy(update={"distortion": bent})), fit)


def _deck(run, fit, depth, trim=0.0, squat=0.0):
    """Deeper, by the bow more than by the stern, and as the square of the speed."""
    ahead = [m.body_m[0] for m in run.file.marker]
    middle, half = 0.5 * (max(ahead) + min(ahead)), max(0.5 * (max(ahead) - min(ahead)), 1e-9)
    all_of_them = float(depth) + float(squat) * (run.file.tow.speed_m_s or 0.0) ** 2
    marks = tuple(
        m.model_copy(update={"depth_m": m.depth_m + all_of_them + float(trim) * (x - middle) / half})
        for m, x in zip(run.file.marker, ahead, strict=True)
    )
    return _changed(run, marker=marks), fit.mapping


def _squat(run, fit, depth, squat):
    return _deck(run, fit, depth, 0.0, squat)


def _scale(run, fit, ahead, aside):
    points = tuple(
        p.model_copy(
            update={"tank_m": (p.tank_m[0] * (1 + float(ahead)), p.tank_m[1] * (1 + float(aside)), p.tank_m[2])}
        )
        for p in run.file.datum
    )
    return _fitted(_changed(run, datum=points), fit)


def _post(run, fit, ahead, aside):
    post = run.file.tow.post_m
    tow = run.file.tow.model_copy(update={"post_m": (post[0] + float(ahead), post[1] + float(aside))})
    return _changed(run, tow=tow), fit.mapping


def _turned(run, fit, right, down, roll):
    """The marks were seen by a camera turned since the datum was picked."""
    mapping = fit.mapping
    turn = Rotation.from_rotvec([float(right), float(down), float(roll)]).as_matrix()
    return run, replace(mapping, matrix=turn @ mapping.matrix)


def _roll(seen: Seen, lean, swing):
    """The model leans with the line's side pull (and later by its own swing); its marks stand above the roll axis."""
    nothing = 0.0 * seen.side
    return nothing, lean * seen.pull + swing * seen.rate[2], nothing, nothing


def _rolling(seen: Seen, lean, period, damping, turn, sway=0.0, swing=0.0):
    """A roll with its own period: it swings into its lean, from upright when the model is let go; marks of unlike height turn.

    The model's sideways acceleration and its turning may drive it besides the line's pull.
    """
    ahead, v = seen.through_water
    faster = np.where(seen.speed_m_s > 0, ahead / np.maximum(seen.speed_m_s, 1e-9), 1.0)
    inertia = sway * np.gradient(v, seen.step_s, axis=0, edge_order=2) + swing * faster * seen.rate[2]
    return rolled(seen, lean * seen.pull + inertia, period, damping, turn)


def _shutter(way: int) -> Callable[..., tuple[Any, ...]]:
    """A mark lower in the picture (or further to the right) is seen later: it has moved on by its own speed."""

    def observe(seen: Seen, readout):
        rates = np.stack(np.broadcast_arrays(*seen.rate), axis=-1)
        change = np.einsum("srij,srkj->srki", seen.shutter[way], rates)
        return tuple(readout * change[..., i] for i in range(4))

    return observe


def _delayed(s: Situation, delay):
    return s.tension_n * (s.history(s.t_s - delay) / s.history(s.t_s) - 1)


def _late(_run, t_s, delay, per_s=0.0):
    """Steadily, or later and later."""
    return delay + per_s * t_s


def _drift(s: Situation, share, settling, sooner, level):
    """A straight drift over the run, and one that settles, early or late, about a level that need not be the stated one."""
    return s.speed_m_s * (level + along_the_run(s, 0.5 * share, settling, sooner))


def _drift_swings(period_s: float) -> Callable[..., Any]:
    """A carriage whose control swings."""

    def speed(s: Situation, sine, cosine, faster, level):
        return s.speed_m_s * (level + swinging(s, period_s, sine, cosine, faster))

    return speed


def _ramp(at: float) -> Callable[..., Any]:
    """From one speed to another, about a share of the run; ``level`` is how far the first is from the stated one."""

    def speed(s: Situation, share, later, longer, level):
        lasts = np.maximum(RAMP_S + longer, SHORTEST_RAMP_S)
        return s.speed_m_s * (level + 0.5 * share * (1 + np.tanh((s.t_s - at * s.duration_s - later) / lasts)))

    return speed


def _no_lens(run) -> str:
    return "" if run.file.camera is not None and run.file.source.motion is None else "no [camera] table and pixels"


def _no_pixels(run) -> str:
    return "" if run.file.source.motion is None else "a motion holds no pixels"


def _history_of(line: str, otherwise: str) -> Callable[[Any], str]:
    """A tension history, of that line; ``otherwise``: what it is on another."""

    def needs(run) -> str:
        tow = run.file.tow
        if tow is None or tow.tension is None:
            return "no tension history"
        return "" if tow.line == line else otherwise

    return needs


_no_history = _history_of("constant", 'line = "surge": a history is compared with what the motion makes')
_no_cell = _history_of("surge", 'line = "constant": a history moves the model')


LENS = Effect(
    "lens_distortion",
    "camera",
    (Parameter("k1", "", 0.03, apart=0.002),),
    "The lens bends straight lines otherwise than [camera] says.",
    "Calibrate the lens (towline lens).",
    "theory.md 4",
    correct=_lens,
    form=LENS_FORM,
    needs=_no_lens,
    title="the lens's true distortion",
)
LENS_FORMS = (
    replace(
        LENS,
        parameters=(*LENS.parameters, Parameter("k2", "", 0.1)),
        members=with_some(["k2"], ["k1"]),
        variant="with k2",
    ),
    replace(
        LENS,
        parameters=(*LENS.parameters, Parameter("p1", "", 0.005), Parameter("p2", "", 0.005)),
        physics="The lens bends straight lines otherwise than [camera] says, about another place than the middle of the picture.",
        correct=lambda run, fit, k1, p1, p2: _lens(run, fit, k1, 0.0, p1, p2),
        members=with_some(["p1", "p2"], ["k1"]),
        variant="off its middle",
    ),
)
"""Beside one that bends by the square of the distance alone: Brown's further terms."""
DECK = Effect(
    "deck_height",
    "camera",
    (Parameter("depth_m", "m", 0.015, apart=RULE_M),),
    "The marks lie on another plane than depth_m says, so that they are projected to the wrong place.",
    "Measure the marks' height against the datum plane.",
    "thesis (4.2)",
    correct=_deck,
    form=EXACT,
    needs=_no_pixels,
    title="the marks' true height",
)
DECK_FORMS = (
    replace(
        DECK,
        parameters=(*DECK.parameters, Parameter("trim_m", "m", 0.01, apart=RULE_M)),
        members=with_some(["trim_m"], ["depth_m"]),
        variant="of each mark",
    ),
    replace(
        DECK,
        parameters=(*DECK.parameters, Parameter("squat_s2_m", "s2/m", 0.01)),
        correct=_squat,
        members=with_some(["squat_s2_m"], ["depth_m"]),
        physics="The hull sinks and the marks with it, as the square of the speed, so that they are projected to the wrong place.",
        cure="Measure the marks' height under way, or tow at one speed and give the height there.",
        variant="with the speed",
    ),
)
"""Beside one error of all of them."""
SHIFT = Effect(
    "camera_shift",
    "camera",
    tuple(Parameter(f"{name}_rad", "rad", 0.003, apart=PICKED_RAD) for name in ("right", "down", "roll")),
    "The camera was turned after the datum was picked.",
    "Pick the datum again in this recording, or let its points be tracked.",
    "theory.md 4",
    correct=_turned,
    members=any_of("right_rad", "down_rad", "roll_rad"),
    form=EXACT,
    needs=_no_lens,
    title="a camera that was turned after the datum was picked",
)
SCALE = Effect(
    "datum_scale",
    "camera",
    (Parameter("scale", "", 0.01, apart=5e-4),),
    "The datum points stand elsewhere than tank_m says, all by one factor.",
    "Measure the datum's length and width again.",
    "thesis 4.6",
    correct=lambda run, fit, scale: _scale(run, fit, scale, scale),
    form=EXACT,
    needs=_no_pixels,
    title="the datum's true scale",
)
SCALE_APART = replace(
    SCALE,
    parameters=(Parameter("ahead", "", 0.01, apart=5e-4), Parameter("aside", "", 0.01, apart=5e-4)),
    physics="The datum points stand elsewhere than tank_m says, ahead by one factor and aside by another.",
    correct=_scale,
    members=any_of("ahead", "aside"),
    variant="ahead and aside apart",
)
POST = Effect(
    "datum_bias",
    "camera",
    (Parameter("ahead_m", "m", 0.006, apart=RULE_M), Parameter("aside_m", "m", 0.006, apart=RULE_M)),
    "The tow post stands off the place that post_m says.",
    "Measure the post against the datum.",
    "theory.md 4",
    correct=_post,
    members=any_of("ahead_m", "aside_m"),
    shift=lambda _ahead_m, aside_m: (-aside_m, 0.0, 0.0, 0.0),
    form=EXACT,
    title="the tow post's true place",
)
ROLL = Effect(
    "marker_roll",
    "camera",
    (Parameter("lean_m", "m", 0.01), Parameter("swing_m_s", "m s", 0.02)),
    "The model rolls under the line's side pull, and marks above its roll axis move sideways with it.",
    "Set the marks lower, or measure the roll.",
    "rigid body",
    observe=_roll,
    members=any_of("lean_m", "swing_m_s"),
    title="the model's roll under its marks",
)
ROLLING = tuple(
    replace(
        ROLL,
        parameters=(
            Parameter("lean_m", "m", 0.01),
            Parameter("period_s", "s", 0.15, none=period),
            Parameter("damping", "", 0.05, none=0.15),
            Parameter("turn_rad_m", "rad/m", 0.05),
        ),
        observe=_rolling,
        members=with_some(["period_s", "damping"], ["lean_m", "turn_rad_m"], 1),
        remembers=True,
        form=ROLL_FORM,
        variant=f"a roll of about {period:g} s",
    )
    for period in ROLLS_S
)
"""One variant for each period at which a fit may begin; the numbers are prior standard deviations, `none` where they
begin."""
ROLLING_FREELY = tuple(
    replace(
        each,
        parameters=(*each.parameters, Parameter("sway_s2", "s2", 0.05), Parameter("swing_m_s", "m s", 0.02)),
        members=with_some(["period_s", "damping"], ["lean_m", "turn_rad_m", "sway_s2", "swing_m_s"], 1),
        variant=f"{each.variant}, by sway and yaw too",
    )
    for each in ROLLING
)
"""The same periods, driven by the model's own acceleration and turning as well."""
SHUTTER = Effect(
    "rolling_shutter",
    "clock",
    (Parameter("readout_s", "s", 0.02, apart=1e-3),),
    "The sensor's rows are exposed one after another, so that marks in different rows are seen at different times.",
    "Film a light that flashes (its edge stands in one row) for the readout time; use a camera with a global shutter.",
    "CMOS sensors",
    observe=_shutter(0),
    needs=_no_pixels,
    title="a rolling shutter",
)
SHUTTER_ACROSS = replace(SHUTTER, observe=_shutter(1), variant="column by column")
"""Of a camera on its side, whose picture was turned."""
RATE_CHANGES_S = (8.0, 16.0, 26.0, 40.0)
"""Times from which one at which a camera goes over to another rate is sought ..."""
CHANGES_S = 0.3
"""... and how long it takes."""
RATE = Effect(
    "frame_rate",
    "clock",
    (Parameter("rate", "", 0.01, apart=1e-4),),
    "Frames come at another rate than stated, so that every time is stretched.",
    "Film a clock; give source.frame_rate_hz.",
    "theory.md 2",
    clock=lambda t_s, rate: rate * t_s,
    title="the true frame rate",
)
RATE_FORMS = (
    replace(
        RATE,
        parameters=(Parameter("rate", "", 0.01), Parameter("drift_1_s", "1/s", 2e-4)),
        physics="The camera's clock warms up: its rate drifts.",
        clock=lambda t_s, rate, drift: rate * t_s + 0.5 * drift * t_s**2,
        members=with_some(["drift_1_s"], ["rate"]),
        variant="drifting",
    ),
    *(
        replace(
            RATE,
            parameters=(
                Parameter("rate", "", 0.01),
                Parameter("later", "", 0.01),
                Parameter("change_s", "s", 5.0, none=at),
            ),
            physics="Frames come at one rate at first and at another later: they were dropped, or the light changed.",
            clock=lambda t_s, rate, later, change_s: (
                rate * t_s + later * CHANGES_S * np.logaddexp(0.0, (t_s - change_s) / CHANGES_S)
            ),
            members=with_some(["later", "change_s"], ["rate"]),
            variant=f"another rate from about {at:g} s on",
        )
        for at in RATE_CHANGES_S
    ),
)
"""A clock whose rate is not one all along."""
DRIFT = Effect(
    "speed_drift",
    "sway",
    (
        Parameter("share", "", 0.02),
        Parameter("settling", "", 0.02),
        Parameter("sooner", "", 0.01),
        Parameter("level", "", 0.005),
    ),
    "The carriage runs faster or slower towards the end of the run.",
    "Record the carriage's speed (tow.speed).",
    "theory.md 2",
    speed=_drift,
    members=with_some(["share"], ["settling", "sooner", "level"]),
    title="a drifting carriage speed",
)
DRIFT_RAMPS = tuple(
    replace(
        DRIFT,
        parameters=(
            Parameter("share", "", 0.02),
            Parameter("later_s", "s", 2.0),
            Parameter("longer_s", "s", 1.5),
            Parameter("level", "", 0.005),
        ),
        physics="The carriage goes over from one speed to another in mid-run.",
        speed=_ramp(at),
        members=with_some(["share", "later_s", "longer_s"], ["level"]),
        variant=f"a ramp at {at:g} of the run",
    )
    for at in RAMPS
)
DRIFT_SWINGS = tuple(
    replace(
        DRIFT,
        parameters=(
            Parameter("sine", "", 0.005),
            Parameter("cosine", "", 0.005),
            Parameter("faster", "", 0.1),
            Parameter("level", "", 0.005),
        ),
        physics="The carriage's speed swings slowly.",
        speed=_drift_swings(period),
        members=with_some(["sine", "cosine", "faster"], ["level"]),
        variant=f"to and fro, about {period:g} s",
    )
    for period in SWINGS_S
)
"""Beside a drift all along."""
DELAY = Effect(
    "sync_delay",
    "clock",
    (Parameter("delay_s", "s", 0.2, apart=0.02),),
    "Load cell and video run on different clocks, so that the tension comes too early or too late.",
    "Give tow.tension_delay_s from a tap that both record.",
    "formats.md",
    tension=_delayed,
    needs=_no_history,
    title="the delay between load cell and video",
)
DELAY_FORMS = (
    replace(DELAY, tension=None, cell=_late, needs=_no_cell, variant="beside the line's pull"),
    replace(
        DELAY,
        parameters=(*DELAY.parameters, Parameter("per_s", "", 0.005)),
        tension=None,
        cell=_late,
        members=with_some(["per_s"], ["delay_s"]),
        needs=_no_cell,
        variant="beside the line's pull, growing",
    ),
)
"""Where the line keeps its length: its pull follows from the motion, and the load cell's record is compared with it."""


FOUND_TO_S = 0.03
"""A delay is found in the measured motion to so much: the fit goes on from there. A choice."""


def delayed_each(late_s: Mapping[str, float], cost: float) -> Effect:
    """A load cell whose clock was started anew before each run; the engine finds the delays in its record.

    Parameters
    ----------
    late_s : run's name -> delay; runs that are not named have none
    cost : log evidence that finding them costs
    """
    runs = list(late_s)

    def late(run: str, _t_s: Any, *delays_s: Any) -> Any:
        return delays_s[runs.index(run)] if run in late_s else 0.0 * delays_s[0]

    return replace(
        DELAY_FORMS[0],
        parameters=tuple(
            Parameter(f"delay_{k}_s", "s", FOUND_TO_S, none=found_s) for k, found_s in enumerate(late_s.values(), 1)
        ),
        cell=late,
        variant="in each run another",
        bound=True,
        sizes=(1.0,),
        cost=cost,
    )


def delayed_since(since_s: float, over_s: float, cost: float) -> Effect:
    """A load cell whose clock jumps; the engine finds about when in its record.

    Parameters
    ----------
    since_s : when, from the runs' start
    over_s : what the record is averaged over: a mean over the jump has a part of it
    cost : log evidence that finding it costs
    """
    return replace(
        DELAY_FORMS[0],
        parameters=(*DELAY.parameters, Parameter("jump_s", "s", 0.2), Parameter("since_s", "s", over_s, none=since_s)),
        cell=lambda _run, t_s, delay, jump, since: delay + jump * share_since(t_s, since, over_s),
        members=with_some(["jump_s", "since_s"], ["delay_s"]),
        variant=f"another from about {since_s:.1f} s on",
        bound=True,
        sizes=(1.0,),
        cost=cost,
    )
