"""Follow a point picked in one frame: a bow's corner, a mark, a stanchion's foot on a hull that was never prepared.

Every place comes from registering the same first template (``patch``), so nothing drifts; coarse search (``patch_search``)
only says where to start. Frames are held in chunks: forwards as they come, then backwards from the chunk's last place; a
frame where both ways end at different places is `drifted`. Memory is one chunk of cut-outs, whatever the clip's length.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .patch import (
    SHEAR_SD,
    SIZE_SD,
    TURN_SD,
    Array,
    Patch,
    Pose,
    Registration,
    axes_of,
    determinant,
    inverse,
    matching_share,
    register,
)
from .patch_learn import LEARN_FRAMES, Learner, expected_sigma_px, first_patch, picture_noise_dn
from .patch_search import peaks_everywhere, peaks_near

NO_MATCH, AMBIGUOUS, OUTSIDE, COVERED, DRIFTED = "no match", "ambiguous", "outside the picture", "covered", "drifted"
REACH_PX = 6
REACH_GROWTH_PX = 2
REACH_LIMIT_PX = 40
FIRST_REACH_PX = 16
"""Search radius: usual, its growth with every lost frame, its limit; and while the point's rate is not known."""
RATE_SHARE = 0.7
"""The rate follows by this share a frame."""
STAND_FRAMES = 10
"""After this many lost frames the point is looked for about its last place, and every so often in the whole frame."""
EVERYWHERE_FRAMES = 60
"""How often the whole frame is searched for look-alikes while nothing is lost."""
TURNS_RAD = (0.0, 0.2, -0.2)
"""Rotations tried in turn in whole-frame searches."""
LEAST_VISIBLE = 0.6
LEAST_INLIERS = 0.55
"""Share of the patch that must fit; less is `covered`."""
COVERED_SHARE = 0.35
"""A place that cannot be registered although this share of its pixels is as expected is covered in part."""
FIRST_INLIERS = 0.3
"""... until the background's pixels are known."""
CORRELATION, STRICT_CORRELATION = (0.35, 0.92), (0.2, 0.95)
"""A correlation may fall by this share of the way from the expected to chance, and to this share of the expected; the strict
pair holds after a loss, when only the look says what is the mark."""
NOISE, STRICT_NOISE, FIRST_NOISE = (1.6, 0.05), (1.3, 0.03), (2.0, 0.3)
"""Residuals may grow to this multiple of their usual size, and by this share of the texture."""
NOISE_RISE = 2.0
NOISE_MEMORY = 0.1
GAIN_LIMITS, GAIN_STEP = (0.3, 3.0), 1.6
"""Contrast against the picked frame's, and from frame to frame."""
TELLING_CHANCE = 0.8
CHANCE_SD = 4.0
"""Correlations that chance reaches, in standard deviations of a chance correlation."""
SHEAR_LIMIT = 1.7
SCALE_LIMITS = (0.5, 1.6)
"""Ratio of the shape's axes; their geometric mean."""
CLEARLY_BETTER = 1.4
"""Of two places, the one whose residual is smaller by this factor is the mark."""
NEARER = 0.5
"""... or the one nearer to the prediction, closer than this share of the other's distance (only while nothing is lost)."""
TWIN_SHARE = 0.7
"""A place elsewhere in the frame with this share of the patch's own correlation is a look-alike."""
SURE_PX = 1.5
"""A place this near to the prediction is the mark, look-alike or not, after ..."""
SURE_FRAMES = 3
"""... no more lost frames than this."""
PLAIN_PX = 0.5
"""From a prediction this near the registration ends at the same place: it need not be run again backwards."""
AGREE_PX, AGREE_SD = 0.2, 4.0
"""Forwards and backwards agree within this and this many standard deviations."""
HELD_PX = 24
"""Cut-outs kept for the way back reach this far beyond the patch."""
FIRST_SHEAR_SD = 0.001
SHAPE_RETURN = 0.02
RELATED_EVERY = 8
LEARN_EVERY = 4
POOL = 0.05
ROUNDS = 3


