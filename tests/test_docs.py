"""The docs are true: links and anchors lead somewhere, the site builds and asks nothing of the outside, and every code block runs.

What a block says after its language: ``sh`` runs and ends with 0, ``console`` runs what follows ``$`` and its output must hold the
lines below (``...``: anything; numbers to 2 %), ``console exit 3`` ends with that code, ``sh usage`` is held against the
commands' own options, ``toml NAME.toml`` is a whole file of that schema, ``toml part of NAME.toml`` completes the sample run's,
``no-run (why)`` cannot run here. ``text`` is no code.
"""

from __future__ import annotations

import contextlib
import glob
import importlib.util
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

from towline.cli import command_parser, main
from towline.record.budget_file import BudgetInputs
from towline.record.corrections import Corrections
from towline.record.instruments.setup import SetupFile
from towline.record.own_data import OwnData
from towline.record.plan_file import PlanRequest
from towline.record.priors import Priors
from towline.record.scenario import ScenarioFile
from towline.record.schema import RunFile
from towline.record.toml import check_tables

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(
    [p for p in (ROOT / "docs").rglob("*.md") if "site" not in p.relative_to(ROOT / "docs").parts]
    + [ROOT / "README.md", ROOT / "sample_videos" / "README.md"]
)
APP = "app.md"
"""Comes into the navigation by docs/site/hooks.py as soon as it is there."""
SCHEMAS = {
    "run.toml": RunFile,
    "plan.toml": PlanRequest,
    "inputs.toml": BudgetInputs,
    "data.toml": OwnData,
    "setup.toml": SetupFile,
    "corrections.toml": Corrections,
    "priors.toml": Priors,
    "scenario.toml": ScenarioFile,
}
MOST_NOT_RUN = 8
NUMBER_REL = 0.02  # another machine's linear algebra moves what is printed by less
SMALL = 0.05  # near nought: residuals and scores, to their last printed digit or two
LINK = re.compile(r"\]\(([^)\s#]*)(#[^)\s]*)?(?:\s[^)]*)?\)")
FENCE = re.compile(r"^\s*```(\S*)\s*(.*)$")


