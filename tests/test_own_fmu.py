"""FMUs of all four kinds, compiled from C, as models of one's own: the same course and verdict as the equations in Python."""

from __future__ import annotations

import importlib.util
import shutil
import zipfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from towline.diagnose.own import Input, Model, Number, Output, State
from towline.diagnose.own.back import put_in, run_model
from towline.diagnose.own.gap import own_gap
from towline.diagnose.own.read import read_model
from towline.diagnose.own.records import Record, SampleNoise, read_records, together
from towline.record import InputError

pytest.importorskip("fmpy", reason="fmpy, which reads FMUs, is not installed (the extra fmu)")
needs_compiler = pytest.mark.skipif(
    shutil.which("gcc") is None and shutil.which("cc") is None, reason="no C compiler is there to make FMUs with"
)
pytestmark = needs_compiler
KINDS = [(2, "exchange"), (3, "exchange"), (2, "co-simulation"), (3, "co-simulation")]
EQUATIONS = Model(
    [State("angle", "rad", 0.3), State("rate", "rad/s")],
    [Input("torque", "N m")],
    [
        Number("w2", "1/s2", 50.0, least=0.0),
        Number("damping_c", "1/s", 0.1, least=0.0),
        Number("gain", "1/(kg m2)", 1.0),
    ],
    [Output("angle", "rad")],
    lambda t, x, u, p: (x.rate, -p.w2 * np.sin(x.angle) - p.damping_c * x.rate + p.gain * u.torque),
)


