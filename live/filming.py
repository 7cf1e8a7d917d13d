"""A tow of the day, or its static record: from the set-up to a run folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..geometry import DatumFit, run_datum
from ..pipeline.mistaken import named
from ..pipeline.stages import track_run
from ..record.errors import InputError
from ..record.run import RUN_FILE, Run, read_run, refuse_two_cameras
from .folder import STATIC, TOW, make_folder, next_of, static_of, tows_of
from .resting import Resting, may_settle
from .session import USUAL, Counts, Telling, Wanted, live_tow

STATIC_S = 20.0
"""Of a static record where nobody says: some hundred frames, and what is slow in the noise a few times over. A choice."""


def setup_of(folder: Path) -> Run:
    """The set-up: a run with this camera, its datum, marks, model and tow.

    Parameters
    ----------
    folder : of the run

    Raises
    ------
    InputError : it cannot be read, or is none that was filmed by one camera
    """
    setup = read_run(folder)
    refuse_two_cameras(setup, "towline live")
    if setup.file.source.motion is not None or not setup.file.marker or not setup.file.datum:
        raise InputError(
            setup.folder / RUN_FILE, "source", "a run with marks and a datum is expected, one that was filmed"
        )
    return setup


def film_tow(
    setup: Run,
    source: str,
    day: Path,
    telling: Telling,
    stopped: Callable[[], bool],
    wanted: Wanted = USUAL,
    track: bool = True,
    told: Callable[[Path], None] = lambda _: None,
) -> tuple[Path, Counts]:
    """Film the day's next tow; it knows the day's latest static record.

    Parameters
    ----------
    setup : of ``setup_of``
    source : as typed
    day : folder of the day's tows
    telling : is told what is seen
    stopped : whether to end
    wanted : what is to be named and shown
    track : make its tracks while it is filmed
    told : is told the tow's folder, which is there when the source has answered

    Raises
    ------
    TowlineError : the source does not answer, its picture is another than the set-up's camera has, or the set-up cannot be used
    """
    folder = next_of(day, TOW)
    told(folder)
    begin, before = _beginning(setup, folder, static_of(day)), tows_of(day)

    def resting(run: Run) -> Resting | None:
        return Resting(run, before, wanted.x_v_m) if may_settle(run) else None

    return folder, live_tow(source, folder, begin, telling, stopped, wanted, track, resting)


def film_static(
    setup: Run,
    source: str,
    day: Path,
    telling: Telling,
    stopped: Callable[[], bool],
    wanted: Wanted = USUAL,
    told: Callable[[Path], None] = lambda _: None,
) -> tuple[Path, Counts]:
    """Film the model held still, and track it: the static record of the tows that come; the arguments as for ``film_tow``.

    Raises
    ------
    TowlineError : as ``film_tow``; or the marks cannot be tracked
    """
    folder = next_of(day, STATIC)
    told(folder)
    counts = live_tow(source, folder, _beginning(setup, folder, None), telling, stopped, wanted, track=False)
    track_run(read_run(folder))
    return folder, counts


def _beginning(setup: Run, folder: Path, static: Path | None) -> Callable[[str, tuple[int, int]], tuple[Run, DatumFit]]:
    """What ``live_tow`` calls when the source has answered."""

    def begin(recording: str, size_px: tuple[int, int]) -> tuple[Run, DatumFit]:
        stated = setup.file.camera
        if stated is not None and stated.image_size_px != size_px:
            raise InputError(
                setup.folder / RUN_FILE,
                "camera.image_size_px",
                f"{list(stated.image_size_px)}, but the source's picture is {size_px[0]} x {size_px[1]}; the lens would be another",
            )
        with named(setup):
            fit = run_datum(setup, size_px)
        return make_folder(setup, folder, recording, static), fit

    return begin


__all__ = ["STATIC_S", "film_static", "film_tow", "setup_of"]