@dataclass(frozen=True)
class TemplatePlace:
    """A point in one frame.

    Attributes
    ----------
    index, t_s : the frame's
    centre_px : (2,), NaN where lost
    sigma_px : (2,), of what varies from frame to frame; large along a straight edge. The picked frame's own noise
        (``TemplateFollower.reference_sigma_px``) shifts all frames alike and is not in it
    angle_rad : turned against the picked frame, from u towards v
    scale : against the picked frame
    correlation : with the template
    reason : "" = measured; else why lost
    """

    index: int
    t_s: float
    centre_px: Array
    sigma_px: Array
    angle_rad: float
    scale: float
    correlation: float
    reason: str = ""


@dataclass(frozen=True)
class _State:
    """What is known of the point after a frame."""

    pose: Pose
    t_s: float
    rate_px_s: Array
    steps: int
    lost: int
    noise_dn: float

    def predict(self, t_s: float) -> Array:
        standing = self.lost >= STAND_FRAMES
        return self.pose.centre_px + (0.0 if standing else t_s - self.t_s) * self.rate_px_s

    def shape(self) -> Array:
        """Expected shape; what the texture does not show of it (a round spot's turn) drifts back to the picked frame's."""
        return self.pose.shape + SHAPE_RETURN * (np.eye(2) - self.pose.shape)

    def reach(self) -> int:
        if self.steps < 2:
            return FIRST_REACH_PX
        return min(REACH_PX + REACH_GROWTH_PX * self.lost, REACH_LIMIT_PX)

    def after(self, found: Registration, t_s: float) -> _State:
        rate, steps = self.rate_px_s, self.steps + 1
        if t_s != self.t_s and self.lost < STAND_FRAMES:
            seen = (found.pose.centre_px - self.pose.centre_px) / (t_s - self.t_s)
            rate = seen if self.steps < 2 else rate + RATE_SHARE * (seen - rate)
        elif self.lost >= STAND_FRAMES:
            rate, steps = np.zeros(2), 1
        noise = self.noise_dn + NOISE_MEMORY * (found.noise_dn - self.noise_dn)
        return _State(found.pose, t_s, rate, steps, 0, noise)


@dataclass
class _Held:
    """A frame of the chunk: its cut-out, where that lies, what was found forwards, and the state before it."""

    index: int
    t_s: float
    cut: NDArray[np.uint8]
    corner: Array
    found: Registration | None
    reason: str
    before: _State


