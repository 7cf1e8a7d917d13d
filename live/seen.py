"""What one frame says of the tow: marks, y_CG, beta, alpha, the line, the camera, each with its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import DatumFit
from ..geometry.line import alpha_of
from ..geometry.motion import invariant_series
from ..geometry.poses import Framed, poses_of
from ..record.errors import InputError
from ..record.run import Run
from ..vision.flash import light
from ..vision.follower import Glance
from ..vision.glance import Glances
from ..vision.recording.codecs import losses
from .datum_watch import DatumWatch, Turn
from .stamped import Stamped

TAUT = "taut line"
"""Of ``invariant_series``."""


@dataclass(frozen=True)
class Valued:
    """A value and its standard deviations: of what varies from frame to frame, and of what is common to the run."""

    value: float = np.nan
    sd: float = np.nan
    common_sd: float = np.nan


@dataclass(frozen=True)
class Seen:
    """One frame's provisional values.

    Attributes
    ----------
    index, t_s, arrived_s, by_source : the frame's (``Stamped``)
    damaged : the picture could not be decoded as it was written
    marks : in run.toml's order
    y_cg_m, beta_rad, alpha_rad : as in motion.csv; NaN where fewer than two marks were seen, alpha also without a line
    slack_m : how much nearer to the post the tow point is than the line is long; negative: farther
    turn : the camera against the first second; None: not looked at in this frame, or nothing to see it by
    light : how bright the whole picture is, as a share of white; NaN where it is damaged
    """

    index: int
    t_s: float
    arrived_s: float
    by_source: bool
    damaged: bool
    marks: tuple[Glance, ...]
    y_cg_m: Valued
    beta_rad: Valued
    alpha_rad: Valued
    slack_m: Valued
    turn: Turn | None
    light: float = np.nan


class Seeing:
    """Frames of one tow -> what is seen in each, at once.

    Parameters
    ----------
    run : as its run.toml says; the recording need not be there
    fit : of its datum
    codec : of the frames, by ffmpeg's name: it says whether pixels were lost

    Raises
    ------
    InputError : a mark's look cannot be followed live
    """

    def __init__(self, run: Run, fit: DatumFit, codec: str) -> None:
        self._run, self._mapping = run, fit.mapping
        self._glances = Glances(run, fit.mapping, *losses(codec))
        self._datum = DatumWatch(run.file.datum, fit.mapping)

    def step(self, stamped: Stamped) -> Seen:
        """Take the next frame.

        Raises
        ------
        TrackingError : what is seen cannot be told to be the marks
        """
        frame = stamped.frame
        marks = self._glances.step(frame)
        y, beta, alpha, slack = self._values(frame.index, frame.t_s, marks)
        turn = None if frame.damaged else self._datum.step(frame)
        return Seen(
            frame.index,
            frame.t_s,
            stamped.arrived_s,
            stamped.by_source,
            frame.damaged,
            marks,
            y,
            beta,
            alpha,
            slack,
            turn,
            np.nan if frame.damaged else light(frame),
        )

    def settle(self) -> None:
        """As ``Glances.settle``: to be called when a frame's values have gone out."""
        self._glances.settle()

    def _values(self, index: int, t_s: float, marks: tuple[Glance, ...]) -> tuple[Valued, Valued, Valued, Valued]:
        place = np.array([[[m.u_px, m.v_px] for m in marks]])
        sigma = np.array([[[m.sigma_u_px, m.sigma_v_px] for m in marks]])
        none = np.zeros((0, 1, len(marks), 2))
        one = Framed(np.array([index]), np.array([t_s]), place, sigma, none, none, ())
        try:
            poses = poses_of(self._run, one, self._mapping)
        except InputError:  # never two marks at once: of one frame that is no error
            return Valued(), Valued(), Valued(), Valued()
        pose, covariance, modes = poses.rigid.pose, poses.rigid.covariance[0], poses.pose_modes[:, 0]
        alpha, slope = alpha_of(self._run, pose)
        y, beta = (_valued(pose[0, i], np.eye(3)[i], covariance, modes) for i in (1, 2))
        taut = invariant_series(self._run, poses).get(TAUT)
        slack = Valued()
        if taut is not None:
            tow = self._run.tow
            towards = _along_line(pose[0], float(alpha[0]), tow.tow_point_m or 0.0, tow.tow_point_offset_m)
            slack = _valued(-float(taut[0]), towards, covariance, modes)
        return y, beta, _valued(alpha[0], slope[0], covariance, modes), slack


def _valued(value: float, slope: np.ndarray, covariance: np.ndarray, modes: np.ndarray) -> Valued:
    """A function of the pose: its slope (3,) by x_CG, y_CG, beta."""
    spread = float(slope @ covariance @ slope)
    return Valued(float(value), float(np.sqrt(max(spread, 0.0))), float(np.linalg.norm(modes @ slope)))


def _along_line(pose: np.ndarray, alpha: float, ahead_m: float, aside_m: float) -> np.ndarray:
    """How the tow point's way to the post shrinks with x_CG, y_CG and beta, (3,)."""
    unit = np.array([np.cos(alpha), -np.sin(alpha)])
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    turned = np.array([-ahead_m * sine - aside_m * cosine, ahead_m * cosine - aside_m * sine])
    return np.array([unit[0], unit[1], float(unit @ turned)])


__all__ = ["Seeing", "Seen", "Valued"]
