"""What a machine has of what towline needs. Nothing here needs a package that may be missing."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import locale
import os
import re
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Status = Literal["ok", "missing", "old", "low"]

PYTHON = (3, 11)
"""The oldest that is supported, as in pyproject.toml."""
MEMORY_BYTES, DISK_BYTES = 1 << 30, 1 << 30
"""Less than this is said to be low. A short run takes 0.3 GiB of memory from video to page; many runs take more."""
GIB = 1 << 30
"""Bytes: 2^30."""
PURPOSES = {
    "av": "reads and writes videos",
    "matplotlib": "pictures on the pages",
    "numpy": "all numbers",
    "opencv-python-headless": "boards, tags, pictures",
    "pandas": "tables",
    "pyarrow": "Parquet tables",
    "pydantic": "checks run.toml and results",
    "rich": "tables and progress on the terminal",
    "scikit-image": "marks of any look",
    "scipy": "the fits",
    "shtab": "towline completion",
    "threadpoolctl": "linear algebra on one thread",
    "tomlkit": "writes run.toml",
    "torch": "check of the camera chain; tracking on a GPU",
    "kornia": "check of the camera chain",
    "dask": "towline campaign on a cluster",
    "nicegui": "the local web page",
    "python-docx": "towline budget --docx",
    "fmpy": "towline gap with an FMU",
}
"""What each package is for, by the name it is installed under."""
INSTEAD = {
    "opencv-python-headless": ("opencv-python", "opencv-contrib-python", "opencv-contrib-python-headless"),
}
"""Packages that hold the same modules."""
CODECS = {"h264": "most videos", "hevc": "videos of newer cameras and telephones"}
DEVELOPERS = "test"
"""The extra that only those need who change towline."""


@dataclass(frozen=True)
class Item:
    """One thing that was looked at.

    Attributes
    ----------
    name, found : what, and which version or how much
    status : ok, missing, old, or low (there, but little of it)
    needed : towline does not work without it
    purpose : what it is for
    todo : what to do where it is not ok
    """

    name: str
    found: str
    status: Status
    needed: bool
    purpose: str
    todo: str = ""


def looked_at(folder: Path) -> list[Item]:
    """Everything, for work in ``folder``."""
    return [
        _python(),
        *_packages(),
        *_codecs(),
        _cuda(),
        _cores(),
        _memory(),
        _disk(folder),
        _writable(folder),
        _encoding(),
    ]


def _python() -> Item:
    found, wanted = ".".join(map(str, sys.version_info[:3])), ".".join(map(str, PYTHON))
    old = sys.version_info[:2] < PYTHON
    todo = f"install Python {wanted} or newer and make the environment anew with it" if old else ""
    return Item("Python", found, "old" if old else "ok", True, "runs towline", todo)


# packages --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Requirement:
    """A package that is asked for: ``wanted`` as typed (">=2.0"), ``extra`` empty where it is needed."""

    name: str
    wanted: str
    extra: str


def requirements() -> list[Requirement]:
    """What towline's own metadata (or the checkout's pyproject.toml) asks for, without the developers' extra."""
    found: list[Requirement] = []
    for line in _asked_for():
        asked, _, marker = line.partition(";")
        match = re.match(r"\s*([A-Za-z0-9._-]+)\s*(?:\[[^]]*\])?\s*(.*)", asked)
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)", marker)
        if match is not None:
            found.append(Requirement(match[1].lower(), match[2].strip(" ()"), "" if extra is None else extra[1]))
    return [r for r in found if r.extra != DEVELOPERS]


def _asked_for() -> list[str]:
    """The checkout's own list first: what an editable install noted may be older."""
    project = Path(__file__).parent.with_name("pyproject.toml")
    if project.is_file():
        table = tomllib.loads(project.read_text(encoding="utf-8"))["project"]
        extras = table.get("optional-dependencies", {})
        more = [f'{line}; extra == "{extra}"' for extra, lines in extras.items() for line in lines]
        return [*table["dependencies"], *more]
    try:
        return importlib.metadata.requires("towline") or []
    except importlib.metadata.PackageNotFoundError:
        return []


def _packages() -> Iterator[Item]:
    for asked in requirements():
        version = next(filter(None, map(_version, (asked.name, *INSTEAD.get(asked.name, ())))), None)
        purpose = PURPOSES.get(asked.name, asked.extra)
        status: Status = "missing" if version is None else "ok" if fits(version, asked.wanted) else "old"
        extra = f"towline[{asked.extra}]" if asked.extra else f"{asked.name}{asked.wanted}"
        todo = "" if status == "ok" else f"pip install '{extra}'"
        if status == "old":
            todo = f"{asked.wanted} is wanted; {todo}"
        yield Item(asked.name, version or "-", status, not asked.extra, purpose, todo)


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def fits(version: str, wanted: str) -> bool:
    """Whether ``version`` is what ``wanted`` (">=2.0", "==2.13.0", both with a comma between) asks for; by release numbers."""
    for clause in filter(None, (part.strip() for part in wanted.split(","))):
        match = re.match(r"(>=|==|~=|>|<=|<|!=)\s*(.+)", clause)
        if match is None:
            continue
        have, want = _release(version), _release(match[2])
        length = max(len(have), len(want))
        have, want = (numbers + (0,) * (length - len(numbers)) for numbers in (have, want))
        holds = {
            ">=": have >= want,
            "~=": have >= want,
            "==": have == want,
            ">": have > want,
            "<=": have <= want,
            "<": have < want,
            "!=": have != want,
        }
        if not holds[match[1]]:
            return False
    return True


