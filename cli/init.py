"""``towline init``: a few questions, and a commented run.toml."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from .ask import Asker, numbers, say, terminal

NAME = "init"
HELP = "ask a few questions and write a commented run.toml (every question has a flag; --yes asks nothing)"

TABLES = (".csv", ".parquet")
SIZE_PX = "1280 720"
NOT_MEASURED = "none"
FULLNESS = 4.8
"""Displacement over L^3 in fresh water, kg/m3: block coefficient 0.6, length over beam 7, over draught 18."""


class _Asked(NamedTuple):
    key: str
    flag: str
    metavar: str
    words: str


SPEED = _Asked("tow.speed_m_s", "--speed", "M_S", "carriage speed, m/s")
LINE = _Asked("tow.line_length_m", "--line-length", "M", "length of the tow line, m")
POINT = _Asked("tow.tow_point_m", "--tow-point", "M", "tow point ahead of LCG, m")
TENSION = _Asked(
    "tow.tension_n", "--tension", "N|FILE", f"line tension, N, or a file of t_s, tension_n, or {NOT_MEASURED}"
)
AMPLITUDE = _Asked("tow.post_amplitude_m", "--amplitude", "M", "amplitude of the post, m")
FREQUENCY = _Asked("tow.post_frequency_hz", "--frequency", "HZ", "frequency of the post, Hz")
LENGTH = _Asked("model.length_pp_m", "--length", "M", "length of the model between perpendiculars, m")
MASS = _Asked("model.mass_kg", "--mass", "KG", "displacement mass of the model, kg")
DENSITY = _Asked("water.density_kg_m3", "--density", "KG_M3", "density of the water, kg/m3")
WIDTH = _Asked("water.tank_width_m", "--tank-width", "M", f"width of the tank, m, or {NOT_MEASURED}")
SIZE = _Asked("camera.image_size_px", "--size", "W,H", "width and height of the picture, px")
ASKED = (SPEED, LINE, POINT, TENSION, AMPLITUDE, FREQUENCY, LENGTH, MASS, DENSITY, WIDTH, SIZE)


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    sub.add_argument("folder", type=Path, nargs="?", default=Path(), metavar="FOLDER", help="default: this one")
    sub.add_argument("--yes", action="store_true", help="ask nothing: flags, and the defaults for the rest")
    sub.add_argument("--force", action="store_true", help="replace a run.toml that is there")
    sub.add_argument("--name", help="name of the run (default: the folder's)")
    sub.add_argument("--kind", metavar="tow|forced|free", help="kind of run (default: tow)")
    source = sub.add_mutually_exclusive_group()
    for what in ("video", "tracks", "motion"):
        source.add_argument(f"--{what}", metavar="FILE", help=f"the {what} (default: what lies in FOLDER)")
    for asked in ASKED:
        sub.add_argument(asked.flag, metavar=asked.metavar, help=asked.words)
    sub.add_argument(
        "--mark",
        nargs=4,
        action="append",
        metavar=("NAME", "AHEAD_M", "STARBOARD_M", "DEPTH_M"),
        help="a mark: from LCG, and below the datum plane (negative: above it); give at least two",
    )


def call(options: argparse.Namespace) -> int:
    """Ask, check, write, say what is left to do."""
    import tomllib

    from ..record.errors import InputError
    from ..record.run import RUN_FILE
    from ..record.schema import RunFile
    from ..record.template import PLACEHOLDER, run_text
    from ..record.toml import check_tables
    from ..record.typed import write_typed

    folder: Path = options.folder
    path = folder / RUN_FILE
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "", "is no folder")
    if path.exists() and not options.force:
        raise InputError(path, "", "is there already; --force replaces it")
    asker = Asker(path, options.yes, terminal(), say)
    content, size_px = _content(options, folder, asker)
    text = run_text(content, asker.assumed, size_px)
    check_tables(tomllib.loads(text), RunFile, path)
    write_typed(path, text, content.get("outside") is True)
    options.outcome.wrote(path)
    todo = []
    if any(point["name"].startswith(PLACEHOLDER) for point in content.get("datum", [])):
        todo.append(f"the {len(content['datum'])} [[datum]] points are an example that nobody picked: replace them")
    if asker.assumed:
        todo.append("defaults that nobody gave: " + ", ".join(asker.assumed))
    options.outcome.result |= {"run": content, "todo": todo}
    for line in todo:
        print(f"to do: {line}")
    print(f"then: towline check {folder}")
    return 0


def _content(options: argparse.Namespace, folder: Path, asker: Asker) -> tuple[dict[str, Any], tuple[int, int] | None]:
    """The tables of run.toml, and the size of the picture."""
    from ..record.run import leads_out
    from ..record.template import checked_value, example_datum

    def number(asked: _Asked, default: float) -> float:
        return _one(asker, options, asked, f"{default:.4g}", lambda said: checked_value(asked.key, numbers(said)[0]))

    name = asker.answer(
        "name",
        "--name",
        options.name,
        "name of the run",
        folder.resolve().name or "run",
        lambda text: checked_value("name", text),
        guess=False,
    )
    kind = asker.answer(
        "kind",
        "--kind",
        options.kind,
        "kind of run: tow, forced (the post oscillates) or free (no line)",
        "tow",
        lambda text: checked_value("kind", text),
    )
    what, file = _source(options, folder, asker)
    content: dict[str, Any] = {"name": name, "kind": kind, "source": {what: file}}
    size_px = (
        None if what == "motion" else _size(options, (folder / file).resolve() if what == "video" else None, asker)
    )
    length_m = number(LENGTH, 2.5)
    content["model"] = {"length_pp_m": length_m, "mass_kg": number(MASS, FULLNESS * length_m**3)}
    content["water"] = {"density_kg_m3": number(DENSITY, 1000.0)}
    width_m = _one(
        asker, options, WIDTH, NOT_MEASURED, _or_none(lambda t: checked_value(WIDTH.key, numbers(t)[0])), guess=False
    )
    if width_m is not None:
        content["water"]["tank_width_m"] = width_m
    tow: dict[str, Any] = {"speed_m_s": number(SPEED, 1.0)}
    if kind != "free":
        tow["line_length_m"] = number(LINE, 1.0)
        tow["tow_point_m"] = number(POINT, 0.55 * length_m)
        tension = _tension(options, folder, asker)
        if tension is not None:
            tow["tension_n" if isinstance(tension, float) else "tension"] = tension
    if kind == "forced":
        tow["post_amplitude_m"] = number(AMPLITUDE, 0.05)
        tow["post_frequency_hz"] = number(FREQUENCY, 0.2)
    content["tow"] = tow
    if any(leads_out(name) for name in (file, tow.get("tension")) if isinstance(name, str)):
        content["outside"] = True
    if size_px is not None:
        content["marker"] = _marks(options, asker, length_m)
        behind_m = -(tow.get("line_length_m", 1.0) + 1.2 * length_m)
        content["datum"] = example_datum(size_px, 0.0, behind_m, 1.0 if width_m is None else 0.5 * width_m)
    return content, size_px


def _one(
    asker: Asker,
    options: argparse.Namespace,
    asked: _Asked,
    default: str | None,
    parse: Callable[[str], Any],
    guess: bool = True,
) -> Any:
    given = getattr(options, asked.flag.removeprefix("--").replace("-", "_"))
    return asker.answer(asked.key, asked.flag, given, asked.words, default, parse, guess)


def _or_none(parse: Callable[[str], Any]) -> Callable[[str], Any]:
    return lambda text: None if text.strip().lower() == NOT_MEASURED else parse(text)


def _source(options: argparse.Namespace, folder: Path, asker: Asker) -> tuple[str, str]:
    """Which of video, tracks, motion, and its path from the folder."""
    from ..record.sources import is_recording, recordings_in

    given = next(((w, f) for w in ("video", "tracks", "motion") if (f := getattr(options, w)) is not None), None)
    if given is not None:
        what, file = given
        there = is_recording if what == "video" else Path.is_file
        return what, asker.answer(
            f"source.{what}", f"--{what}", file, "", None, lambda text: _inside(folder, text, there)
        )
    files = sorted(path.name for path in folder.iterdir() if path.is_file()) if folder.is_dir() else []
    found = recordings_in(folder)
    found += [name for name in files if Path(name).stem in ("tracks", "motion") and Path(name).suffix in TABLES]
    file = asker.answer(
        "source",
        "--video, --tracks or --motion FILE",
        None,
        "the video, or a table of tracks or motion",
        found[0] if found else None,
        lambda text: _inside(folder, text, is_recording),
        guess=len(found) > 1,
    )
    return _what((folder / file).resolve()), file


def _what(path: Path) -> str:
    """video, tracks or motion, by the suffix and the columns."""
    from ..record.tables import read_table

    if path.suffix.lower() not in TABLES:
        return "video"
    return "motion" if "y_cg_m" in read_table(path, ()).columns else "tracks"


def _inside(folder: Path, text: str, there: Callable[[Path], bool] = Path.is_file) -> str:
    """The path from the folder to a file that lies in it, or, as a second choice, at ``text`` from here."""
    if there(folder / text):
        return Path(text).as_posix()
    if there(Path(text)):
        return Path(os.path.relpath(text, folder)).as_posix()
    raise ValueError(f"a file is expected; there is none of this name in {folder}")


def _size(options: argparse.Namespace, video: Path | None, asker: Asker) -> tuple[int, int]:
    """Width and height of the picture, px: the video's own where there is one."""
    if video is not None and options.size is None:
        from ..vision.recording import clip_info

        info = clip_info(video)
        return info.width_px, info.height_px

    def parse(text: str) -> tuple[int, int]:
        wide, high = numbers(text.replace("x", " "), 2)
        if not (wide >= 1 and high >= 1 and wide % 1 == 0 and high % 1 == 0):
            raise ValueError("two whole numbers above 0, like 1280 720, are expected")
        return int(wide), int(high)

    return _one(asker, options, SIZE, SIZE_PX, parse)


