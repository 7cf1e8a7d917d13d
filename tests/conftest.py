"""Where things lie: the project, its sample videos, and the reference data that may stand beside the checkout."""

from __future__ import annotations

import base64
import importlib.util
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, chdir
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import pytest

if TYPE_CHECKING:
    from towline.app.session import Session
    from towline.record import DerivativesFile

ROOT = Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"
DEAREST = (
    "blind",
    "docs",
    "diagnose_surge",
    "surge_fit",
    "commands",
    "identify",
    "acquire",
    "diagnose",
    "campaign",
    "rough",
    "examples",
    "law",
    "effect_seam",
    "jerks",
    "app_browser",
    "end_to_end",
    "app",
    "identify_page",
    "budget",
    "datum_find",
    "blind_forms",
    "diagnose_motion",
    "front",
    "free_command",
    "hall",
    "identify_noise",
    "corrections",
    "doors",
    "check",
    "load_cell",
    "lens",
    "own_model",
    "figure_data",
    "plan",
    "faults",
    "identify_joint",
    "random_forces",
    "live",
    "static_noise",
)
"""Of the files that were timed (November 2026), those whose tests take longest: 15 to 150 s of CPU each. They begin, whole files
as their fixtures are shared, so that the last minute of several workers (``--dist worksteal``) is shared out in small pieces.
"""


CORES = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
"""Which this process may use; of what goes on before ``pytest_configure``."""


def pytest_configure() -> None:
    """Where there is a worker for every core, each keeps to its own: no diagnosis copies itself for a core that has work already,
    which costs a sixth more (a copy's findings are lost with it). Whether it does changes no answer (test_side_by_side.py).
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if CORES and worker and int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")) >= len(CORES):
        os.sched_setaffinity(0, {CORES[int(worker.removeprefix("gw")) % len(CORES)]})


@pytest.fixture
def two_cores() -> Iterator[None]:
    """All cores for the test; skips it where there is one, or where the system copies no process."""
    if sys.platform != "linux" or len(CORES) < 2:
        pytest.skip("the system copies no process, or has one core")
    own = os.sched_getaffinity(0)
    os.sched_setaffinity(0, CORES)
    yield
    os.sched_setaffinity(0, own)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The dearest files first, all others in their order; of tests marked ``once`` all cases but the first are slow."""
    begun: set[str] = set()
    for item in items:
        if item.get_closest_marker("once") is not None:
            function = item.nodeid.partition("[")[0]
            if function in begun:
                item.add_marker("slow")
            begun.add(function)
    place = {f"test_{name}.py": k for k, name in enumerate(DEAREST)}
    items.sort(key=lambda item: place.get(item.path.name, len(place)))


@pytest.fixture(scope="session")
def root() -> Path:
    return ROOT


@pytest.fixture(scope="session")
def samples(root: Path) -> Path:
    return root / "sample_videos"


@pytest.fixture(scope="session")
def shared() -> Path:
    if not SHARED.is_dir():
        pytest.skip("the reference data (../shared) does not stand beside this checkout")
    return SHARED


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], None]], Path]:
    """(name, what makes a folder's content) -> the folder: made by the first worker that asks, for all of them."""
    own = tmp_path_factory.getbasetemp()
    # a worker's own folder stands in the session's; where no file can be locked so, each makes its own
    alone = "PYTEST_XDIST_WORKER" not in os.environ or sys.platform == "win32"
    base = own if alone else own.parent

    def made(name: str, make: Callable[[Path], None]) -> Path:
        folder, done = base / f"once-{name}", base / f"once-{name}.done"
        with (base / f"once-{name}.lock").open("w") as lock:
            if not alone:
                import fcntl

                fcntl.flock(lock, fcntl.LOCK_EX)
            if not done.exists():
                shutil.rmtree(folder, ignore_errors=True)  # of one that failed here
                folder.mkdir()
                make(folder)
                done.touch()
        return folder

    return made


TRACKED = (
    "mariner/x1446",
    "mariner/x1548",
    "mariner/x1649",
    "mariner/x1751",
    "leander_steady/hole6",
    "leander_steady/hole3",
)
"""Samples that tests share as they are tracked and fitted."""


