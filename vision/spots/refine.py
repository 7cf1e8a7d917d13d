"""From a mark's windows over a stretch of frames to its places: the simplest model that the pixels allow, frame by frame.

The ladder: width shared by all frames -> own ellipse -> sloping ground and taper (flat top where there is one) -> mark and
reflection together. The step is chosen for the stretch on some of its frames; a single frame that does not fit its
neighbours' noise tries the steps above. Noise (variance against grey value) is read from the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..backend import NUMPY, Backend
from .candidates import Array
from .fit import fit_spots
from .ground import pull_about
from .model import (
    ELLIPSE,
    GROUND,
    HEIGHT,
    HEIGHT_2,
    P_UU,
    P_VV,
    PLATEAU,
    PLATEAU_SHARED,
    POWER,
    REFLECTION,
    REFLECTION_FREE,
    REFLECTION_SHARED,
    SHARED,
    SLOPE_U,
    SLOPE_V,
    SLOPED,
    TAPERED,
    U_2,
    V_2,
    Model,
    SpotFit,
    U,
    V,
    has_plateau,
    start_of,
    width_of,
    without_rims,
)
from .pixel_noise import pixel_noise
from .reflection import LEAST_WIDTHS, exchanged, lights_around, mark_first, with_second_light
from .stack import Stack

CHECK_FRAMES = 10
"""The step of the ladder is chosen on this many frames of a stretch."""
LEARN_ALL = 16
"""Good frames of a stretch that teach as much as any number."""
LEARN_FRAMES, LEARN_STRETCHES = 48, 5
"""A reflection's and its mark's widths blur each other: they are learnt from more frames at first."""
REFLECTION_EVERY = 4
"""A reflection is looked for in every so many stretches (and wherever a frame does not fit). Of short stretches so many more that
it is so many frames; then the marks take turns, so that no frame has to wait for all of them."""
MARGIN = {
    SHARED.name: 0.0,
    TAPERED.name: 0.02,
    ELLIPSE.name: 0.03,
    SLOPED.name: 0.08,
    PLATEAU_SHARED.name: 0.05,
    PLATEAU.name: 0.08,
}
"""The models without a reflection; those with one follow."""
MARGIN |= {REFLECTION_SHARED.name: 0.30, REFLECTION.name: 0.33, REFLECTION_FREE.name: 0.38}
"""How much a step must lower the logarithm of the residual variance below the first step's to be taken: an ellipse costs the
centre nothing, a free slope 6-14 % of its sd, a reflection more, and on a codec's residuals every parameter gains something."""
GATE_SD = 5.0
"""With the share below: 5 standard deviations of a variance of so many degrees of freedom."""
GATE_SHARE = 1.3
"""A frame's residual variance beyond this many of its standard deviations and this share above the usual tries other steps."""
SHAPE_LIMIT = 5.0
"""Residual variance over the usual beyond which the spot is not the mark (or only part of it)."""
SAME_SHAPE = 0.1
"""What a fit leaves over below this share of the mark's height is no other shape, however little is usual: a choice, a third of
what a mark covered to a fifth leaves."""
LADDER = (SHARED, TAPERED, ELLIPSE, SLOPED, PLATEAU_SHARED, PLATEAU, REFLECTION_SHARED, REFLECTION, REFLECTION_FREE)
"""All steps."""
REFLECTED = tuple(m.name for m in (REFLECTION_SHARED, REFLECTION, REFLECTION_FREE))
MODEL_SHARE = 0.5
"""Of the squared difference between the places that two models give to a partly covered or blurred mark."""
BESIDE_WIDTHS = 1.5
"""A mark's width with a reflection beside it is within this factor of what it is without."""
REFLECTION_SPREAD_PX = 1.5
"""A second spot that wanders about its place beside the mark by more than this (or is nearer than ``LEAST_WIDTHS``) is not a
reflection but the fit's way round a mark that is no Gaussian."""
MEMORY = 0.15
"""Share of a new stretch in what is known of the mark, once several have been seen."""
LEAST_GOOD = 0.6
"""Share of a stretch's frames that a model must fit to be taken as its model: a choice."""
WIDEST_PX = 14.0
"""Standard deviation of the widest mark that is followed: a disc of 33 px."""
MOSTLY_GOOD = 0.8
"""The same of a model with a reflection, which can also be the fit's way round something else: a choice."""
AWAY_PX = 1.0
"""A fit stands within this and a width of where the spot was seen."""
BEGIN_WIDTHS = 2.2
"""At first sight its width is within this factor of what it seemed, ..."""
BEGIN_WIDER = 1.5
"""... and not wider than this of it, which is found by half of its height and holds more of a disc than a Gaussian's width does:
what is wider is the mark and the plate on which it stands. Choices."""
LEAST_SURE_PX = 0.5
"""A model that leaves a place less sure than this in half of the frames is none for it."""
SMALL_PX = 2.0
"""Below this width the pixels may not tell a mark's shape from its noise: a choice."""
UNSURE_SHARE = 0.1
"""A shape that leaves so many more of the frames without a sure place than the shared width does is not looked for: a choice."""
LIKE_WIDTH, UNLIKE_COST = 1.8, 5.0
"""A fit that is wider or narrower than the mark by more than this factor, beyond which none is believed, or is lost in noise, went
to something else, or has too much that is free. Any other is taken before it that leaves less than e^5 as much."""
TAUGHT_WIDTH = 1.15
"""The shape of a mark that was taken for too wide a one is learnt from fits that are this near to it: it may grow as the mark comes
nearer, by so much in a stretch, and does not take up again what is beside it."""
NARROWEST_PX = 0.6
"""Standard deviation of the narrowest mark: a point through a lens of 0.5 px over square pixels has 0.58."""
LEAST_LEVEL = 1e-12
"""Of a residual variance over the noise's, where its logarithm is taken: a picture without noise leaves none."""
GROUND_FRAMES = 8
"""Of a stretch from which the ground beside a mark is read: a choice, for its cost."""
GROUND_EXCESS = 0.3
"""Of a fit's own variance: what the ground adds counts from there on; less is the estimate's scatter on even ground."""
LEAST_INSIDE = 0.6
"""A window that lies farther outside the picture is not fitted."""


