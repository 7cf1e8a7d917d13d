"""Follow printed ArUco and AprilTag marks through frames that come one at a time.

Which family (dictionary) the tags are of, nobody has to say: it is the one that shows all wanted numbers. Where tags of several are
in one run, each names its own ("aruco:4x4:7"). A tag is measured only where its whole pattern fits, every cell of it (``tag_fit``);
one that names its dictionary and was never seen whole (worn print, glare), where every cell can be read. Once seen, it is fitted
from its predicted place; squares are looked for (``tag_squares``) only where that fails, around it and now and then everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Lens
from ..record.tags import DICTIONARIES, tag_name
from .tag_fit import Tag, TagFit
from .tag_squares import Squares, count_tags, tag_cells
from .tag_view import SQUARE, Array, inside, middle_px, project

NO_TAG, AMBIGUOUS, OUTSIDE, COVERED = "no tag", "ambiguous", "outside the picture", "covered"
REACH_PX, REACH_SIDES, REACH_GROWTH_PX, REACH_LIMIT_PX = 8.0, 0.3, 4.0, 150.0
"""Squares are looked for this far beyond the predicted tag (sum of the first two); growth with every lost frame; limit."""
COAST_FRAMES = 10
"""A tag unseen for longer is looked for where it was, not where it would have gone, and ..."""
WINDOW_EVERY, WHOLE_EVERY = 3, 30
"""... only in one of so many frames, and so often in the whole frame."""
EAGER_FRAMES, UNSEEN_EVERY = 30, 15
"""A tag never seen is looked for in each of the first frames, then in one of so many."""
PATIENCE = 10
"""If no family has shown all numbers after so many looks at whole frames, the one that has shown most is taken."""
CLEARLY_NEARER = 0.5
"""Of two tags of one number in the whole frame, the nearer one is taken if its distance is below this share of the other's."""
USUAL_FACTOR, USUAL_SHARE, USUAL_MEMORY = 1.5, 0.015, 0.1
"""Residuals may be this multiple of the tag's usual ones (and this share of the contrast); beyond that something covers an edge."""
PARTLY = 0.45
"""A fit whose residual is below this share of the contrast lies on a tag that something covers."""


@dataclass(frozen=True)
class FiducialPlace:
    """A tag in one frame.

    Attributes
    ----------
    index, t_s : the frame's
    centre_px : (2,), where the diagonals meet, NaN where lost: the image of the square's middle, whatever the perspective
    sigma_px : (2,), standard deviations of the centre from the scatter of the fit's residuals
    corners_px : (4, 2), of the black square, clockwise from the one at the code's first bit
    reason : "" = measured; else why lost: "no tag", "covered", "outside the picture", "ambiguous" (two tags of this number)
    """

    index: int
    t_s: float
    centre_px: Array
    sigma_px: Array
    corners_px: Array
    reason: str = ""


@dataclass
class _Group:
    """Looks whose tags are of one family: their places in the list; of each family that has all their numbers, the tags' cells."""

    looks: list[int]
    families: dict[str, list[Array]]
    named: bool = False
    """run.toml names the family: a worn tag is no sign of another one."""
    family: str | None = None
    tried: int = 0
    shown: dict[str, int] = field(default_factory=dict)


@dataclass
class _Trail:
    """A tag that has been seen."""

    tag: Tag
    to_px: Array
    t_s: float
    rate_px_s: Array
    usual_dn: float
    lost: int = 0
    worn: bool = False
    """It was never seen whole."""

    def predict(self, t_s: float) -> Array:
        """Its homography at ``t_s`` (3, 3): constant velocity, after a while standing."""
        shift = np.eye(3)
        if self.lost <= COAST_FRAMES:
            shift[:2, 2] = (t_s - self.t_s) * self.rate_px_s
        return shift @ self.to_px

    def accepts(self, fit: TagFit) -> bool:
        """The whole tag is there, as well as ever (in a while, light and blur may have changed)."""
        limit = USUAL_FACTOR * self.usual_dn / fit.contrast_dn + USUAL_SHARE
        there = fit.readable if self.worn else fit.whole
        return there and (self.lost > COAST_FRAMES or fit.residual < limit)

    def take(self, fit: TagFit, t_s: float) -> None:
        """The tag was measured."""
        now = fit.residual * fit.contrast_dn
        self.usual_dn = now if self.lost > COAST_FRAMES else self.usual_dn + USUAL_MEMORY * (now - self.usual_dn)
        gap = t_s - self.t_s
        known = gap > 0 and self.lost <= COAST_FRAMES
        self.rate_px_s = (fit.centre_px - middle_px(self.to_px)) / gap if known else np.zeros(2)
        self.to_px, self.t_s, self.lost = fit.to_px, t_s, 0
        self.worn = self.worn and not fit.whole


