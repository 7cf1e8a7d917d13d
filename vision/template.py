"""Follow a point picked in one frame: a bow's corner, a mark, a stanchion's foot on a hull that was never prepared.

Every place comes from registering the same first template (``patch_fit``), so nothing drifts; a coarse search
(``patch_search``) only says where to start. Frames are held in chunks: forwards as they come, then backwards from the
chunk's last place; a frame from which both ways part is `drifted`, and so is what follows it. Memory is one chunk of
cut-outs, whatever the clip's length.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .patch import Array, determinant, inverse
from .patch_fit import Registration
from .patch_learn import LEARN_FRAMES, Learner, first_patch, picture_noise_dn
from .patch_look import Look, apart_px
from .patch_pixels import Pose
from .patch_track import DRIFTED, NO_MATCH, Track

PLAIN_PX = 0.5
"""From a prediction this near the registration ends at the same place: it need not be run again backwards."""
AGREE_PX, AGREE_SD = 0.2, 4.0
"""Forwards and backwards agree within this and this many standard deviations."""
OTHER_PX = 1.5
"""Farther apart they are at different things, and nothing that follows is believed; nearer, only that frame is in doubt."""
HELD_PX = 24
"""Cut-outs kept for the way back reach this far beyond the patch."""
ROUNDS = 3
"""Template and poses of the first chunk are found in turn, so many times."""
LEARN_EVERY = 4
"""The pixels' trust is learnt on from every so many frames."""
CLEAN_SHARE = 0.9
"""A frame whose pixels fit in more than this share teaches the template: a choice."""
POOL = 0.05
"""Share of a new frame in the pooled relation of residuals."""
FIRST_PIECES = 0.3
"""How far scatter in place carries to the centre before any frame has told: a choice."""
FEW_FRAMES = 3
"""Until so many frames are learnt the first frame's noise holds as well."""


@dataclass(frozen=True)
class TemplatePlace:
    """A point in one frame.

    Attributes
    ----------
    index, t_s : the frame's
    centre_px : (2,), NaN where lost
    sigma_px : (2,), of what varies from frame to frame; the patch's radius along a straight edge. The picked frame's own
        noise (``TemplateFollower.reference_sigma_px``) shifts all frames alike and is not in it
    angle_rad : turned against the picked frame, from u towards v
    scale : against the picked frame
    correlation : with the template
    reason : "" = measured; else why lost: no match, ambiguous, outside the picture, covered, drifted
    """

    index: int
    t_s: float
    centre_px: Array
    sigma_px: Array
    angle_rad: float
    scale: float
    correlation: float
    reason: str = ""


@dataclass
class _Held:
    """A frame of the chunk: its cut-out, where that lies, what was found forwards, and what was known before it."""

    index: int
    t_s: float
    cut: NDArray[np.uint8]
    corner: Array
    found: Registration | None
    reason: str
    before: Track


