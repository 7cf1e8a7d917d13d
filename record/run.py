"""A run folder: the checked run.toml with the folder it lies in."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from .errors import InputError
from .files import ABSENT, refusal, sha256_of_texts
from .looks import look_of
from .schema import FilmingTable, Line, ModelTable, RunFile, TowTable, WaterTable
from .sources import file_hash, recording_hash, recording_refusal
from .toml import read_toml
from .toml_words import lost_backslash

RUN_FILE = "run.toml"
CORRECTIONS = "corrections.toml"
RECORDINGS = ("video", "static")
"""Last parts of the keys that may name a recording of any kind; the others name plain files."""


@dataclass(frozen=True)
class Run:
    """A run folder.

    Attributes
    ----------
    folder : where run.toml lies; all of its paths start there
    file : the checked content of run.toml
    camera : of a run as one of its two cameras sees it (``cameras_of``): that camera's name; else empty
    """

    folder: Path
    file: RunFile
    camera: str = ""

    @property
    def name(self) -> str:
        """The run's name."""
        return self.file.name

    @property
    def out(self) -> Path:
        """Where the commands write; deleting it loses nothing that was measured."""
        return self.folder / "out" / self.camera

    @property
    def source_path(self) -> Path:
        """The recording, tracks or motion."""
        return self.folder / self.file.source.file

    @property
    def tow(self) -> TowTable:
        """The tow table; InputError where run.toml has none."""
        return self._needed(self.file.tow, "tow")

    @property
    def model(self) -> ModelTable:
        """The model table; InputError where run.toml has none."""
        return self._needed(self.file.model, "model")

    @property
    def water(self) -> WaterTable:
        """The water table; InputError where run.toml has none."""
        return self._needed(self.file.water, "water")

    def path(self, relative: str) -> Path:
        """A path of run.toml, from the run folder."""
        return self.folder / relative

    def _needed(self, table, name: str):
        if table is None:
            raise InputError(self.folder / RUN_FILE, name, "missing table; this command needs it")
        return table

    def need(self, value, key: str):
        """Return ``value`` or raise the error that ``key`` of run.toml is missing for this command."""
        if value is None:
            raise InputError(self.folder / RUN_FILE, key, "missing key; this command needs it")
        return value

    def input_hashes(self) -> dict[str, str]:
        """SHA-256 of run.toml, of every file or recording that it names, and of corrections.toml, by their paths in the folder."""
        named = [("", RUN_FILE), *named_files(self.file)]
        if self.file.source.video is not None and (self.folder / CORRECTIONS).is_file():
            named.append(("", CORRECTIONS))
        found = {name: (recording_hash if is_recording(key) else file_hash)(self.path(name)) for key, name in named}
        return {name: digest for name, digest in found.items() if digest is not None}

    def input_hash(self, *stage: str, without: Collection[str] = ()) -> str:
        """One hash over all inputs, the ``stage`` words (version, options) that an output depends on, and registered code.

        Parameters
        ----------
        stage : words
        without : names of inputs that the output does not depend on
        """
        hashes = {name: digest for name, digest in self.input_hashes().items() if name not in without}
        found = {look.name: look.stamp for marker in self.file.marker if (look := look_of(marker.look)) and look.stamp}
        own = (f"look {name}={stamp}" for name, stamp in sorted(found.items()))
        return sha256_of_texts(*stage, *own, *(f"{name}={digest}" for name, digest in sorted(hashes.items())))


def all_inputs(runs: Iterable[Run]) -> dict[str, str]:
    """Hashes of every input of every run, by run name and path."""
    return {f"{run.name}/{name}": digest for run in runs for name, digest in run.input_hashes().items()}


def read_run(folder: str | Path, line: Line | None = None) -> Run:
    """Read the run folder (or the run.toml in it).

    Parameters
    ----------
    folder : run folder, or its run.toml
    line : what the tow line keeps, "surge" or "constant", instead of what run.toml says

    Returns
    -------
    Run
        the folder with what run.toml says, in SI units; nothing but run.toml is read yet

    Raises
    ------
    InputError : run.toml or a file that it names is missing, or its content cannot be used

    Examples
    --------
    >>> import towline
    >>> run = towline.read_run("sample_videos/mariner/x1446")
    >>> run.tow.speed_m_s
    1.28
    """
    folder = Path(folder)
    if folder.name == RUN_FILE and not folder.is_dir():
        folder = folder.parent
    if not folder.is_dir():
        raise InputError(folder, "", "no such run folder")
    path = folder / RUN_FILE
    run = with_line(Run(folder, read_toml(path, RunFile)), line)
    for key, name in named_files(run.file):
        stay_inside(path, key, name, run.file.outside)
        wrong = (recording_refusal if is_recording(key) else refusal)(folder / name)
        if wrong is not None:
            written = name if name.isprintable() else repr(name)
            lost = lost_backslash(name) or ""
            raise InputError(path, key, f"{wrong}: {written}{lost}" if wrong == ABSENT else f"{written} {wrong}")
    return run


