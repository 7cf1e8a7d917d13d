"""Two cameras over one tow, not synchronised: clocks, motion, hand-over, roll and heave against truth.

    python benchmarks/two_cameras.py [OUT] [--tows 60] [--seed 0] [--only level rolling rendered films flash]

Writes a table to standard output; benchmarks/two_cameras.txt is a run of it. The tows are pixel tracks of known noise through two
cameras of OpenCV's (two_cameras_cases.py); the films are rendered, coded and tracked, into OUT: random tows
(two_cameras_rendered.py), and those of the sample recordings (two_cameras_films.py).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from two_cameras_cases import MARKS, NAMES, Case, random_case
from two_cameras_films import film_two
from two_cameras_flash import flash_rows, tied_rows
from two_cameras_rendered import rendered, tracked

from towline.geometry.cameras.flash import Lit
from towline.geometry.cameras.motion import AFLOAT, JointMotion, joint_motion
from towline.geometry.cameras.view import between
from towline.geometry.motion import run_datum
from towline.geometry.poses import poses_from_tracks
from towline.record.run import cameras_of

LEVEL, ROLLING = ("bow", "stern"), ("bow", "stern", "mast", "side")
PULLS_PX_RAD = (0.0, 0.2, 0.4)
BOTH = "+".join(NAMES)
STEP_S = 0.5
ENDS_S = (18.0, 22.0)
SAME_S = 1e-9
PARTS = ("level", "rolling", "rendered", "films", "flash")
DEGREE = float(np.degrees(1.0))
ROOT = Path(__file__).resolve().parent.parent
FILMS = (("x1446", 1.337, 8e-5), ("x1548", -1.604, 1e-4), ("x1649", -0.812, -1e-4), ("x1751", 1.93, -6e-5))
POSES = (
    {"place_m": [-7.2, -1.6, -3.4], "look_at_m": [-2.5, 0.05, 0.15]},
    {"place_m": [-7.0, 1.9, -3.0], "look_at_m": [-2.5, -0.05, 0.15]},
)


def joined(case: Case, lit: tuple[list[Lit], list[Lit]] = ((), ())) -> JointMotion:  # pyright: ignore
    """What the product makes of a case; ``lit``: flashes that each camera saw."""
    poses, mappings = [], []
    for view, tracks in zip(cameras_of(case.run), case.tracks, strict=True):
        fit = run_datum(view, None)
        mappings.append(fit.mapping)
        poses.append(poses_from_tracks(view, tracks, fit.mapping, fit, None, pulled=True))
    return joint_motion(case.run, poses, mappings, lit)


def quoted(case: Case, t_s: np.ndarray, marks: tuple[str, ...]) -> np.ndarray:
    """The truth of the point that the product quotes: the LCG at the depth of the lowest mark, (n, 6)."""
    pose = case.truth(t_s)
    down = max(MARKS[name][2] for name in marks) - case.axis_m
    moved = Rotation.from_euler("ZYX", pose[:, [2, 5, 4]]).as_matrix()[:, :, 2] * down
    pose[:, :2] += moved[:, :2]
    pose[:, 3] += moved[:, 2] - down
    return pose


def stated(motion, lag: np.ndarray) -> np.ndarray:
    """Standard deviations (n, 2) of y and heading: frame, common, and what pulls and lags leave."""
    slow = np.sqrt((lag[:, :, :2] ** 2).sum(axis=0))
    own, common = (motion[[f"{kind}_y_cg_m", f"{kind}_beta_rad"]].to_numpy() for kind in ("sigma", "common"))
    return np.sqrt(own**2 + common**2 + slow**2)


def middles(motion) -> list[int]:
    """A row in the middle of what each camera sees alone, and of what both see."""
    found = [np.flatnonzero(motion["camera"] == name) for name in (*NAMES, BOTH)]
    return [int(rows[len(rows) // 2]) for rows in found if len(rows)]


def hand_overs(one: JointMotion, error: np.ndarray) -> list[np.ndarray]:
    """Steps of the error of y and heading where a camera begins or ends, over their stated standard deviation."""
    modes = np.concatenate([one.common, one.lag])[:, :, :2]
    times, names = one.motion["t_s"].to_numpy(), one.motion["camera"].to_numpy()
    steps = []
    for here, other in ((NAMES[0], BOTH), (BOTH, NAMES[1])):
        went = np.flatnonzero((names[:-1] == here) & (names[1:] == other))
        if not len(went):
            continue
        edge = times[went[-1] + 1]
        before = np.flatnonzero((names == here) & (times < edge) & (times > edge - STEP_S))
        after = np.flatnonzero((names == other) & (times >= edge) & (times < edge + STEP_S))
        if len(before) < 5 or len(after) < 5:
            continue
        step = error[after].mean(axis=0) - error[before].mean(axis=0)
        drawn = modes[:, after].mean(axis=1) - modes[:, before].mean(axis=1)
        steps.append(step / np.sqrt((drawn**2).sum(axis=0) + mean_noise(one, before) + mean_noise(one, after)))
    return steps


def mean_noise(one: JointMotion, rows: np.ndarray) -> np.ndarray:
    """Variance (2,) of a mean over rows of y and heading: rows between the second camera's frames share the noise of those."""
    first, second, whole = one.match.first, one.match.second, one.joined.covariance[rows]
    own_s = one.joined.t_s[rows]
    at_s = one.match.clock.second(own_s)
    frames = np.searchsorted(first.t_s, own_s - SAME_S).clip(0, len(first.t_s) - 1)
    filmed = np.abs(first.t_s[frames] - own_s) < SAME_S
    seen = filmed & first.seen[frames]
    of_first = np.zeros_like(whole)
    of_first[seen] = whole[seen] @ np.linalg.inv(first.covariance[frames[seen]])
    of_second = np.eye(whole.shape[1]) - of_first
    # the rows that the first camera did not film are the second one's frames
    beside, alone = between(second, at_s), np.searchsorted(second.t_s, at_s - second.step_s / 4)
    frame = np.where(filmed[:, None], beside.frame, alone.clip(0, len(second.t_s) - 1)[:, None])
    weight = np.where(filmed[:, None], beside.weight, np.eye(1, beside.weight.shape[1]))
    gain = np.zeros((len(second.t_s), *whole.shape[1:]))
    np.add.at(gain, frame, weight[..., None, None] * of_second[:, None])
    used = gain.any(axis=(1, 2))
    own = of_first[seen] @ first.covariance[frames[seen]] @ of_first[seen].transpose(0, 2, 1)
    others = gain[used] @ second.covariance[used] @ gain[used].transpose(0, 2, 1)
    return np.diag(own.sum(axis=0) + others.sum(axis=0))[1:3] / len(rows) ** 2