class FiducialFollower:
    """All fiducials of a run.

    Parameters
    ----------
    looks : one per marker, such as "aruco:7", "apriltag:3" or, with its dictionary, "aruco:4x4:7"
    white_dn : value at which the picture is clipped
    lens : of the camera; without it the picture is taken as free of distortion (``tag_fit.Tag`` says what that costs)

    Raises
    ------
    ValueError : not such a look, one given twice, or no family has all numbers of a kind that are given without one
    """

    def __init__(self, looks: Sequence[str], white_dn: float = 255.0, lens: Lens | None = None) -> None:
        self.looks, self.white_dn, self.lens = tuple(looks), white_dn, lens
        self._groups = _groups(self.looks)
        self._trails: list[_Trail | None] = [None] * len(self.looks)
        self._reasons = [NO_TAG] * len(self.looks)
        self._frames = 0

    @property
    def families(self) -> dict[str, str | None]:
        """Group ("aruco", "aruco:4x4") -> the family its tags turned out to be of, by OpenCV's name; None while that is open."""
        return {name: group.family for name, group in self._groups.items()}

    def step(self, index: int, t_s: float, luma: NDArray[np.uint8]) -> list[FiducialPlace]:
        """Take one frame.

        Parameters
        ----------
        index, t_s : the frame's; times rise
        luma : (h, w)

        Returns
        -------
        One place per look, in their order
        """
        fits = [trail and self._near(look, trail, luma, t_s) for look, trail in enumerate(self._trails)]
        missing = [look for look, fit in enumerate(fits) if fit is None and self._due(look)]
        if missing:
            for look, fit in self._everywhere(luma, missing, t_s).items():
                fits[look] = fit
        self._frames += 1
        return [self._place(index, t_s, look, fit) for look, fit in enumerate(fits)]

    def _place(self, index: int, t_s: float, look: int, fit: TagFit | None) -> FiducialPlace:
        trail = self._trails[look]
        if fit is None:
            if trail is not None:
                trail.lost += 1
            return FiducialPlace(
                index, t_s, np.full(2, np.nan), np.full(2, np.nan), np.full((4, 2), np.nan), self._reasons[look]
            )
        if trail is not None:
            trail.take(fit, t_s)
        return FiducialPlace(index, t_s, fit.centre_px, np.sqrt(np.diag(fit.covariance_px2)), fit.corners_px)

    # near the predicted place -----------------------------------------------------------------------------------

    def _near(self, look: int, trail: _Trail, luma: NDArray[np.uint8], t_s: float) -> TagFit | None:
        """The tag at its predicted place; else, of those among the squares around, the nearest."""
        start = trail.predict(t_s)
        corners = project(start, SQUARE)
        within = inside(corners, luma.shape)
        fit = trail.tag.fit(luma, start) if within else None
        if fit is not None and trail.accepts(fit):
            return fit
        partly = fit is not None and fit.settled and fit.residual < PARTLY
        self._reasons[look] = OUTSIDE if not within else COVERED if partly else NO_TAG
        if trail.lost > COAST_FRAMES and trail.lost % WINDOW_EVERY:
            return None
        side = float(np.ptp(corners, axis=0).max())
        reach = min(REACH_PX + REACH_SIDES * side + REACH_GROWTH_PX * trail.lost, REACH_LIMIT_PX)
        squares = Squares(luma, corners.min(axis=0) - reach, corners.max(axis=0) + reach)
        found = _nearest_first(squares.tags(trail.tag, trail.worn), middle_px(start))
        return found[0] if found and trail.accepts(found[0]) else None

    # whole frames -----------------------------------------------------------------------------------------------

    def _due(self, look: int) -> bool:
        trail = self._trails[look]
        if trail is not None:
            return trail.lost % WHOLE_EVERY == WHOLE_EVERY - 1
        return self._frames < EAGER_FRAMES or self._frames % UNSEEN_EVERY == 0

    def _everywhere(self, luma: NDArray[np.uint8], missing: list[int], t_s: float) -> dict[int, TagFit]:
        """Those of the missing looks that the whole frame shows."""
        squares = Squares(luma)
        found: dict[int, TagFit] = {}
        for group in self._groups.values():
            wanted = [look for look in group.looks if look in missing]
            if wanted and group.family is None:
                self._name_family(group, squares)
            if group.family is None:
                continue
            for look in wanted:
                cells = group.families[group.family][group.looks.index(look)]
                trail = self._trails[look]
                whole = squares.tags(self._tag(cells))
                worn = not whole and (group.named if trail is None else trail.worn)
                fit = self._one(look, squares.tags(self._tag(cells), worn=True) if worn else whole, t_s)
                if fit is not None:
                    found[look] = fit
                    if trail is None:
                        usual_dn = fit.residual * fit.contrast_dn
                        self._trails[look] = _Trail(
                            self._tag(cells), fit.to_px, t_s, np.zeros(2), usual_dn, worn=not fit.whole
                        )
        return found

    def _one(self, look: int, fits: list[TagFit], t_s: float) -> TagFit | None:
        """The one tag of its number; of several, the one that is clearly nearest to where it is expected."""
        trail = self._trails[look]
        if len(fits) < 2:
            return fits[0] if fits else None
        if trail is not None:
            expected = middle_px(trail.predict(t_s))
            fits = _nearest_first(fits, expected)
            near, far = (np.hypot(*(fit.centre_px - expected)) for fit in fits[:2])
            if near < CLEARLY_NEARER * far:
                return fits[0]
        self._reasons[look] = AMBIGUOUS
        return None

    def _name_family(self, group: _Group, squares: Squares) -> None:
        """Settle on the family that shows all numbers; after a while, on the one that has shown most."""
        group.tried += 1
        full: dict[str, float] = {}
        for name, cells in group.families.items():
            seen = [squares.tags(self._tag(c)) for c in cells]
            group.shown[name] = group.shown.get(name, 0) + sum(map(bool, seen))
            if all(seen):
                full[name] = float(np.mean([np.ptp(fits[0].corners_px) for fits in seen]))
        if len(full) > 1:
            # a calibration board of another family shows many numbers besides; then the larger tags
            group.family = min(full, key=lambda name: (count_tags(squares.luma, name), -full[name]))
        elif full:
            group.family = next(iter(full))
        elif group.tried >= PATIENCE and any(group.shown.values()):
            group.family = max(group.shown, key=lambda name: group.shown[name])

    def _tag(self, cells: Array) -> Tag:
        return Tag(cells, self.white_dn, self.lens)