@dataclass(frozen=True)
class Block:
    page: Path
    line: int
    language: str
    marker: str
    text: str

    @property
    def place(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def split(page: Path) -> tuple[list[Block], list[str]]:
    """Fenced blocks, and the lines outside of them."""
    blocks: list[Block] = []
    prose: list[str] = []
    begun: tuple[int, str, str] | None = None
    inside: list[str] = []
    for number, line in enumerate(page.read_text(encoding="utf-8").split("\n"), 1):
        fence = FENCE.match(line)
        if begun is None and fence:
            begun, inside = (number, fence[1], fence[2]), []
        elif begun is not None and line.strip() == "```":
            blocks.append(Block(page, begun[0], begun[1], begun[2], "\n".join(inside) + "\n"))
            begun = None
        elif begun is not None:
            inside.append(line)
        else:
            prose.append(line)
    assert begun is None, f"{page}: a fence stays open"
    return blocks, prose


BLOCKS = {page: split(page)[0] for page in PAGES}


def anchors(page: Path) -> set[str]:
    """GitHub's anchors of a page's headings."""
    heads = [line.lstrip("#").strip() for line in split(page)[1] if line.startswith("#")]
    return {re.sub(r"[^\w\- ]", "", re.sub(r"`|\*", "", head).lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_links_and_pictures_are_there(page: Path) -> None:
    for target, anchor in LINK.findall("\n".join(split(page)[1])):
        if "://" in target or target.startswith("mailto:"):
            continue
        place = (page.parent / target).resolve() if target else page
        if place.name == "api.md":  # made when the site is built
            continue
        assert place.exists(), f"{page.name}: {target} is not there"
        if anchor and place.suffix == ".md":
            assert anchor[1:] in anchors(place), f"{page.name}: {target}{anchor} leads nowhere"


def test_pictures_are_small() -> None:
    found = list((ROOT / "docs" / "pictures").iterdir())
    assert {p.suffix for p in found} <= {".svg", ".png", ".webp"}
    assert sum(p.stat().st_size for p in found) < 1.5e6
    words = "\n".join(p.read_text(encoding="utf-8") for p in PAGES)
    for picture in found:
        assert f"pictures/{picture.name}" in words, f"{picture.name} is in no page"


def test_every_page_is_in_the_navigation() -> None:
    listed = re.findall(r"[\w/.-]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    there = [p.relative_to(ROOT / "docs").as_posix() for p in PAGES if ROOT / "docs" in p.parents]
    made = {name for name in listed if re.fullmatch(r"api\.md|api/\w+\.md", name)}
    assert made == set(site_module("api").pages())
    assert (set(there) | made | {"readme.md", "sample_videos/README.md"}) - {APP} == set(listed)
    assert len(listed) == len(set(listed))


# blocks --------------------------------------------------------------------------------------------------------------


def test_every_block_says_what_it_is() -> None:
    skipped = []
    for block in (b for found in BLOCKS.values() for b in found):
        allowed = {
            "sh": r"|usage|no-run \(.+\)",
            "console": r"|exit \d+|no-run \(.+\)",
            "python": r"|no-run \(.+\)",
            "matlab": r"no-run \(.+\)",
            "toml": rf"({'|'.join(SCHEMAS)})|part of run\.toml",
            "json": "",
            "text": "",
        }
        assert block.language in allowed, f"{block.place}: what is {block.language!r}?"
        assert re.fullmatch(allowed[block.language], block.marker), f"{block.place}: {block.marker!r}"
        if block.marker.startswith("no-run"):
            skipped.append(f"{block.place}: {block.marker}")
    print(*skipped, sep="\n")
    assert len(skipped) <= MOST_NOT_RUN, skipped


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_no_code_hides_in_indented_text(page: Path) -> None:
    for line in split(page)[1]:
        assert not re.match(r" {4,}(\$ |towline |make |pip |python|import |from \w+ import|\[\[?\w+\]\]?$)", line), line


@pytest.mark.parametrize(
    "page", [p for p in PAGES if any(b.marker == "usage" for b in BLOCKS[p])], ids=lambda p: p.name
)
def test_usage_is_what_the_commands_take(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parser = command_parser()
    for block in (b for b in BLOCKS[page] if b.marker == "usage"):
        for line in filter(None, (line.partition(" #")[0].strip() for line in block.text.split("\n"))):
            for words in spelled_out(line):
                assert words[0] == "towline", f"{block.place}: {line}"
                try:
                    parser.parse_args(words[1:])
                except SystemExit:
                    pytest.fail(f"{block.place}: {line}: {capsys.readouterr().err}")


def spelled_out(line: str) -> list[list[str]]:
    """A line of usage as one might type it: options in brackets taken and left, the first and the last of what a bar parts."""
    line = line.partition(" > ")[0]
    found = []
    for shown in (re.sub(r"\[([^\]]*)\]", r"\1", line), re.sub(r"\[[^\]]*\]", "", line)):
        for which in (0, -1):
            words = [word.split("|")[which].replace("...", "") for word in shlex.split(shown)]
            found.append([word for word in words if word])
    return found


@pytest.mark.parametrize(
    "page", [p for p in PAGES if any(b.language == "toml" for b in BLOCKS[p])], ids=lambda p: p.name
)
def test_tables_are_of_their_schema(page: Path, samples: Path) -> None:
    for block in (b for b in BLOCKS[page] if b.language == "toml"):
        content = tomllib.loads(block.text)
        name = block.marker.split()[-1]
        if block.marker.startswith("part"):
            whole = tomllib.loads((samples / "mariner" / "x1446" / name).read_text(encoding="utf-8"))
            for key, value in content.items():
                if isinstance(value, list) and isinstance(whole.get(key), list):
                    named = {entry["name"]: entry for entry in [*whole[key], *value]}
                    whole[key] = list(named.values())
                else:
                    whole[key] = value
            content = whole
        check_tables(content, SCHEMAS[name], block.place)


def test_a_table_of_no_schema_would_be_seen() -> None:
    with pytest.raises(Exception, match="tow_pint_m"):
        check_tables({"name": "a", "tow": {"tow_pint_m": 1.0}}, RunFile, "here")


# running them --------------------------------------------------------------------------------------------------------


RUNNABLE = [
    page
    for page in PAGES
    if any(
        b.language in ("sh", "console", "python") and not b.marker.startswith(("usage", "no-run")) for b in BLOCKS[page]
    )
]


LONG = {
    "campaign.md", "commands.md", "derivatives.md", "effect.md", "figures.md", "gap.md", "index.md", "plan.md", "source.md",
    "tutorial.md", "winch.md",
}  # fmt: skip
"""Pages whose blocks take more than a few seconds."""


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[pytest.mark.slow] * (page.name in LONG)) for page in RUNNABLE],
    ids=[page.relative_to(ROOT).as_posix() for page in RUNNABLE],
)
def test_blocks_run(
    page: Path, worked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, registries: None
) -> None:
    """In the order of the page, in a folder of its own, with one namespace for its Python."""
    shutil.copytree(worked / "sample_videos", tmp_path / "sample_videos")
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    names: dict[str, object] = {"__name__": page.stem}
    for block in BLOCKS[page]:
        if block.marker.startswith(("usage", "no-run")):
            continue
        if block.language == "toml" and block.marker in SCHEMAS:
            Path(block.marker).write_text(block.text, encoding="utf-8")
        elif block.language == "python":
            lead = "\n" * block.line
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile(lead + block.text, str(page), "exec"), names)
        elif block.language == "sh":
            for line in joined(block.text):
                code, said = shell(line)
                assert code == 0, f"{block.place}: {line} ended with {code}: {said[-1500:]}"
        elif block.language == "console":
            console(block)
    if page.parent.name == "gallery":
        drawn = Path(f"{page.stem}.webp")
        assert size_px(drawn) == size_px(ROOT / "docs" / "pictures" / f"gallery_{drawn}")


def size_px(picture: Path) -> tuple[int, ...]:
    import cv2

    read = cv2.imread(str(picture))
    assert read is not None, picture
    assert read.std() > 5, f"{picture}: nothing is drawn"
    return read.shape


def joined(text: str) -> list[str]:
    """Commands of a block, those that go on behind a backslash in one."""
    lines = text.replace("\\\n", " ").split("\n")
    return [line for line in lines if line.strip() and not line.startswith("#")]


def shell(line: str) -> tuple[int, str]:
    """Exit code and output; plain towline commands in this process, which saves their imports."""
    words = shlex.split(line, comments=True)
    if words[0] != "towline" or re.search(r"[|&;<>$]", line.partition(" #")[0]):
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False, timeout=120)
        return done.returncode, done.stdout + done.stderr
    spread = [name for word in words[1:] for name in (sorted(glob.glob(word)) if "*" in word else [word])]
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = main(spread)
    return code, said.getvalue()