@pytest.fixture(scope="session")
def worked(made_once: Callable[[str, Callable[[Path], None]], Path]) -> Path:
    """A folder with sample_videos, six of the eight, tracked and fitted."""
    from towline.cli import main

    def make(folder: Path) -> None:
        for name in TRACKED:
            shutil.copytree(
                ROOT / "sample_videos" / name, folder / "sample_videos" / name, ignore=shutil.ignore_patterns("out")
            )
        with chdir(folder):
            mariner, leander = (
                [f"sample_videos/{n}" for n in TRACKED if n.startswith(kind)] for kind in ("mar", "lea")
            )
            assert main(["identify", "--no-page", *mariner]) == 0
            assert main(["steady", *leander]) == 0

    return made_once("docs", make)


def _cases(root: Path, name: str) -> ModuleType:
    """A module of cases with their truth, the benchmarks' own."""
    spec = importlib.util.spec_from_file_location(name, root / "benchmarks" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def live_senders(root: Path) -> ModuleType:
    """Sources on the loopback."""
    return _cases(root, "live_senders")


@pytest.fixture(scope="session")
def live_settles(root: Path) -> ModuleType:
    """Steady tows that settle."""
    return _cases(root, "live_settles")


@pytest.fixture(scope="session")
def live_joint(root: Path, pairs: ModuleType) -> ModuleType:
    """Two cameras' frames as they come."""
    return _cases(root, "live_joint")


@pytest.fixture(scope="session")
def laws_truth(root: Path) -> ModuleType:
    """The judge of laws, which shares nothing with their search."""
    return _cases(root, "laws_truth")


@pytest.fixture
def run_folder(tmp_path: Path, samples: Path) -> Path:
    """A copy of a sample, without results and truth."""
    folder = tmp_path / "x1446"
    folder.mkdir()
    for name in ("video.mp4", "run.toml"):
        shutil.copy(samples / "mariner" / "x1446" / name, folder)
    return folder


@pytest.fixture
def session(run_folder: Path) -> Iterator[Session]:
    """The page's state with that run open."""
    from towline.app.session import Session

    made = Session(run_folder)
    made.open(run_folder)
    yield made
    made.close()


@pytest.fixture(scope="session")
def cameras(root: Path) -> ModuleType:
    """Random cameras and planted faults."""
    return _cases(root, "geometry_cases")


@pytest.fixture(scope="session")
def pairs(root: Path) -> ModuleType:
    """Random tows before two cameras that are not synchronised."""
    return _cases(root, "two_cameras_cases")


@pytest.fixture(scope="session")
def films(root: Path) -> ModuleType:
    """Tows rendered before two such cameras."""
    return _cases(root, "two_cameras_films")


@pytest.fixture(scope="session")
def set_ups(root: Path) -> ModuleType:
    """Random set-ups as people write them, and mistakes."""
    return _cases(root, "mistakes_cases")


@pytest.fixture(scope="session")
def mistakes(root: Path, cameras: ModuleType, set_ups: ModuleType) -> ModuleType:
    """What towline says of them."""
    return _cases(root, "mistakes")


@pytest.fixture(scope="session")
def footage_scenes(root: Path) -> ModuleType:
    """Marks on a deck that moves over a tank, both cut from photographs; every place is known."""
    return _cases(root, "footage_scenes")


@pytest.fixture(scope="session")
def footage(root: Path, footage_scenes: ModuleType) -> ModuleType:
    """What towline makes of such a scene."""
    for name in ("footage_peers", "footage_real"):
        _cases(root, name)
    return _cases(root, "footage")


@pytest.fixture(scope="session")
def campaigns(root: Path) -> ModuleType:
    """Simulated tows."""
    return _cases(root, "identify_cases")


@pytest.fixture(scope="session")
def surge_cases(root: Path) -> ModuleType:
    """Tows with surge in full on a line of constant length, from equations of their own."""
    return _cases(root, "surge_cases")


@pytest.fixture(scope="session")
def steady_tows(root: Path) -> ModuleType:
    """Swinging and settled tows, by two simulators."""
    return _cases(root, "steady")


@pytest.fixture(scope="session")
def doors_wire(root: Path) -> ModuleType:
    """Attacks on a started app over its port."""
    return _cases(root, "doors_wire")


@pytest.fixture(scope="session")
def browsers(root: Path) -> ModuleType:
    """Chromium, where there is one."""
    made = _cases(root, "browser")
    if made.CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    return made


@pytest.fixture(scope="session")
def doors_browser(root: Path, browsers: ModuleType, doors_wire: ModuleType) -> ModuleType:
    """Attacks on a started app in Chromium."""
    assert {browsers.__name__, doors_wire.__name__} <= sys.modules.keys()  # it imports them
    return _cases(root, "doors_browser")


@pytest.fixture(scope="session")
def cases(root: Path) -> ModuleType:
    """Filmed campaigns with a planted effect."""
    return _cases(root, "gap_cases")


@pytest.fixture
def registries() -> Iterator[None]:
    """Looks, sources and estimators that the test registers are forgotten behind it."""
    from towline.identify.estimators import ESTIMATORS
    from towline.record.looks import DATUM_LOOKS, LOOKS
    from towline.record.sources import KINDS
    from towline.vision.datum_find import FINDERS
    from towline.vision.looks import TRACKERS
    from towline.vision.recording.source import OPENED_BY

    with ExitStack() as stack:
        for table in (LOOKS, TRACKERS, DATUM_LOOKS, FINDERS, KINDS, OPENED_BY, ESTIMATORS):
            stack.enter_context(table.kept())
        yield


MOTION_RUN = """\
name = {name}
notes = {notes}
{more}
[source]
motion = {motion}
[tow]
speed_m_s = 1.28
line_length_m = 0.91
tow_point_m = {point}
line = "constant"
tension_n = 3.96
[model]
length_pp_m = 2.66
mass_kg = 78.0
[water]
density_kg_m3 = 1000.0
"""


@pytest.fixture(scope="session")
def motion_run() -> Callable[..., Path]:
    """(folder, tow point m, name, what source.motion says, notes, further keys) -> a run that came as motion, 40 s."""
    import tomlkit

    from towline.record import write_table
    from towline.simulate import Hull, Start, Tow, simulate_full

    hull = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28)

    def made(
        folder: Path,
        point: float = 1.548,
        name: str = "tow",
        motion: str = "motion.csv",
        notes: str = "",
        more: str = "",
    ) -> Path:
        folder.mkdir(parents=True)
        t_s = np.arange(400) / 10
        table = simulate_full(hull, Tow(1.28, 0.91, point, 3.96), Start(y_cg_m=0.2), t_s)
        table = table[["t_s", "y_cg_m", "beta_rad", "alpha_rad"]]
        table[["y_cg_m", "beta_rad"]] += np.random.default_rng(1).normal(0, 1e-3, (len(t_s), 2))
        write_table(folder / "motion.csv", table)
        texts = {"name": name, "notes": notes, "motion": motion}
        quoted = {key: tomlkit.item(value).as_string() for key, value in texts.items()}
        (folder / "run.toml").write_text(MOTION_RUN.format(point=point, more=more, **quoted), encoding="utf-8")
        return folder

    return made


