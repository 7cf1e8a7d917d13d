"""Reference sets: the thesis's tables in primes and back, a result against a set, errors that name row and value."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from towline.cli import main
from towline.identify import prime_factors
from towline.identify.reference import (
    BUILT_IN,
    ReferenceSet,
    compare_to_reference,
    comparison_lines,
    read_reference,
    reference_set,
    set_of_result,
)
from towline.record import DerivativesFile, InputError, write_result
from towline.simulate import DERIVATIVE_UNITS

NAMES = list(DERIVATIVE_UNITS)
SYMBOLS = dict(zip(["m-Y_vdot", "I-N_rdot", "Y_v", "Y_r-mU", "N_v", "N_r"], NAMES, strict=True))
ITTC_SI = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
"""Thesis table 8.2, column ITTC, at rho 1025, U 1.276, LBP 2.66 m."""
MARINER = (1025.0, 2.66, 1.276)


@pytest.fixture
def result(derivatives_of: Callable[..., DerivativesFile]) -> Callable[..., DerivativesFile]:
    """The thesis's model, where nothing else is said."""
    return lambda values, std, size=MARINER, mass_kg=78.03, **more: derivatives_of(values, std, size, mass_kg, **more)


def test_ittc_primes_give_table_8_2_back() -> None:
    """The printed primes have three decimals of 1e-3: half a unit of the last is 0.0005e-3."""
    values, std = reference_set("ittc").dimensional(*MARINER)
    np.testing.assert_allclose(values, ITTC_SI, atol=0.005 + 0.0005e-3 * prime_factors(*MARINER).max())
    half_digit = 0.0005e-3 * prime_factors(*MARINER) + 0.005
    assert (np.abs(values - ITTC_SI) < half_digit).all()
    assert not std.any()


def test_table_8_2_in_primes_and_its_one_misprint(shared: Path) -> None:
    """theory.md 2: rho 1025, U 1.276; the 'analysis' Y_v' 11.185 should read 11.152. Half a printed digit, and of the SI value."""
    table = pd.read_csv(shared / "thesis" / "table_8_2_mariner_reference.csv", comment="#").set_index("derivative")
    factors = dict(zip(NAMES, prime_factors(*MARINER), strict=True))
    for symbol, name in SYMBOLS.items():
        for kind in ("analysis", "ittc"):
            prime = 1e3 * table.loc[symbol, kind] / factors[name]
            printed = 11.152 * -1 if (symbol, kind) == ("Y_v", "analysis") else table.loc[symbol, f"{kind}_nd_e3"]
            assert prime == pytest.approx(printed, abs=0.0005 + 1e3 * 0.005 / factors[name] + 0.0003), (symbol, kind)
    assert table.loc["Y_v", "analysis_nd_e3"] == -11.185
    assert abs(1e3 * table.loc["Y_v", "analysis"] / factors["y_v"] + 11.185) > 0.03


def test_southampton_is_table_8_4(shared: Path) -> None:
    """Six decimals of the primes: half of 1e-6 of the unit, and the printed centi-unit."""
    table = pd.read_csv(shared / "thesis" / "table_8_4_southampton_pmm.csv", comment="#").set_index("derivative")
    size = (1025.0, 2.5, 0.856)
    values, std = reference_set("southampton").dimensional(*size)
    wanted = np.array([table.loc[symbol, "mean"] for symbol in SYMBOLS])
    assert (np.abs(values - wanted) < 0.5e-6 * prime_factors(*size) + 0.005).all()
    # scatter of the five yaw tests' N_r: 44.38 37.53 46.44 47.81 42.84
    n_r = np.array([44.38, 37.53, 46.44, 47.81, 42.84])
    assert std[5] == pytest.approx(n_r.std(ddof=1) / np.sqrt(5), abs=0.5e-6 * prime_factors(*size)[5])
    assert (std > 0).all()