def console(block: Block) -> None:
    expected_code = int(block.marker.split()[-1]) if block.marker else 0
    parts = re.split(r"^\$ ", block.text, flags=re.MULTILINE)
    assert not parts[0].strip(), f"{block.place}: output before the first command"
    for part in parts[1:]:
        command, _, shown = part.replace("\\\n", " ").partition("\n")
        code, said = shell(command)
        assert code == expected_code, f"{block.place}: {command} ended with {code}: {said[-1500:]}"
        at = 0
        words = plain(said)
        for piece in shown.split("..."):
            wanted = plain(piece)
            found = next((k for k in range(at, len(words) - len(wanted) + 1) if alike(wanted, words[k:])), None)
            assert found is not None, f"{block.place}: {piece.strip()!r} is not in the output:\n{said}"
            at = found + len(wanted)


def plain(text: str) -> list[str]:
    """Words, numbers and signs, without the frames of tables."""
    text = re.sub(r"[─-╿]", " ", text)
    return re.findall(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?|[^\W\d]+|[^\s\w]", text)


def alike(wanted: list[str], words: list[str]) -> bool:
    return all(one == other or close(one, other) for one, other in zip(wanted, words))


def close(one: str, other: str) -> bool:
    try:
        a, b = float(one), float(other)
    except ValueError:
        return False
    return abs(a - b) <= max(NUMBER_REL * abs(a), SMALL if "." in one else 0.0)


def test_outputs_are_compared_by_their_numbers() -> None:
    assert alike(plain("Y_v -53.06 +- 0.08"), plain("│ Y_v │ -53.10 +- 0.10 kg"))
    assert not alike(plain("Y_v -53.06"), plain("Y_v -55.0"))
    assert not alike(plain("4 runs"), plain("5 runs"))


# the site ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mkdocs", reason="the test extra holds mkdocs")
    folder = tmp_path_factory.mktemp("site")
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "-f",
        str(ROOT / "mkdocs.yml"),
        "-d",
        str(folder),
    ]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def site_module(name: str) -> ModuleType:
    """One of docs/site, which is no package."""
    spec = importlib.util.spec_from_file_location(f"docs_{name}", ROOT / "docs" / "site" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_docstring_of_the_house_is_numpydoc_for_the_site() -> None:
    text = "Fit.\n\nParameters\n----------\nruns : one or more\n\nWhere it fails, more.\n\nRaises\n------\nTypeError : no run\n"
    told = site_module("sections").numpydoc(text)
    assert "runs\n    one or more\n" in told
    assert "TypeError\n    no run\n" in told
    assert told.index("Where it fails, more.") < told.index("Parameters")


@pytest.mark.slow
def test_the_site_is_whole(site: Path) -> None:
    for page in PAGES:
        if ROOT / "docs" in page.parents:
            name = page.relative_to(ROOT / "docs").with_suffix(".html").as_posix().replace("README", "index")
            assert (site / name).is_file(), name
    for page in site_module("api").pages():
        assert (site / page).with_suffix(".html").is_file(), page
    door = (site / "api.html").read_text(encoding="utf-8")
    for name in ("track", "identify", "diagnose"):
        assert f'id="towline.{name}"' in door
    room = (site / "api" / "identify.html").read_text(encoding="utf-8")
    fit_runs = room[room.index('id="towline.identify.fit_runs"') :]
    shown = re.sub(r"<[^>]+>", "", fit_runs[: fit_runs.index("fit_steady")])
    for part in ("runs: list[RunData]", "one or more; runs of one hull share", "EstimationError"):
        assert part in shown, part
    assert (site / "search" / "search_index.json").is_file()
    assert (site / "benchmarks" / "identify.txt").is_file()


@pytest.mark.slow
def test_the_site_asks_nothing_of_the_outside(site: Path) -> None:
    loaded = re.compile(
        r"<(?:script|link|img|iframe|source|video|object)\b[^>]*?\b(?:src|href|srcset|data)=[\"']?([^\"'\s>]+)"
    )
    seen = 0
    for path in site.rglob("*.html"):
        for target in loaded.findall(path.read_text(encoding="utf-8")):
            seen += 1
            assert not re.match(r"(?:https?:)?//", target), f"{path.name} loads {target}"
    assert seen > 100
    for path in site.rglob("*.css"):
        style = path.read_text(encoding="utf-8")
        assert not re.search(r"(?:@import|url\()\s*[\"']?(?:https?:)?//", style), path.name


def test_markers_and_tight_lists_reach_the_site_as_markdown() -> None:
    hooks = site_module("hooks")
    text = "Then\n- one\n  more\n- two\n\n```sh no-run (why)\nThen\n- not a list\n```\n"
    assert hooks.for_python_markdown(text) == "Then\n\n- one\n  more\n- two\n\n```sh\nThen\n- not a list\n```\n"
    assert hooks.with_inner_links("[a](../benchmarks/x.txt) [b](b.md#c)", "d.md") == "[a](benchmarks/x.txt) [b](b.md#c)"
    assert hooks.with_inner_links("[a](../../tests/x.py)", "methods/d.md") == "[a](../tests/x.py)"
    assert hooks.with_inner_links("[a](../docs/x.md)", "sample_videos/README.md") == "[a](../x.md)"


TRACED = re.compile(r"^\| `(.+?)` \| ([\w/-]+\.txt) \| `(.+?)` \|$", re.MULTILINE)
TRACED_PAGE = re.compile(r"^\| ([\w/-]+\.md) \| `(.+?)` \| ([\w/-]+\.txt) \| `(.+?)` \|$", re.MULTILINE)


def test_the_figures_of_how_well_stand_in_the_benchmarks_tables() -> None:
    rows = TRACED.findall((ROOT / "benchmarks" / "README.md").read_text())
    assert len(rows) > 20
    page = (ROOT / "docs" / "how-well.md").read_text()
    for said, file, there in rows:
        assert said.replace("\\|", "|") in page, f"docs/how-well.md does not say {said!r}"
        assert there in (ROOT / "benchmarks" / file).read_text(), f"benchmarks/{file} does not hold {there!r}"


def test_the_readme_is_short_and_its_figures_are_those_of_how_well() -> None:
    """150 lines, three tables at most of how well it does, each row of them as the page has it; a sentence with a share, too."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(readme.splitlines()) <= 150
    said = readme.partition("## How well\n")[2].partition("\n## ")[0]
    page = (ROOT / "docs" / "how-well.md").read_text(encoding="utf-8")
    rows = [line for line in said.splitlines() if line.startswith("|")]
    assert 1 <= sum(row.startswith("|---") for row in rows) <= 3
    for row in rows:
        assert row in page, f"docs/how-well.md does not hold {row}"
    flat = " ".join(page.split())
    sentences = re.split(r"(?<=[.;:]) ", " ".join(line for line in said.splitlines() if not line.startswith("|")))
    shares = [one.strip(" .;") for one in sentences if re.search(r"\d of \d|\d %|\d called", one)]
    assert len(shares) >= 2
    for one in shares:
        assert one in flat, f"docs/how-well.md does not say {one!r}"


def test_the_figures_of_the_pages_stand_in_the_benchmarks_tables() -> None:
    rows = TRACED_PAGE.findall((ROOT / "benchmarks" / "README.md").read_text())
    assert len(rows) >= 5
    for page, said, file, there in rows:
        assert said.replace("\\|", "|") in (ROOT / "docs" / page).read_text(), f"docs/{page} does not say {said!r}"
        assert there in (ROOT / "benchmarks" / file).read_text(), f"benchmarks/{file} does not hold {there!r}"