class TemplateFollower:
    """Follow one point through frames that come one at a time.

    Parameters
    ----------
    picked_px : (2,), where the point is in the first frame
    radius_px : of the round patch; None: the smallest of 8 .. 18 that the first frame's texture allows
    chunk_frames : frames held back until they are final
    white_dn : the sensor's upper limit; pixels near it are left out
    """

    def __init__(
        self, picked_px: Array, radius_px: int | None = None, chunk_frames: int = 32, white_dn: float = 255.0
    ) -> None:
        self.picked_px = np.asarray(picked_px, dtype=float)
        self.radius_px = radius_px
        self.chunk_frames = chunk_frames
        self.white_dn = white_dn
        self._learner: Learner | None = None
        self._state: _State | None = None
        self._held: list[_Held] = []
        self._final = False
        self._learnt = 0
        self._upright = np.eye(2)
        self._first_noise = 0.0
        self._usual_dn = np.inf
        self._texture_dn, self._chance = 0.0, 1.0
        self._twins: list[Array] = []
        self._since = 0
        self._searches = 0
        self._registered = 0
        self._pool, self._pieces, self._pooled = np.ones(2), np.full(2, 0.3), 0
        self.reference_sigma_px = np.full(2, np.nan)

    def step(self, index: int, t_s: float, luma: NDArray[np.uint8]) -> list[TemplatePlace]:
        """Take the next frame; the places that became final with it (none, or a chunk of them)."""
        if self._state is None:
            self._begin(t_s, luma)
        assert self._state is not None and self._learner is not None
        before = self._state
        found, reason = self._locate(luma, before, t_s)
        if found is None:
            self._state = replace(before, lost=before.lost + 1)
        else:
            self._state = before.after(found, t_s)
            if not self._learnt:
                self._learner.glance(luma, found.pose)
        self._held.append(self._hold(index, t_s, luma, found, reason, before))
        self._look_for_twins(luma, found)
        return self._close() if len(self._held) >= self.chunk_frames else []

    def finish(self) -> list[TemplatePlace]:
        """The places still held back."""
        return self._close() if self._held else []

    # the first frame ----------------------------------------------------------------------------------------------

    def _begin(self, t_s: float, luma: NDArray[np.uint8]) -> None:
        self._first_noise = picture_noise_dn(luma)
        patch = first_patch(luma, self.picked_px, self.radius_px, self._first_noise)
        self._learner = Learner(patch)
        self._texture_dn, self._chance = _texture(patch)
        pose = Pose(self.picked_px, np.eye(2))
        self._state = _State(pose, t_s, np.zeros(2), 0, 0, np.sqrt(2) * self._first_noise)
        self._since = EVERYWHERE_FRAMES

    @property
    def _patch(self) -> Patch:
        assert self._learner is not None
        return self._learner.patch

    def _hold(self, index, t_s, luma, found, reason, before) -> _Held:
        middle = np.rint(found.pose.centre_px if found is not None else before.predict(t_s)).astype(int)
        half = round(1.6 * self._patch.radius_px) + HELD_PX
        low = np.clip(middle - half, 0, None)
        cut = luma[low[1] : max(middle[1] + half + 1, 0), low[0] : max(middle[0] + half + 1, 0)].copy()
        return _Held(index, t_s, cut, low.astype(float), found, reason, before)

    # one frame ----------------------------------------------------------------------------------------------------

    def _locate(
        self, luma: NDArray[np.uint8], state: _State, t_s: float, everywhere: bool = True
    ) -> tuple[Registration | None, str]:
        """The mark in a frame, or why it is lost."""
        expected = state.predict(t_s)
        height, width = luma.shape
        if not (0 <= expected[0] <= width - 1 and 0 <= expected[1] <= height - 1):
            return None, OUTSIDE
        reason = NO_MATCH
        if state.lost <= SURE_FRAMES:
            near = self._register(luma, Pose(expected, state.shape()), state)
            reason = self._judge(near, state)
            if not reason and near is not None and (not state.lost or self._surprise(near, expected) < SURE_PX):
                return near, ""
        patch, nodes = self._patch, self._nodes()
        peaks = peaks_near(luma, patch, nodes, Pose(expected, state.shape()), state.reach())
        found, searched = self._choose(luma, state, [p.centre_px for p in peaks], expected, state.shape())
        if found is None and everywhere and self._due_everywhere(state) and searched != AMBIGUOUS:
            turn = _turned(state.shape(), TURNS_RAD[self._searches % len(TURNS_RAD)])
            self._searches += 1
            peaks = peaks_everywhere(luma, patch, nodes, turn)
            found, searched = self._choose(luma, state, [p.centre_px for p in peaks], expected, turn)
        if found is not None:
            return found, ""
        if searched == NO_MATCH and reason in (COVERED, OUTSIDE):
            return None, reason
        there = replace(state.pose, centre_px=expected, shape=state.shape())
        if searched == NO_MATCH and matching_share(luma, patch, there, state.noise_dn, self.white_dn) > COVERED_SHARE:
            return None, COVERED
        return None, searched

    def _due_everywhere(self, state: _State) -> bool:
        """A patch that chance imitates well (a corner of plain areas) is not believed far from where it must be."""
        return state.lost > 0 and state.lost % STAND_FRAMES == 0 and self._chance < TELLING_CHANCE

    def _register(self, luma: Array, start: Pose, state: _State) -> Registration | None:
        self._registered += 1
        related = self._registered % RELATED_EVERY == 0
        grown = min(1.0 + state.lost, 25.0) ** 0.5
        # before the background's pixels are known, shear would take up that they move otherwise
        sd = (TURN_SD * grown, SIZE_SD * grown, SHEAR_SD * grown if self._learnt else FIRST_SHEAR_SD)
        as_one = float(max(self._pool.max(), 1.0))
        return register(luma, self._patch, start, sd, self.white_dn, related, as_one)

    def _judge(self, found: Registration | None, state: _State) -> str:
        """Why a registration is not the mark; "" = it is."""
        if found is None:
            return NO_MATCH
        if found.visible_share < LEAST_VISIBLE:
            return OUTSIDE
        axes = axes_of(found.pose.shape)
        gain = found.pose.gain
        strict = state.lost > SURE_FRAMES
        rise = GAIN_STEP * (2.0 if strict else 1.0)
        if (
            axes[0] > SHEAR_LIMIT * axes[1]
            or not SCALE_LIMITS[0] < np.sqrt(axes[0] * axes[1]) < SCALE_LIMITS[1]
            or not GAIN_LIMITS[0] < gain < GAIN_LIMITS[1]
            or not 1 / rise < gain / state.pose.gain < rise
            or found.correlation < self._least_correlation(gain, state.noise_dn, strict)
            or found.noise_dn > self._largest_noise(gain, state.noise_dn, strict)
        ):
            return NO_MATCH
        return COVERED if found.inlier_share < (LEAST_INLIERS if self._final else FIRST_INLIERS) else ""

    def _least_correlation(self, gain: float, noise_dn: float, strict: bool) -> float:
        """Between what noise leaves of the template's own correlation and what chance reaches, nearer the first."""
        texture = gain * self._texture_dn
        expected = texture / np.hypot(texture, noise_dn) * self._texture_dn / np.hypot(self._texture_dn, self._patch.noise_dn)
        share, most = STRICT_CORRELATION if strict else CORRELATION
        return min(expected - share * (expected - self._chance), most * expected)

    def _largest_noise(self, gain: float, noise_dn: float, strict: bool) -> float:
        """The residual's usual size, and a share of the texture (sampling and compression leave more where it is steep)."""
        growth, share = STRICT_NOISE if strict else NOISE if self._final else FIRST_NOISE
        return growth * min(noise_dn, NOISE_RISE * self._usual_dn) * max(gain, 1.0) + share * gain * self._texture_dn

    def _choose(
        self, luma: Array, state: _State, places: list[Array], expected: Array, shape: Array
    ) -> tuple[Registration | None, str]:
        """Register every candidate; the mark if one stands out, else why not."""
        good: list[Registration] = []
        reasons: list[str] = []
        for place in places:
            found = self._register(luma, Pose(self._informed(place, expected, shape), shape), state)
            reasons.append(self._judge(found, state))
            if not reasons[-1] and found is not None and all(self._surprise(found, g.pose.centre_px) > 1 for g in good):
                good.append(found)
        if not good:
            return None, reasons[0] if reasons else NO_MATCH
        good.sort(key=lambda g: g.noise_dn / g.pose.gain)
        best = good[0]
        if len(good) > 1 and good[1].noise_dn / good[1].pose.gain < CLEARLY_BETTER * best.noise_dn / best.pose.gain:
            good.sort(key=lambda g: self._surprise(g, expected))
            best = good[0]
            if state.lost or self._surprise(best, expected) > NEARER * self._surprise(good[1], expected):
                return None, AMBIGUOUS
        near = self._surprise(best, expected) < SURE_PX
        if state.lost and not (near and state.lost <= SURE_FRAMES) and self._near_twin(best.pose.centre_px):
            return None, AMBIGUOUS
        if state.lost and not near and self._chance > TELLING_CHANCE:
            return None, AMBIGUOUS
        return best, ""

    def _informed(self, place: Array, expected: Array, shape: Array) -> Array:
        """A candidate's place, without its component along a straight edge (there the prediction stands)."""
        blind = self._patch.blind
        return place - shape @ blind * float(blind @ inverse(shape) @ (place - expected))

    @staticmethod
    def _surprise(found: Registration, expected: Array) -> float:
        return float(np.hypot(*(found.pose.centre_px - expected)))

    # look-alikes --------------------------------------------------------------------------------------------------

    def _nodes(self) -> Array:
        """The patch for coarse searches: the template, half of it as it looked lately."""
        assert self._learner is not None
        return 0.5 * (self._learner.patch.mean_dn + self._learner.recent)

    def _look_for_twins(self, luma: NDArray[np.uint8], found: Registration | None) -> None:
        """Now and then: where else in the frame something looks like the mark, to be mistrusted after a loss."""
        self._since += 1
        if found is None or self._since < EVERYWHERE_FRAMES:
            return
        self._since = 0
        peaks = peaks_everywhere(luma, self._patch, self._nodes(), found.pose.shape)
        own = [p.correlation for p in peaks if self._surprise(found, p.centre_px) < 3]
        level = TWIN_SHARE * (own[0] if own else 1.0)
        apart = self._patch.radius_px
        self._twins = [
            p.centre_px for p in peaks if p.correlation > level and self._surprise(found, p.centre_px) > 0.5 * apart
        ]

    def _near_twin(self, place: Array) -> bool:
        return any(np.hypot(*(place - twin)) < self._patch.radius_px for twin in self._twins)

    # a chunk ------------------------------------------------------------------------------------------------------

    def _close(self) -> list[TemplatePlace]:
        held, self._held = self._held, []
        if not self._final:
            self._learn(held)
        self._go_back(held)
        self._watch(held)
        for frame in held:
            if frame.found is not None and frame.found.spread[0, 0] != frame.found.spread[0, 1]:
                growth = frame.found.spread[:, 0] / np.maximum(frame.found.spread[:, 1], 1e-30)
                self._pooled += 1
                share = max(1.0 / (self._pooled + 2), POOL)
                self._pool += share * (growth - self._pool)
                self._pieces += share * (frame.found.pieces - self._pieces)
        places = [self._place(frame) for frame in held]
        if not np.isfinite(self.reference_sigma_px).all():
            first = [p.sigma_px for p in places if not p.reason]
            self.reference_sigma_px = np.median(first, axis=0) if first else self.reference_sigma_px
        return places

    def _learn(self, held: list[_Held]) -> None:
        """The template from the frames that confirm the first one; then those frames anew against it, some times over."""
        assert self._learner is not None
        good = [f for f in held if f.found is not None]
        for number in range(ROUNDS):
            if not good:
                return
            noise = float(np.median([f.found.noise_dn for f in good if f.found is not None]))
            self._learner.learn([self._at_nodes(f) for f in good], noise, number == ROUNDS - 1)
            for frame in good:
                assert frame.found is not None
                frame.found = self._again(frame, frame.found.pose)
            good = [f for f in good if f.found is not None]
            self._anchor(held)
        self._learnt += len(good)
        self._final = self._learnt >= LEARN_FRAMES
        self._texture_dn, self._chance = _texture(self._patch)
        if self._state is not None and good and held[-1].found is not None:
            noises = [f.found.noise_dn for f in good if f.found is not None]
            self._usual_dn = float(np.median(noises))
            self._state = replace(self._state, pose=held[-1].found.pose, noise_dn=self._usual_dn)

    def _anchor(self, held: list[_Held]) -> None:
        """In the first chunk: the picked point is what lies at picked_px in the first frame, as the new template sees it."""
        assert self._learner is not None
        if self._learnt or held[0].found is None:
            return
        self._upright = held[0].found.pose.shape
        xi = self._learner.anchor(held[0].found.pose, self.picked_px)
        for frame in held:
            if frame.found is not None:
                pose = frame.found.pose
                frame.found = replace(frame.found, pose=replace(pose, centre_px=pose.centre_px + pose.shape @ xi))

    def _again(self, frame: _Held, pose: Pose) -> Registration | None:
        """Register a held frame in its cut-out."""
        start = Pose(pose.centre_px - frame.corner, pose.shape)
        found = self._register(frame.cut, start, frame.before)
        return None if found is None else _shifted(found, frame.corner)

    def _at_nodes(self, frame: _Held) -> Array:
        assert self._learner is not None and frame.found is not None
        pose = frame.found.pose
        return self._learner.at_nodes(frame.cut, replace(pose, centre_px=pose.centre_px - frame.corner))

    def _watch(self, held: list[_Held]) -> None:
        assert self._learner is not None
        good = [f for f in held if f.found is not None and f.found.inlier_share > 0.9]
        if self._final and good:
            noise = float(np.median([f.found.noise_dn for f in good if f.found is not None]))
            self._learner.watch([self._at_nodes(f) for f in good[::LEARN_EVERY]], noise)

    def _go_back(self, held: list[_Held]) -> None:
        """Follow the chunk from its last place backwards; where another place is reached, nothing later is believed."""
        state: _State | None = None
        for position in range(len(held) - 1, -1, -1):
            frame = held[position]
            if state is None:
                if frame.found is not None:
                    state = _State(frame.found.pose, frame.t_s, np.zeros(2), 0, 0, frame.before.noise_dn)
                continue
            if frame.found is not None and self._surprise(frame.found, state.predict(frame.t_s)) < PLAIN_PX:
                state = state.after(frame.found, frame.t_s)
                continue
            local = replace(state, pose=replace(state.pose, centre_px=state.pose.centre_px - frame.corner))
            back, _ = self._locate(frame.cut, local, frame.t_s, everywhere=False)
            back = None if back is None else _shifted(back, frame.corner)
            if frame.found is None:
                state = replace(state, lost=state.lost + 1)
                continue
            if back is not None and not self._agree(back, frame.found):
                self._distrust(held[position:])
                state = None
                continue
            state = state.after(frame.found, frame.t_s)

    def _distrust(self, frames: list[_Held]) -> None:
        self._state = replace(frames[0].before, lost=frames[0].before.lost + len(frames))
        for frame in frames:
            if frame.found is not None:
                frame.found, frame.reason = None, DRIFTED

    def _sigma(self, found: Registration) -> Array:
        """Standard deviation (2,): noise, as related over pixels, and pieces of the picture that scatter in place."""
        assert self._learner is not None
        noise = np.diag(found.covariance_px2) * np.maximum(self._pool, 1.0)
        return np.sqrt(noise + self._learner.place_variance_px2() * self._pieces)

    def _agree(self, one: Registration, two: Registration) -> bool:
        apart = np.abs(one.pose.centre_px - two.pose.centre_px)
        return bool((apart < AGREE_PX + AGREE_SD * self._sigma(one)).all())

    def _place(self, frame: _Held) -> TemplatePlace:
        nothing = np.full(2, np.nan)
        if frame.found is None:
            reason = frame.reason or NO_MATCH
            return TemplatePlace(frame.index, frame.t_s, nothing, nothing, np.nan, np.nan, np.nan, reason)
        shape = frame.found.pose.shape @ inverse(self._upright)
        return TemplatePlace(
            frame.index,
            frame.t_s,
            frame.found.pose.centre_px,
            self._sigma(frame.found),
            float(np.arctan2(shape[1, 0] - shape[0, 1], shape[0, 0] + shape[1, 1])),
            float(np.sqrt(abs(determinant(shape)))),
            frame.found.correlation,
        )


