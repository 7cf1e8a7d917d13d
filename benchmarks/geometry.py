"""Geometry against truth: intervals over random cameras, planted faults, the differentiable chain.

    python benchmarks/geometry.py [--cameras 200] [--only intervals faults chain]

Writes a table to standard output; benchmarks/geometry.txt is a run of it.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator

import numpy as np
from geometry_cases import FAULTS, MARK_PX, Case, film, random_scene
from scipy.stats import beta as beta_distribution

from towline.geometry import fit_datum, motion_from_tracks, run_datum
from towline.geometry.checks.check import check_geometry
from towline.geometry.poses import poses_from_tracks

NAMES = ("y_CG", "beta", "alpha")
FRAMES, CHECK_FRAMES = 60, 300
CHANGES_BY = 3.0
KINDS = {"k1": "lens"}


def errors(case: Case) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Error of y_CG, beta, alpha (n, 3), and their frame and common standard deviations."""
    motion = motion_from_tracks(case.run, case.tracks, run_datum(case.run, None)).motion
    keys = ("y_cg_m", "beta_rad", "alpha_rad")
    own, common = (motion[[f"{kind}_{key}" for key in keys]].to_numpy() for kind in ("sigma", "common"))
    return motion[list(keys)].to_numpy() - case.motion, own, common


def intervals(cameras: int) -> None:
    """Standardised errors: both parts together, the frame part alone, the common part alone."""
    both, frame, common = [], [], []
    middle = FRAMES // 2
    for seed in range(cameras):
        scene = random_scene(np.random.default_rng(seed), FRAMES)
        noisy, own, shared = errors(film(scene, np.random.default_rng([seed, 1]), unsure=True))
        still, _, _ = errors(film(scene, np.random.default_rng([seed, 1]), noise=(0.0, 0.3), unsure=True))
        both.append(noisy[middle] / np.hypot(own, shared)[middle])
        frame.append((noisy - still) / own)
        common.append(still[middle] / shared[middle])
    print(f"\n== intervals: {cameras} cameras, marks {MARK_PX} px, picks 0.3 px, lens, heights and places unsure")
    print(f"{'':14}" + "".join(f"{name + ' std':>12}{'in 95 %':>9}" for name in NAMES))
    for name, parts in (
        ("both", np.array(both)),
        ("frame part", np.concatenate(frame)),
        ("common part", np.array(common)),
    ):
        cells = "".join(f"{parts[:, k].std():12.3f}{100 * (np.abs(parts[:, k]) < 1.96).mean():9.1f}" for k in range(3))
        print(f"{name:14}{cells}")


def faults(cameras: int) -> None:
    """Each fault alone: named or not, where it changes y_CG by more than three standard deviations."""
    print(
        f"\n== faults: {cameras} cameras each, ten datum points, {CHECK_FRAMES} frames; counted where y_CG changes by 3 sigma"
    )
    print("(line length and slack line change no y_CG: all are counted). Interval: 95 %, one-sided.")
    print(f"{'planted':16}{'counted':>9}{'named':>7}{'rate':>8}{'bound':>8}   named, of all")
    for planted in FAULTS:
        names: Counter[str] = Counter()
        counted = right = 0
        began = time.perf_counter()
        for case, healthy in _cases(cameras, planted):
            check = check_geometry([case.run], [case.tracks], run_datum(case.run, None))
            first = check.named[0].fault if check.named else None
            kind = "nothing" if first is None else first.kind.split(":")[0]
            names[kind] += 1
            ok = kind == (KINDS.get(planted, planted) or "nothing")
            if planted == "datum point" and first is not None:
                ok = ok and first.item == case.item
            if _matters(case, healthy):
                counted, right = counted + 1, right + ok
        spent = (time.perf_counter() - began) / cameras
        wrong = counted - right
        if planted:
            bound = f"{beta_distribution.ppf(0.05, right, wrong + 1):8.3f}"
        else:
            bound = f"{beta_distribution.ppf(0.95, wrong + 1, right):8.3f}"
        rate = (right if planted else wrong) / counted
        print(
            f"{planted or 'nothing (false)':16}{counted:9d}{right if planted else wrong:7d}{rate:8.3f}{bound}   {dict(names)}, "
            f"{spent:.2f} s each",
            flush=True,
        )


