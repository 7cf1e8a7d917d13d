"""What two cameras say of each other, as a result file and in words."""

from __future__ import annotations

import numpy as np

from ...record.cameras_file import CamerasFile, Difference
from ...record.results import Measured
from ...record.run import Run
from .flash import Tie
from .join import BOTH
from .match import Match
from .motion import AFLOAT, CAMERA_COLUMN, JointMotion

NAMES = ("x_m", "y_m", "heading_rad", *AFLOAT)
SPOKEN = {
    "heading_rad": "heading",
    "x_m": "x",
    "y_m": "y",
    "heave_m": "heave",
    "roll_rad": "roll",
    "pitch_rad": "pitch",
}


def cameras_file(run: Run, found: JointMotion, tool: str, inputs: dict[str, str]) -> CamerasFile:
    """The result file of a joint motion.

    Parameters
    ----------
    run : with two ``[[camera]]``
    found : its motion
    tool, inputs : written into the file
    """
    match = found.match
    names = run.file.cameras[0].name, run.file.cameras[1].name
    rows = found.motion[CAMERA_COLUMN].replace("", "lost").value_counts()
    return CamerasFile(
        schema="towline/cameras",
        tool=tool,
        inputs=inputs,
        cameras=names,
        offset_s=Measured(value=match.clock.offset_s, std=match.clock.offset_sd_s),
        rate=Measured(value=match.clock.rate, std=match.clock.rate_sd),
        offset_stated=run.file.cameras[1].offset_s is not None,
        flash_s=None if found.flash is None else Measured(value=found.flash.known.offset_s, std=found.flash.known.sd_s),
        flash_used=found.flash is not None and found.flash.agrees,
        together=len(match.rows),
        rows={str(name): int(count) for name, count in rows.items()},
        agree=match.agree,
        probability=match.probability,
        chi_square=match.chi_square,
        degrees=match.degrees,
        widened=match.widened,
        inflation=match.inflation,
        differences=_differences(match),
        rolls=None if found.afloat is None else found.rolls,
        afloat=_afloat(found),
        sentences=joint_sentences(run, found),
    )


def _differences(match: Match) -> dict[str, Difference]:
    """By what they differ, by name."""
    return {
        name: Difference(mean=float(match.found[k]), expected=float(match.expected[k]), left=float(match.left[k]))
        for k, name in enumerate(NAMES[: len(match.found)])
    }


def _afloat(found: JointMotion) -> dict[str, Measured]:
    """What heave, roll and pitch vary by where both cameras see the model, and what a frame tells of them."""
    if found.afloat is None:
        return {}
    both = found.afloat.source == BOTH
    varies = found.afloat.pose[both, 3:].std(axis=0)
    sd = np.sqrt(np.einsum("ndd->nd", found.afloat.covariance[both])[:, 3:].mean(axis=0))
    return {name: Measured(value=float(v), std=float(s)) for name, v, s in zip(AFLOAT, varies, sd, strict=True)}


def joint_sentences(run: Run, found: JointMotion) -> list[str]:
    """What the cameras say of each other, in words, the clock first.

    Parameters
    ----------
    run : with two ``[[camera]]``
    found : its motion
    """
    names = run.file.cameras[0].name, run.file.cameras[1].name
    match, clock = found.match, found.match.clock
    differences, afloat = _differences(match), _afloat(found)
    said = [
        f"{names[1]}'s clock shows 0 when {names[0]}'s shows {clock.offset_s:+.4f} +- {clock.offset_sd_s:.4f} s, and "
        f"runs {1e6 * abs(clock.rate):.0f} +- {1e6 * clock.rate_sd:.0f} millionths {'slow' if clock.rate > 0 else 'fast'}",
        f"both see the model in {len(match.rows)} frames: "
        + "; ".join(_difference(*item) for item in differences.items()),
    ]
    if found.flash is not None:
        said.append(_flash(names, found.flash))
    if match.agree:
        said.append(
            f"the two cameras agree: what is stated of datum, lens and marks lets them differ so (p {match.probability:.2g})"
        )
    else:
        worst = max(differences, key=lambda name: abs(differences[name].mean) / max(differences[name].expected, 1e-12))
        said.append(
            f"the two cameras do not agree (p {match.probability:.2g}), most in {SPOKEN[worst]}: a datum point, a lens, a depth_m "
            "or a body_m is off by more than is stated; check each camera by itself; what they have in common is taken as "
            f"{match.widened:.1f} times as unsure"
        )
    if match.inflation > 1.0:
        said.append(
            f"what differs from frame to frame lasts: sums over frames vary {np.sqrt(match.inflation):.1f} times as much as single "
            "frames let expect, and the clock's uncertainty is as much larger"
        )
    if afloat:
        parts = ", ".join(_varies(*item) for item in afloat.items())
        what = (
            "the model rolls, heaves or pitches: y and heading are told with that taken out"
            if found.rolls
            else ("the model does not roll, heave or pitch by more than noise")
        )
        said.append(f"{what} ({parts})")
    elif found.untold:
        said.append(found.untold)
    return said


def _flash(names: tuple[str, str], tie: Tie) -> str:
    many = "a flash" if tie.flashes == 1 else f"{tie.flashes} flashes"
    said = f"{many} that both cameras saw: {names[0]}'s clock shows {tie.known.offset_s:+.4f} +- {tie.known.sd_s:.4f} s more"
    if tie.by_motion is None:
        return f"{said}; the motion does not tell the clock, the flash alone does"
    motion = f"by the motion {tie.by_motion[0]:+.4f} +- {tie.by_motion[1]:.4f} s"
    if tie.agrees:
        return f"{said}, {motion}: they agree ({tie.apart_sd:.1f} standard deviations), both count by their weight"
    return (
        f"{said}, {motion}: they do not agree ({tie.apart_sd:.1f} standard deviations), and the motion's is taken; was it one "
        "flash, and are both exposure_s right?"
    )


def _spoken(name: str) -> tuple[str, float, str]:
    scale, unit = (float(np.degrees(1.0)), "deg") if name.endswith("_rad") else (1e3, "mm")
    return SPOKEN[name], scale, unit


def _varies(name: str, one: Measured) -> str:
    word, scale, unit = _spoken(name)
    return f"{word} varies by {scale * one.value:.3f} {unit} rms, a frame tells it to {scale * one.std:.3f}"


def _difference(name: str, one: Difference) -> str:
    word, scale, unit = _spoken(name)
    mean, expected, left = (scale * value for value in (one.mean, one.expected, one.left))
    return f"{word} differs by {mean:+.3f} {unit} (stated {expected:.3f}, left {left:.3f})"


__all__ = ["NAMES", "cameras_file", "joint_sentences"]
