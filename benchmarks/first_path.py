"""The whole path on the sample videos: errors against their truth, and speed as a ratio to decoding alone.

    python benchmarks/first_path.py

Prints a table; the figures of README.md and docs/how-well.md come from it.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from towline.diagnose import motion_error
from towline.geometry import motion_from_tracks, run_datum
from towline.pipeline.analysis import Batch, fit_steady_batch, identify_batch
from towline.pipeline.stages import RunMotion, read_true_motion
from towline.record import read_run, read_tracks
from towline.vision import clip_info, read_frames, track
from towline.vision.recording.codecs import losses

SAMPLES = Path(__file__).resolve().parent.parent / "sample_videos"
GROUPS = {
    "mariner": ("x1446", "x1548", "x1649", "x1751"),
    "leander_steady": ("hole6", "hole5", "hole4", "hole3"),
}


def main() -> None:
    """Measure and print."""
    print(
        f"{'run':22} {'pixel':>7} {'z std':>6} {'y_CG':>8} {'beta':>8} {'alpha':>8} {'track':>8} {'decode':>8} {'ratio':>6}"
    )
    print(f"{'':22} {'px rms':>7} {'':>6} {'mm':>8} {'deg':>8} {'deg':>8} {'frame/s':>8} {'frame/s':>8}")
    for group, names in GROUPS.items():
        runs = [_row(SAMPLES / group / name) for name in names]
        batch = Batch(runs, {})
        if group == "mariner":
            began = time.perf_counter()
            result = identify_batch(batch).result
            seconds = time.perf_counter() - began
            print(f"\njoint fit of four runs, full equations: {seconds:.1f} s")
            for name, d in result.derivatives.items():
                assert d.true_value is not None
                error = 100 * (d.value / d.true_value - 1)
                z = (d.value - d.true_value) / d.std
                print(
                    f"  {name:16} {d.value:10.3f} +- {d.std:6.3f}  true {d.true_value:9.3f}  error {error:+.2f} %  {z:+.1f} std"
                )
            print()
        else:
            steady = fit_steady_batch(batch)
            low, high = steady.x_v_interval_m
            print(
                f"\nX_v {steady.x_v_m.value:.4f} +- {steady.x_v_m.std:.4f} m, 95 % {low:.4f} .. {high:.4f}, "
                f"true {steady.x_v_true_m}"
            )


def _row(folder: Path) -> RunMotion:
    run = read_run(folder)
    info = clip_info(run.source_path)
    datum = run_datum(run, (info.width_px, info.height_px))
    began = time.process_time()
    frames = sum(1 for _ in read_frames(run.source_path))
    decode = frames / (time.process_time() - began)
    began = time.process_time()
    lossy, linked = losses(info.codec)
    found = track(run, read_frames(run.source_path), datum.mapping, lossy=lossy, linked=linked)
    follow = frames / (time.process_time() - began)
    truth = read_tracks(folder / "truth" / "tracks.csv")
    both = found.table.merge(truth, on=["frame", "marker"], suffixes=("", "_true"))
    both = both[both["status"] == "measured"]
    gap = both[["u_px", "v_px"]].to_numpy() - both[["u_px_true", "v_px_true"]].to_numpy()
    score = gap / both[["sigma_u_px", "sigma_v_px"]].to_numpy()
    made = motion_from_tracks(run, found.table, datum)
    reference = read_true_motion(run)
    assert reference is not None
    error = motion_error(made.motion, reference)
    print(
        f"{run.name:22} {np.sqrt((gap**2).mean()):7.3f} {score.std():6.2f} {1e3 * error.y_cg_m:8.2f} {error.beta_deg:8.4f} "
        f"{error.alpha_deg:8.4f} {follow:8.0f} {decode:8.0f} {follow / decode:6.2f}"
    )
    return RunMotion(run, made.motion, made.common, made.camera, found.table, made.lag)


if __name__ == "__main__":
    main()
