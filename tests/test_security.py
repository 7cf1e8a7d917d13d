"""What a hostile file, name or page could do, and does not: code, paths, markup, requests."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tomlkit

from towline.app.guard import MOST_BODY, Guard
from towline.cli import main
from towline.record import InputError, read_run, write_table
from towline.record.errors import TowlineError
from towline.record.gap_file import GapFile, NextRun, RankedEffects, Where
from towline.record.imported import import_tracks
from towline.record.results import Measured

ROOT = Path(__file__).resolve().parent.parent
ALLOWED = {
    "record/own_code.py: exec_module": "run_own: a Python file of the user's own, named outright on the command line",
    "diagnose/own/back.py: eval": "arithmetic of a corrected.json, node by node from a list",
    "pipeline/executor/copies.py: pickle": "between this process and its own forked copy, through a pipe; never from a file",
}
"""Where what runs code stands all the same, and why."""
MODULES = {"pickle", "cPickle", "dill", "marshal", "shelve", "yaml", "joblib", "cloudpickle"}
CALLS = {"eval", "exec", "exec_module", "system", "popen", "run_path", "run_module", "read_pickle", "to_pickle"}
HOSTILE = "<script>alert(1)</script>"
IMAGE = '"><img src=x onerror=alert(2)>'


@cache
def trees() -> dict[str, ast.AST]:
    """Every module of the package: its path and its tree."""
    found = {}
    left_out = ("tests", "benchmarks", "build", "docs", "examples")
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT).parts
        if not any(part.startswith(".") for part in parts) and parts[0] not in left_out:
            found["/".join(parts)] = ast.parse(path.read_text(encoding="utf-8"))
    return found


# code ----------------------------------------------------------------------------------------------------------------


def running(tree: ast.AST) -> Iterator[str]:
    """What a module uses that runs code, or reads files that can."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
            yield from (name for name in names if name.partition(".")[0] in MODULES)
        elif isinstance(node, ast.Call):
            called = node.func
            name = (
                called.id if isinstance(called, ast.Name) else called.attr if isinstance(called, ast.Attribute) else ""
            )
            if name in CALLS:
                yield name
            if any(
                k.arg == "shell" and not (isinstance(k.value, ast.Constant) and not k.value.value)
                for k in node.keywords
            ):
                words = {k.arg: k.value for k in node.keywords}
                if name in ("run", "call", "Popen", "check_call", "check_output") or isinstance(
                    words["shell"], ast.Constant
                ):
                    yield "shell"


def test_nothing_runs_code_from_a_file_but_what_is_listed() -> None:
    assert len(trees()) > 150
    found = {f"{path}: {what}" for path, tree in trees().items() for what in running(tree)}
    assert found == set(ALLOWED), "each use needs its reason here"


def test_the_search_for_code_finds_it() -> None:
    for text in (
        "eval('1')",
        "exec(x)",
        "import pickle",
        "from yaml import load",
        "os.system('ls')",
        "pd.read_pickle(p)",
        "import subprocess\nsubprocess.run('ls', shell=True)",
        "import marshal as m",
    ):
        assert list(running(ast.parse(text))), text


def test_arrays_are_read_without_pickles() -> None:
    seen = 0
    for path, tree in trees().items():
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr == "load"
                and isinstance(node.func.value, ast.Name)
                and node.func.value.id in ("np", "numpy")
            ):
                seen += 1
                given = {k.arg: k.value for k in node.keywords}.get("allow_pickle")
                assert isinstance(given, ast.Constant), path
                assert given.value is False, path
    assert seen


def test_another_programs_pickle_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "tracks.pkl"
    path.write_bytes(b"\x80\x04.")
    with pytest.raises(InputError, match="is a pickle"):
        import_tracks(path)


# paths ---------------------------------------------------------------------------------------------------------------


def test_paths_that_leave_the_run_folder_need_a_word(motion_run: Callable[..., Path], tmp_path: Path) -> None:
    other = motion_run(tmp_path / "other")
    for number, path in enumerate(("../other/motion.csv", str(other / "motion.csv"), "x/../../other/motion.csv", "..")):
        run = motion_run(tmp_path / f"run{number}", motion=path)
        with pytest.raises(InputError, match="leads out of the run folder; outside = true") as caught:
            read_run(run)
        assert caught.value.where == "source.motion"
        assert path in str(caught.value)
    allowed = motion_run(tmp_path / "allowed", motion="../other/motion.csv", more="outside = true")
    assert read_run(allowed).source_path.is_file()
    inside = motion_run(tmp_path / "inside", motion="./x/../motion.csv")
    (inside / "x").mkdir()
    assert read_run(inside).source_path.is_file()


