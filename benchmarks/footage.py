"""Recordings as people have them: random scenes over photographs.

OpenCV's blob detector and trackpy see the same frames of some of the scenes; then come real recordings, where they are there.

usage: footage.py [--scenes N] [--first SEED] [--workers N] [--peers SCENES] [--no-real]
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from footage_peers import followed, present, why_absent
from footage_real import real
from footage_scenes import FRAMES, Scene, scene
from numpy.typing import NDArray

from towline.pipeline.stages import fit_run_datum
from towline.record.errors import TowlineError
from towline.vision import ClipInfo, track
from towline.vision.recording import Frame

Array = NDArray[Any]

RIGHT_PX = 1.0
"""A place nearer to its mark than this, or a fifth of its diameter, is that mark's."""


LEAST_HELD = 0.98
"""Of its frames, in which a scene's marks are held."""
CLASSES: dict[str, tuple[float, ...]] = {
    "diameter_px": (0.8, 2.0, 4.0, 8.0, 16.0, 30.1),
    "uneven": (0.0, 0.5, 1.0, 2.0, 4.0, 100.0),
}
"""By which the table tells the scenes apart: ``uneven`` is the ground's own scatter over the noise."""


def ours(one: Scene, frames: list[Frame]) -> dict[str, Any]:
    """What towline makes of a scene."""
    n, m = one.place_px.shape[:2]
    with tempfile.TemporaryDirectory() as folder:
        run = one.run(Path(folder))
        mapping = fit_run_datum(run, ClipInfo(*one.size_px, 30.0, None, "ffv1")).mapping
        began = time.process_time()
        try:
            table = track(run, frames, mapping, lossy=False).table
        except TowlineError as error:
            return {
                "error": str(error).rpartition("/")[2],
                "held": 0.0,
                "wrong": 0,
                "z": [],
                "s": time.process_time() - began,
            }
        spent = time.process_time() - began
    seen = table.pivot(index="frame", columns="marker", values=["u_px", "v_px", "sigma_u_px", "sigma_v_px"])
    names = [f"m{i}" for i in range(m)]
    place, sigma = (
        np.stack([seen[[(a, k), (b, k)]].to_numpy() for k in names], axis=1)
        for a, b in (("u_px", "v_px"), ("sigma_u_px", "sigma_v_px"))
    )
    gap, right = _right(place, one.place_px[seen.index.to_numpy()], one)
    z = (gap / sigma)[right]
    reasons = table[table.status == "lost"].reason.value_counts().to_dict()
    return {
        "held": float(right.sum() / (n * m)),
        "wrong": int((np.isfinite(place).all(axis=2) & ~right).sum()),
        "z": z[np.isfinite(z)].ravel().tolist(),
        "rms": float(np.sqrt(np.mean(gap[right] ** 2))) if right.any() else np.nan,
        "s": spent,
        "reasons": reasons,
    }


def _right(place: Array, truth: Array, one: Scene) -> tuple[Array, Array]:
    """Errors, and which places are near enough to be their mark's."""
    gap = place - truth
    with np.errstate(invalid="ignore"):
        return gap, np.hypot(gap[..., 0], gap[..., 1]) < max(RIGHT_PX, 0.2 * one.diameter_px)


def theirs(one: Scene, frames: list[Frame]) -> dict[str, dict[str, Any]]:
    """What the peers make of it, who are told where the marks are in the first frame."""
    size = float(np.hypot(one.diameter_px, 2.355 * one.blur_px))
    answer = {}
    for name, peer in present().items():
        place, spent = followed(peer, [f.luma for f in frames], one.place_px, size, one.contrast_dn < 0)
        gap, right = _right(place, one.place_px, one)
        answer[name] = {
            "held": float(right.mean()),
            "wrong": int((np.isfinite(place).all(axis=2) & ~right).sum()),
            "rms": float(np.sqrt(np.mean(gap[right] ** 2))) if right.any() else np.nan,
            "s": spent,
        }
    return answer


SAID = ("seed", "size_px", "diameter_px", "blur_px", "contrast_dn", "noise_dn", "deck", "seeded", "scatter_dn")
"""Of a scene, for the lines of those that are not held."""