def with_line(run: Run, line: Line | None) -> Run:
    """The run with another tow.line; None: as it is.

    Parameters
    ----------
    run : the run folder as read
    line : what the tow line keeps, "surge" or "constant"; None: what run.toml says
    """
    if line is None or run.file.tow is None:
        return run
    tow = run.file.tow.model_copy(update={"line": line})
    return replace(run, file=run.file.model_copy(update={"tow": tow}))


def cameras_of(run: Run) -> tuple[Run, ...]:
    """The run as each of its cameras sees it: a run of one camera each, with an out/ of its own; of one camera the run itself.

    Parameters
    ----------
    run : the run folder as read

    Examples
    --------
    >>> import towline
    >>> run = towline.read_run("sample_videos/mariner/x1446")
    >>> cameras_of(run) == (run,)
    True
    """
    if not run.file.cameras:
        return (run,)
    return tuple(_as_seen_by(run, camera) for camera in run.file.cameras)


def refuse_two_cameras(run: Run, what: str) -> None:
    """Raise InputError where two cameras filmed a run.

    Parameters
    ----------
    run : the run folder as read
    what : cannot be done with it, in words: "towline datum"
    """
    if run.file.cameras:
        raise InputError(
            run.folder / RUN_FILE, "camera", f"{what} takes a run of one camera; this one has two [[camera]]"
        )


def _as_seen_by(run: Run, camera: FilmingTable) -> Run:
    markers = tuple(
        m.model_copy(update={"seen_at_px": camera.seen_at_px.get(m.name, m.seen_at_px)}) for m in run.file.marker
    )
    update = {
        "name": f"{run.name} ({camera.name})",
        "source": camera.source,
        "camera": camera.lens,
        "datum": camera.datum,
        "marker": markers,
        "cameras": (),
    }
    return replace(run, file=run.file.model_copy(update=update), camera=camera.name)


def stay_inside(path: Path, key: str, name: str, outside: bool) -> None:
    """Refuse a file that ``key`` of run.toml names out of the run folder, unless ``outside`` (true at the top) allows it.

    The one rule of the commands and of the app.

    Parameters
    ----------
    path : of run.toml, for messages
    key : that names the file
    name : the path as written
    outside : it may lead out

    Raises
    ------
    InputError : it leads out and may not
    """
    if not outside and leads_out(name):
        raise InputError(path, key, f"{name!r} leads out of the run folder; outside = true at the top allows it")


def leads_out(name: str) -> bool:
    """Whether a path, as written, is absolute or climbs out of the folder it starts at; links are followed, not judged."""
    return bool(Path(name).anchor) or Path(os.path.normpath(name)).parts[:1] == ("..",)


def is_recording(key: str) -> bool:
    """Whether a key of run.toml may name a recording of any kind; the others name plain files."""
    return key.rpartition(".")[2] in RECORDINGS


def named_files(file: RunFile) -> list[tuple[str, str]]:
    """Keys of run.toml that name a file or a recording, and the names, as written.

    Parameters
    ----------
    file : the content of run.toml
    """
    pairs = [
        ("source.video", file.source.video),
        ("source.tracks", file.source.tracks),
        ("source.motion", file.source.motion),
        ("noise.static", file.noise.static if file.noise else None),
        ("camera.calibration", file.camera.calibration if file.camera else None),
        ("tow.tension", file.tow.tension if file.tow else None),
        ("tow.rudder", file.tow.rudder if file.tow else None),
        ("tow.speed", file.tow.speed if file.tow else None),
    ]
    if file.cameras:
        pairs = [pair for pair in pairs if not pair[0].startswith(("source.", "camera."))]
    for index, camera in enumerate(file.cameras, 1):
        where = f'camera[{index} "{camera.name}"]'
        pairs += [(f"{where}.video", camera.video), (f"{where}.tracks", camera.tracks)]
        pairs.append((f"{where}.lens.calibration", camera.lens.calibration if camera.lens else None))
    return [(key, name) for key, name in pairs if name]
