"""The record that would tell most: distances against least squares, and a drag that only fast gliding tells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from towline.diagnose.inference.discern import distance_left, expected, told
from towline.diagnose.own import Input, Model, Number, Output, State
from towline.diagnose.own.designs import designs_of
from towline.diagnose.own.gap import OwnGap, own_gap
from towline.diagnose.own.records import Records, read_records
from towline.record import InputError
from towline.record.gap_file import NextExperiment

RNG = np.random.default_rng
NOISE, STEP_S = 0.01, 0.15
MODEL = Model(
    [State("v", "m/s", equation="cart")],
    [Input("pull", "N", stage="motor")],
    [Number("a", "1/s", 0.5, least=0.0), Number("gain", "1/kg", 0.8)],
    [Output("v", "m/s", stage="encoder")],
    lambda t, x, u, p: [p.gain * u.pull - p.a * x.v],
    name="cart.py",
)
TOML = """
[clock]
column = "t_s"

[[column]]
name = "v_mm_s"
role = "output"
of = "v"
unit = "mm/s"
noise_sd = 10.0

[[column]]
name = "pull_mn"
role = "input"
of = "pull"
unit = "mN"
"""
BOX = """
[[next]]
input = "pull"
unit = "mN"
amplitude = [50.0, 4000.0]
frequency_hz = [0.1, 0.4]
"""


def test_what_is_left_of_a_distance_is_what_least_squares_leaves() -> None:
    rng = RNG(1)
    apart, columns = rng.normal(size=30), rng.normal(size=(30, 4)) * [1.0, 1e6, 0.1, 3.0]
    wide = np.concatenate([columns, np.eye(4)])
    z, *_ = np.linalg.lstsq(wide, np.concatenate([apart, np.zeros(4)]), rcond=None)
    assert distance_left(apart, columns) == pytest.approx(np.sum((apart - columns @ z) ** 2) + z @ z, rel=1e-9)


def test_how_often_the_true_one_is_told_is_how_often_it_is() -> None:
    """Two courses of white noise 3.5 sigma apart: the log evidence of the true one is beyond 3 as often as said, of 20,000."""
    apart = 3.5 * np.array([0.6, 0.8])
    noise = RNG(2).normal(size=(20_000, 2))
    log = 0.5 * (np.sum((noise + apart) ** 2, axis=1) - np.sum(noise**2, axis=1))
    assert told(3.5**2) == pytest.approx(np.mean(log > 3.0), abs=4 * np.sqrt(0.25 / 20_000))


def test_a_hypothesis_of_little_weight_hardly_counts() -> None:
    far, near = 40.0, 0.1
    distances = np.array([[0.0, far, near], [far, 0.0, near], [near, near, 0.0]])
    with_it, without = expected([0.5, 0.5, 1e-6], distances), expected([0.5, 0.5], distances[:2, :2])
    np.testing.assert_allclose(with_it, without, rtol=1e-4)
    assert expected([0.4, 0.2, 0.4], distances)[0] < 0.5 * without[0]


def glided(pull: np.ndarray, seed: int) -> np.ndarray:
    """v' = pull - 0.4 v - 0.3 v |v| by scipy, with noise."""
    t = STEP_S * np.arange(len(pull))

    def rates(s: float, v: np.ndarray) -> list[float]:
        return [np.interp(s, t, pull) - 0.4 * v[0] - 0.3 * v[0] * abs(v[0])]

    clean = solve_ivp(rates, (0, t[-1]), (0.0,), t_eval=t, rtol=1e-8, max_step=STEP_S).y[0]
    return clean + NOISE * RNG(seed).normal(size=len(t))


def table(path: Path, pull: np.ndarray, v: np.ndarray | None = None) -> Path:
    t = STEP_S * np.arange(len(pull))
    columns = [t, 1e3 * pull] + ([] if v is None else [1e3 * v])
    np.savetxt(
        path,
        np.column_stack(columns),
        "%.6f",
        ",",
        header="t_s,pull_mn" + ("" if v is None else ",v_mm_s"),
        comments="",
    )
    return path