def _cases(cameras: int, planted: str) -> Iterator[tuple[Case, Case]]:
    for seed in range(cameras):
        scene = random_scene(np.random.default_rng(seed), CHECK_FRAMES)
        yield film(scene, np.random.default_rng([seed, 2]), planted), film(scene, np.random.default_rng([seed, 2]))


def _matters(case: Case, healthy: Case) -> bool:
    if case.planted in ("", "line length", "slack line"):
        return True
    _, own, common = errors(healthy)
    file = case.run.file
    naive = fit_datum(file.datum, file.camera, [m.depth_m for m in file.marker], robust=False)
    y = motion_from_tracks(case.run, case.tracks, naive).motion["y_cg_m"].to_numpy()
    return bool((np.abs(y - case.motion[:, 0]) / np.hypot(own, common)[:, 0]).max() > CHANGES_BY)


def chain(device: str) -> None:
    """kornia's chain: its Jacobians against finite differences and the hand-written ones, and the time of both."""
    from towline.geometry.chain import chain_motion

    print("\n== the differentiable chain, 1 minute at 30 Hz, two marks")
    scene = random_scene(np.random.default_rng(0), 1800)
    case = film(scene, np.random.default_rng(1), noise=(0.0, 0.0))
    fit = run_datum(case.run, None)
    began = time.perf_counter()
    motion_from_tracks(case.run, case.tracks, fit)
    hand = time.perf_counter() - began
    found = poses_from_tracks(case.run, case.tracks, fit.mapping)
    stated = chain_of(case, fit)
    weight = np.linalg.inv(found.covariance_m2)
    result = chain_motion(found.pixel_px, stated, weight, found.rigid.pose, device)
    began = time.perf_counter()
    result = chain_motion(found.pixel_px, stated, weight, found.rigid.pose, device)
    spent = time.perf_counter() - began
    step, some = 1e-3, slice(0, 40)
    worst = 0.0
    for mark in range(2):
        for axis in range(2):
            move = np.zeros((1, 2, 2))
            move[0, mark, axis] = step
            ends = [
                chain_motion(
                    found.pixel_px[some] + s * move, stated, weight[some], found.rigid.pose[some], device
                ).motion
                for s in (1, -1)
            ]
            slope = (ends[0] - ends[1]) / (2 * step)
            exact = result.per_px[some, :, mark, axis]
            worst = max(worst, np.abs(slope - exact).max() / np.abs(result.per_px[some]).max())
    print(f"largest difference from finite differences: {worst:.1e} of the largest derivative")
    each = 1e6 / len(found.t_s)
    print(
        f"whole motion with covariance, by hand: {each * hand:.1f} us a frame; kornia on {device}: {each * spent:.1f}"
    )


def chain_of(case: Case, fit):
    """The chain of a case."""
    from towline.geometry.chain import Chain

    file = case.run.file
    return Chain(
        fit.mapping.lens,
        fit.mapping.matrix,
        np.array([m.depth_m for m in file.marker]),
        np.array([m.body_m for m in file.marker]),
        np.array([file.tow.tow_point_m, 0.0]),
        np.array(file.tow.post_m),
    )


def main() -> None:
    """Run the sections asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cameras", type=int, default=200)
    parser.add_argument(
        "--only", nargs="+", choices=("intervals", "faults", "chain"), default=("intervals", "faults", "chain")
    )
    parser.add_argument("--device", default="cpu", help="of the chain")
    given = parser.parse_args()
    if "intervals" in given.only:
        intervals(given.cameras)
    if "faults" in given.only:
        faults(given.cameras)
    if "chain" in given.only:
        chain(given.device)


if __name__ == "__main__":
    main()
