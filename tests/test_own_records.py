"""Records for a model of one's own: units, clocks, noise; and one clear line for whatever is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from towline.cli import main
from towline.diagnose.own import Input, Model, Number, Output, State
from towline.diagnose.own.records import SampleNoise, read_records, together
from towline.record import InputError
from towline.record.units import conversion, unit_of

MODEL = Model(
    [State("level", "m", equation="tank")],
    [Input("flow", "m3/s", stage="pump")],
    [Number("area", "m2", 2.0, least=0.1, most=10.0)],
    [Output("level", "m", stage="gauge")],
    lambda t, x, u, p: [u.flow / p.area],
    name="tank.py",
)
HEAD = '[clock]\ncolumn = "t"\nunit = "min"\n'
GAUGE = '[[column]]\nname = "gauge_cm"\nrole = "output"\nof = "level"\nunit = "cm"\nnoise_sd = 0.2\n'
PUMP = '[[column]]\nname = "pump"\nrole = "input"\nof = "flow"\nunit = "l/min"\nhold = "step"\n'


def table(count: int = 20) -> pd.DataFrame:
    return pd.DataFrame({"t": np.arange(count) / 60, "gauge_cm": np.arange(count) * 1.0, "pump": 60.0})


def written(folder: Path, text: str = HEAD + GAUGE + PUMP, rows: pd.DataFrame | None = None) -> Path:
    (folder / "data.toml").write_text(text)
    (table() if rows is None else rows).to_csv(folder / "filled.csv", index=False)
    return folder / "filled.csv"


@pytest.mark.parametrize(
    ("given", "wanted", "factor"),
    [("deg/s", "rad/s", np.pi / 180), ("kN m", "N m", 1e3), ("l/min", "m3/s", 1e-3 / 60), ("1/s2", "Hz^2", 1.0),
     ("V", "kg m2/(s3 A)", 1.0), ("m^0.5/s", "m^0.5/s", 1.0), ("%", "", 0.01), ("rpm", "rad/s", np.pi / 30)],
)  # fmt: skip
def test_units_are_converted(given: str, wanted: str, factor: float) -> None:
    assert conversion(given, wanted) == pytest.approx(factor, rel=1e-12)


def test_what_is_no_unit_is_said() -> None:
    for text in ("furlong", "m/s/s", "2 m"):
        with pytest.raises(ValueError, match=r"is no unit|more than one /"):
            unit_of(text)
    with pytest.raises(ValueError, match="'m' does not fit 's'"):
        conversion("m", "s")


@pytest.mark.parametrize("kind", ["csv", "parquet", "mat"])
def test_a_table_comes_in_the_models_units(tmp_path: Path, kind: str) -> None:
    path, rows = written(tmp_path), table()
    rows.loc[3, "gauge_cm"] = np.nan
    if kind == "parquet":
        path = tmp_path / "filled.parquet"
        rows.to_parquet(path)
    elif kind == "mat":
        path = tmp_path / "filled.mat"
        savemat(path, {name: rows[name].to_numpy() for name in rows})
    else:
        rows.to_csv(path, index=False)
    system, records = read_records(MODEL, [path])
    (record,) = records.records
    assert system.outputs == MODEL.outputs
    assert record.step_s == pytest.approx(1.0)
    known = np.arange(20) * 0.01
    known[3] = np.nan
    np.testing.assert_allclose(record.values[:, 0], known)
    np.testing.assert_allclose(record.inputs[:, 0], 1e-3)
    assert record.noises == (SampleNoise(pytest.approx(0.002)),)
    assert record.stays == (True,)


def test_a_row_that_is_missing_is_a_gap(tmp_path: Path) -> None:
    rows = table().drop(index=[5, 6])
    _, records = read_records(MODEL, [written(tmp_path, rows=rows)])
    values = records.records[0].values[:, 0]
    assert len(values) == 20
    assert np.flatnonzero(np.isnan(values)).tolist() == [5, 6]


def test_a_file_of_columns_says_more_of_the_model(tmp_path: Path) -> None:
    more = '[[number]]\nname = "area"\nunit = "cm2"\nstart = 5e3\nmost = 1e5\n[[state]]\nname = "level"\nknown = true\n'
    system, _ = read_records(
        MODEL, [written(tmp_path, HEAD + GAUGE + PUMP + more + '[[stage]]\nname = "level"\nstage = "basin"\n')]
    )
    (area,), (level,) = system.numbers, system.states
    assert (area.start, area.least, area.most) == (pytest.approx(0.5), 0.1, pytest.approx(10.0))
    assert level.known
    assert level.equation == "basin"


def test_a_static_record_tells_the_noise(tmp_path: Path) -> None:
    """White noise of 3 mm and a slow wander of 2 mm: what means over blocks of 10 scatter by, to a quarter."""
    rng, count = np.random.default_rng(1), 2000
    slow = np.zeros(count)
    for k in range(1, count):
        slow[k] = np.exp(-1 / 30) * slow[k - 1] + np.sqrt(1 - np.exp(-2 / 30)) * rng.normal()
    still = 0.3 * rng.normal(size=count) + 0.2 * slow
    pd.DataFrame({"gauge_cm": still}).to_csv(tmp_path / "still.csv", index=False)
    text = 'static = "still.csv"\n' + HEAD + GAUGE.replace("noise_sd = 0.2\n", "") + PUMP
    _, records = read_records(MODEL, [written(tmp_path, text)])
    lag_s = np.abs(np.subtract.outer(10.0 * np.arange(5), 10.0 * np.arange(5)))
    covariance = records.records[0].noises[0].covariance(10, 1.0, lag_s)
    # of a mean over ten: white 3^2/10 mm2, and nearly all of the wander's 2^2, which the next mean shares
    ratio = 10 / 30
    wander = 2e-3**2 * 2 / ratio * (1 - (1 - np.exp(-ratio)) / ratio)
    assert covariance[0, 0] == pytest.approx(3e-3**2 / 10 + wander, rel=0.25)
    assert covariance[0, 1] == pytest.approx(wander * np.exp(-ratio), rel=0.35)


def test_long_and_fast_records_are_thinned_and_said() -> None:
    from towline.diagnose.own.records import Record

    def record(hertz: float, count: int) -> Record:
        t = np.arange(count) * 0.01
        return Record(
            "long", 0.01, np.zeros((count, 0)), np.sin(2 * np.pi * hertz * t)[:, None], (SampleNoise(0.01),), ()
        )

    slow = together([record(0.1, 5000)])
    assert len(slow.records[0].values) == 1666
    assert slow.size * 200 >= 1666
    assert "means of 3" in slow.notes[0]
    assert any("fast" in note for note in together([record(12.0, 5000)]).notes)


OWN = "from towline.diagnose.own import *\nSAME = [State('x')], [], [], [Output('x')], None\nA = Model(*SAME)\n"
ALL = HEAD + GAUGE + PUMP
BAD = {
    "an unknown column": (
        HEAD + GAUGE.replace("gauge_cm", "gage_cm") + PUMP, None, r"filled\.csv: column gage_cm: missing; found t, gauge"),
    "a unit that does not fit": (
        HEAD + GAUGE.replace('"cm"', '"s"') + PUMP, None, r'data\.toml: column "gauge_cm": unit: .s. does not fit .m.'),
    "a unit that is none": (
        HEAD + GAUGE.replace('"cm"', '"inches"') + PUMP, None, r"is no unit that is known"),
    "an output the model has not": (
        HEAD + GAUGE.replace('"level"', '"height"') + PUMP, None, r"'height' is no output of tank\.py, which has level"),
    "no input": (
        HEAD + GAUGE, None, r"input flow: tank\.py needs it, and no column is it"),
    "no output": (
        HEAD + PUMP, None, r"column: none has role = .output."),
    "no noise": (
        HEAD + GAUGE.replace("noise_sd = 0.2\n", "") + PUMP, None, r'column "gauge_cm": noise_sd: missing'),
    "no clock": (
        GAUGE + PUMP, None, r"data\.toml: clock: missing key"),
    "two clocks": (
        HEAD.replace("[clock]\n", "[clock]\nrate_hz = 2.0\n") + GAUGE + PUMP, None, r"column or rate_hz"),
    "a number out of bounds": (
        
        ALL + '[[number]]\nname = "area"\nstart = 20.0\n', None, r"number area: starts at 20, outside 0\.1 to 10"),
    "an unknown number": (
        ALL + '[[number]]\nname = "aera"\nstart = 2.0\n', None, r"number aera: unknown; the model has area"),
    "an unknown stage": (
        ALL + '[[stage]]\nname = "lid"\nstage = "top"\n', None, r"stage lid: unknown; tank\.py has level, flow"),
    "an empty table": (
        ALL, table(0), r"filled\.csv: holds no row"),
    "hardly any row": (
        ALL, table(5), r"filled\.csv: holds 5 rows; at least 12"),
    "uneven times": (
        ALL, table().assign(t=lambda d: d.t.where(d.index != 7, d.t + 0.5 / 60)), r"row 8: the times are not even"),
    "times that go back": (
        ALL, table().assign(t=lambda d: d.t.where(d.index != 7, 0.0)), r"row 8: its time does not come after"),
    "an input with a gap": (
        ALL, table().assign(pump=lambda d: d.pump.where(d.index != 4)), r"column pump: row 5: no value"),
    "text in a number": (
        ALL, table().astype({"gauge_cm": object}).assign(
        gauge_cm=lambda d: d.gauge_cm.where(d.index != 2, "wet")), r"column gauge_cm: row 3: .wet. is no number"),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_is_one_clear_line(tmp_path: Path, what: str) -> None:
    text, rows, message = BAD[what]
    with pytest.raises(InputError, match=message) as caught:
        read_records(MODEL, [written(tmp_path, text, rows)])
    assert "\n" not in str(caught.value)


def test_records_of_different_steps_are_said(tmp_path: Path) -> None:
    first = written(tmp_path)
    table().assign(t=lambda d: 2 * d.t).to_csv(tmp_path / "slower.csv", index=False)
    with pytest.raises(InputError, match=r"slower: clock: a step of 2 s; filled has 1 s"):
        read_records(MODEL, [first, tmp_path / "slower.csv"])


def test_what_is_no_model_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = written(tmp_path)
    for name, text, message in (
        ("empty.py", "", "defines no Model at its top level"),
        ("wrong.py", "1 / 0", "ZeroDivisionError"),
        ("model.slx", "", "is no model: a Python file"),
        ("absent.py", None, "no such file"),
        ("twice.py", OWN + "B = Model(*SAME)", "defines 2"),
        ("again.py", OWN.replace("x')]", "x'), State('x')]", 1), "stands there twice"),
        ("unseen.py", OWN.replace("Output('x')", "Output('y')"), "output y: is no state"),
    ):  # fmt: skip
        path = tmp_path / name
        if text is not None:
            path.write_text(text)
        assert main(["gap", str(path), str(data)]) == 1
        said = capsys.readouterr().err.strip()
        assert message in said
        assert name in said
        assert "\n" not in said