def rms(values) -> float:
    """Root mean square of numbers."""
    return float(np.sqrt(np.mean(np.square(values))))


def level(tows: int, first: int) -> None:
    """Models that neither roll nor heave: clock, y, heading, hand-over."""
    print(
        f"\n== level: {tows} tows of 60 s, two marks, 0.05 px, picks 0.3 px, lens, heights and places wrong as stated"
    )
    groups(tows, first + 1000, LEVEL)


def rolling(tows: int, first: int) -> None:
    """Models that roll by 0.5 to 2 degrees, heave by 1 to 6 mm and pitch."""
    print(f"\n== rolling: {tows} tows of 60 s, four marks (one on a mast, one aside), the rest as above")
    groups(tows, first + 2000, ROLLING)


def rendered_tows(tows: int, out: Path, first: int) -> None:
    """Half of them level with two marks, half rolling with four, all through pictures and H.264."""
    print(f"\n== rendered: {tows} tows of 30 to 45 s, two films of 1280x720 each, H.264 crf 17 to 28, tracked")
    header()
    for marks, seed in ((LEVEL, first + 5000), (ROLLING, first + 6000)):
        cases = [rendered(seed + k, marks == ROLLING, out) for k in range(tows // 2)]
        show("rolling, four marks" if marks == ROLLING else "level, two marks", tally(cases, marks))


def header() -> None:
    """Of the rows that ``show`` writes."""
    print(
        f"{'':22}{'offset rms':>11}{'within 1 ms':>13}{'most':>7}{'stated':>8}{'z':>6}{'rate z':>8}{'y rms':>8}{'z':>6}"
        f"{'heading':>10}{'z':>6}{'hand-over z':>13}{'beyond 2':>11}{'disagree':>10}{'s each':>8}"
    )


def groups(tows: int, seed: int, marks: tuple[str, ...]) -> None:
    """A third of the tows with each size of pulls, and all together."""
    header()
    every: dict[str, list] = {}
    for share, pull in enumerate(PULLS_PX_RAD):
        some = range(share * tows // len(PULLS_PX_RAD), (share + 1) * tows // len(PULLS_PX_RAD))
        one = tally([random_case(seed + k, marks, rolls=marks == ROLLING, pull_px_rad=pull) for k in some], marks)
        every = {key: every.get(key, []) + values for key, values in one.items()}
        show(f"pulled by {pull} px/rad", one)
    show("all", every)


def tally(cases: list[Case], marks: tuple[str, ...]) -> dict[str, list]:
    """Errors and standardised errors of cases."""
    found: dict[str, list] = {
        key: [] for key in ("offset", "sd", "rate_z", "error", "z", "steps", "apart", "seconds", "afloat", "silent")
    }
    for case in cases:
        began = time.perf_counter()
        one = joined(case)
        found["seconds"].append(time.perf_counter() - began)
        clock, motion = one.match.clock, one.motion
        found["offset"].append(clock.offset_s - case.offset_s)
        found["sd"].append(clock.offset_sd_s)
        found["rate_z"].append((clock.rate - case.rate) / clock.rate_sd)
        truth = quoted(case, motion["t_s"].to_numpy(), marks)
        error = motion[["y_cg_m", "beta_rad"]].to_numpy() - truth[:, 1:3]
        at = middles(motion)
        found["error"] += list(error[at])
        found["z"] += list((error / stated(motion, one.lag))[at])
        found["steps"] += hand_overs(one, error)
        found["apart"].append(not one.match.agree)
        if marks == ROLLING:
            found["silent"].append(not one.rolls)
        if marks == ROLLING and AFLOAT[0] in motion:
            both = (motion["camera"] == BOTH).to_numpy()
            off = (motion[list(AFLOAT)].to_numpy() - truth[:, 3:])[both]
            own, common = (motion[[f"{kind}_{n}" for n in AFLOAT]].to_numpy()[both] for kind in ("sigma", "common"))
            slow = np.sqrt((one.joined.modes[: one.joined.slow, both, 3:] ** 2).sum(axis=0))
            whole = np.sqrt(own**2 + common**2 + slow**2)
            middle = len(off) // 2
            found["afloat"].append((off.std(axis=0), rms_of(off), off[middle] / whole[middle], rms_of(own)))
    return found


def show(name: str, found: dict[str, list]) -> None:
    """A row, and of tows that roll three more."""
    offset, sd = np.array(found["offset"]), np.array(found["sd"])
    (y, heading), (y_z, heading_z) = np.array(found["error"]).T, np.array(found["z"]).T
    cells = [
        f"{1e3 * rms(offset):8.2f} ms",
        f"{int((np.abs(offset) < 1e-3).sum()):7d} of {len(offset):2d}",
        f"{1e3 * np.abs(offset).max():7.2f}{1e3 * rms(sd):8.2f}{rms(offset / sd):6.2f}{rms(found['rate_z']):8.2f}",
        f"{1e3 * rms(y):5.2f} mm{rms(y_z):6.2f}{np.degrees(rms(heading)):6.3f} deg{rms(heading_z):6.2f}",
        f"{rms(found['steps']):13.2f}{int((np.abs(found['steps']) > 2).sum()):4d} of {np.size(found['steps']):3d}",
        f"{sum(found['apart']):10d}{np.mean(found['seconds']):8.1f}",
    ]
    print(f"{name:22}{''.join(cells)}", flush=True)
    if not found["afloat"]:
        return
    varies, whole, z, frame = (np.array(part) for part in zip(*found["afloat"], strict=True))
    print(f"{'':22}rolling not noticed: {sum(found['silent'])} of {len(found['silent'])}")
    for k, (word, scale, unit) in enumerate((("heave", 1e3, "mm"), ("roll", DEGREE, "deg"), ("pitch", DEGREE, "deg"))):
        total, alone = (
            f"{scale * rms(part[:, k]):.3f} {unit} rms, at most {scale * part[:, k].max():.3f}"
            for part in (whole, varies)
        )
        print(
            f"{'':22}{word:6}{total}, z {rms(z[:, k]):.2f}; as it varies {alone}, a frame's stated {scale * rms(frame[:, k]):.3f}"
        )


def rms_of(values: np.ndarray) -> np.ndarray:
    """Root mean square down the rows."""
    return np.sqrt((values**2).mean(axis=0))


def films(out: Path) -> None:
    """Rendered before two cameras, H.264 crf 20, tracked by the stages of ``towline track``, and joined."""
    print("\n== films: the MARINER tows before two cameras, 640x480, 30 and 25 frames/s, H.264 crf 20, tracked")
    print(
        f"{'':8}{'offset':>9}{'stated':>8}{'rate':>10}{'stated':>9}{'y rms':>10}{'z':>6}{'heading':>11}{'z':>6}   "
        "hand-overs (sd)  said"
    )
    for number, (name, offset_s, rate) in enumerate(FILMS):
        scenario = ROOT / "sample_videos" / "mariner" / name / "scenario.toml"
        seed = 100 + 10 * number
        made = film_two(scenario, out / name, POSES, ENDS_S, (30.0, 25.0), offset_s, rate, seed, (640, 480))
        found = joined(tracked(made, offset_s, rate, 0.0))
        motion, clock = found.motion, found.match.clock
        seen = (motion["status"] == "measured").to_numpy()
        truth = made.truth(np.clip(motion["t_s"], made.motion["t_s"].iloc[0], made.motion["t_s"].iloc[-1]))
        error = motion[["y_cg_m", "beta_rad"]].to_numpy() - truth[:, 1:3]
        y, heading = rms_of(error[seen])
        y_z, heading_z = rms_of((error / stated(motion, found.lag))[seen])
        steps = " ".join(f"{v:+.1f}" for v in np.ravel(hand_overs(found, error)))
        cells = [
            f"{1e3 * (clock.offset_s - offset_s):+6.2f} ms{1e3 * clock.offset_sd_s:8.2f}",
            f"{clock.rate - rate:+10.1e}{clock.rate_sd:9.1e}",
            f"{1e3 * y:7.2f} mm{y_z:6.2f}{np.degrees(heading):7.4f} deg{heading_z:6.2f}",
            f"   {steps:16} {'agree' if found.match.agree else 'do not agree'}",
        ]
        print(f"{name:8}{''.join(cells)}", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", nargs="?", type=Path, default=Path(tempfile.gettempdir()) / "towline-two-cameras")
    parser.add_argument("--tows", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0, help="added to the seed of every random tow")
    parser.add_argument(
        "--only",
        nargs="+",
        choices=PARTS,
        default=list(PARTS),
    )
    given = parser.parse_args()
    if "level" in given.only:
        level(given.tows, given.seed)
    if "rolling" in given.only:
        rolling(given.tows, given.seed)
    if "rendered" in given.only:
        rendered_tows(given.tows, given.out, given.seed)
    if "films" in given.only:
        films(given.out)
    if "flash" in given.only:
        flash_rows(200, given.seed + 41)
        pulls = [PULLS_PX_RAD[k % len(PULLS_PX_RAD)] for k in range(given.tows // 2)]
        tied_rows(
            [random_case(given.seed + 100 + k, LEVEL, pull_px_rad=pull) for k, pull in enumerate(pulls)],
            joined,
            given.seed + 30,
        )


if __name__ == "__main__":
    main()
