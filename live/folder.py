"""The run folder of a tow that is about to be filmed: the set-up's run.toml with another recording."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from ..record.errors import InputError
from ..record.files import TOML_BYTES, name_on_disk, read_bytes, write_text
from ..record.run import RUN_FILE, Run, leads_out, named_files
from ..record.schema import RunFile
from ..record.toml import check_tables

TOW, STATIC = "tow-", "static-"
"""Begin the names of a day's tows (tow-01, tow-02, ...) and of its static records."""
OF_A_FILM = ("video", "tracks", "span_s", "frame_rate_hz", "offset_s", "offset_sd_s")
"""Keys of [[camera]] that say what one recording is, and not what the camera is."""
STATIC_TRACKS = "static.csv"
"""Of the day's static record, in a tow's folder."""


def next_of(day: Path, kind: str = TOW) -> Path:
    """The folder of the day's next tow, or static record; not made yet.

    Parameters
    ----------
    day : where the day's tows lie
    kind : ``TOW`` or ``STATIC``
    """
    numbers = [_number(path, kind) for path in day.glob(f"{kind}*") if _number(path, kind)]
    return day / f"{kind}{max(numbers, default=0) + 1:02d}"


def tows_of(day: Path, kind: str = TOW) -> list[Path]:
    """The day's tows so far, or its static records, in their order.

    Parameters
    ----------
    day : where they lie; need not be there
    kind : ``TOW`` or ``STATIC``
    """
    found = [path for path in day.glob(f"{kind}*") if _number(path, kind) and (path / RUN_FILE).is_file()]
    return sorted(found, key=lambda path: _number(path, kind))


def static_of(day: Path) -> Path | None:
    """Tracks of the day's latest static record; None: there is none.

    Parameters
    ----------
    day : where the day's tows lie
    """
    there = [path / "out" / "tracks.csv" for path in tows_of(day, STATIC)]
    return next((path for path in reversed(there) if path.is_file()), None)


def _number(path: Path, kind: str) -> int:
    """Of a folder; 0: it is none of this kind."""
    said = path.name.removeprefix(kind)
    return int(said) if said.isdecimal() else 0


def make_folder(setup: Run, folder: Path, recordings: str | Sequence[str], static: Path | None = None) -> Run:
    """Write the run folder of a tow: an ordinary one, as soon as the recording is in it. It appears whole, under its name.

    What the set-up's run.toml names beside its recording (a lens, a static record) is copied.

    Parameters
    ----------
    setup : the run whose camera, datum, marks and tow these are
    folder : new
    recordings : the name that its file will have, or those of the cameras' in their order
    static : tracks of the model held still, instead of those that the set-up names; None: those

    Raises
    ------
    InputError : the set-up names files outside of its folder, or no tow can be made of it
    """
    import tomlkit

    source = setup.folder / RUN_FILE
    document = tomlkit.parse(read_bytes(source, TOML_BYTES).decode("utf-8"))
    document["name"] = f"{setup.name} {folder.name}"
    names = [recordings] if isinstance(recordings, str) else list(recordings)
    if setup.file.cameras:
        for table, name in zip(document["camera"], names, strict=True):
            for key in OF_A_FILM:
                table.pop(key, None)
            table["video"] = name
    else:
        document["source"] = _source(setup, names[0])
    if static is not None:
        document["noise"] = {"static": STATIC_TRACKS}
    checked = check_tables(document.unwrap(), RunFile, source)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as hidden:
        made = Path(hidden) / folder.name
        made.mkdir()
        _fill(made, setup, checked, static, tomlkit.dumps(document))
        made.rename(folder)
    name_on_disk(folder)
    return Run(folder, checked)


def _fill(folder: Path, setup: Run, checked: RunFile, static: Path | None, text: str) -> None:
    """Copy what the set-up names, and the static record, and write run.toml."""
    for key, name in named_files(checked):
        if key == "source.video" or (key.startswith("camera[") and key.endswith((".video", ".tracks"))):
            continue
        if static is not None and key == "noise.static":
            shutil.copyfile(static, folder / name)
            continue
        if leads_out(name):
            raise InputError(
                setup.folder / RUN_FILE,
                key,
                f"{name!r} leads out of the run folder; for a live tow it must lie beside run.toml",
            )
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (setup.folder / name).is_dir():
            shutil.copytree(setup.folder / name, target)
        else:
            shutil.copyfile(setup.folder / name, target)
    write_text(folder / RUN_FILE, text, lasting=True)


def _source(setup: Run, recording: str) -> dict[str, object]:
    """[source] of the new run: of the set-up's only what the camera is, not which part of its film was used."""
    exposure_s = setup.file.source.exposure_s
    found: dict[str, object] = {"video": recording}
    return {**found, "exposure_s": exposure_s} if exposure_s else found


__all__ = ["STATIC", "TOW", "make_folder", "next_of", "static_of", "tows_of"]