@pytest.mark.parametrize("key", ["tension", "rudder", "speed"])
def test_every_key_that_names_a_file_is_looked_at(motion_run: Callable[..., Path], tmp_path: Path, key: str) -> None:
    run = motion_run(tmp_path / "run")
    text = (run / "run.toml").read_text()
    (run / "run.toml").write_text(text.replace("tension_n = 3.96", f'{key} = "/etc/passwd"'))
    with pytest.raises(InputError, match=f"tow.{key}: '/etc/passwd' leads out"):
        read_run(run)
    (run / "run.toml").write_text(text + '[noise]\nstatic = "../../static.csv"\n')
    with pytest.raises(InputError, match=r"noise\.static: .* leads out"):
        read_run(run)


def test_the_lens_is_a_file_like_the_others(motion_run: Callable[..., Path], tmp_path: Path) -> None:
    run = motion_run(tmp_path / "run")
    camera = "[camera]\nimage_size_px = [640, 480]\nfx_px = 500.0\nfy_px = 500.0\ncx_px = 320.0\ncy_px = 240.0\n"
    (run / "run.toml").write_text((run / "run.toml").read_text() + camera + 'calibration = "../lens.json"\n')
    with pytest.raises(InputError, match=r"camera\.calibration: '\.\./lens\.json' leads out"):
        read_run(run)
    inside = (run / "run.toml").read_text().replace("../lens.json", "lens.json")
    (run / "run.toml").write_text(inside)
    (run / "lens.json").write_text("{}")
    before = read_run(run).input_hash()
    (run / "lens.json").write_text("{ }")
    assert read_run(run).input_hash() != before  # what was made with another lens is made again


def test_a_link_in_the_folder_is_followed(motion_run: Callable[..., Path], tmp_path: Path) -> None:
    """Whoever made the link chose its target; a recording often lies on another disk."""
    other, run = motion_run(tmp_path / "other"), motion_run(tmp_path / "run")
    (run / "motion.csv").unlink()
    try:
        (run / "motion.csv").symlink_to(other / "motion.csv")
    except OSError:
        pytest.skip("links cannot be made here")
    assert read_run(run).source_path.is_file()


def test_names_that_are_no_paths(motion_run: Callable[..., Path], tmp_path: Path) -> None:
    for number, name in enumerate(("a" * 5000, "a\0b", "motion.csv/x", "\n")):
        with pytest.raises(TowlineError, match="no such file") as caught:
            read_run(motion_run(tmp_path / f"run{number}", motion=name))
        assert "\n" not in str(caught.value)


# pages ---------------------------------------------------------------------------------------------------------------


class Page(HTMLParser):
    """Tags, attributes and what is loaded."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.loads: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for key, value in attrs:
            assert not key.startswith("on"), f"<{tag} {key}={value}>"
            if key in ("src", "href", "srcset", "data", "action", "poster", "background"):
                self.loads.append(value or "")


def harmless(path: Path) -> str:
    """Asserts that a page holds no script, no foreign picture, and asks nothing of the outside."""
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert not {"script", "iframe", "object", "embed", "link", "base", "form"} & set(page.tags)
    for load in page.loads:
        assert load.startswith(("data:image/", "#")) or re.fullmatch(r"[\w.%-]*figures/[\w.-]+\.csv", load), load
    assert "x" not in page.loads
    assert not re.search(r"@import|url\(\s*['\"]?(?!data:)", text)
    assert "default-src 'none'" in text
    return text


@pytest.fixture(scope="module")
def hostile(motion_run: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs whose names, notes and folders are markup, and a third that cannot be read."""
    folder = tmp_path_factory.mktemp("hall") / "<b>hall"
    motion_run(folder / "<i>one", 1.446, HOSTILE, notes=IMAGE)
    motion_run(folder / "two", 1.649, IMAGE, notes=IMAGE)
    bad = motion_run(folder / "three", 1.548, "third", notes=IMAGE)
    (bad / "motion.csv").write_text(f"t_s,y_cg_m,beta_rad\n0,{HOSTILE},0\n")
    return folder


@pytest.mark.slow
def test_run_and_identify_pages_escape_every_name(hostile: Path, tmp_path: Path) -> None:
    runs = [str(hostile / name) for name in ("<i>one", "two", "three")]
    assert main(["run", *runs, "--form", "linear", "--noise", "output", "-o", str(tmp_path / "run")]) == 3
    assert main(["identify", *runs, "--form", "linear", "--noise", "output", "-o", str(tmp_path / "fit")]) == 3
    for path in (tmp_path / "run" / "report.html", tmp_path / "fit" / "derivatives.html"):
        text = harmless(path)
        assert "&lt;script&gt;alert(1)" in text
        assert "&lt;img src=x" in text


@pytest.mark.slow
def test_the_campaign_page_escapes_every_name(hostile: Path) -> None:
    assert main(["campaign", str(hostile), "--form", "linear", "--noise", "output"]) == 3
    text = harmless(hostile / "out" / "campaign.html")
    assert "&lt;script&gt;alert(1)" in text
    assert "&lt;b&gt;hall" in text


