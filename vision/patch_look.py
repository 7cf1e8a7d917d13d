"""Find a followed patch in one frame: at the prediction, else among the places around it that look like it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .patch import Array, Patch, inverse
from .patch_fit import SHEAR_SD, SIZE_SD, TURN_SD, Registration, matching_share, register
from .patch_pixels import Pose
from .patch_search import peaks_everywhere, peaks_near
from .patch_track import AMBIGUOUS, COVERED, NO_MATCH, OUTSIDE, STAND_FRAMES, SURE_FRAMES, Judge, Track

EVERYWHERE_FRAMES = 60
"""How often the whole frame is searched for look-alikes while nothing is lost."""
TURN_STEP_RAD, TURN_STEPS = 0.2, 31
"""A lost patch may have turned meanwhile: rotations tried are so far apart (a registration finds what is half of that off), and so
many go once round."""
TURNS_A_SEARCH = 3
"""So many of them are tried in a search of the whole frame, the next in the search after it: a choice, for its cost."""
COVERED_SHARE = 0.35
"""A place that cannot be registered although this share of its pixels is as expected is covered in part."""
CLEARLY_BETTER = 1.4
"""Of two places, the one whose residual is smaller by this factor is the mark."""
NEARER = 0.5
"""... or the one nearer to the prediction, closer than this share of the other's distance (only while nothing is lost)."""
TWIN_SHARE = 0.7
"""A place elsewhere in the frame with this share of the patch's own correlation is a look-alike."""
SURE_PX = 1.5
"""A place this near to the prediction is the mark, look-alike or not, after a short loss."""
RIM_SHARE = 0.3
"""A lost patch whose centre is within this share of its radius of the picture's rim is outside it."""
FIRST_SHEAR_SD = 0.001
"""Before the background's pixels are known, shear would take up that they move otherwise."""
RELATED_EVERY = 8
"""Every so many registrations the residuals' relation over pixels is worked out."""


