"""A campaign on object storage or another machine (fsspec): its files come to a local folder, its results go back."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from ...record.errors import TowlineError
from ...record.files import JSON_BYTES, read_text, sha256_of_file, write_text
from .find import OUT

INDEX = ".towline-mirror.json"


def is_remote(place: str) -> bool:
    """Whether ``place`` is a URL (s3://, gs://, sftp://, memory://, ...)."""
    return "://" in place


def cache_folder(url: str) -> Path:
    """Where the files of a URL are kept on this machine."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return home / "towline" / f"{PurePosixPath(url).name or 'campaign'}-{hashlib.sha256(url.encode()).hexdigest()[:12]}"


@contextmanager
def mirrored(url: str, cache: Path | None = None) -> Iterator[Path]:
    """A local folder with the files of ``url``; what changed in its out/ folders goes back, also when the block fails.

    Files that did not change since the last time are not fetched again.

    Parameters
    ----------
    url : where the files are
    cache : local folder; None: ``cache_folder``

    Raises
    ------
    TowlineError : fsspec or the storage's own package is not installed, or the storage does not answer
    """
    try:
        import fsspec
    except ImportError:
        raise TowlineError(
            f"{url}: remote folders need fsspec: install towline with its extra 'remote', and the storage's own package"
        ) from None
    local = cache or cache_folder(url)
    try:
        storage, root = fsspec.core.url_to_fs(url)
        known = _pulled(storage, root.rstrip("/"), local)
    except (OSError, ImportError, ValueError) as error:
        raise TowlineError(f"{url}: {' '.join(str(error).split()) or type(error).__name__}") from None
    try:
        yield local
    finally:
        _pushed(storage, root.rstrip("/"), local, known)


def _pulled(storage: Any, root: str, local: Path) -> dict[str, list[str]]:
    """Fetch; returns path -> the storage's mark of its version, and its SHA-256 here."""
    try:
        known = json.loads(read_text(local / INDEX, JSON_BYTES))
    except (ValueError, RecursionError, TowlineError):
        known = {}
    files = storage.find(root)
    if not files:
        raise FileNotFoundError("no such folder, or nothing in it")
    found: dict[str, list[str]] = {}
    for path in files:
        name = path[len(root) :].lstrip("/")
        target = local / name
        if ".." in PurePosixPath(name).parts or not target.resolve().is_relative_to(local.resolve()):
            raise ValueError(f"{name!r} would be written outside of {local}")
        mark = str(storage.ukey(path))
        if name in known and known[name][0] == mark and target.is_file():
            found[name] = known[name]
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = target.with_name(f".{target.name}.tmp")
        storage.get_file(path, str(temporary))
        os.replace(temporary, target)
        found[name] = [mark, sha256_of_file(target)]
    write_text(local / INDEX, json.dumps(found, indent=1, sort_keys=True) + "\n")
    return found


def _pushed(storage: Any, root: str, local: Path, known: dict[str, list[str]]) -> None:
    for path in sorted(local.rglob("*")):
        name = path.relative_to(local).as_posix()
        if not path.is_file() or OUT not in PurePosixPath(name).parts[:-1] or path.name.startswith("."):
            continue
        digest = sha256_of_file(path)
        if name in known and known[name][1] == digest:
            continue
        place = f"{root}/{name}"
        storage.makedirs(place.rpartition("/")[0], exist_ok=True)
        storage.put_file(str(path), place)
        known[name] = [str(storage.ukey(place)), digest]
    write_text(local / INDEX, json.dumps(known, indent=1, sort_keys=True) + "\n")


__all__ = ["cache_folder", "is_remote", "mirrored"]