def _release(version: str) -> tuple[int, ...]:
    """ "2.13.0+cpu" -> (2, 13, 0)."""
    match = re.match(r"\d+(\.\d+)*", version)
    return () if match is None else tuple(int(part) for part in match[0].split("."))


# what is imported to look ----------------------------------------------------------------------------------------


def _codecs() -> Iterator[Item]:
    try:
        import av.codec as codecs
    except ImportError as error:
        for name, purpose in CODECS.items():
            yield Item(f"codec {name}", "-", "missing", True, purpose, f"PyAV does not start ({error}): pip install av")
        return
    for name, purpose in CODECS.items():
        there = name in codecs.codecs_available
        todo = "" if there else "install PyAV's own wheel: pip install --force-reinstall --only-binary :all: av"
        yield Item(f"codec {name}", "decodes" if there else "-", "ok" if there else "missing", True, purpose, todo)


def _cuda() -> Item:
    purpose, found = "towline track --device cuda", ""
    if importlib.util.find_spec("torch") is None:
        return Item("CUDA device", "-", "missing", False, purpose, "torch, which would use it, is not installed")
    try:
        import torch

        if torch.cuda.is_available():
            found = torch.cuda.get_device_name(0)
    except (ImportError, OSError, RuntimeError) as error:
        return Item(
            "CUDA device", "-", "missing", False, purpose, f"torch does not start: {' '.join(str(error).split())}"
        )
    todo = "" if found else "without one, track on the CPU (the default)"
    return Item("CUDA device", found or "-", "ok" if found else "missing", False, purpose, todo)


# the machine -----------------------------------------------------------------------------------------------------


def _cores() -> Item:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    todo = "" if cores > 1 else "decoding and tracking take turns"
    return Item("cores", str(cores), "ok" if cores > 1 else "low", False, "decoding beside tracking, --workers", todo)


def _memory() -> Item:
    purpose = "frames and fits"
    free = free_memory_bytes()
    if free is None:
        return Item("free memory", "not known", "ok", False, purpose)
    low = free < MEMORY_BYTES
    todo = f"{MEMORY_BYTES / GIB:.0f} GiB is wanted: close other programs, or take fewer runs at once" if low else ""
    return Item("free memory", f"{free / GIB:.1f} GiB", "low" if low else "ok", False, purpose, todo)


def free_memory_bytes() -> int | None:
    """What can be had without swapping, the container's own limit included; None where the system does not say."""
    found: list[int] = []
    text = _text(Path("/proc/meminfo"))
    match = re.search(r"^MemAvailable:\s+(\d+) kB", text, re.MULTILINE)
    if match is not None:
        found.append(1024 * int(match[1]))
    limit, used, kept = (_text(Path(f"/sys/fs/cgroup/memory.{name}")).strip() for name in ("max", "current", "stat"))
    if limit.isdigit() and used.isdigit():
        # the files that the system keeps for speed count as used; they give way
        gives_way = re.search(r"^inactive_file (\d+)", kept, re.MULTILINE)
        found.append(int(limit) - int(used) + (0 if gives_way is None else int(gives_way[1])))
    if not found and sys.platform == "win32":
        found += _windows_memory()
    return min(found) if found else None


def _windows_memory() -> list[int]:
    import ctypes

    # MEMORYSTATUSEX: two 32-bit words (its own length, the load), then seven 64-bit ones; the second is what is free
    status = (ctypes.c_uint64 * 8)()
    status[0] = ctypes.sizeof(status)
    done = getattr(ctypes, "windll").kernel32.GlobalMemoryStatusEx(ctypes.byref(status))  # noqa: B009
    return [int(status[2])] if done else []


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""


def _disk(folder: Path) -> Item:
    name, purpose = "free disk", "overlays, tables, pages"
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return Item(name, "-", "missing", True, purpose, f"{folder}: {error.strerror}; name a folder that is there")
    low = free < DISK_BYTES
    todo = f"{DISK_BYTES / GIB:.0f} GiB is wanted in {folder.resolve()}: make room" if low else ""
    return Item(name, f"{free / GIB:.1f} GiB", "low" if low else "ok", False, purpose, todo)


def _writable(folder: Path) -> Item:
    name, purpose = "folder", "run folders take results in out/"
    try:
        with tempfile.NamedTemporaryFile(prefix=".towline-", dir=folder):
            pass
    except OSError as error:
        todo = f"{folder.resolve()}: {error.strerror}; work where you may write"
        return Item(name, "not writable", "missing", True, purpose, todo)
    return Item(name, "writable", "ok", True, purpose)


def _encoding() -> Item:
    """towline reads and writes files as UTF-8 by itself; the terminal and file names are the system's."""
    names, terminal = sys.getfilesystemencoding(), getattr(sys.__stdout__, "encoding", None) or ""
    good = all(_is_utf8(name) for name in (names, terminal or names))
    todo = (
        "" if good else "set LANG=C.UTF-8 (Windows: PYTHONUTF8=1), or letters such as e with an accent stop a command"
    )
    found = f"{terminal or names}, {locale.getlocale()[0] or 'C'}"
    return Item("text encoding", found, "ok" if good else "old", good, "names and words with any letters", todo)


def _is_utf8(name: str) -> bool:
    return name.lower().replace("_", "-") in ("utf-8", "utf8")
