"""Real recordings, which nobody here drew: how often the marks are held, and how a rigid pair's distance scatters.

They stand beside the checkout, in ``../shared``, and are not part of it; without them nothing is said. A place that towline gives
is right where OpenCV's blobs, linked from a known start, are within a pixel of it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from footage_peers import Array, followed, present

from towline.pipeline.stages import fit_run_datum
from towline.record import read_run
from towline.record.errors import TowlineError
from towline.vision import clip_info, read_frames, track

SHARED = Path(__file__).resolve().parents[1].parent / "shared"
FILM_FRAMES = 100
"""Of the film, that the peers see."""
FILM_SIZE_PX = 9.0
"""Of its lights' pictures."""
RIGHT_PX = 1.0
"""Of the linked blobs: such a place is the mark's."""


@dataclass(frozen=True)
class Dots:
    """Two dark dots on a light disc, on video.

    Attributes
    ----------
    video : below ``SHARED``
    datum_px : four places, a pixel m_per_px each
    m_per_px : of a scale that is nearly right
    body_m : of the two dots
    start_px : (2, 2) in the frame ``first``
    first, last : frames looked at
    rate_hz : of the file's times
    size_px : of a dot's picture
    waves : harmonics of the pair's direction by which the camera changes their distance
    """

    video: str
    datum_px: tuple[tuple[float, float], ...]
    m_per_px: float
    body_m: tuple[float, float]
    start_px: tuple[tuple[float, float], tuple[float, float]]
    first: int
    last: int
    rate_hz: float
    size_px: float
    waves: tuple[int, ...]

    def run(self, folder: Path, seen_px: Array | None, first: int) -> Any:
        """A run folder of it from a frame on."""
        name = Path(self.video).name
        span = (first - 0.5) / self.rate_hz, (self.last + 0.5) / self.rate_hz
        lines = ['name = "dots"', 'kind = "free"', "[source]", f'video = "{name}"']
        lines += [f"span_s = [{max(span[0], 0.0):.4f}, {span[1]:.4f}]"]
        for index, (u, v) in enumerate(self.datum_px):
            lines += ["[[datum]]", f'name = "d{index}"', f"pixel_px = [{u}, {v}]"]
            lines += [f"tank_m = [{-v * self.m_per_px:.6f}, {u * self.m_per_px:.6f}, 0.0]"]
        for index, x in enumerate(self.body_m):
            lines += ["[[marker]]", f'name = "m{index}"', f"body_m = [{x}, 0.0]", "depth_m = 0.0"]
            lines += ['look = "disc"', 'colour = "dark"']
            if seen_px is not None:
                lines += [f"seen_at_px = [{seen_px[index, 0]:.1f}, {seen_px[index, 1]:.1f}]"]
        (folder / "run.toml").write_text("\n".join(lines) + "\n")
        if not (folder / name).exists():
            (folder / name).symlink_to(SHARED / self.video)
        return read_run(folder)


ROLLING = Dots(
    "real/rolling_cylinder/RollingCylinder.MP4",
    ((10.0, 10.0), (310.0, 10.0), (10.0, 230.0), (310.0, 230.0)),
    0.003,
    (0.03465, -0.03465),
    ((251.9, 106.4), (247.7, 129.1)),
    120,
    262,
    30000 / 1001,
    5.0,
    (2,),
)
STARTS = range(120, 201, 10)
PIVOT = Dots(
    "real/pivot_video/RotationOnAFixedPivot_R1.MP4",
    ((50.0, 20.0), (250.0, 20.0), (50.0, 220.0), (250.0, 220.0)),
    0.001,
    (0.0, 0.073),
    ((199.0, 110.0), (269.0, 130.0)),
    95,
    1177,
    30000 / 1001,
    13.0,
    (1, 2, 3, 4),
)


def rigid_scatter(place: Array, waves: Sequence[int]) -> float:
    """Standard deviation of a pair's distance less what a camera does to it: by place and by direction.

    Parameters
    ----------
    place : (frames, 2, 2), all known
    waves : harmonics of the direction
    """
    gap, middle = place[:, 0] - place[:, 1], place.mean(axis=1)
    angle = np.arctan2(gap[:, 1], gap[:, 0])
    distance = np.hypot(*gap.T)
    basis = np.column_stack(
        [np.ones(len(gap)), middle - middle.mean(axis=0), *(f(k * angle) for k in waves for f in (np.cos, np.sin))]
    )
    rest = distance - basis @ np.linalg.lstsq(basis, distance, rcond=None)[0]
    return float(np.sqrt((rest**2).sum() / max(len(rest) - basis.shape[1], 1)))