class Look:
    """The eye of a follower.

    Parameters
    ----------
    patch : first template
    white_dn : the sensor's upper limit
    """

    def __init__(self, patch: Patch, white_dn: float) -> None:
        self.patch = patch
        self.recent_dn = patch.mean_dn
        self.judge = Judge(patch)
        self.white_dn = white_dn
        self.young = True
        self.as_one = 1.0
        self._twins: list[Array] = []
        self._since = EVERYWHERE_FRAMES
        self._registered = 0

    def find(
        self, luma: NDArray[np.uint8], track: Track, t_s: float, corner: Array | None = None
    ) -> tuple[Registration | None, str]:
        """The mark in a frame, or why it is lost.

        Parameters
        ----------
        corner : (2,), where ``luma`` is a cut-out of the frame: its first pixel, and ``track`` is seen from there
        """
        expected = track.predict(t_s)
        height, width = luma.shape
        if not (0 <= expected[0] <= width - 1 and 0 <= expected[1] <= height - 1):
            return None, OUTSIDE
        there = replace(track.pose, centre_px=expected, shape=track.shape())
        reason = NO_MATCH
        if track.lost <= SURE_FRAMES:
            near = self.register(luma, there, track)
            reason = self.judge.why_not(near, track)
            if not reason and near is not None and (not track.lost or apart_px(near, expected) < SURE_PX):
                return near, ""
        peaks = peaks_near(luma, self.patch, self._nodes(), there, track.reach())
        found, searched = self._choose(luma, track, [p.centre_px for p in peaks], there, corner)
        if found is None and corner is None and searched != AMBIGUOUS:
            found = self._turned_near(luma, track, there)
            if found is None and self._due_everywhere(track):
                found, searched = self._everywhere(luma, track, there)
        if found is not None or searched != NO_MATCH:
            return found, searched
        if reason == OUTSIDE or self._gone(track, t_s, luma.shape):
            return None, OUTSIDE
        if reason == COVERED:
            return None, reason
        seen = matching_share(luma, self.patch, there, track.noise_dn, self.white_dn)
        return None, COVERED if seen > COVERED_SHARE else NO_MATCH

    def register(self, luma: Array, start: Pose, track: Track, related: bool = False) -> Registration | None:
        """Fit the template from ``start``; ``related``: with the residuals' relation, worked out now and then anyway."""
        self._registered += 1
        grown = min(1.0 + track.lost, 25.0) ** 0.5
        shape_sd = (TURN_SD * grown, SIZE_SD * grown, FIRST_SHEAR_SD if self.young else SHEAR_SD * grown)
        related = related or self._registered % RELATED_EVERY == 0
        return register(luma, self.patch, start, shape_sd, self.white_dn, related, self.as_one)

    def note_twins(self, luma: NDArray[np.uint8], found: Registration | None) -> None:
        """Now and then: where else in the frame something looks like the mark, to be mistrusted after a loss."""
        self._since += 1
        if found is None or self._since < EVERYWHERE_FRAMES:
            return
        self._since = 0
        peaks = peaks_everywhere(luma, self.patch, self._nodes(), found.pose.shape)
        own = [p.correlation for p in peaks if apart_px(found, p.centre_px) < 3]
        level = TWIN_SHARE * (own[0] if own else 1.0)
        far = 0.5 * self.patch.radius_px
        self._twins = [p.centre_px for p in peaks if p.correlation > level and apart_px(found, p.centre_px) > far]

    def _choose(
        self, luma: Array, track: Track, places: list[Array], there: Pose, corner: Array | None
    ) -> tuple[Registration | None, str]:
        """Register every candidate; the mark if one stands out, else why not."""
        good: list[Registration] = []
        reasons: list[str] = []
        for place in places:
            found = self.register(luma, replace(there, centre_px=self._informed(place, there)), track)
            reasons.append(self.judge.why_not(found, track))
            if not reasons[-1] and found is not None and all(apart_px(found, g.pose.centre_px) > 1 for g in good):
                good.append(found)
        if not good:
            return None, reasons[0] if reasons else NO_MATCH
        expected = there.centre_px
        good.sort(key=_misfit)
        best = good[0]
        if len(good) > 1 and _misfit(good[1]) < CLEARLY_BETTER * _misfit(best):
            good.sort(key=lambda g: apart_px(g, expected))
            best = good[0]
            if track.lost or apart_px(best, expected) > NEARER * apart_px(good[1], expected):
                return None, AMBIGUOUS
        near = apart_px(best, expected) < SURE_PX
        if track.lost and not near and not self.judge.telling:
            return None, AMBIGUOUS
        if track.lost and not (near and track.lost <= SURE_FRAMES) and self._near_twin(best, corner):
            return None, AMBIGUOUS
        return best, ""

    def _turned_near(self, luma: Array, track: Track, there: Pose) -> Registration | None:
        """About its last place, turned: another rotation in every frame of a longer loss."""
        if track.lost <= SURE_FRAMES or not self.judge.telling:
            return None
        turned = replace(there, shape=_turned(there.shape, _turn_rad(track.lost - SURE_FRAMES)))
        peaks = peaks_near(luma, self.patch, self._nodes(), turned, track.reach())
        return self._choose(luma, track, [p.centre_px for p in peaks], turned, None)[0]

    def _everywhere(self, luma: Array, track: Track, there: Pose) -> tuple[Registration | None, str]:
        """In the whole frame, by some rotations, the small ones first."""
        first = TURNS_A_SEARCH * (track.lost // STAND_FRAMES - 1)
        found, reason = None, NO_MATCH
        for number in range(first, first + TURNS_A_SEARCH):
            turned = replace(there, shape=_turned(there.shape, _turn_rad(number)))
            peaks = peaks_everywhere(luma, self.patch, self._nodes(), turned.shape)
            found, reason = self._choose(luma, track, [p.centre_px for p in peaks], turned, None)
            if found is not None or reason == AMBIGUOUS:
                break
        return found, reason

    def _informed(self, place: Array, there: Pose) -> Array:
        """A candidate's place, without its component along a straight edge (there the prediction stands)."""
        blind = self.patch.blind
        away = place - there.centre_px
        return place - there.shape @ blind * float(blind @ inverse(there.shape) @ away)

    def _gone(self, track: Track, t_s: float, shape: tuple[int, ...]) -> bool:
        """At its last rate the patch would have left the picture soon after it was lost, or half left it."""
        ahead = (t_s - track.t_s) * min(1.0, STAND_FRAMES / max(track.lost, 1))
        place = track.pose.centre_px + track.rate_px_s * ahead
        rim = RIM_SHARE * self.patch.radius_px
        return track.lost > 0 and not (rim <= place[0] <= shape[1] - 1 - rim and rim <= place[1] <= shape[0] - 1 - rim)

    def _due_everywhere(self, track: Track) -> bool:
        return track.lost > 0 and track.lost % STAND_FRAMES == 0 and self.judge.telling

    def _nodes(self) -> Array:
        """The patch for coarse searches: the template, half of it as it looked lately."""
        return 0.5 * (self.patch.mean_dn + self.recent_dn)

    def _near_twin(self, found: Registration, corner: Array | None) -> bool:
        place = found.pose.centre_px + (0.0 if corner is None else corner)
        return any(np.hypot(*(place - twin)) < self.patch.radius_px for twin in self._twins)


def apart_px(found: Registration, place: Array) -> float:
    """Distance of a registration from a place.

    Parameters
    ----------
    found : of the registration
    place : (2,) px
    """
    return float(np.hypot(*(found.pose.centre_px - place)))


def _misfit(found: Registration) -> float:
    return found.noise_dn / found.pose.gain


def _turn_rad(number: int) -> float:
    """The rotations in the order in which they are tried: 0, then ever larger ones to both sides."""
    step = number % TURN_STEPS
    return TURN_STEP_RAD * ((step + 1) // 2) * (1 if step % 2 else -1)


def _turned(shape: Array, angle_rad: float) -> Array:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]]) @ shape