def _tension(options: argparse.Namespace, folder: Path, asker: Asker) -> float | str | None:
    from ..record.template import checked_value

    def parse(text: str) -> float | str:
        try:
            value = numbers(text)[0]
        except ValueError:
            return _inside(folder, text)
        return checked_value(TENSION.key, value)

    there = [name for name in ("tension.csv", "tension.parquet") if (folder / name).is_file()]
    return _one(asker, options, TENSION, (there or [NOT_MEASURED])[0], _or_none(parse), guess=False)


def _marks(options: argparse.Namespace, asker: Asker, length_m: float) -> list[dict[str, Any]]:
    """Two marks that are asked for, or those of the flags."""
    from ..record.template import checked_value

    def place(text: str) -> list[float]:
        return list(checked_value("marker.body_m", tuple(numbers(text, 2))))

    usual = [("bow", None, None, None, 0.4), ("stern", None, None, None, -0.4)]
    rows = [(*mark, 0.0) for mark in options.mark] if options.mark else usual
    marks: list[dict[str, Any]] = []
    for number, (name, x, y, depth, ahead) in enumerate(rows, 1):
        key = f"marker.{number}"
        called = asker.answer(
            f"{key}.name",
            "--mark",
            name if options.mark else None,
            f"mark {number}: name",
            name,
            lambda text: checked_value("marker.name", text),
        )
        body_m = asker.answer(
            f"{key}.body_m",
            "--mark",
            None if x is None else f"{x} {y}",
            f"{called}: m ahead of LCG, m to starboard",
            f"{ahead * length_m:.3g} 0",
            place,
        )
        depth_m = asker.answer(
            f"{key}.depth_m",
            "--mark",
            depth,
            f"{called}: m below the datum plane (negative: above it)",
            "0",
            lambda text: checked_value("marker.depth_m", numbers(text)[0]),
        )
        marks.append({"name": called, "body_m": body_m, "depth_m": depth_m})
    return marks