class TemplateFollower:
    """Follow one point through frames that come one at a time.

    Parameters
    ----------
    picked_px : (2,), where the point is in the first frame
    radius_px : of the round patch; None: the smallest of RADII_PX that the first frame's texture allows
    chunk_frames : frames held back until they are final; the first chunk also teaches the template
    white_dn : the sensor's upper limit; pixels near it are left out

    Attributes
    ----------
    reference_sigma_px : (2,), error of the picked frame's own registration: an offset common to all frames, fixed to the
        body (beside the picking error itself); NaN until the first chunk is done
    """

    def __init__(
        self, picked_px: Array, radius_px: int | None = None, chunk_frames: int = 32, white_dn: float = 255.0
    ) -> None:
        self.reference_sigma_px = np.full(2, np.nan)
        self._picked = np.asarray(picked_px, dtype=float)
        self._radius, self._chunk, self._white = radius_px, chunk_frames, white_dn
        self._started: tuple[Look, Learner] | None = None
        self._track = Track.starting(Pose(self._picked, np.eye(2)), 0.0, 1.0)
        self._held: list[_Held] = []
        self._learnt = 0
        self._first_noise = 1.0
        self._upright = np.eye(2)
        self._related, self._pieces, self._pooled = np.ones(2), np.full(2, FIRST_PIECES), 0

    def step(self, index: int, t_s: float, luma: NDArray[np.uint8]) -> list[TemplatePlace]:
        """Take the next frame, (h, w); the places that became final with it (none, or a chunk of them)."""
        look, learner = self._started or self._begin(t_s, luma)
        before = self._track
        found, reason = look.find(luma, before, t_s)
        self._track = before.missed() if found is None else before.after(found, t_s)
        if found is not None and not self._learnt:
            learner.glance(luma, found.pose)
            look.patch = learner.patch
        self._held.append(self._hold(index, t_s, luma, found, reason, before))
        look.note_twins(luma, found)
        return self._close(look, learner) if len(self._held) >= self._chunk else []

    def seek(self, place_px: Array, t_s: float, luma: NDArray[np.uint8]) -> bool:
        """Whether the template is about a place of the frame that comes next; it is followed on from there, then.

        Parameters
        ----------
        place_px : (2,), where a person sees the point
        t_s : the frame's time
        luma : (h, w)
        """
        if self._started is None:
            return False
        pose = replace(self._track.pose, centre_px=np.asarray(place_px, dtype=float))
        there = Track.starting(pose, t_s, self._track.noise_dn)
        if self._started[0].find(luma, there, t_s)[0] is None:
            return False
        self._track = there
        return True

    def finish(self) -> list[TemplatePlace]:
        """The places still held back."""
        return self._close(*self._started) if self._held and self._started else []

    def _begin(self, t_s: float, luma: NDArray[np.uint8]) -> tuple[Look, Learner]:
        self._first_noise = picture_noise_dn(luma)
        patch = first_patch(luma, self._picked, self._radius, self._first_noise)
        self._track = Track.starting(self._track.pose, t_s, float(np.sqrt(2)) * self._first_noise)
        self._started = Look(patch, self._white), Learner(patch)
        return self._started

    def _hold(
        self,
        index: int,
        t_s: float,
        luma: NDArray[np.uint8],
        found: Registration | None,
        reason: str,
        before: Track,
    ) -> _Held:
        assert self._started is not None
        middle = np.rint(found.pose.centre_px if found is not None else before.predict(t_s)).astype(int)
        half = round(1.6 * self._started[0].patch.radius_px) + HELD_PX
        low = np.clip(middle - half, 0, None)
        high = np.clip(middle + half + 1, 0, None)
        cut = luma[low[1] : high[1], low[0] : high[0]].copy()
        return _Held(index, t_s, cut, low.astype(float), found, reason, before)

    # a chunk ------------------------------------------------------------------------------------------------------

    def _close(self, look: Look, learner: Learner) -> list[TemplatePlace]:
        held, self._held = self._held, []
        if not look.judge.final:
            self._learn(held, look, learner)
        self._go_back(held, look, learner)
        self._learn_on(held, look, learner)
        places = [self._place(frame, learner) for frame in held]
        measured = [p.sigma_px for p in places if not p.reason]
        if measured and not np.isfinite(self.reference_sigma_px).all():
            self.reference_sigma_px = np.median(measured, axis=0)
        return places

    def _learn(self, held: list[_Held], look: Look, learner: Learner) -> None:
        """The template from the frames that confirm the first one; then those frames anew against it, some times over."""
        good = [f for f in held if f.found is not None]
        noise = 0.0
        for number in range(ROUNDS):
            if not good:
                return
            noise = _usual_noise(good)
            learner.learn([_at_nodes(f, learner) for f in good], noise, number == ROUNDS - 1)
            look.patch = learner.patch
            for frame in good:
                assert frame.found is not None
                frame.found = _again(frame, frame.found.pose, look, number == ROUNDS - 1)
            good = [f for f in good if f.found is not None]
            if not self._learnt and held[0].found is not None:
                self._anchor(held, held[0].found.pose, learner)
                look.patch = learner.patch
        self._learnt += len(good)
        look.young = False
        noise = _usual_noise(good) if good else noise
        look.judge.learnt(learner.patch, noise, self._learnt >= LEARN_FRAMES)
        if held[-1].found is not None:
            self._track = replace(self._track, pose=held[-1].found.pose, noise_dn=noise)

    def _anchor(self, held: list[_Held], first: Pose, learner: Learner) -> None:
        """The picked point is what lies at the picked place in the first frame, as the new template sees that frame."""
        self._upright = first.shape
        xi = learner.anchor(first, self._picked)
        for frame in held:
            if frame.found is not None:
                pose = frame.found.pose
                frame.found = replace(frame.found, pose=replace(pose, centre_px=pose.centre_px + pose.shape @ xi))

    def _go_back(self, held: list[_Held], look: Look, learner: Learner) -> None:
        """Follow the chunk from its last place backwards; once it is at another thing, nothing later is believed."""
        track: Track | None = None
        for position in range(len(held) - 1, -1, -1):
            frame = held[position]
            if frame.found is None:
                track = None if track is None else track.missed()
                continue
            if track is None:
                track = Track.starting(frame.found.pose, frame.t_s, frame.before.noise_dn)
                continue
            back = self._found_back(frame, track, look)
            if back is None or self._agree(back, frame.found, learner):
                track = track.after(frame.found, frame.t_s)
            elif apart_px(back, frame.found.pose.centre_px) < OTHER_PX:
                track = track.after(back, frame.t_s)
                frame.found, frame.reason = None, DRIFTED
            else:
                self._distrust(held[position:])
                track = None

    @staticmethod
    def _found_back(frame: _Held, track: Track, look: Look) -> Registration | None:
        """The mark in a held frame, looked for from later frames."""
        if frame.found is not None and apart_px(frame.found, track.predict(frame.t_s)) < PLAIN_PX:
            return frame.found
        back, _ = look.find(frame.cut, track.moved(-frame.corner), frame.t_s, frame.corner)
        return None if back is None else _shifted(back, frame.corner)

    def _distrust(self, frames: list[_Held]) -> None:
        self._track = frames[0].before.missed(len(frames))
        for frame in frames:
            if frame.found is not None:
                frame.found, frame.reason = None, DRIFTED

    def _learn_on(self, held: list[_Held], look: Look, learner: Learner) -> None:
        """The pixels' trust, the template's recent look and the residuals' relation, from a chunk that is final."""
        good = [f for f in held if f.found is not None and f.found.inlier_share > CLEAN_SHARE]
        if look.judge.final and good:
            learner.watch([_at_nodes(f, learner) for f in good[::LEARN_EVERY]], _usual_noise(good))
            look.patch, look.judge.patch = learner.patch, learner.patch
        look.recent_dn = learner.recent
        for frame in held:
            if frame.found is not None and frame.found.spread[0, 1] != 1.0:
                self._pooled += 1
                share = max(1.0 / (self._pooled + 1), POOL)
                growth = frame.found.spread[:, 0] / np.maximum(frame.found.spread[:, 1], 1e-30)
                self._related += share * (growth - self._related)
                self._pieces += share * (frame.found.pieces - self._pieces)
        look.as_one = float(max(self._related.max(), 1.0))

    # places -------------------------------------------------------------------------------------------------------

    def _sigma(self, found: Registration, learner: Learner) -> Array:
        """Standard deviation (2,): noise, as related over pixels, and pieces of the picture that scatter in place."""
        noise = np.diag(found.covariance_px2) * np.maximum(self._related, 1.0)
        if self._learnt < FEW_FRAMES:  # a frame against itself leaves no residual
            noise = noise * max(self._first_noise / found.noise_dn, 1.0) ** 2
        return np.sqrt(noise + learner.place_variance_px2() * self._pieces)

    def _agree(self, one: Registration, two: Registration, learner: Learner) -> bool:
        apart = np.abs(one.pose.centre_px - two.pose.centre_px)
        return bool((apart < AGREE_PX + AGREE_SD * self._sigma(one, learner)).all())

    def _place(self, frame: _Held, learner: Learner) -> TemplatePlace:
        if frame.found is None:
            nothing, reason = np.full(2, np.nan), frame.reason or NO_MATCH  # "": the learnt template did not hold
            return TemplatePlace(frame.index, frame.t_s, nothing, nothing, np.nan, np.nan, np.nan, reason)
        shape = frame.found.pose.shape @ inverse(self._upright)
        return TemplatePlace(
            frame.index,
            frame.t_s,
            frame.found.pose.centre_px,
            self._sigma(frame.found, learner),
            float(np.arctan2(shape[1, 0] - shape[0, 1], shape[0, 0] + shape[1, 1])),
            float(np.sqrt(abs(determinant(shape)))),
            frame.found.correlation,
        )


def _usual_noise(frames: list[_Held]) -> float:
    return float(np.median([f.found.noise_dn for f in frames if f.found is not None]))


def _again(frame: _Held, pose: Pose, look: Look, related: bool) -> Registration | None:
    """Register a held frame anew, in its cut-out."""
    found = look.register(frame.cut, replace(pose, centre_px=pose.centre_px - frame.corner), frame.before, related)
    return None if found is None else _shifted(found, frame.corner)


def _at_nodes(frame: _Held, learner: Learner) -> Array:
    assert frame.found is not None
    pose = frame.found.pose
    return learner.at_nodes(frame.cut, replace(pose, centre_px=pose.centre_px - frame.corner))


def _shifted(found: Registration, by_px: Array) -> Registration:
    return replace(found, pose=replace(found.pose, centre_px=found.pose.centre_px + by_px))