def test_the_check_page_escapes_every_name(cameras: ModuleType, tmp_path: Path) -> None:
    scene = cameras.random_scene(np.random.default_rng(3), 60)
    case = cameras.film(scene, np.random.default_rng(4), "deck height")
    content = case.run.file.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    content |= {"name": HOSTILE, "notes": IMAGE}
    content["datum"][0]["name"] = IMAGE
    old = content["marker"][0]["name"]
    content["marker"][0]["name"] = HOSTILE
    (tmp_path / "run.toml").write_text(tomlkit.dumps(content), encoding="utf-8")
    write_table(tmp_path / "tracks.csv", case.tracks.assign(marker=case.tracks["marker"].replace({old: HOSTILE})))
    assert main(["check", str(tmp_path), "--no-effects"]) == 0
    assert "&lt;script&gt;alert(1)" in harmless(tmp_path / "out" / "check.html")


def test_the_gap_page_escapes_every_name(tmp_path: Path) -> None:
    from towline.report.gap_page import write_gap_page

    number = Measured(value=1.0, std=0.1)
    file = GapFile(
        tool=IMAGE,
        inputs={},
        verdict="effect",
        where=Where(stage="sway", share={"sway": 1.0}, runs={HOSTILE: 1.0}, span_s=[0.0, 1.0], band_hz=[0.1, 1.0], when=IMAGE),
        ranking=[
            RankedEffects(
                effects=[HOSTILE], probability=0.9, parameters={f"{HOSTILE}.{IMAGE}": number}, gap_before=4.0, gap_after=1.0,
                shrink=0.9, shrink_interval=(0.8, 1.0), cure=IMAGE,
            )
        ],
        indistinguishable=[[HOSTILE, IMAGE]],
        p_no_gap=0.0,
        p_unknown=0.1,
        set95=[[HOSTILE]],
        next_run=NextRun(
            tow_point_m=1.0, line_length_m=1.0, speed_m_s=1.0, y_release_m=0.1, beta_release_rad=0.0, distance=1.0, why=IMAGE
        ),
        derivatives={"before": {HOSTILE: number}, "after": {HOSTILE: number}},
        noise={"side_n": 0.1, "moment_n_m": 0.1, "time_s": 3.0},
        runs=[HOSTILE],
        excluded={HOSTILE: IMAGE},
        sentences=[IMAGE],
    )  # fmt: skip
    run = SimpleNamespace(name=HOSTILE, centre_s=np.arange(5.0), covariance=np.stack([np.eye(5)] * 2))
    fitted = SimpleNamespace(linear=SimpleNamespace(rows=[(np.zeros((5, 2)),)]))
    diagnosis = SimpleNamespace(
        file=file,
        inference=SimpleNamespace(simulator=SimpleNamespace(step_s=1.0, runs=[run])),
        ranking=SimpleNamespace(base=fitted),
        best=SimpleNamespace(fitted=fitted),
        place=SimpleNamespace(drop={HOSTILE: np.ones(5)}),
    )
    found: Any = SimpleNamespace(diagnosis=diagnosis)
    write_gap_page(tmp_path / "gap.html", found)
    assert "&lt;script&gt;alert(1)" in harmless(tmp_path / "gap.html")


# the app: loopback, token, cookie, Origin and bounds are in test_app_guard.py --------------------------------------------------


@pytest.mark.parametrize("length", ["²", "9" * 5000, "1e9", "", " 1", "+1", str(MOST_BODY + 1)])
def test_a_stated_length_that_is_no_number_is_refused(length: str) -> None:
    import asyncio

    async def served(*_: Any) -> None:
        raise AssertionError("let through")

    guard = Guard(served, lambda _: False, 8123)
    head = [
        (b"host", b"127.0.0.1:8123"),
        (b"origin", b"http://127.0.0.1:8123"),
        (b"content-length", length.encode("latin-1")),
    ]
    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    async def receive() -> Any:
        return {"type": "http.disconnect"}

    def asked(cookie: str) -> None:
        headers = [*head, (b"cookie", cookie.encode())]
        scope = {
            "type": "http",
            "method": "POST",
            "path": f"/{guard._place}/x",
            "query_string": b"",
            "headers": headers,
        }
        asyncio.run(guard(scope, receive, send))

    asked(f"{guard.cookie}={guard._session}")
    assert sent[0]["status"] == 413


def test_the_app_listens_on_this_machine_only() -> None:
    tree = trees()["app/server.py"]
    hosts = [k.value for node in ast.walk(tree) if isinstance(node, ast.Call) for k in node.keywords if k.arg == "host"]
    named = {
        target.id: node.value.value
        for node in [*ast.walk(trees()["app/address.py"]), *ast.walk(tree)]
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    assert hosts
    for host in hosts:
        assert (named.get(host.id) if isinstance(host, ast.Name) else getattr(host, "value", None)) == "127.0.0.1"
