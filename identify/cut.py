"""Where a record ends early: the model touches the wall, or is lost for good (4.4, 9.2). What comes before is used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from ..record.run import Run
from ..record.schema import ModelTable
from ..simulate.model import Array

BEAM_SHARE = 1 / 7
"""Beam over Lpp where ``model.beam_m`` is not given; the MARINER's is 1 / 6.9."""
MARGIN_SHARE = 0.01
"""The model touches the wall where its side comes within this share of Lpp of it."""
TOUCH_SAMPLES = 3
"""So many samples in a row at the wall are a touch, one alone may be noise: a choice."""
FREE_S = 1.0
"""A touch counts after the model was clear of both walls for so long: many are let go from the side."""
LOST_S = 1.0
"""A model not found for so long, up to the record's end, is lost for good."""


@dataclass(frozen=True)
class Cut:
    """The end of a record's usable part.

    Attributes
    ----------
    t_s : from here on nothing is used
    words : why
    """

    t_s: float
    words: str


def cut_of(run: Run, motion: pd.DataFrame) -> Cut | None:
    """The first of: the model touches the wall, it is lost for good. None: neither.

    Parameters
    ----------
    run : the run folder as read
    motion : t_s, y_cg_m, beta_rad, status

    The hull is an ellipse of Lpp and beam about the LCG, the walls stand at y = +- tank_width_m / 2.
    """
    found = [c for c in (_wall(run, motion), _lost(motion)) if c is not None]
    return min(found, key=lambda c: c.t_s, default=None)


def before_cut(run: Run, motion: pd.DataFrame) -> Array:
    """(n,) of bool: the rows of ``motion`` before ``cut_of``.

    Parameters
    ----------
    run : the run folder as read
    motion : motion table
    """
    cut = cut_of(run, motion)
    times = motion["t_s"].to_numpy(dtype=float)
    return np.ones(len(times), dtype=bool) if cut is None else times < cut.t_s


def _seen(motion: pd.DataFrame) -> Array:
    places = motion[["y_cg_m", "beta_rad"]].to_numpy(dtype=float)
    return (motion["status"] == "measured").to_numpy() & np.isfinite(places).all(axis=1)


def _wall(run: Run, motion: pd.DataFrame) -> Cut | None:
    model, water = run.file.model, run.file.water
    if model is None or water is None or water.tank_width_m is None:
        return None
    seen = _seen(motion)
    t_s, y, beta = motion[["t_s", "y_cg_m", "beta_rad"]].to_numpy(dtype=float)[seen].T
    beam, reach = beam_of(model), hull_reach(model, beta)
    wall = water.tank_width_m / 2
    near = np.abs(y) + reach > wall - MARGIN_SHARE * model.length_pp_m
    free = 0.0
    for i in range(1, len(t_s)):
        if free < FREE_S:
            free = 0.0 if near[i - 1] else free + t_s[i] - t_s[i - 1]
        elif near[i] and i + TOUCH_SAMPLES <= len(t_s) and near[i : i + TOUCH_SAMPLES].all():
            side = "starboard" if y[i] > 0 else "port"
            assumed = "" if model.beam_m is not None else f", beam_m taken as {beam:.2g} m"
            return Cut(
                float(t_s[i]),
                f"the model touches the {side} wall at {t_s[i]:.2f} s (|y_CG| {abs(y[i]):.3f} m and "
                f"{reach[i]:.3f} m of hull beside it of {wall:.3f} m{assumed}): only what is before is used",
            )
    return None


def beam_of(model: ModelTable) -> float:
    """The model's beam, m, as stated or as usual for its length."""
    return BEAM_SHARE * model.length_pp_m if model.beam_m is None else model.beam_m


def hull_reach(model: ModelTable, beta_rad: Array) -> Array:
    """How far the hull reaches to either side of the LCG, m, as an ellipse of Lpp and beam.

    Parameters
    ----------
    model : its length and beam
    beta_rad : heading
    """
    return np.hypot(model.length_pp_m / 2 * np.sin(beta_rad), beam_of(model) / 2 * np.cos(beta_rad))


def _lost(motion: pd.DataFrame) -> Cut | None:
    seen = np.flatnonzero(_seen(motion))
    times = motion["t_s"].to_numpy(dtype=float)
    if not len(seen) or not times[-1] - times[seen[-1]] >= LOST_S:  # nor where a time is no number
        return None
    begin = float(times[seen[-1] + 1])
    return Cut(
        begin,
        f"the model is lost for good at {begin:.2f} s, {times[-1] - begin:.1f} s before the record's end: it left the picture, "
        "or its marks did; only what is before is used",
    )