@pytest.mark.parametrize("name", BUILT_IN)
def test_primes_round_trip_over_size_and_speed(name: str) -> None:
    found = reference_set(name)
    assert found.source
    for size in (MARINER, (1000.0, 3.15, 0.5), (1026.0, 160.0, 7.7)):
        hull = found.hull(*size)
        np.testing.assert_allclose(hull.six / prime_factors(*size), found.prime, rtol=1e-12)
        np.testing.assert_allclose(
            hull.at_speed(2.0).six / prime_factors(size[0], size[1], 2.0), found.prime, rtol=1e-12
        )


def test_the_mass_and_inertia_of_the_model_enter() -> None:
    """1 kg more: m - Y_vdot 1 kg more, Y_r - mU 1 kg x U less; 1 kg m2 more dry inertia: I - N_rdot as much more."""
    found = reference_set("ittc")
    assert found.mass_prime is not None
    assert found.inertia_prime is not None
    own = found.mass_prime * 0.5 * 1025 * 2.66**3
    inertia = found.inertia_prime * 0.5 * 1025 * 2.66**5
    assert own == pytest.approx(78.03, abs=0.01)  # 765.2 N
    assert inertia == pytest.approx(34.98, abs=0.04)  # 343 N m2; three digits of the prime
    change = found.hull(*MARINER, own + 1, inertia + 1).six - found.hull(*MARINER).six
    np.testing.assert_allclose(change, [1, 1, 0, -1.276, 0, 0], atol=1e-9)


def test_a_result_against_its_set(result: Callable[..., DerivativesFile]) -> None:
    reference = reference_set("ittc")
    truth = reference.dimensional(*MARINER)[0]
    std = 0.01 * np.abs(truth)
    same = compare_to_reference(result(truth, std), reference)
    assert same.chi_square == pytest.approx(0, abs=1e-12)
    assert same.p_value == pytest.approx(1)
    moved = truth.copy()
    moved[2] *= 1.03  # Y_v 3 % more negative: 3 sd below
    found = compare_to_reference(result(moved, std), reference)
    assert found.rows[2].difference_percent == pytest.approx(-3)
    assert found.rows[2].difference_sd == pytest.approx(-3)
    assert found.chi_square == pytest.approx(9)
    # correlated with m' at 0.9, the same difference is 9/(1 - 0.81)
    correlation = np.eye(6)
    correlation[0, 2] = correlation[2, 0] = 0.9
    tied = compare_to_reference(result(moved, std, correlation=correlation), reference)
    assert tied.chi_square == pytest.approx(9 / 0.19)
    assert len(comparison_lines(found)) == 9


def test_the_sets_own_uncertainty_counts(result: Callable[..., DerivativesFile]) -> None:
    reference = reference_set("southampton")
    size = (1025.0, 2.5, 0.856)
    values, stds = reference.dimensional(*size)
    moved = values + 2 * stds
    found = compare_to_reference(result(moved, np.sqrt(3) * stds, size, 95.76), reference)
    np.testing.assert_allclose([r.difference_sd for r in found.rows], 1.0, rtol=1e-9)
    assert not found.notes
    heavy = compare_to_reference(result(moved, stds, size, 105.0), reference)
    assert "the model's mass" in heavy.notes[0]


def test_a_result_serves_as_a_set(result: Callable[..., DerivativesFile]) -> None:
    made = set_of_result(result(ITTC_SI, 0.01 * np.abs(ITTC_SI)))
    np.testing.assert_allclose(made.dimensional(*MARINER)[0], ITTC_SI, rtol=1e-12)
    np.testing.assert_allclose(made.hull(*MARINER, 78.03).six, ITTC_SI, rtol=1e-9)


GOOD = "# a source\nname,value,std\n" + "".join(
    f"{name},{value},\n" for name, value in zip(NAMES, (0.015, 0.0009, -0.011, -0.005, -0.004, -0.0018), strict=True)
)