def judged(seed: int, with_peers: bool) -> dict[str, Any]:
    """A scene and what was made of it."""
    drawn = scene(seed)
    about = {key: getattr(drawn, key) for key in SAID}
    uneven = float(np.sqrt(max(drawn.scatter_dn**2 - drawn.noise_dn**2, 0.0)) / drawn.noise_dn)
    frames = list(drawn.frames())
    return {
        **about,
        "uneven": uneven,
        "count": drawn.place_px.shape[1],
        "bound": float(drawn.bound_px.max()),
        **ours(drawn, frames),
        "peers": theirs(drawn, frames) if with_peers else {},
    }


def row(name: str, found: list[dict[str, Any]]) -> str:
    """One method's line."""
    held = np.array([f["held"] for f in found])
    marks = np.array([FRAMES * f["count"] for f in found])
    return (
        f"{name:13s} {len(found):6d} {np.mean(held >= LEAST_HELD):9.1%} {np.mean(held == 0):7.1%} "
        f"{(held * marks).sum() / marks.sum():7.2%} {sum(f['wrong'] for f in found):6d} of {marks.sum():7d} "
        f"{np.nanmedian([f.get('rms', np.nan) / f['bound'] for f in found]):7.2f} "
        f"{1000 * sum(f['s'] for f in found) / len(found) / FRAMES:9.1f}"
    )


HEAD = "method        scenes  held 98%   never   right  wrong   of   marks  /bound  ms/frame"


def by_class(found: list[dict[str, Any]]) -> list[str]:
    """z and what is held, for the scenes of one kind each."""
    lines = []
    for key, edges in CLASSES.items():
        for low, high in itertools.pairwise(edges):
            some = [f for f in found if low <= f[key] < high]
            z = np.concatenate([f["z"] for f in some]) if some else np.zeros(0)
            if len(z):
                held = np.mean([f["held"] >= LEAST_HELD for f in some])
                lines.append(
                    f"{key:12s} {low:5.1f}-{high:5.1f} {len(some):6d} {held:9.1%}   z {_rms(z):5.2f} {_middle(z):5.2f}"
                )
    return lines


def _rms(z: Array) -> float:
    return float(np.sqrt(np.mean(z**2)))


def _middle(z: Array) -> float:
    """Median |z| over a Gaussian's."""
    return float(np.median(np.abs(z)) / 0.6745)


def table(found: list[dict[str, Any]]) -> str:
    """What came of the scenes together, and those that are not held throughout."""
    z = np.concatenate([f["z"] for f in found])
    beside = [f for f in found if f["peers"]]
    lines = [HEAD, row("towline", found)]
    if beside:
        lines += ["of these, those that the peers saw as well:", row("towline", beside)]
        lines += [
            row(name, [{"count": f["count"], "bound": f["bound"], **f["peers"][name]} for f in beside])
            for name in beside[0]["peers"]
        ]
    lines += [why_absent()] if why_absent() else []
    lines += [
        "held 98%: scenes whose marks are right in so many frames; /bound: median over the scenes of rms error over the",
        "largest Cramer-Rao bound of a frame for white noise, the ground being even and the disc known",
        "",
        f"z: rms {_rms(z):.2f}, median |z| over a Gaussian's {_middle(z):.2f}",
        *by_class(found),
        "",
        "not held, or wrong somewhere:",
    ]
    for f in sorted(found, key=lambda f: f["held"]):
        if f["held"] < LEAST_HELD or f["wrong"]:
            w, h = f["size_px"]
            lines.append(
                f"{f['seed']:5d} {w}x{h} D {f['diameter_px']:5.1f} blur {f['blur_px']:.1f} contrast {f['contrast_dn']:6.1f} "
                f"noise {f['noise_dn']:.1f} scatter {f['scatter_dn']:4.1f} {f['deck']:5s} {f['count']} marks"
                f"{', seeded' if f['seeded'] else ''}: held {f['held']:.2f}, wrong {f['wrong']}; "
                f"{f.get('error', f.get('reasons'))!s:.80}"
            )
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--peers", type=int, default=100, help="scenes that the peers see as well")
    parser.add_argument("--no-real", action="store_true", help="leave the real recordings out")
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.scenes)
    with ProcessPoolExecutor(given.workers) as pool:
        print(table(list(pool.map(judged, seeds, [k - given.first < given.peers for k in seeds], chunksize=4))))
    if not given.no_real:
        print()
        for line in real():
            print(line, flush=True)


if __name__ == "__main__":
    main()