@pytest.fixture(scope="session")
def end_to_end(root: Path) -> ModuleType:
    """Random campaigns from hull to film, and what comes out of them."""
    _cases(root, "end_to_end_cases")
    return _cases(root, "end_to_end")


@pytest.fixture(scope="session")
def tow_runs(cases: ModuleType) -> Callable[[int, int], list]:
    """(seed, how many) -> tows without any effect, as the diagnosis takes them."""
    from towline.diagnose.tow.data import Recorded, block_step, tow_runs
    from towline.geometry import motion_from_tracks, run_datum

    def made(seed: int, count: int) -> list:
        found = []
        for run, tracks, static in cases.campaign("none", np.random.default_rng(seed)).runs[:count]:
            fit = run_datum(run, None)
            motion = motion_from_tracks(run, tracks, fit)
            found.append(Recorded(run, motion.motion, motion.common, tracks, fit, static))
        return tow_runs(found, block_step([45.0]))

    return made


@pytest.fixture(scope="session")
def write_runs() -> Callable[..., list[Path]]:
    """(runs of a simulated campaign, folder, until when, s) -> their run folders, with tracks and static records."""
    import tomlkit

    from towline.record.tables import write_table

    def written(runs: list, folder: Path, until_s: float = np.inf) -> list[Path]:
        paths = []
        for run, tracks, static in runs:
            path = folder / run.name
            path.mkdir(parents=True)
            content = run.file.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
            (path / "run.toml").write_text(tomlkit.dumps(content))
            write_table(path / "tracks.csv", tracks[tracks["t_s"] < until_s])
            write_table(path / "static.csv", static)
            paths.append(path)
        return paths

    return written


