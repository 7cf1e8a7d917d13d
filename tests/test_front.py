"""The front door: a flat list of functions, each documented, each example of which runs; quick to open."""

from __future__ import annotations

import doctest
import inspect
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import FunctionType

import pytest

import towline
from towline.pipeline import front
from towline.record import DerivativesFile, InputError, read_result

NAMES = [name for name in towline.__all__ if name != "__version__"]


@pytest.fixture
def in_a_copy(samples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where ``sample_videos`` lie without their results; the scenario that is rendered is short."""
    shutil.copytree(samples, tmp_path / "sample_videos", ignore=shutil.ignore_patterns("out"))
    scenario = tmp_path / "sample_videos" / "mariner" / "x1446" / "scenario.toml"
    text, changed = re.subn(r"^duration_s = .*$", "duration_s = 2.0", scenario.read_text(), flags=re.MULTILINE)
    assert changed == 1
    scenario.write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_list_is_whole() -> None:
    assert sorted(front.__all__) == sorted(NAMES)
    assert set(NAMES) <= set(dir(towline))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        towline.nothing  # noqa: B018  # pyright: ignore


@pytest.mark.parametrize("name", NAMES)
def test_every_name_is_documented(name: str) -> None:
    function = getattr(front, name)
    assert isinstance(function, FunctionType)
    text = inspect.getdoc(function) or ""
    for section in ("Parameters", "Returns", "Raises", "Examples"):
        assert re.search(rf"^{section}\n-+$", text, flags=re.MULTILINE), section
    said = set(re.findall(r"^(\w+) : ", text.split("Returns\n")[0], flags=re.MULTILINE))
    signature = inspect.signature(function)
    assert said == set(signature.parameters)
    assert all(p.annotation is not p.empty for p in signature.parameters.values())
    assert signature.return_annotation is not signature.empty


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_example_runs(name: str, in_a_copy: Path, request: pytest.FixtureRequest) -> None:
    """That of ``track`` from the videos, others from videos that are tracked already: the test below tracks its own."""
    if name != "track":
        worked = request.getfixturevalue("worked")
        for out in (worked / "sample_videos").glob("*/*/out"):
            shutil.copytree(out, in_a_copy / out.relative_to(worked))
    function = getattr(front, name)
    [test] = doctest.DocTestFinder(recurse=False).find(function, name, globs={})
    done = doctest.DocTestRunner().run(test)
    assert done.attempted > 1
    assert not done.failed


@pytest.mark.slow
def test_what_is_called_gives_what_the_command_writes(in_a_copy: Path) -> None:
    from towline.cli import main

    runs = [f"sample_videos/mariner/{name}" for name in ("x1446", "x1649")]
    found = towline.identify(*runs, form="linear", line="constant")
    assert main(["identify", *runs, "--form", "linear", "--line", "constant", "--no-page", "-o", "out"]) == 0
    assert found == read_result(Path("out/derivatives.json"), DerivativesFile)
    with pytest.raises(InputError, match="no such run folder"):
        towline.track("nowhere")


def test_a_room_and_a_function_of_one_name_are_both_there() -> None:
    """In a fresh Python, in either order."""
    code = """
import sys, towline
assert not {"numpy", "pandas", "pydantic", "scipy", "cv2"} & set(sys.modules)
assert callable(towline.identify)
import towline.identify.fit
assert callable(towline.identify) and towline.identify.fit.Fit
from towline.simulate import Hull
import towline.diagnose as room
assert room.MotionError
try:
    towline.simulate("nowhere.toml")
except towline.record.InputError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "nowhere.toml" in done.stdout