def places(dots: Dots, seen_px: Array | None, first: int) -> Array | str:
    """(frames, 2, 2) that towline gives from a frame on; or the line with which it ends."""
    with tempfile.TemporaryDirectory() as name:
        run = dots.run(Path(name), seen_px, first)
        mapping = fit_run_datum(run, clip_info(run.source_path)).mapping
        try:
            table = track(run, read_frames(run.source_path, run.file.source.span_s), mapping).table
        except TowlineError as error:
            return str(error).rpartition("/")[2]
    return _placed(table, ("m0", "m1"))


def _placed(table: pd.DataFrame, names: Sequence[str]) -> Array:
    seen = table.pivot(index="frame", columns="marker", values=["u_px", "v_px"])
    return np.stack([seen[[("u_px", m), ("v_px", m)]].to_numpy() for m in names], axis=1)


def rows(dots: Dots, starts: Sequence[int], seeds: Sequence[bool]) -> Iterator[str]:
    """A line for every start, towline and the peers on the same frames."""
    pictures = [f.luma.copy() for f in read_frames(SHARED / dots.video) if dots.first <= f.index <= dots.last]
    path = np.array([dots.start_px] * len(pictures), dtype=float)
    h, w = pictures[0].shape
    path[-1] = [[0, 0], [w, h]]  # they look at the whole picture
    known = {n: followed(peer, pictures, path, dots.size_px, True)[0] for n, peer in present().items()}
    blobs = known["OpenCV blob"]
    for name, place in known.items():
        both = np.isfinite(place).all(axis=(1, 2))
        scatter = rigid_scatter(place[both], dots.waves)
        yield f"  {name:12s} from frame {dots.first}: both held {both.mean():6.2%}, scatter {scatter:.3f} px"
    for first in starts:
        for seeded in seeds:
            what = f"from frame {first}{', seeded' if seeded else ''}"
            ref = blobs[first - dots.first :]
            found = places(dots, np.nan_to_num(ref[0], nan=0.0) if seeded else None, first)
            yield f"  {'towline':12s} {what}: " + (found if isinstance(found, str) else _judged(found, ref, dots))


def _judged(place: Array, ref: Array, dots: Dots) -> str:
    count = min(len(place), len(ref))
    place, ref = place[:count], ref[:count]
    held = np.isfinite(place).all(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        right, turned = (
            (np.hypot(*np.moveaxis(place - other, -1, 0)) < RIGHT_PX).sum() for other in (ref, ref[:, ::-1])
        )
    both = held & np.isfinite(ref).all(axis=(1, 2))
    ours, theirs = (rigid_scatter(p[both], dots.waves) for p in (place, ref))
    return (
        f"both held {held.mean():6.2%}, at the blobs {right} of {2 * count}, at each other's {turned}; "
        f"scatter {ours:.3f} px, blobs' in the same frames {theirs:.3f}"
    )


def film() -> Iterator[str]:
    """The path-traced film: rms from its truth, towline and the peers."""
    folder = SHARED / "film"
    truth = pd.read_csv(folder / "truth.csv")
    names = ("bow", "stern")
    path = np.stack([truth[[f"{m}_u", f"{m}_v"]].to_numpy() for m in names], axis=1)
    run = read_run(folder)
    mapping = fit_run_datum(run, clip_info(run.source_path)).mapping
    frames = list(read_frames(run.source_path))
    answers = {"towline": _placed(track(run, frames, mapping).table, names)}
    pictures = [f.luma for f in frames]
    few = pictures[:FILM_FRAMES]
    answers |= {n: followed(peer, few, path[:FILM_FRAMES], FILM_SIZE_PX, False)[0] for n, peer in present().items()}
    for name, place in answers.items():
        away = place - path[: len(place)]
        held = np.isfinite(away).all(axis=(1, 2))
        near = np.hypot(*np.moveaxis(away, -1, 0)) < RIGHT_PX
        rms = [float(np.sqrt(np.mean(away[near[:, k], k] ** 2))) if near[:, k].any() else np.nan for k in range(2)]
        right = f"{near.mean():6.2%} of the places right"
        yield (
            f"  {name:12s} {len(place)} frames: both held {held.mean():6.2%}, {right}, rms of these "
            f"{rms[0]:.4f} (bow), {rms[1]:.4f} px (stern)"
        )


def real() -> Iterator[str]:
    """The lines of all recordings that are there."""
    if not SHARED.is_dir():
        yield f"real recordings: left out, no folder {SHARED.name} beside the checkout"
        return
    yield "a disc that rolls, two dark dots (real/rolling_cylinder)"
    yield from rows(ROLLING, STARTS, (True, False))
    yield "a disc that turns about a pivot, two dark dots (real/pivot_video)"
    yield from rows(PIVOT, (PIVOT.first,), (True,))
    yield "a path-traced tow, two lights (film)"
    yield from film()