def found_of(records: Records, *rest: object) -> OwnGap:
    return own_gap(MODEL, records, "test", {}, rng=RNG(0), designs=rest[0] if rest else ())  # pyright: ignore[reportArgumentType]


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, OwnGap]:
    """A record so slow that a drag hardly shows; a box, and two tables to choose from."""
    folder = tmp_path_factory.mktemp("cart")
    (folder / "data.toml").write_text(TOML + BOX)
    pull = 0.45 * np.sin(0.5 * STEP_S * np.arange(60))
    made = table(folder / "slow.csv", pull, glided(pull, 5))
    tables = [table(folder / "weak.csv", 0.05 * np.ones(60)), table(folder / "strong.csv", 3.0 * np.ones(90))]
    _, records = read_records(MODEL, [made])
    return folder, found_of(records, designs_of(MODEL, records, made, tables))


def asked(slow: tuple[Path, OwnGap]) -> NextExperiment:
    found = slow[1].file.next_experiment
    assert found is not None
    return found


@pytest.mark.slow
def test_a_drag_that_is_not_told_is_looked_for_at_speed(slow: tuple[Path, OwnGap]) -> None:
    """Fast beats slow, in the box and among the tables; the weak ones tell next to nothing."""
    tried = asked(slow).tried
    assert len(tried) == 12 + 2
    place = {e.name: k for k, e in enumerate(tried)}
    assert tried[0].settings.get("pull.amplitude", 4000.0) == 4000.0
    assert tried[0].told > 0.5
    assert place["strong.csv"] < place["weak.csv"]
    weak = [e for e in tried if e.settings.get("pull.amplitude") == 50.0 or e.name == "weak.csv"]
    assert max(e.told for e in weak) < 0.3 * tried[0].told
    assert slow[1].file.sentences[-2].startswith(f"To record next: {tried[0].name}")


@pytest.mark.slow
def test_the_truth_settles_it_with_the_record_that_is_proposed(slow: tuple[Path, OwnGap], tmp_path: Path) -> None:
    folder, found = slow
    assert len(found.file.set95) > 1
    design = found.proposed
    assert design is not None
    pull = design.record.inputs[:, 0]
    if design.columns:
        np.testing.assert_allclose(design.columns["pull_mn"], 1e3 * pull)
    (tmp_path / "data.toml").write_text(TOML)
    more = table(tmp_path / "next.csv", pull, glided(pull, 6))
    again = table(tmp_path / "slow.csv", *np.loadtxt(folder / "slow.csv", delimiter=",", skiprows=1).T[1:] / 1e3)
    file = found_of(read_records(MODEL, [again, more])[1]).file
    assert file.verdict == "effect"
    assert file.set95 == [["v_quadratic_damping"]]
    assert file.next_experiment is None


def test_what_cannot_be_recorded_is_said(tmp_path: Path) -> None:
    pull = 0.1 * np.ones(40)
    made = table(tmp_path / "made.csv", pull, pull)
    coarse = tmp_path / "coarse.csv"
    np.savetxt(coarse, np.column_stack([0.3 * np.arange(40), pull]), "%.3f", ",", header="t_s,pull_mn", comments="")
    (tmp_path / "data.toml").write_text(TOML)
    _, records = read_records(MODEL, [made])
    with pytest.raises(InputError, match=r"coarse\.csv: clock: a step of 0\.3 s; the records have 0\.15 s"):
        designs_of(MODEL, records, made, [coarse])
    for text, message in (
        (BOX.replace("pull", "push"), r"next push: is no input of cart\.py; there are pull"),
        (BOX.replace('"mN"', '"rad"'), r"next pull: unit: "),
        (
            BOX.replace("0.4]", "4.0]"),
            r"next pull: frequency_hz: up to 4 Hz, of which samples 0\.15 s apart show less than four",
        ),
        (
            BOX.replace("[50.0, 4000.0]", "[4000.0, 50.0]"),
            r"next\[1\]: amplitude: 4000, 50: the smaller first, above 0",
        ),
        ('[[next]]\ninput = "pull"\nfrequency_hz = [0.1, 0.4]\n', r"amplitude: missing; two numbers are expected"),
        ('[[next]]\nstate = "v"\ninput = "pull"\n', r"input or state, one of the two"),
        (
            '[[next]]\nstate = "x"\nrange = [0.0, 1.0]\n',
            r"next x: is no state of cart\.py whose start is free; there are v",
        ),
    ):
        (tmp_path / "data.toml").write_text(TOML + text)
        with pytest.raises(InputError, match=message) as caught:
            designs_of(MODEL, records, made)
        assert "\n" not in str(caught.value)