@pytest.fixture(scope="session")
def derivatives_of() -> Callable[..., DerivativesFile]:
    """(values (6,), their sd, (rho, L, U), mass, correlation, further keys) -> a derivatives.json."""
    from towline.identify import prime_factors
    from towline.record import Derivative, DerivativesFile
    from towline.simulate import DERIVATIVE_UNITS

    def made(
        values: np.ndarray,
        std: np.ndarray,
        size: tuple[float, float, float] = (1000.0, 2.66, 1.28),
        mass_kg: float = 78.0,
        correlation: np.ndarray | None = None,
        **more: Any,
    ) -> DerivativesFile:
        rows = zip(DERIVATIVE_UNITS.items(), values, std, prime_factors(*size), strict=True)
        given: dict[str, Any] = {
            "tool": "test",
            "inputs": {},
            "method": "output_error",
            "form": "full",
            "density_kg_m3": size[0],
            "length_pp_m": size[1],
            "speed_m_s": size[2],
            "mass_kg": mass_kg,
            "derivatives": {
                name: Derivative(value=v, std=s, unit=unit, prime=v / f, prime_std=s / f)
                for (name, unit), v, s, f in rows
            },
            "correlation": (np.eye(6) if correlation is None else correlation).tolist(),
            "straight_line_stable": False,
            "runs": {},
            "failed": {},
            "not_identifiable": [],
            "notes": [],
        }
        return DerivativesFile(**{**given, **more})

    return made


@pytest.fixture(scope="session")
def table_in() -> Callable[[Any], Any]:
    """(annotation of a key of run.toml) -> the model of the table that stands there, alone or in a list; None: a value."""
    from pydantic import BaseModel

    def found(annotation: Any) -> Any:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            return annotation
        return next((model for part in get_args(annotation) if (model := found(part)) is not None), None)

    return found


@pytest.fixture(scope="session")
def files_of() -> Callable[[Path], dict[str, bytes]]:
    """(folder) -> every file below it, by its path; a campaign's lock is none."""

    def found(folder: Path) -> dict[str, bytes]:
        paths = [p for p in sorted(folder.rglob("*")) if p.is_file() and p.name != ".campaign.lock"]
        return {p.relative_to(folder).as_posix(): p.read_bytes() for p in paths}

    return found


class _Outline(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []
        self.identifiers: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img"):
            self.open.append(tag)
        given = {key: value or "" for key, value in attrs}
        self.references += [given[key] for key in ("src", "href", "srcset", "data", "action") if key in given]
        if "id" in given:
            self.identifiers.append(given["id"])

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="session")
def self_contained() -> Callable[[str], list[bytes]]:
    """Asserts that a page is well formed and asks nothing of the outside; gives its drawn pictures."""

    def pictures_of(page: str) -> list[bytes]:
        outline = _Outline()
        outline.feed(page)
        assert outline.open == []
        assert len(set(outline.identifiers)) == len(outline.identifiers)
        for reference in outline.references:
            if re.fullmatch(
                r"[\w.%-]*figures/[\w.-]+\.csv", reference
            ):  # a link to the numbers beside the page loads nothing
                continue
            assert reference.startswith(("data:image/", "#"))
            if reference.startswith("#"):
                assert reference[1:] in outline.identifiers
        assert not re.search(r"@import|url\(|<link|<iframe|<script", page)
        drawn = [base64.b64decode(r.partition(",")[2]) for r in outline.references if r.startswith("data:image/svg")]
        for svg in drawn:
            assert not re.search(rb'href="(?!#|data:)', svg)
            assert b"script" not in svg  # no name enters a picture
        return drawn

    return pictures_of


@pytest.fixture
def straight_tow() -> Callable[[dict], dict]:
    """A scenario of 20 s, on the centre line, by hull and effects as ``towline diagnose --write-model`` saves them."""

    def scenario(saved: dict) -> dict:
        return {
            "name": "again",
            "time": {"duration_s": 20.0, "rate_hz": 10.0},
            "hull": saved["hull"],
            "effect": saved["effect"],
            "tow": {"speed_m_s": 1.28, "line_length_m": 0.91, "tow_point_m": 1.6, "tension_n": 3.96},
            "start": {"y_cg_m": 0.0},
            "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
        }

    return scenario
