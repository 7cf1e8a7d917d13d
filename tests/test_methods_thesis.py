"""The thesis's tables through its own equations: what follows, and by how much the rest does not (docs/thesis-check.md)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares

from towline.identify import fit_steady, phase_analysis, prime_factors, two_tow_x_v
from towline.identify.methods.hull_conditions import neutral_stern_force, to_prime, with_stern_force
from towline.identify.methods.phase import Amplitudes, phase_from_amplitudes
from towline.identify.steady import SteadyState
from towline.simulate import Hull, Start, Tow, linear_system, simulate_full, stability
from towline.simulate.model import Line

SIX = ["m_minus_y_vdot", "i_minus_n_rdot", "y_v", "y_r_minus_mu", "n_v", "n_r"]
ITTC = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28)
TENSION_8_3_N = {68: 2.07, 69: 2.01, 70: 2.22, 71: 2.23, 72: 1.98}


@pytest.fixture
def table(shared: Path):
    return lambda name: pd.read_csv(shared / "thesis" / f"table_{name}.csv", comment="#")


@pytest.fixture(scope="module")
def page() -> str:
    return (Path(__file__).resolve().parent.parent / "docs" / "thesis-check.md").read_text(encoding="utf-8")


def quoted(page: str, *numbers: str) -> None:
    """The page states these numbers."""
    missing = [n for n in numbers if n not in page]
    assert not missing, f"docs/thesis-check.md does not state {missing}"


def test_table_3_1(table, page: str) -> None:
    """rho 1027, LBP 3.15 m, U 1.30 m/s: last printed digit, but for Y_v' and I' by one unit in the fourth and third digit."""
    rows = table("3_1_derivatives").set_index("symbol")
    symbols = ["m-Y_vdot", "I-N_rdot", "Y_v", "Y_r-m", "N_v", "N_r"]
    dimensional = rows.loc[symbols, "dimensional"].to_numpy(float)
    prime = np.array([p.value for p in to_prime(dimensional, 1027, 3.15, 1.30).values()])
    printed = rows.loc[symbols, "non_dimensional"].to_numpy(float)
    unit = np.array([1e-6, 1e-6, 1e-5, 1e-6, 1e-6, 1e-6])
    np.testing.assert_allclose(prime / unit, printed / unit, atol=1.01)
    assert f"{prime[2]:.5f}" == "-0.01467"
    assert prime[1] == pytest.approx(0.0005897, abs=5e-8)
    assert float(rows.loc["m", "dimensional"]) / prime_factors(1027, 3.15, 1.30)[0] == pytest.approx(
        0.0086397, abs=1e-6
    )
    quoted(page, "-0.01467", "0.0005897")


def test_table_3_2(table, page: str) -> None:
    rows = table("3_1_derivatives").set_index("symbol")["dimensional"].astype(float)
    hull = Hull(*rows[["m-Y_vdot", "I-N_rdot", "Y_v", "Y_r-m", "N_v", "N_r"]], speed_m_s=1.30)
    cases = table("3_2_hull_conditions").set_index("case")
    found = {c: with_stern_force(hull, f, 3.15) for c, f in cases["f_delta"].items()}
    for case, one in found.items():
        printed = cases.loc[case]
        if case == 3:
            # 1.248: the text's 1.25; the table's 1.28 does not follow
            assert (one.x_r_m, one.x_v_m) == pytest.approx((1.25, 1.25), abs=0.005)
            assert printed["x_r_m"] - one.x_r_m == pytest.approx(0.032, abs=0.001)
        else:
            assert (one.x_r_m, one.x_v_m) == pytest.approx((printed["x_r_m"], printed["x_v_m"]), abs=0.0085)
        assert one.straight_line_stable == (case < 4)
    assert f"{found[2].x_r_m:.3f}" == "1.518"  # printed 1.51: cut, not rounded
    assert f"{found[2].x_v_m:.3f}" == "1.136"
    assert neutral_stern_force(hull, 3.15) == pytest.approx(10.766, abs=5e-4)
    quoted(page, "1.248", "1.518", "1.136", "10.766")


def test_table_4_3(table, page: str) -> None:
    """(4.9) on the printed angles: 20.32, 21.84, 23.59 cm; the thesis prints 2.47 to 2.56 cm more."""
    rows = table("4_3_steady").set_index("hole")
    tows = {
        hole: SteadyState(str(hole), row.x_t_cm, np.radians(row.alpha_deg), np.radians(row.beta_deg))
        for hole, row in rows.iterrows()
    }
    pairs = ((6, 4), (6, 3), (4, 3))
    found = np.array(
        [
            two_tow_x_v(tows[a].force()[0], tows[a].tow_point_m, tows[b].force()[0], tows[b].tow_point_m)
            for a, b in pairs
        ]
    )
    np.testing.assert_allclose(found, [20.32, 21.84, 23.59], atol=0.005)
    more = np.array([22.88, 24.36, 26.06]) - found
    np.testing.assert_allclose(more, [2.56, 2.52, 2.47], atol=0.005)
    line = fit_steady([tows[h] for h in (6, 4, 3)])
    assert line.x_v_m.value == pytest.approx(21.7, abs=0.5)
    quoted(page, "20.32", "21.84", "23.59", "2.56", "2.52", "2.47", f"{found.mean():.2f}")


def phase_8_1(row: dict) -> np.ndarray:
    tension = 4.18 if row["tow_point"] == 8 else 3.96
    k2 = row["i_minus_n_rdot"] / row["m_minus_y_vdot"]
    return phase_analysis(row["omega_rad_s"], row["y0_over_beta0"], tension, row["x_t_m"], 0.91, 1.28, k2)


def test_table_8_1_n_r_follows_and_the_rest_does_not(table, page: str) -> None:
    rows = table("8_1_mariner_analytic")
    gap = {}
    for row in rows.to_dict("records"):
        printed = np.array([row[c] for c in SIX])
        gap[row["tow_point"]] = 100 * (phase_8_1(row) / printed - 1)
        assert abs(gap[row["tow_point"]][5]) < 0.3
    lines = {p: " | ".join(f"{g:+.1f}" for g in gap[p]) for p in (12, 10, 8, 6)}
    for point, line in lines.items():
        assert line in page, f"tow point {point}: {line}"
    # tow point 6: Y_v -69.7 against the printed -58.34
    assert phase_8_1(rows.to_dict("records")[3])[2] == pytest.approx(-69.68, abs=0.01)
    # its own two columns of amplitude ratios disagree at tow point 8 by 0.9 %
    ratio = rows.set_index("tow_point")
    np.testing.assert_allclose(ratio["beta0_over_y0"] * ratio["y0_over_beta0"], [1, 1, 1.0092, 1], atol=1.2e-3)
    means = rows[SIX].mean()
    assert means["m_minus_y_vdot"] == pytest.approx(151.72, abs=0.005)  # printed 151.59
    assert means["y_r_minus_mu"] == pytest.approx(-66.08, abs=0.005)  # printed -66.03
    np.testing.assert_allclose(
        means[["i_minus_n_rdot", "y_v", "n_v", "n_r"]], [62.33, -51.60, -46.29, -57.14], atol=0.0051
    )
    quoted(page, "-69.68", "151.72", "-66.08", "2.874")


def test_table_8_2(table, page: str) -> None:
    rows = table("8_2_mariner_reference").set_index("derivative")
    order = ["m-Y_vdot", "I-N_rdot", "Y_v", "Y_r-mU", "N_v", "N_r"]
    for column in ("analysis", "ittc"):
        values = rows.loc[order, column].to_numpy(float)
        prime = 1e3 * np.array([p.value for p in to_prime(values, 1025, 2.66, 1.276).values()])
        printed = rows.loc[order, f"{column}_nd_e3"].to_numpy(float)
        follows = np.ones(6, bool)
        follows[2] = column == "ittc"
        np.testing.assert_allclose(prime[follows], printed[follows], atol=6e-4)
        if column == "analysis":
            assert prime[2] == pytest.approx(-11.152, abs=5e-4)
            assert printed[2] == -11.185
    quoted(page, "-11.152", "-11.185")


def phase_8_3(inputs: pd.DataFrame, run: int, k2: float) -> np.ndarray:
    row = inputs.loc[run]
    ratio = abs(row["y_amp_m"] / row["beta_amp_rad"])
    return phase_analysis(row["omega_rad_s"], ratio, TENSION_8_3_N[run], row["x_t_m"], 0.851, 0.860, k2)


def test_tables_8_3_and_8_5(table, page: str) -> None:
    """8.3 from 8.7 to 0.25 %; 8.5's means from 8.3's rows to the last digit; its primes with rho 1023.8, U 0.856."""
    inputs, rows = table("8_7_bombardier_fits").set_index("run"), table("8_3_bombardier_analytic")
    worst = 0.0
    for printed_k2, k2 in ((0.288, 0.288), (0.391, 0.390625)):
        for row in rows[rows["k2"] == printed_k2].to_dict("records"):
            gap = phase_8_3(inputs, row["run"], k2) / np.array([row[c] for c in SIX]) - 1
            worst = max(worst, np.abs(gap).max())
    assert 0.0020 < worst < 0.0025
    means = rows.groupby("k2")[SIX].mean()
    np.testing.assert_allclose(means.loc[0.288], [189.56, 54.59, -45.78, -50.20, -36.48, -38.18], atol=0.0051)
    np.testing.assert_allclose(means.loc[0.391], [149.04, 58.27, -45.78, -45.07, -34.43, -38.18], atol=0.0051)
    primes = {
        0.288: [23.700, 1.092, -16.713, -7.331, -5.327, -2.229],
        0.391: [18.631, 1.165, -16.713, -6.581, -5.027, -2.229],
    }
    for k2, printed in primes.items():
        prime = 1e3 * means.loc[k2].to_numpy() / prime_factors(1023.8, 2.5, 0.8561)
        np.testing.assert_allclose(prime, printed, atol=2.5e-3)
    pmm = table("8_4_southampton_pmm").set_index("derivative")["mean"]
    gap = 100 * (means.loc[0.288, "n_v"] / pmm["N_v"] - 1)
    assert gap == pytest.approx(-29.4, abs=0.05)
    quoted(page, f"{100 * worst:.2f} %", "1023.8", "0.856", f"{gap:.1f} %")


def test_tables_8_8_and_8_10_do_not_swing_as_fitted(table, page: str) -> None:
    """The pair of each identified hull, at T 3.96 N (U/1.28)^2 and 8.3's T, against the fitted w and lambda of the same run."""
    points = {6: 1.446, 8: 1.548, 12: 1.751}
    fits = table("8_6_mariner_fits").set_index("run")
    for row in table("8_8_mariner_si").to_dict("records"):
        hull = Hull(*[row[c] for c in SIX], speed_m_s=row["speed_m_s"])
        tow = Tow(row["speed_m_s"], 0.91, points[row["tow_point"]], 3.96 * (row["speed_m_s"] / 1.28) ** 2)
        quoted(page, _pair_line(row["run"], hull, tow, fits))
    fits = table("8_7_bombardier_fits").set_index("run")
    for row in table("8_10_bombardier_si").to_dict("records"):
        hull = Hull(*[row[c] for c in SIX], speed_m_s=0.86)
        tow = Tow(0.86, 0.851, fits.loc[row["run"], "x_t_m"], TENSION_8_3_N[row["run"]])
        quoted(page, _pair_line(row["run"], hull, tow, fits))


