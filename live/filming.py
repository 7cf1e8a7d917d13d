"""A tow of the day, or its static record: from the set-up to a run folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ..geometry import DatumFit, run_datum
from ..pipeline.mistaken import named
from ..pipeline.stages import track_run
from ..record.errors import InputError
from ..record.run import RUN_FILE, Run, cameras_of, read_run, refuse_two_cameras
from .folder import STATIC, TOW, make_folder, next_of, static_of, tows_of
from .meeting import Answer, Begin
from .recorder import FILM
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
    InputError : it cannot be read, or is none that was filmed
    """
    setup = read_run(folder)
    views = cameras_of(setup)
    if not setup.file.marker or any(view.file.source.motion is not None or not view.file.datum for view in views):
        raise InputError(
            setup.folder / RUN_FILE, "source", "a run with marks and a datum is expected, one that was filmed"
        )
    return setup


def film_tow(
    setup: Run,
    sources: Sequence[str],
    day: Path,
    telling: Telling,
    stopped: Callable[[], bool],
    wanted: Wanted = USUAL,
    track: bool = True,
    told: Callable[[Path], None] = lambda _: None,
) -> tuple[Path, tuple[Counts, ...]]:
    """Film the day's next tow; it knows the day's latest static record.

    Parameters
    ----------
    setup : of ``setup_of``
    sources : as typed; as many as the set-up has cameras, in their order
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
    stems = _stems(setup, sources)
    folder = next_of(day, TOW)
    told(folder)
    static = None if setup.file.cameras else static_of(day)
    begin, before = _beginning(setup, folder, static), tows_of(day)

    def resting(run: Run) -> Resting | None:
        return Resting(run, before, wanted.x_v_m) if may_settle(run) else None

    return folder, live_tow(sources, stems, folder, begin, telling, stopped, wanted, track, resting)


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
    refuse_two_cameras(setup, "a static record")
    folder = next_of(day, STATIC)
    told(folder)
    begin = _beginning(setup, folder, None)
    (counts,) = live_tow([source], [FILM], folder, begin, telling, stopped, wanted, track=False)
    track_run(read_run(folder))
    return folder, counts


def _stems(setup: Run, sources: Sequence[str]) -> list[str]:
    """What the recordings are called; InputError where there are not as many sources as cameras."""
    names = [camera.name for camera in setup.file.cameras] or [FILM]
    if len(names) != len(sources):
        films = "films with one camera" if len(names) == 1 else f"has two [[camera]] ({', '.join(names)})"
        many = "one source" if len(sources) == 1 else f"{len(sources)} sources"
        raise InputError(setup.folder / RUN_FILE, "camera", f"{many} to film from, but the set-up {films}")
    return names


def _beginning(setup: Run, folder: Path, static: Path | None) -> Begin:
    """What ``live_tow`` calls when all sources have answered."""

    def begin(answers: Sequence[Answer]) -> tuple[Run, list[tuple[Run, DatumFit]]]:
        fits = [_fit(view, answer.size_px) for view, answer in zip(cameras_of(setup), answers, strict=True)]
        run = make_folder(setup, folder, [answer.recording for answer in answers], static)
        return run, list(zip(cameras_of(run), fits, strict=True))

    return begin


def _fit(view: Run, size_px: tuple[int, int]) -> DatumFit:
    """The set-up's datum, for a picture of this size."""
    stated = view.file.camera
    if stated is not None and stated.image_size_px != size_px:
        where = f'camera "{view.camera}".lens.image_size_px' if view.camera else "camera.image_size_px"
        raise InputError(
            view.folder / RUN_FILE,
            where,
            f"{list(stated.image_size_px)}, but the source's picture is {size_px[0]} x {size_px[1]}; the lens would be another",
        )
    with named(view):
        return run_datum(view, size_px)


__all__ = ["STATIC_S", "film_static", "film_tow", "setup_of"]
