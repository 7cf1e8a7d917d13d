"""Recordings on the disk: which files one is made of. Video files and pictures are built in; other kinds are registered.

How frames come out of one is ``vision.recording``'s; ``register_source`` there takes both in (docs/developer/source.md).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from .files import ABSENT, refusal, sha256_of_file, sha256_of_texts
from .picture_files import picture_files
from .registry import Registry

VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".mts", ".mpg", ".webm", ".wmv")
"""Files of these suffixes are offered as videos; one that run.toml names may have any."""


@dataclass(frozen=True)
class SourceKind:
    """A kind of recording.

    Attributes
    ----------
    name : for errors: "folder of pictures"
    takes : whether a path, which need not be there, is such a recording
    files : the plain files that a recording is made of, in their order; what is made from it is made anew when one changes
    stamp : of the code that reads it: what is made from it is made anew when that changes; "": towline's own
    """

    name: str
    takes: Callable[[Path], bool]
    files: Callable[[Path], Sequence[Path]]
    stamp: str = ""


VIDEO_FILE = SourceKind("video file", lambda _: True, lambda path: [path])
PICTURES = SourceKind(
    "sequence of pictures",
    lambda path: bool(picture_files(path)),
    lambda path: [file.path for file in picture_files(path)],
)
KINDS: Registry[SourceKind] = Registry("towline.sources")


def register_kind(kind: SourceKind) -> None:
    """Take a kind of recording in, behind those that are there and before the video file; one of its name is replaced."""
    KINDS.add(kind.name, kind)


def kind_of(path: str | Path) -> SourceKind:
    """The first kind that takes ``path``, those of installed packages included, then pictures; else it is a video file."""
    return next((kind for kind in (*KINDS.all(), PICTURES) if kind.takes(Path(path))), VIDEO_FILE)


def recording_refusal(path: str | Path) -> str | None:
    """Why ``path`` is no recording ("no such file", "is a named pipe; ..."); None where all its files are plain files."""
    kind = kind_of(path)
    if kind is VIDEO_FILE:
        return refusal(path)
    files = kind.files(Path(path))
    if not files:
        return f"is a {kind.name} without a file"
    found = ((file, refusal(file)) for file in files)
    return next((f"is a {kind.name} whose {file.name} {_said(wrong)}" for file, wrong in found if wrong), None)


def is_recording(path: str | Path) -> bool:
    """Whether a plain file, or a recording of another kind, is there."""
    return recording_refusal(path) is None


def _said(wrong: str) -> str:
    return "is not there" if wrong == ABSENT else wrong


def recording_hash(path: str | Path) -> str | None:
    """SHA-256 of a recording: of its file's bytes, or of its files' names and bytes; None where there is none."""
    kind = kind_of(path)
    if kind is VIDEO_FILE:
        return file_hash(path)
    files = kind.files(Path(path))
    return sha256_of_texts(
        kind.name, kind.stamp, *(f"{os.path.relpath(file, path)}={sha256_of_file(file)}" for file in files)
    )


def file_hash(path: str | Path) -> str | None:
    """SHA-256 of a plain file; None where there is none."""
    return sha256_of_file(path) if Path(path).is_file() else None


def recordings_in(folder: str | Path) -> list[str]:
    """Names of the recordings in a folder, hidden ones left out; none where it cannot be read."""
    try:
        names = sorted(entry.name for entry in os.scandir(folder) if not entry.name.startswith("."))
    except OSError:
        return []
    return [name for name in names if _offered(Path(folder) / name)]


def _offered(path: Path) -> bool:
    return (path.is_file() and path.suffix.lower() in VIDEOS) or kind_of(path) is not VIDEO_FILE


__all__ = [
    "KINDS",
    "PICTURES",
    "VIDEOS",
    "VIDEO_FILE",
    "SourceKind",
    "file_hash",
    "is_recording",
    "kind_of",
    "recording_hash",
    "recording_refusal",
    "recordings_in",
    "register_kind",
]