def _pair_line(run: int, hull: Hull, tow: Tow, fits: pd.DataFrame) -> str:
    pair = stability(hull, tow).roots
    pair = pair[np.argmax(pair.imag)]
    fitted = fits.loc[run]
    return (
        f"| {run} | {pair.imag:.4f} | {fitted['omega_rad_s']:.4f} | {100 * (fitted['omega_rad_s'] / pair.imag - 1):+.1f} % "
        f"| {pair.real:+.4f} | {fitted['lambda_per_s']:+.4f} |"
    )


def test_the_phase_analysis_on_the_hull_it_was_checked_on(page: str) -> None:
    """Approach one on the ITTC hull's own exact swing: what neglected damping and the closure (8.8) cost at each tow point."""
    for x_t in (1.446, 1.548, 1.649, 1.751):
        tow = Tow(1.28, 0.91, x_t, 3.96)
        rates, vectors = np.linalg.eig(linear_system(ITTC, tow)[0])
        at = int(np.argmax(rates.imag))
        ratio = complex(vectors[0, at] / vectors[1, at])
        found = phase_from_amplitudes(
            Amplitudes(complex(rates[at]), ratio, 1.0, np.zeros((4, 4)), 0.0, 0.0), tow, ITTC.six[1] / ITTC.six[0]
        )
        gap = " | ".join(f"{g:+.1f}" for g in 100 * (found.six / ITTC.six - 1))
        quoted(page, f"| {x_t:.3f} | {found.damping_share:.4f} | {gap} |")