def test_a_file_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text("\ufeff" + GOOD, encoding="utf-8")
    found = read_reference(path)
    assert (found.name, found.source, found.mass_prime) == ("mine", "a source", None)
    np.testing.assert_allclose(found.prime, [0.015, 0.0009, -0.011, -0.005, -0.004, -0.0018])
    np.testing.assert_array_equal(reference_set("mine.csv", tmp_path).prime, found.prime)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("y_v,-0.011,", "y_v,minus,", "row 5: value of y_v is 'minus'"),
        ("y_v,-0.011,", "y_v,-11.4,", "row 5: value of y_v is -11.4"),
        ("y_v,-0.011,", "y_v,0,", "row 5: value of y_v is 0"),
        ("y_v,-0.011,", "y_v,nan,", "row 5: value of y_v is nan"),
        ("y_v,-0.011,", "y_w,-0.011,", "row 5: name 'y_w'"),
        ("y_v,-0.011,", "n_v,-0.011,", "row 7: 'n_v' stands here a second time"),
        ("y_v,-0.011,", "y_v,-0.011", "row 5: 'y_v,-0.011': 2 fields; 3 are expected"),
        ("y_v,-0.011,", "y_v,-0.011,-1", "row 5: std of y_v is '-1'"),
        ("y_v,-0.011,\n", "", "row 7: the file ends without y_v"),
        ("m_minus_y_vdot,0.015,", "m_minus_y_vdot,-0.015,", "row 3: value of m_minus_y_vdot is -0.015"),
        ("name,value,std", "name,prime", "row 2: 'name,prime'"),
    ],
)
def test_a_bad_row_is_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "bad.csv"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_reference(path)
    assert said in str(caught.value)
    assert "bad.csv" in str(caught.value)


def test_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], result: Callable[..., DerivativesFile]
) -> None:
    path = tmp_path / "derivatives.json"
    write_result(path, result(1.02 * ITTC_SI, 0.01 * np.abs(ITTC_SI)))
    assert main(["compare", str(path), "--reference", "ittc"]) == 0
    said = capsys.readouterr().out
    row = next(line for line in said.splitlines() if line.startswith("Y_v"))
    assert row.split()[1:4:2] == ["-53.927", "-52.869"]  # 1.02 x 52.87, and the printed prime's five digits
    assert row.split()[-2:] == ["-2.00", "-2.0"]
    assert main(["compare", str(path), "--reference", "itcc"]) == 1
    assert "itcc: no such file, and no built-in reference set; known: ittc, southampton" in capsys.readouterr().err


def test_values_without_scatter_differ_by_nothing_or_without_bound(result: Callable[..., DerivativesFile]) -> None:
    """Neither the result nor the set states a deviation."""
    exact = ReferenceSet("mine", "", ITTC_SI / prime_factors(*MARINER), np.zeros(6))
    values = exact.dimensional(*MARINER)[0] * [1, 1.1, 1, 0.9, 1, 1]
    rows = compare_to_reference(result(values, np.zeros(6)), exact).rows
    assert [row.difference_sd for row in rows] == [0.0, np.inf, 0.0, np.inf, 0.0, 0.0]
    assert [row.difference_percent for row in rows] == pytest.approx([0, 10, 0, 10, 0, 0], abs=1e-9)


def test_the_chi_square_is_that_of_both_covariances_together(result: Callable[..., DerivativesFile]) -> None:
    """Correlated result, independent set: gaps' (C + D)^-1 gaps by hand, and its probability on six degrees."""
    rng = np.random.default_rng(2)
    root = rng.normal(size=(6, 12))
    correlation = np.corrcoef(root)
    own, sizes = np.abs(ITTC_SI) * 0.013, np.abs(ITTC_SI) * 0.007
    factors = prime_factors(*MARINER)
    known = ReferenceSet("mine", "", ITTC_SI / factors, sizes / factors)
    values = ITTC_SI * (1 + 0.03 * rng.normal(size=6))
    found = compare_to_reference(result(values, own, correlation=correlation), known)
    gaps = values - ITTC_SI
    whole = correlation * np.outer(own, own) + np.diag(sizes**2)
    assert found.chi_square == pytest.approx(gaps @ np.linalg.solve(whole, gaps), rel=1e-9)
    assert found.p_value == pytest.approx(chi2.sf(found.chi_square, 6), rel=1e-9)
    assert [row.difference_sd for row in found.rows] == pytest.approx(gaps / np.hypot(own, sizes))
