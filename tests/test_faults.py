"""Bad input and bad circumstances: what is damaged is refused in one line or taken with its promises kept; outputs stay whole."""

from __future__ import annotations

import ast
import errno
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pandas as pd
import pytest
from hypothesis import HealthCheck, Phase, given, settings

from towline.cli import main
from towline.identify import run_data, steady_state
from towline.identify.methods import fit_decay
from towline.record import EstimationError, InputError, TowlineError, read_motion, read_run, read_table, read_tracks
from towline.record.imported import Wanted, import_tracks
from towline.record.results import DerivativesFile, read_result

ROOT = Path(__file__).resolve().parent.parent
CASES, SLOW_CASES = 40, 6
SLICE = {
    "derandomize": True, "database": None, "deadline": None, "phases": (Phase.generate,),
    "suppress_health_check": list(HealthCheck),
}  # fmt: skip
FILE_LIMIT_BYTES = 8192
BOMB = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\x01\x11p\0\x01\x11p\x10\0\0\0\0J\xc5\xb7T"
"""A picture of 70,000 by 70,000, as its header says."""


def benchmark(name: str) -> ModuleType:
    """A module of the benchmarks, by its name (they import one another by theirs)."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "benchmarks" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


benchmark("faults_cases")
BASES = benchmark("faults_bases")
READERS = benchmark("faults_readers")
ESTIMATORS = benchmark("faults_estimators")


# readers and estimators ----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # what numpy warns of on nonsense is no matter here: the answer is judged
@pytest.mark.parametrize("reader", READERS.readers(), ids=lambda one: one.name)
def test_a_reader_takes_or_refuses_whatever_it_is_given(reader: Any, tmp_path: Path) -> None:
    READERS.prepared(reader, tmp_path)
    seen: set[str] = set()

    @settings(max_examples=CASES, **SLICE)
    @given(reader.damaged)
    def any_case(data: bytes) -> None:
        seen.add(READERS.judged(reader, tmp_path, data))  # anything that is not handled is raised

    any_case()
    assert "refused" in seen


@pytest.mark.once
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("estimator", ESTIMATORS.estimators(), ids=lambda one: one.name)
def test_an_estimator_answers_or_refuses(estimator: Any) -> None:
    @settings(max_examples=max(1, round(estimator.share * SLOW_CASES)), **SLICE)
    @given(estimator.cases)
    def any_case(case: Any) -> None:
        assert ESTIMATORS.estimated(estimator, case) in ("accepted", "refused")

    any_case()


@pytest.mark.parametrize(
    ("name", "data", "read", "words"),
    [
        ("run.toml", b"x = " + b"9" * 5000, lambda p: read_run(p.parent), "not valid TOML"),
        ("run.toml", b"x = 0x" + b"f" * 5000, lambda p: read_run(p.parent), "beyond 64 bits"),
        ("run.toml", b"x = " + b"[" * 5000, lambda p: read_run(p.parent), "too deep"),
        ("run.toml", b"x" + b".a" * 5000 + b" = 1", lambda p: read_run(p.parent), "too deep"),
        ("run.toml", b'name = "t"\n[t\x0bow]\n', lambda p: read_run(p.parent), r"t\\x0bow"),
        ("run.toml", b'"a\\u001b[2J\\u2028b" = 1\n', lambda p: read_run(p.parent), r"a\\x1b\[2J\\u2028b"),
        ("h.csv", b"t_s,tension_n\n0,4,9\n1,4,9\n", lambda p: read_table(p, ("t_s",)), "row 1: 3 cells; the header has 2"),
        ("t.csv", b"frame,t_s,marker,u_px,v_px\n0,0,,1,2\n", read_tracks, "row 1, marker: is empty"),
        ("m.csv", b"t_s,y_cg_m,beta_rad,status\n0,0,0,guessed\n", read_motion, "row 1: status 'guessed'"),
        ("p.csv", b"frame,particle,x,y\n0,1,5,5\n900000000,1,5,5\n", lambda p: imported(p), "too far from the first"),
        ("p.csv", b"frame,particle,x,y\n0,1,5,5\n1e300,1,5,5\n", lambda p: imported(p), "an integer is expected"),
        ("p.csv", b"a," * 60_000, lambda p: imported(p), "has 120000 letters"),
        ("k.kva", b'<?xml version="1.0" encoding="utf-x"?><a/>', lambda p: imported(p), "is no XML"),
        ("p.png", BOMB, lambda p: READERS._picture(p), "is no picture"),
        ("d.json", b'{"speed_m_s": 1e999}', lambda p: read_result(p, DerivativesFile), "d.json"),
    ],
)  # fmt: skip
def test_what_was_not_handled_once(
    tmp_path: Path, name: str, data: bytes, read: Callable[[Path], Any], words: str
) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(InputError, match=words) as caught:
        read(path)
    assert name in str(caught.value)
    assert str(caught.value).isprintable()


def imported(path: Path) -> Any:
    return import_tracks(path, "auto", Wanted(rate_hz=25.0))


def test_a_measured_sample_has_a_place(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text("t_s,y_cg_m,beta_rad,status\n0,,0,measured\n1,0,0,measured\n")
    assert list(read_motion(path)["status"]) == ["lost", "measured"]


@pytest.mark.parametrize("fill", [9.96921e36, -1e160, 1e300])
def test_a_fill_value_is_no_measurement(fill: float) -> None:
    """What other programs write for a value that is missing: named with its row, and not squared until it overflows."""
    tow, record = ESTIMATORS._towed(1.446), ESTIMATORS._tow(1.446)
    for column, name, taken in ((1, "y_cg_m", run_data), (2, "beta_rad", run_data), (2, "beta_rad", steady_state)):
        values = record.copy()
        values[6, column] = fill
        with pytest.raises(InputError, match=rf"row 7, {name}: is .*an empty cell"):
            taken(tow, ESTIMATORS._frame(values), None)
        with pytest.raises(EstimationError, match="sample 7 is"):
            fit_decay(*values[:, :3].T)


def test_a_byte_order_mark_before_a_comment_is_no_column(tmp_path: Path) -> None:
    path = tmp_path / "h.csv"
    path.write_bytes("\ufeff# made by hand\nt_s,tension_n\n0,4\n".encode())
    assert list(read_table(path, ("t_s", "tension_n")).columns) == ["t_s", "tension_n"]


def test_rows_of_parquet_are_counted_as_they_stand(tmp_path: Path) -> None:
    path = tmp_path / "m.parquet"
    frame = pd.DataFrame({"t_s": [0.0, 1.0, 1.0], "y_cg_m": 0.0, "beta_rad": 0.0}, index=list("abc"))
    frame.to_parquet(path)
    with pytest.raises(InputError, match="row 3, t_s: repeats"):
        read_motion(path)


def test_a_result_holds_finite_numbers_only(tmp_path: Path) -> None:
    path = tmp_path / "derivatives.json"
    content = BASES.example_of(DerivativesFile)
    content["speed_m_s"] = 1.28
    path.write_text(json.dumps(content), encoding="utf-8")
    assert read_result(path, DerivativesFile).speed_m_s == 1.28
    path.write_text(json.dumps(content).replace('"speed_m_s": 1.28', '"speed_m_s": 1e999'), encoding="utf-8")
    with pytest.raises(InputError, match="speed_m_s: is not a finite number"):
        read_result(path, DerivativesFile)


# circumstances -------------------------------------------------------------------------------------------------------


def identify(run: Path, *more: str) -> list[str]:
    return ["identify", str(run), "--form", "linear", "--noise", "output", "--no-page", *more]


def shell(arguments: list[str], env: dict[str, str] | None = None, limit: int | None = None) -> subprocess.Popen:
    """The command in a process of its own, its files bounded."""
    code = "import resource, sys\nfrom towline.cli import main\n"
    code += f"resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))\n" if limit is not None else ""
    command = [sys.executable, "-c", code + "sys.exit(main(sys.argv[1:]))", *arguments]
    whole = {**os.environ, **(env or {})}
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=whole)


def whole_or_absent(folder: Path, there: set[str]) -> None:
    """Nothing is in the folder but these, and no temporary file anywhere."""
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert found == there


@pytest.fixture
def run(motion_run: Callable[..., Path], tmp_path: Path) -> Path:
    return motion_run(tmp_path / "run")


def test_a_disk_that_fills_is_one_line_and_leaves_nothing(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(self: Path, *_: Any, **__: Any) -> int:
        with open(self, "w", encoding="utf-8") as stream:
            stream.write("{")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self))

    monkeypatch.setattr(Path, "write_text", full)
    assert main(identify(run)) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert os.strerror(errno.ENOSPC) in said
    assert "Traceback" not in said
    whole_or_absent(run, {"run.toml", "motion.csv"})


def test_a_file_that_may_not_grow_leaves_no_half_of_it(tmp_path: Path) -> None:
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(
        'name = "s"\n[time]\nduration_s = 60.0\nrate_hz = 30.0\n[hull]\nspeed_m_s = 1.28\nm_minus_y_vdot = 149.19\n'
        "i_minus_n_rdot = 62.11\ny_v = -52.87\ny_r_minus_mu = -66.33\nn_v = -48.51\nn_r = -57.6\n[tow]\nspeed_m_s = 1.28\n"
        "line_length_m = 0.91\ntow_point_m = 1.446\ntension_n = 3.96\n[start]\ny_cg_m = 0.2\n[model]\nlength_pp_m = 2.66\n"
        "mass_kg = 78.0\n"
    )
    process = shell(["simulate", str(scenario)], limit=FILE_LIMIT_BYTES)
    said = process.communicate(timeout=60)[1]
    assert process.returncode == 1, said
    assert said.startswith("towline: error: ")
    assert said.count("\n") == 1
    assert os.strerror(errno.EFBIG) in said
    whole_or_absent(tmp_path, {"scenario.toml"})


def test_an_output_folder_that_cannot_be_written(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run / "out").write_text("a file stands where the folder should")
    assert main(identify(run)) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "out" in said
    assert (run / "out").read_text() == "a file stands where the folder should"
    if os.geteuid():  # root writes anyway
        (run / "out").unlink()
        run.chmod(0o500)
        assert main(identify(run)) == 1
        assert os.strerror(errno.EACCES) in capsys.readouterr().err
        run.chmod(0o700)


def test_an_interrupted_write_leaves_the_old_output(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(identify(run)) == 0
    before = (run / "out" / "derivatives.json").read_bytes()

    def refused(*_: Any) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", refused)
        assert main(identify(run, "--speed", "1.0")) == 1
    assert (run / "out" / "derivatives.json").read_bytes() == before
    whole_or_absent(run, {"run.toml", "motion.csv", "out/derivatives.json"})

    def killed(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", killed)
        assert main(identify(run, "--speed", "1.0")) == 130
    assert (run / "out" / "derivatives.json").read_bytes() == before
    whole_or_absent(run, {"run.toml", "motion.csv", "out/derivatives.json"})
    capsys.readouterr()


@pytest.mark.slow
def test_what_a_killed_command_left_is_no_output(run: Path) -> None:
    """Killed between temporary name and rename: the temporary file stays, under a name that nothing reads."""
    code = (
        "import os, signal, sys\nos.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        "from towline.cli import main\nmain(sys.argv[1:])"
    )
    subprocess.run([sys.executable, "-c", code, *identify(run)], check=False, capture_output=True, timeout=60)
    left = [path.name for path in (run / "out").iterdir()]
    assert left
    assert all(name.startswith(".derivatives-") for name in left)
    assert main(identify(run)) == 0
    assert read_result(run / "out" / "derivatives.json", DerivativesFile).speed_m_s == pytest.approx(1.28)


@pytest.mark.slow
def test_two_commands_on_one_folder_both_end_well(run: Path) -> None:
    both = [shell(identify(run)) for _ in range(2)]
    for process in both:
        out, err = process.communicate(timeout=90)
        assert process.returncode == 0, (out, err)
    read_result(run / "out" / "derivatives.json", DerivativesFile)
    whole_or_absent(run, {"run.toml", "motion.csv", "out/derivatives.json"})


def test_names_with_blanks_and_letters_of_other_languages(
    motion_run: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = motion_run(tmp_path / "Schlepprinne 3 – „Ærø“ 船" / "run 1; 'x' $(y)", name="Größe 船")
    assert main(identify(folder)) == 0
    assert "Größe 船" in read_result(folder / "out" / "derivatives.json", DerivativesFile).runs
    (folder / "motion.csv").unlink()
    capsys.readouterr()
    assert main(identify(folder)) == 1
    assert "船" in capsys.readouterr().err


@pytest.mark.slow
def test_a_locale_with_a_decimal_comma_changes_nothing(run: Path, tmp_path: Path) -> None:
    found = []
    for number, name in enumerate(("C.UTF-8", "de_DE.UTF-8")):  # where the second is absent, Python takes C
        out = tmp_path / f"out{number}"
        process = shell(identify(run, "-o", str(out)), {"LC_ALL": name, "LC_NUMERIC": name, "LANG": name})
        said = process.communicate(timeout=90)
        assert process.returncode == 0, said
        found.append((out / "derivatives.json").read_bytes())
    assert found[0] == found[1]


def test_no_code_sets_a_locale(root: Path) -> None:
    for path in (p for p in root.glob("**/[a-z_]*.py") if not p.relative_to(root).parts[0].startswith((".", "build"))):
        text = path.read_text(encoding="utf-8")
        if "setlocale" in text:
            names = [node.attr for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)]
            assert "setlocale" not in names, path


@pytest.mark.slow
def test_a_traceback_comes_with_debug_only(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run / "motion.csv").write_text("t_s;y_cg_m\n")
    assert main(identify(run)) == 1
    said = capsys.readouterr().err
    assert said.startswith("towline: error: ")
    assert said.count("\n") == 1
    with pytest.raises(TowlineError):
        main(["--debug", *identify(run)])
    process = shell(["--debug", *identify(run)])
    assert "Traceback" in process.communicate(timeout=60)[1]
    assert process.returncode == 1


def test_a_folder_that_goes_while_it_is_read(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = pd.read_csv

    def gone(*arguments: Any, **named: Any) -> Any:
        shutil.rmtree(run, ignore_errors=True)
        return real(*arguments, **named)

    monkeypatch.setattr(pd, "read_csv", gone)
    out = Path(tempfile.mkdtemp(dir=run.parent))
    code = main(identify(run, "-o", str(out)))
    said = capsys.readouterr().err
    assert code in (0, 1)
    assert "Traceback" not in said
    assert said.count("\n") == code