def _nearest_first(fits: list[TagFit], place_px: Array) -> list[TagFit]:
    return sorted(fits, key=lambda fit: float(np.hypot(*(fit.centre_px - place_px))))


def _groups(looks: tuple[str, ...]) -> dict[str, _Group]:
    """Looks by what they say of kind and family, with the cells of their numbers in every family that has them all."""
    names = [tag_name(look) for look in looks]
    if len(set(names)) < len(names):
        raise ValueError(f"looks {list(looks)}: a fiducial stands there twice")
    groups: dict[str, _Group] = {}
    for place, name in enumerate(names):
        groups.setdefault(name.group, _Group([], {})).looks.append(place)
    for group in groups.values():
        first = names[group.looks[0]]
        numbers = [names[place].number for place in group.looks]
        for dictionary, family in DICTIONARIES[first.kind].items():
            if first.dictionary not in ("", dictionary):
                continue
            # a tag that names its dictionary is not meant a second time without it
            named = {name.number for name in names if (name.kind, name.dictionary) == (first.kind, dictionary)}
            if (first.dictionary or not named.intersection(numbers)) and (cells := tag_cells(family, numbers)):
                group.families[family] = cells
        if not group.families:
            if first.dictionary:
                raise ValueError(
                    f"{first.kind}:{first.dictionary} {numbers}: the dictionary does not have all these numbers"
                )
            raise ValueError(
                f"{first.kind} {numbers}: no family of tags has all these numbers; tags of several name theirs, aruco:4x4:7"
            )
        if first.dictionary:
            [group.family], group.named = group.families, True
    return groups