@pytest.mark.slow
def test_what_surge_does_to_the_frequency(page: str) -> None:
    """A decaying sinusoid through the tow's y_CG from 8 s on, with surge in full and with T constant."""
    t = np.arange(0, 60, 0.1)
    late = t > 8

    def frequency(x_t: float, release_deg: float, line: Line, x_vr_kg: float = 0.0) -> float:
        hull = replace(ITTC, mass_kg=78.0, x_udot_kg=-4.0, x_vr_kg=x_vr_kg)
        start = Start(alpha_rad=float(np.radians(release_deg)))
        y = simulate_full(hull, Tow(1.28, 0.91, x_t, 3.96, line=line), start, t)["y_cg_m"].to_numpy()[late]

        def left(rates: np.ndarray) -> np.ndarray:
            shape = np.exp(-rates[1] * t[late])[:, None] * np.column_stack(
                [np.cos(rates[0] * t[late]), np.sin(rates[0] * t[late])]
            )
            rows = np.column_stack([shape, np.ones(late.sum())])
            return y - rows @ np.linalg.lstsq(rows, y, rcond=None)[0]

        return float(least_squares(left, [0.35, 0.0]).x[0])

    for x_t in (1.446, 1.751):
        shifts = []
        for release in (5, 10, 15, 20):
            constant, surge = (frequency(x_t, release, line) for line in ("constant", "surge"))
            shifts.append(100 * (surge / constant - 1))
            assert abs(frequency(x_t, release, "surge", 71.19) / surge - 1) < 0.0013
        quoted(page, f"| {x_t:.3f} | {' | '.join(f'{s:+.2f}' for s in shifts)} |")