@dataclass(frozen=True)
class Refined:
    """Places of one mark over some frames.

    Attributes
    ----------
    fit : one row a frame
    excess : (b,), residual variance over the mark's usual one, or over what ``SAME_SHAPE`` of its height is where that is more
    flux : (b,), height times width squared over the mark's usual one
    odd : (b,), the frame's residual was not the usual one, and other steps were tried
    step : (b,), the model of each frame
    ground_px2 : (2,), variance that an uneven ground adds, the same way in all frames
    """

    fit: SpotFit
    excess: Array
    flux: Array
    odd: NDArray[np.bool_]
    step: NDArray[np.object_]
    ground_px2: Array


@dataclass
class _Ground:
    """What the ground was seen to do to a model's fits: in so many stretches that the model fitted, by so many looks."""

    stretches: int = 0
    looks: int = 0
    mean_px2: Array = field(default_factory=lambda: np.zeros(2))


class Refiner:
    """What is known of one mark's looks; learns from every stretch."""

    def __init__(self, width_px: float, dark: bool, white_dn: float | None, backend: Backend = NUMPY) -> None:
        self.width_px, self.dark, self.white_dn, self.backend = width_px, dark, white_dn, backend
        self.model = ELLIPSE
        self.usual: Array | None = None
        self.reflected = self.flat = np.zeros(0)
        self.common_px = np.zeros(2)
        self.ground_dn = self.height_dn = 0.0
        self.noise: tuple[float, float] = (4.0, 0.0)
        self.level = np.nan
        self.stretches = 0
        self.ground_px2 = np.zeros(2)
        self.grounds: dict[str, _Ground] = {}
        self.taught = False
        self.reflection_every, self.reflection_turn = REFLECTION_EVERY, 0

    @classmethod
    def taught_by(cls, other: Refiner) -> Refiner:
        """One for a mark that looks like another's: of its shape, whatever seems to be beside it."""
        one = cls(other.width_px, other.dark, other.white_dn, other.backend)
        assert other.usual is not None
        one.usual = other.usual.copy()
        one.flat = other.flat
        one.ground_dn, one.height_dn, one.noise = other.ground_dn, other.height_dn, other.noise
        one.taught = True
        one.reflection_every, one.reflection_turn = other.reflection_every, other.reflection_turn
        one.model = SHARED if one.usual[POWER] == 1.0 else PLATEAU_SHARED
        return one

    @property
    def half_px(self) -> int:
        """Half side of the windows to keep: room for a reflection and for a start that is some pixels off."""
        return int(np.clip(round(5 * self.width_px) + 6, 14, 44))

    def radius(self, model: Model) -> int:
        """Half side of the fitted window."""
        width = self.width_px
        if model in (PLATEAU, PLATEAU_SHARED):
            return int(np.clip(round(width + 4), 6, 20))  # a flat-topped spot ends soon beyond its edge
        if model.reflects:
            return int(np.clip(round(5 * width), 8, 22))
        return int(np.clip(round(2.8 * width), 5, 38))

    def refine(self, stack: Stack) -> Refined:
        """Fit all frames of a stretch."""
        if self.usual is None:
            self._begin(stack)
        fit = self._fit(stack, self.model)
        checked = self._check(stack, fit)
        if checked is not self.model:
            again = self._fit(stack, checked)
            if (
                _sure(again).mean() >= _sure(fit).mean() - UNSURE_SHARE
            ):  # what costs least in some frames may be lost in many
                self.model, fit = checked, again
        step = np.full(len(stack), self.model.name, dtype=object)
        self._learn(stack, fit, first=self.stretches == 0)
        if self.stretches == 0:  # the first stretch taught what the mark looks like: once more with that
            fit = self._fit(stack, self.model)
        odd = self._odd(fit) | ~self._like_it(fit)
        if odd.any():
            fit = self._climb(stack, fit, odd, step)
        if self.model.reflects:
            fit = replace(fit, sigma_px=np.hypot(fit.sigma_px, self.common_px))
        self._look_at_ground(stack, fit, odd)
        self.stretches += 1
        usual = self.height_dn * self.width_px**2
        with np.errstate(divide="ignore", invalid="ignore"):
            flux = fit.amplitude_dn * fit.width_px**2 / usual
        middle = self.noise[0] + self.noise[1] * abs(self.ground_dn + 0.5 * self.height_dn)
        alike = (SAME_SHAPE * self.height_dn) ** 2 / (SHAPE_LIMIT * middle)
        return Refined(fit, fit.level / max(self.level, alike, 1e-9), flux, odd, step, self.ground_px2)

    def once(self, stack: Stack) -> SpotFit:
        """Fit without learning: a spot that may be the mark."""
        return self._fit(stack, ELLIPSE if self.usual is None else self.model)

    def simplest(self, stack: Stack) -> SpotFit:
        """The same of a round spot of the width that is known: where a free shape finds something else."""
        return self._fit(stack, SHARED)

    # what the mark looks like ------------------------------------------------------------------------------------

    def _begin(self, stack: Stack) -> None:
        """First sight: ellipses of an unknown width."""
        few = stack.rows(_spread(len(stack), CHECK_FRAMES))
        fit = self._fit(few, ELLIPSE)
        good = fit.good & np.isfinite(fit.theta).all(axis=1)
        good &= wide_as_seemed(fit.width_px / self.width_px)
        if good.mean() < LEAST_GOOD:  # a free shape finds something else: a round spot of the width that is known
            fit = self._fit(few, SHARED)
            good = fit.good & np.isfinite(fit.theta).all(axis=1)
        if not good.any():
            return
        self.usual = _not_narrower(np.median(fit.theta[good], axis=0))
        self.width_px = float(np.clip(width_of(self.usual), NARROWEST_PX, WIDEST_PX))
        self.ground_dn, self.height_dn = float(self.usual[GROUND]), float(self.usual[HEIGHT])

    def _check(self, stack: Stack, fit: SpotFit) -> Model:
        """The step of the ladder that this stretch asks for."""
        sound = np.flatnonzero(fit.good & ~self._odd(fit))
        if self.usual is None or (self.taught and self.model is PLATEAU_SHARED):
            return self.model
        blurred = False  # too small or too faint for its shape to be told?
        if self.width_px < SMALL_PX and _sure(fit).mean() < 1 - UNSURE_SHARE:
            bare = self._fit(stack, SHARED)
            blurred = bool(_sure(bare).mean() > _sure(fit).mean() + UNSURE_SHARE)
            sound = np.flatnonzero(_sure(bare) if blurred else fit.good & ~self._odd(fit))
        if len(sound) < max(3, LEAST_GOOD * len(stack)):
            return SHARED if blurred else self.model
        index = sound[_spread(len(sound), CHECK_FRAMES)]
        few, fitted = stack.rows(index), {self.model.name: fit.rows(index)}
        flat = has_plateau(few.cut(few.start_px, self.radius(ELLIPSE))[0], self.dark).mean() > 0.5
        tried = [SHARED, TAPERED] if blurred or self.taught else [SHARED, TAPERED, ELLIPSE, PLATEAU if flat else SLOPED]
        cost = {m.name: self._cost(fitted.get(m.name) or self._fit(few, m), m) for m in tried}
        if flat and not self.taught and np.isfinite(cost.get(PLATEAU.name, np.inf)):
            self.flat = _middle(self._fit(few, PLATEAU))
            tried.append(PLATEAU_SHARED)
            shared = fitted.get(PLATEAU_SHARED.name) or self._fit(few, PLATEAU_SHARED)
            cost[PLATEAU_SHARED.name] = self._cost(shared, PLATEAU_SHARED)
        due = not self.stretches or (self.stretches + self.reflection_turn) % self.reflection_every == 0
        looked_for = (due or self.model.reflects) and not self.taught
        if looked_for and not blurred and self._find_reflection(few):
            free = self._plausible(self._fit(few, REFLECTION_FREE), steady=True)
            if free.good.mean() > MOSTLY_GOOD:
                self.reflected = _middle(free.rows(free.good))
                tried += [REFLECTION_SHARED, REFLECTION]
                cost |= {m.name: self._cost(self._plausible(self._fit(few, m)), m) for m in tried[-2:]}
        return min(tried, key=lambda model: cost[model.name])

    def _cost(self, fit: SpotFit, model: Model) -> float:
        """What a step of the ladder leaves, and costs."""
        like = fit.good if model.reflects else self._like_it(fit)
        if (
            like.mean() <= (MOSTLY_GOOD if model.reflects else LEAST_GOOD)
            or np.median(fit.sigma_px[fit.good].max(axis=1)) > LEAST_SURE_PX
        ):
            return np.inf
        return float(np.median(np.log(np.maximum(fit.level[fit.good], LEAST_LEVEL)))) + MARGIN[model.name]

    def _find_reflection(self, stack: Stack) -> bool:
        """Start values of a second spot, from the stretch's mean picture; False where nothing stands out."""
        assert self.usual is not None
        if self.usual[HEIGHT_2] != 0:
            return True
        radius = self.radius(REFLECTION_FREE)
        values, corner = stack.cut(stack.start_px, radius)
        seen = np.isfinite(values)
        total = np.where(seen, values, 0.0).sum(axis=0)
        mean = np.where(seen.any(axis=0), total / np.maximum(seen.sum(axis=0), 1), np.nan)[None]
        at = (stack.start_px - corner).mean(axis=0)[None]
        start = lights_around(mean, at, self.width_px, self.dark)
        fit = fit_spots(
            np.repeat(mean, len(start), axis=0),
            np.zeros((len(start), 2)),
            start,
            REFLECTION_FREE,
            self.noise,
            self.white_dn,
            self.backend,
        )
        sign = -1.0 if self.dark else 1.0
        sound = fit.good & (sign * fit.theta[:, HEIGHT] > 0) & (sign * fit.theta[:, HEIGHT_2] > 0)
        sound &= np.isfinite(fit.level)
        if not sound.any():
            return False
        best = fit.theta[sound][np.argmin(fit.level[sound])]
        best = mark_first(best[None])[0]
        best[U_2 : V_2 + 1] -= best[U : V + 1]
        if self.stretches > 0:  # the mark is known without its reflection
            best[P_UU : P_VV + 1] = self.usual[P_UU : P_VV + 1]
        self.reflected = best
        return True

    # fitting -----------------------------------------------------------------------------------------------------

    def _start(self, stack: Stack, values: Array, model: Model) -> Array:
        if self.usual is None:
            return start_of(values, stack.start_px, np.full(len(stack), self.width_px), self.dark)
        theta = np.tile(self.usual, (len(stack), 1))
        if model is PLATEAU_SHARED and self.usual[POWER] == 1.0:
            theta = np.tile(self.flat, (len(stack), 1))
        if model.reflects:
            known = self.reflected if self.usual[HEIGHT_2] == 0 else self.usual
            theta = np.tile(known, (len(stack), 1))
            theta[:, U_2 : V_2 + 1] += stack.start_px
        else:
            theta[:, HEIGHT_2] = 0.0
        if model is PLATEAU_SHARED:
            pass
        elif model is not PLATEAU:
            theta[:, POWER] = 1.0
        elif theta[0, POWER] == 1.0:
            theta[:, POWER] = 2.0
        if model not in (SLOPED, PLATEAU, PLATEAU_SHARED):
            theta[:, SLOPE_U : SLOPE_V + 1] = 0.0
        theta[:, U : V + 1] = stack.start_px
        return theta

    def _fit(self, stack: Stack, model: Model) -> SpotFit:
        values, corner = stack.cut(stack.start_px, self.radius(model))
        inside = np.isfinite(values).mean(axis=(1, 2)) >= LEAST_INSIDE
        start = self._start(stack, values, model)
        if not model.reflects:
            values = without_rims(values, self.width_px)
        fit = fit_spots(values, corner, start, model, self.noise, self.white_dn, self.backend)
        if not model.reflects:  # a spot was seen there: what stands elsewhere is another one
            inside &= np.linalg.norm(fit.centre_px - stack.start_px, axis=1) < AWAY_PX + self.width_px
        return replace(fit, good=fit.good & inside)

    def _odd(self, fit: SpotFit) -> NDArray[np.bool_]:
        """Frames whose residual is not the usual one."""
        level = self.level if np.isfinite(self.level) else float(np.median(fit.level))
        return ~fit.good | (fit.level > level * GATE_SHARE * (1 + GATE_SD * np.sqrt(2 / fit.disc)))

    def _like_it(self, fit: SpotFit, most: float = LIKE_WIDTH) -> NDArray[np.bool_]:
        """Fits as wide as the mark usually is, to a factor ``most``, whose place is known."""
        with np.errstate(divide="ignore", invalid="ignore"):
            wide = np.abs(np.log(fit.width_px / self.width_px))
        return fit.good & (fit.sigma_px.max(axis=1) <= max(LEAST_SURE_PX, self.width_px)) & (wide < np.log(most))

    def _climb(self, stack: Stack, fit: SpotFit, odd: NDArray[np.bool_], step: NDArray[np.object_]) -> SpotFit:
        """Try the other steps on the frames that do not fit, and keep what fits best."""
        index = np.flatnonzero(odd)
        few = stack.rows(index)
        best = fit.rows(index)
        cost = np.where(best.good, np.log(np.maximum(best.level, LEAST_LEVEL)) + MARGIN[self.model.name], np.inf)
        cost += np.where(self._like_it(best), 0.0, UNLIKE_COST)
        names = step[index]
        tries: list[tuple[Model, SpotFit]] = [
            (model, self._fit(few, model))
            for model in (SHARED, TAPERED, ELLIPSE, SLOPED, PLATEAU)
            if model is not self.model
        ]
        if self.usual is not None and not self.model.reflects:
            tries.append((REFLECTION, self._plausible(self._two_lights(few))))
        for model, again in tries:
            sure = again.good & (again.sigma_px.max(axis=1) <= LEAST_SURE_PX)
            other = np.where(sure, np.log(np.maximum(again.level, LEAST_LEVEL)) + MARGIN[model.name], np.inf)
            other += np.where(self._like_it(again), 0.0, UNLIKE_COST)
            win = other < cost
            best, cost = best.with_rows(win, again.rows(win)), np.where(win, other, cost)
            names = np.where(win, model.name, names)
        step[index] = names
        # what a frame that does not fit shows depends on the model: by how much is part of its uncertainty
        flat = self.model in (PLATEAU, PLATEAU_SHARED)
        bare = self._fit(few, PLATEAU_SHARED if flat else SHARED)
        moved = np.where((bare.good & ~np.isin(names, REFLECTED))[:, None], best.centre_px - bare.centre_px, 0.0)
        best = replace(best, sigma_px=np.sqrt(best.sigma_px**2 + MODEL_SHARE * moved**2))
        return fit.with_rows(index, best)

    def _two_lights(self, stack: Stack) -> SpotFit:
        """The mark as it usually is, and a second light where the most is left over: a reflection, or a lamp it passes."""
        assert self.usual is not None
        values, corner = stack.cut(stack.start_px, self.radius(REFLECTION))
        theta = with_second_light(self._start(stack, values, SHARED), values, corner, self.width_px, self.dark)
        fit = fit_spots(values, corner, theta, REFLECTION, self.noise, self.white_dn, self.backend)
        swapped = exchanged(fit.theta)
        flux = np.abs([theta[:, HEIGHT] * width_of(theta) ** 2 for theta in (fit.theta, swapped)])
        far = np.abs(np.log(np.maximum(flux, 1e-9) / abs(self.height_dn * self.width_px**2)))
        # began on the wrong one of the two: once more from the other side
        turn = fit.good & (far[1] < far[0] - np.log(1.15))
        if turn.any():
            start = swapped[turn]
            start[:, P_UU : P_VV + 1] = self.usual[P_UU : P_VV + 1]
            more = fit_spots(values[turn], corner[turn], start, REFLECTION, self.noise, self.white_dn, self.backend)
            fit = fit.with_rows(turn, more)
        return fit

    def _plausible(self, fit: SpotFit, steady: bool = False) -> SpotFit:
        """A reflection stands apart from its mark and is not brighter; the mark beside it looks as it does without.

        With ``steady`` it must also stand in the same place beside the mark in most frames.
        """
        theta = fit.theta
        away = theta[:, U_2 : V_2 + 1] - theta[:, U : V + 1]
        ratio = theta[:, HEIGHT_2] / theta[:, HEIGHT]
        # beside a mark that is known, a lamp may be brighter than it
        known = not steady and self.stretches > 0 and self.usual is not None and self.usual[HEIGHT_2] == 0
        good = fit.good & (ratio > 0.05) & (ratio < (4.0 if known else 1.2))
        good &= np.linalg.norm(away, axis=1) > LEAST_WIDTHS * width_of(theta)
        if self.usual is not None and self.usual[HEIGHT_2] != 0:
            good &= np.abs(np.log(width_of(theta) / self.width_px)) < np.log(1.4)
        if steady:  # what is beside a mark does not make another mark of it
            good &= np.abs(np.log(width_of(theta) / self.width_px)) < np.log(BESIDE_WIDTHS)
        if steady and good.sum() > 2:
            spread = np.median(np.abs(away - np.median(away[good], axis=0)), axis=0)
            good &= bool((spread < REFLECTION_SPREAD_PX).all())
        return replace(fit, good=good)

    # learning ----------------------------------------------------------------------------------------------------

    def _learn(self, stack: Stack, fit: SpotFit, first: bool) -> None:
        """The mark's usual parameters, noise and residual, from the frames that look like it."""
        good = fit.good.copy()
        if not good.any():
            return
        middle = float(np.median(fit.amplitude_dn[good]))
        good &= np.abs(np.log(np.abs(fit.amplitude_dn / middle) + 1e-9)) < 0.4
        if not first and self.height_dn:
            good &= np.abs(np.log(np.abs(fit.amplitude_dn / self.height_dn) + 1e-9)) < 1.0
            good &= ~self._odd(fit)
        if good.sum() < 3:
            return
        index = np.flatnonzero(good)[_spread(int(good.sum()), self._learn_frames)]
        few = stack.rows(index)
        most = TAUGHT_WIDTH if self.taught else LIKE_WIDTH
        if self.model.reflects:
            shaped = self._plausible(self._fit(few, REFLECTION_FREE))
        else:
            own = {SHARED.name: ELLIPSE, TAPERED.name: SLOPED, PLATEAU_SHARED.name: PLATEAU}.get(self.model.name)
            shaped = fit.rows(index) if own is None else self._fit(few, own)
        shaped = shaped.rows(shaped.good if self.model.reflects else self._like_it(shaped, most))
        if len(shaped) < 3 and not self.model.reflects:  # free shapes went to the plate below it: the one that is known
            shaped = fit.rows(index)
        if len(shaped) < 3:
            return
        share = 1.0
        if not first:
            share = max(MEMORY, 1 / (self.stretches + 1)) * min(1.0, good.sum() / LEARN_ALL)
        new = _middle(shaped)
        # shared widths that are off move the mark of a reflection by the same in all frames
        self.common_px = np.sqrt(np.pi / 2 / len(shaped)) * np.median(shaped.sigma_px, axis=0)
        if not self.model.reflects:
            new[HEIGHT_2] = 0.0
        before = self.usual
        if before is not None and (before[HEIGHT_2] == 0) == (new[HEIGHT_2] == 0):
            new = before + share * (new - before)
        self.usual = new = _not_narrower(new)
        self.width_px = float(np.clip(width_of(new), NARROWEST_PX, WIDEST_PX))
        self.ground_dn, self.height_dn = float(new[GROUND]), float(new[HEIGHT])
        values, corner = few.cut(few.start_px, self.radius(self.model))
        noise = pixel_noise(values, corner, fit.theta[index], len(self.model.free), self.white_dn)
        if noise is not None:
            floor, slope = (old + share * (now - old) for old, now in zip(self.noise, noise, strict=True))
            self.noise = floor, slope
        again = fit.rows(index) if not first else self._fit(few, self.model)
        level = float(np.median(again.level))
        self.level = level if first else self.level + share * (level - self.level)

    def _look_at_ground(self, stack: Stack, fit: SpotFit, odd: NDArray[np.bool_]) -> None:
        """How far the ground about the mark may pull it: seldom, since it goes with the deck."""
        seen = self.grounds.setdefault(self.model.name, _Ground())
        seen.stretches += 1
        self.ground_px2 = seen.mean_px2 if seen.looks else self.ground_px2
        usable = np.flatnonzero(fit.good & ~odd)
        if len(usable) < 3 or (seen.looks and seen.stretches & (seen.stretches - 1)):  # every time twice as late
            return
        index = usable[_spread(len(usable), GROUND_FRAMES)]
        few, found = stack.rows(index), fit.rows(index)
        windows = [few.cut(few.start_px, radius) for radius in (self.half_px, self.radius(self.model))]
        if not self.model.reflects:
            windows = [(without_rims(values, self.width_px), corner) for values, corner in windows]
        own = np.median(found.sigma_px**2, axis=0)
        by_noise = np.median(found.sigma_px**2 / np.maximum(found.chi_square, LEAST_LEVEL)[:, None], axis=0)
        more = by_noise * pull_about(windows[0], windows[1], found.theta, self.model, self.noise) - own
        now = np.where(more > GROUND_EXCESS * own, more, 0.0)
        seen.looks += 1
        self.ground_px2 = seen.mean_px2 = seen.mean_px2 + (now - seen.mean_px2) / seen.looks

    @property
    def _learn_frames(self) -> int:
        return LEARN_FRAMES if self.model.reflects and self.stretches < LEARN_STRETCHES else 2 * CHECK_FRAMES


def wide_as_seemed(ratio: Array) -> NDArray[np.bool_]:
    """Whether fits are as wide as the spots seemed at first sight.

    Parameters
    ----------
    ratio : of the widths
    """
    return (ratio > 1 / BEGIN_WIDTHS) & (ratio < BEGIN_WIDER)


def _not_narrower(theta: Array) -> Array:
    """Parameters of a spot with a width that pixels allow."""
    answer = theta.copy()
    answer[P_UU : P_VV + 1] *= min(1.0, float(width_of(theta)) / NARROWEST_PX) ** 2
    return answer


def _sure(fit: SpotFit) -> NDArray[np.bool_]:
    """Fits whose place is known."""
    return fit.good & (fit.sigma_px.max(axis=1) <= LEAST_SURE_PX)


def _middle(fit: SpotFit) -> Array:
    """Median parameters of some fits; the reflection's place relative to the mark's."""
    theta = fit.theta.copy()
    theta[:, U_2 : V_2 + 1] -= theta[:, U : V + 1]
    return np.median(theta, axis=0)


def _spread(count: int, most: int) -> NDArray[np.int64]:
    """At most ``most`` of ``count`` places, evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)) if count else np.zeros(0, int)