@pytest.fixture(scope="module")
def maker(root: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("pendulum_fmu", root / "examples" / "pendulum_fmu.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def fmus(maker: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[int, str], Path]:
    folder = tmp_path_factory.mktemp("fmus")
    return {(v, kind): maker.make(folder / f"pendulum_{v}_{kind}.fmu", v, kind) for v, kind in KINDS}


@pytest.mark.parametrize(("version", "kind"), KINDS)
def test_an_fmu_moves_as_its_equations(fmus: dict[tuple[int, str], Path], version: int, kind: str) -> None:
    """Numbers other than its own, an input; a co-simulation steps four times as fine and holds the input between samples."""
    model = read_model(fmus[version, kind])
    assert model.whole == (kind == "co-simulation")
    assert [(n.name, n.unit, n.start) for n in model.numbers] == [(n.name, n.unit, n.start) for n in EQUATIONS.numbers]
    assert [n.least for n in model.numbers] == [0.0, 0.0, -np.inf]
    numbers, torque = {"w2": 30.0, "damping_c": 0.5, "gain": 2.0}, np.sin(0.2 * np.arange(150))
    start = {"angle": 0.8, "rate": -0.4}
    one, other = (
        run_model(put_in(m, numbers), 0.02, 150, start, {"torque": torque})["angle"] for m in (EQUATIONS, model)
    )
    # between samples 0.004 apart in the input's own wave: its second difference, an eighth of it, by gain/w2
    held = 2.0 / 30.0 * 0.2**2 / 8
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 if kind == "exchange" else 3 * held)


def record() -> Record:
    """The pendulum with w2 = 45, c = 0.2, gain 1.3, swept through its resonance."""
    t = 0.05 * np.arange(60)
    torque = 4.0 * np.sin(0.9 * t**1.5)
    truth = put_in(EQUATIONS, {"w2": 45.0, "damping_c": 0.2, "gain": 1.3})
    clean = run_model(truth, 0.05, 60, {"angle": 0.4}, {"torque": torque}, inner=16)["angle"]
    values = clean + 0.003 * np.random.default_rng(1).normal(size=60)
    return Record("sweep", 0.05, torque[:, None], values[:, None], (SampleNoise(0.003),), (False,))


@pytest.mark.slow
def test_the_same_equations_have_the_same_verdict_and_numbers(fmus: dict[tuple[int, str], Path]) -> None:
    records = together([record()])
    found = [
        own_gap(model, records, "test", {}, rng=np.random.default_rng(0)).file
        for model in (EQUATIONS, read_model(fmus[2, "exchange"]))
    ]
    assert [file.verdict for file in found] == ["no_gap", "no_gap"]
    for name, here in found[0].derivatives["before"].items():
        there = found[1].derivatives["before"][name]
        assert there.value == pytest.approx(here.value, abs=1e-3 * here.std)
        assert there.std == pytest.approx(here.std, rel=1e-3)
    assert found[1].p_no_gap == pytest.approx(found[0].p_no_gap, abs=1e-3)


def test_a_co_simulation_is_fitted_by_itself(fmus: dict[tuple[int, str], Path]) -> None:
    """Nothing inside its equations is offered; its numbers are found."""
    found = own_gap(
        read_model(fmus[3, "co-simulation"]), together([record()]), "test", {}, rng=np.random.default_rng(0)
    )
    assert found.file.verdict == "no_gap"
    assert not any(m.equation for m in found.simulator.missing.values())
    for name, value in (("w2", 45.0), ("gain", 1.3)):
        fitted = found.file.derivatives["before"][name]
        # the input is held between the samples, which a finer step would resolve
        assert abs(fitted.value - value) < 4 * fitted.std + 0.01 * value


def test_columns_choose_what_is_fitted_and_measured(fmus: dict[tuple[int, str], Path], tmp_path: Path) -> None:
    rows = "\n".join(f"{0.05 * k:.2f},{0.1 * k % 3:.3f},0.5" for k in range(20))
    (tmp_path / "sweep.csv").write_text(f"t,a,m\n{rows}\n")
    (tmp_path / "data.toml").write_text(
        '[clock]\ncolumn = "t"\n[[column]]\nname = "a"\nrole = "output"\nof = "angle"\nunit = "deg"\nnoise_sd = 0.1\n'
        '[[column]]\nname = "m"\nrole = "input"\nof = "torque"\nunit = "N mm"\n[[number]]\nname = "damping_c"\nstart = 0.3\n'
    )
    model, records = read_records(read_model(fmus[3, "exchange"]), [tmp_path / "sweep.csv"])
    assert [(n.name, n.start, n.known) for n in model.numbers] == [
        ("w2", 50.0, True),
        ("damping_c", 0.3, False),
        ("gain", 1.0, True),
    ]
    np.testing.assert_allclose(records.records[0].inputs, 5e-4)


def test_what_is_wrong_with_an_fmu_is_one_line(maker: ModuleType, tmp_path: Path) -> None:
    other = maker.make(tmp_path / "windows.fmu", 2, "exchange", platform="win64")
    (tmp_path / "text.fmu").write_text("no archive")
    with zipfile.ZipFile(tmp_path / "empty.fmu", "w") as pack:
        pack.writestr("readme.txt", "nothing")
    changed = {
        "events": ('numberOfEventIndicators="0"', 'numberOfEventIndicators="2"'),
        "old": ('fmiVersion="2.0"', 'fmiVersion="1.0"'),
        "once": ('modelIdentifier="pendulum"', 'modelIdentifier="pendulum" canBeInstantiatedOnlyOncePerProcess="true"'),
        "bounds": ('start="50" min="0"', 'start="50" min="60"'),
    }
    for name, (old, new) in changed.items():
        with zipfile.ZipFile(other) as pack, zipfile.ZipFile(tmp_path / f"{name}.fmu", "w") as target:
            for one in pack.namelist():
                content = pack.read(one)
                if one == "modelDescription.xml":
                    assert old.encode() in content
                    content = content.replace(old.encode(), new.encode())
                target.writestr(one.replace("win64", "linux64"), content)
    for name, message in (
        ("windows", r"windows\.fmu: has no binary for .*\(it has win64\)"),
        ("text", r"text\.fmu: is no FMU"),
        ("empty", r"empty\.fmu: is no FMU"),
        ("absent", r"absent\.fmu: no such file"),
        ("events", r"events\.fmu: has 2 event indicators; export it for co-simulation"),
        ("old", r"old\.fmu: is (no FMU|of FMI 1\.0)"),
        ("once", r"once\.fmu: can be instantiated once only"),
        ("bounds", r"bounds\.fmu: number w2: starts at 50, outside 60 to inf"),
    ):
        with pytest.raises(InputError, match=message) as caught:
            read_model(tmp_path / f"{name}.fmu")
        assert "\n" not in str(caught.value)