def _texture(patch: Patch) -> tuple[float, float]:
    """Standard deviation of a template, DN, and the correlation that chance reaches with it.

    Two unrelated pictures of n independent cells correlate by 1/sqrt(n) (Bartlett; Fisher's z for few of them); a cell is the
    sum of the template's squared autocorrelation.
    """
    n = len(patch.mean_dn)
    u, v = np.meshgrid(np.arange(n) + patch.origin_px[0], np.arange(n) + patch.origin_px[1])
    weight = patch.trust * (np.hypot(u, v) <= patch.radius_px)
    total = max(float(weight.sum()), 1e-9)
    values = weight * (patch.mean_dn - (weight * patch.mean_dn).sum() / total)
    square = float((values**2).sum()) / max(float((weight**2).sum()), 1e-9)
    related = np.fft.irfft2(np.abs(np.fft.rfft2(values, (2 * n, 2 * n))) ** 2)
    cells = total / max(float(((related / max(related[0, 0], 1e-12)) ** 2).sum()), 1.0)
    chance = float(np.tanh(CHANCE_SD / np.sqrt(max(cells - 3.0, 1.0))))
    return float(np.sqrt(max(square - patch.noise_dn**2, 1e-6))), chance


def _turned(shape: Array, angle_rad: float) -> Array:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]]) @ shape


def _shifted(found: Registration, corner: Array) -> Registration:
    return replace(found, pose=replace(found.pose, centre_px=found.pose.centre_px + corner))


__all__ = ["TemplateFollower", "TemplatePlace", "expected_sigma_px"]
