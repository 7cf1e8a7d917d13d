"""Where a steady tow comes to rest, told while it is filmed by a process of its own, so that no frame's values wait for it.

It reads what ``live.jsonl`` says of the marks, maps it as any tracks are mapped, common errors included, and asks
``identify.settling``; X_v needs the day's steady tows before it, which it reads once.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..identify.settling import NeutralPoint, Settling, neutral_point, settling
from ..identify.steady import SteadyState, steady_state, tension_known
from ..record.errors import TowlineError
from ..record.run import Run, read_run
from .beside import Beside
from .log import LOG, LogReader

if TYPE_CHECKING:
    import pandas as pd

EVERY_S = 3.0
"""Between two answers; one takes some tenths of a second of a core."""
MOST_FRAMES = 1500
"""Of a longer tow every second frame is taken, or third: the noise that matters is slower."""
LESS_URGENT = 10
"""Of the process, to the system: frames go first."""


def may_settle(run: Run) -> bool:
    """A tow that may come to rest off the line behind its post: its rudder is over, or it is towed for its steady state.

    Parameters
    ----------
    run : as its run.toml says
    """
    tow = run.tow
    return run.file.kind == "tow" and tow.tow_point_m is not None and (tow.rudder_rad != 0.0 or not tension_known(run))


class Resting:
    """Tells of a tow that is being filmed.

    Parameters
    ----------
    run : whose ``live.jsonl`` is being written
    before : folders of the day's tows before it
    wish_m : half-width of the 95 % interval of X_v that is enough; None: not said
    """

    def __init__(self, run: Run, before: Sequence[Path], wish_m: float | None) -> None:
        folders = [str(path) for path in before]
        self._process = Beside(_tell, "resting", str(run.folder), folders, wish_m)

    def told(self) -> Iterator[dict[str, Any]]:
        """What it said since it was asked last."""
        return self._process.told()

    def end(self) -> None:
        """Nobody asks any more."""
        self._process.end()


def _tell(folder: str, before: list[str], wish_m: float | None, pipe: Any) -> None:
    """In the process."""
    if hasattr(os, "nice"):
        os.nice(LESS_URGENT)
    run = read_run(Path(folder))
    others, frames = earlier([Path(path) for path in before]), Marks(run)
    reader = LogReader(run.out / LOG)
    while True:
        began = time.monotonic()
        frames.add(reader.records())
        found = told_of(run, frames, others, wish_m)
        if found is not None:
            pipe.send(found)
        time.sleep(max(EVERY_S - (time.monotonic() - began), 0.1))


class Marks:
    """The marks of a tow's frames so far, by what ``live.jsonl`` says of them.

    Parameters
    ----------
    run : whose they are
    """

    def __init__(self, run: Run) -> None:
        self._names = [mark.name for mark in run.file.marker]
        self._frames: list[dict[str, Any]] = []

    def add(self, records: Iterator[dict[str, Any]]) -> None:
        """Take new lines."""
        self._frames += [record for record in records if "frame" in record]

    @property
    def last_s(self) -> float:
        """Of the last frame."""
        return float(self._frames[-1]["t_s"]) if self._frames else 0.0

    def table(self) -> pd.DataFrame:
        """As ``record.read_tracks`` gives it."""
        import pandas as pd

        some = self._frames[:: max(1, -(-len(self._frames) // MOST_FRAMES))]
        columns = ("frame", "t_s", "marker", "u_px", "v_px", "sigma_u_px", "sigma_v_px", "status")
        rows = []
        for record in some:
            for name in self._names:
                mark = record["marks"].get(name)
                seen = isinstance(mark, list) and None not in mark
                place = mark if seen else [float("nan")] * 4
                rows.append((record["frame"], record["t_s"], name, *place, "measured" if seen else "lost"))
        return pd.DataFrame(rows, columns=list(columns))


def earlier(folders: Sequence[Path]) -> list[SteadyState]:
    """Steady states of the day's tows; those that hold none are left out.

    Parameters
    ----------
    folders : their run folders
    """
    from ..pipeline.stages import compute_run_motion

    found = []
    for folder in folders:
        try:
            run = read_run(folder)
            if may_settle(run):
                m = compute_run_motion(run)
                found.append(steady_state(run, m.motion, m.common))
        except TowlineError:
            continue
    return found


def told_of(run: Run, frames: Marks, before: Sequence[SteadyState], wish_m: float | None) -> dict[str, Any] | None:
    """What stands in ``live.jsonl`` of a tow that settles; None: nothing was seen yet.

    Parameters
    ----------
    run : as its run.toml says
    frames : so far
    before : the day's steady tows
    wish_m : as of ``Resting``
    """
    from ..geometry import motion_from_tracks
    from ..pipeline.stages import fit_run_datum

    try:
        motion = motion_from_tracks(run, frames.table(), fit_run_datum(run))
        now = settling(run, motion.motion, motion.common)
    except TowlineError:  # never two marks at once, or nothing yet
        return None
    return _record(frames.last_s, now, neutral_point(now, before, wish_m))


def _record(t_s: float, now: Settling, found: NeutralPoint) -> dict[str, Any]:
    x_v, state = found.x_v_m, now.state
    return {
        "steady": found.words,
        "t_s": round(t_s, 6),
        "settled": now.settled,
        "stands": found.stands,
        "x_v_m": None if x_v is None else [round(x_v.value, 6), round(x_v.std, 6)],
        "interval_m": None if found.interval_m is None else [round(x, 6) for x in found.interval_m],
        "independent": None if now.independent is None else round(now.independent, 1),
        "alpha_rad": None if state is None else [round(state.alpha_rad, 6), round(state.covariance[0, 0] ** 0.5, 6)],
        "beta_rad": None if state is None else [round(state.beta_rad, 6), round(state.covariance[1, 1] ** 0.5, 6)],
    }


__all__ = ["Marks", "Resting", "earlier", "may_settle", "told_of"]
