"""``towline budget``: lines that sum to the fit's own uncertainty, each by its gain; what is not included; what is carried on."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import towline
from towline.cli import main
from towline.geometry import fit_datum
from towline.identify import Fit, RunData, fit_runs
from towline.identify.budget import Budget, Component, budget_of, judged, repeats_of
from towline.identify.budget.carried import carried_on
from towline.identify.budget.combine import coverage_factor, effective_degrees
from towline.identify.budget.water import density_slope_kg_m3_deg, fresh_water_density_kg_m3
from towline.identify.budget.zigzag import zigzag
from towline.identify.fit import Near
from towline.identify.noise import Whitener
from towline.pipeline.analysis import Identified, compute_motions, identify_batch
from towline.pipeline.budgeting import budget_batch, budget_lines
from towline.record import DerivativesFile, InputError, Priors, read_result
from towline.record.budget_file import BudgetFile, budget_beside
from towline.record.errors import EstimationError
from towline.record.priors import DERIVATIVE_NAMES, DerivativePriors, SurgePriors, ValuePrior
from towline.record.schema import CameraTable, DatumPoint
from towline.simulate import Hull, Start, Tow, simulate_full

CLOSES = 0.01
"""Promised: lines combine to the stated standard deviation within 1 %."""
AS_ITS_LINE_SAYS = 0.1
"""Promised: an input wrong by one standard uncertainty moves a derivative as its line says within 10 % ..."""
FIT_TOL = 0.02
"""... and two fits of tolerance 1e-8 of a chi-square of 6000, 0.008 of a standard deviation each."""
SIX = np.array([149.19, 62.11, -52.87, -66.33, -48.51, -57.60])
HULL = Hull(*SIX, speed_m_s=1.28, mass_kg=78.0, x_udot_kg=-4.0, x_vr_kg=40.0, x_vv_kg_m=-10.0)
T_S = np.arange(0, 40, 0.1)
PRIORS = Priors(
    tension_sd_rel=0.003,
    tow_point_sd_m=0.001,
    tension_common_sd_rel=0.005,
    line_length_sd_m=0.001,
    speed_sd_rel=0.002,
    surge=SurgePriors(x_udot_kg=ValuePrior(value=-4.0, std=2.0)),
)
QUICK = ("--noise", "output")


def tows(priors: Priors = PRIORS, names: tuple[str, ...] = ("a", "b", "c"), seed: int = 4, **more) -> list[RunData]:
    """Tows at three points, released at 12 degrees; ``more``: of ``RunData``."""
    rng = np.random.default_rng(seed)
    covariance = np.zeros((len(T_S), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = 1e-6, np.radians(0.1) ** 2
    found = []
    for k, name in enumerate(names):
        tow = Tow(1.28, 0.91, (1.446, 1.6, 1.751)[k % 3], 3.96, line="surge")
        motion = simulate_full(HULL, tow, Start(alpha_rad=np.radians(12.0) * (-1) ** k), T_S)
        noise = rng.standard_normal((len(T_S), 2)) * np.sqrt(np.diagonal(covariance[0]))
        y, beta = motion["y_cg_m"].to_numpy() + noise[:, 0], motion["beta_rad"].to_numpy() + noise[:, 1]
        common = np.array([np.column_stack([1e-3 * y, 0 * y]), np.column_stack([2e-3 * y**2, 2e-3 * y])])
        found.append(
            RunData(
                name=name, t_s=T_S, y_m=y, beta_rad=beta, covariance=covariance, common=common, common_key="camera",
                tow=tow, tension=None, speed=None, priors=priors, assumed_sigma=False, mass_kg=78.0, length_pp_m=2.66, **more,
            )
        )  # fmt: skip
    return found


@pytest.fixture(scope="module")
def runs() -> list[RunData]:
    return tows()


@pytest.fixture(scope="module")
def fit(runs: list[RunData]) -> Fit:
    return fit_runs(runs)


@pytest.fixture(scope="module")
def budget(fit: Fit, runs: list[RunData]) -> Budget:
    return budget_of(fit, runs)


def six_u(budget: Budget) -> np.ndarray:
    return np.sqrt(np.diag(budget.covariance))[:6]


# the lines ------------------------------------------------------------------------------------------------------------


def test_the_lines_sum_to_the_fits_covariance(budget: Budget, fit: Fit) -> None:
    """Not the six standard deviations alone: correlations too."""
    u = six_u(budget)
    assert budget.closure < CLOSES
    assert (np.abs(budget.covariance[:6, :6] - fit.covariance) < CLOSES * np.outer(u, u)).all()
    assert {c.source for c in budget.components if c.included} >= {
        "pixels, frame to frame", "tension gauge", "tow point", "line length", "speed", "surge", "camera",
    }  # fmt: skip


@pytest.mark.slow
def test_a_load_cells_history_is_four_lines() -> None:
    priors = PRIORS.model_copy(update={"tension_zero_sd_n": 0.02, "tension_delay_sd_s": 0.1})
    rng = np.random.default_rng(2)
    found = []
    for d in tows(priors, ("a", "c")):
        pull = 3.96 + 0.2 * np.sin(d.t_s) + 0.03 * rng.standard_normal(len(d.t_s))
        found.append(replace(d, gauge=(d.t_s, pull), tow=replace(d.tow, tension_n=3.96)))
    budget = budget_of(fit_runs(found), found)
    assert budget.closure < CLOSES
    of_a = {c.name for c in budget.components if c.source == "tension gauge" and c.run == "a"}
    assert of_a == {"scale of the history", "zero of the history", "delay of the history", "noise of the history"}


def stated_more(runs: list[RunData], c: Component, by: float) -> list[RunData]:
    """The runs with the input of a line stated ``by`` units more."""

    def tow(**change: Callable[[RunData], float]) -> list[RunData]:
        return [
            replace(d, tow=replace(d.tow, **{k: f(d) for k, f in change.items()})) if c.run in ("", d.name) else d
            for d in runs
        ]

    match c.source, c.name:
        case "tension gauge", "tension_n":
            return tow(tension_n=lambda d: d.tow.tension_n + by)
        case "tension gauge", _:
            return tow(tension_n=lambda d: d.tow.tension_n * np.exp(by))
        case "tow point", _:
            return tow(tow_point_m=lambda d: d.tow.tow_point_m + by)
        case "line length", _:
            return tow(line_length_m=lambda d: d.tow.line_length_m + by)
        case "speed", _:
            return tow(speed_m_s=lambda d: d.tow.speed_m_s + by)
        case "clock", _:
            return [replace(d, t_s=d.t_s * (1 + by)) for d in runs]
        case "mass and inertia", "mass_kg":
            return [replace(d, mass_kg=d.mass_kg + by) for d in runs]
    raise KeyError(c.name)


def refitted(fit: Fit, runs: list[RunData], others: list[RunData]) -> np.ndarray:
    """How far the six move; the fit begins at the old one, so that what it takes as exact must be what it was there."""
    return fit_runs(others, fit.form, fit.speed_m_s, near=Near.of(fit, runs, range(len(runs)))).six - fit.six


def test_an_input_wrong_by_one_sd_moves_the_derivatives_as_its_line_says(
    budget: Budget, fit: Fit, runs: list[RunData]
) -> None:
    u, seen = six_u(budget), set()
    for c in budget.components:
        if c.status == "fit" and c.sensitivity is not None and c.source != "surge" and (c.source, c.name) not in seen:
            seen.add((c.source, c.name))
            told = c.sensitivity[:6] * c.u
            moved = refitted(fit, runs, stated_more(runs, c, c.u))
            assert (np.abs(moved - told) < AS_ITS_LINE_SAYS * np.abs(told) + FIT_TOL * u).all(), (c.source, c.name)
    assert len(seen) == 5


@pytest.mark.parametrize(("name", "by"), [("mass_kg", 1.0), ("rate of the recording's clock", 5e-4)])
def test_what_the_fit_takes_as_exact_has_a_sensitivity_too(
    budget: Budget, fit: Fit, runs: list[RunData], name: str, by: float
) -> None:
    (c,) = [c for c in budget.components if c.name == name]
    assert c.status == "not included"
    assert not c.covariance.any()
    assert c.sensitivity is not None
    told, moved = c.sensitivity[:6] * by, refitted(fit, runs, stated_more(runs, c, by))
    assert (np.abs(moved - told) < AS_ITS_LINE_SAYS * np.abs(told) + FIT_TOL * six_u(budget)).all()


@pytest.mark.slow
def test_settings_without_priors_are_not_included_and_move_what_they_move() -> None:
    exact = tows(Priors(line_length_sd_m=0.0))
    fit = fit_runs(exact)
    budget = budget_of(fit, exact)
    out = {c.name: c for c in budget.components if not c.included}
    assert {"scale common to all runs", "line_length_m", "speed_m_s", "tow_point_m, all runs", "mass_kg"} <= set(out)
    assert budget.closure < CLOSES
    for name, by in (("line_length_m", 2e-3), ("tow_point_m, all runs", 2e-3), ("scale common to all runs", 2e-3)):
        told = out[name].sensitivity[:6] * by
        moved = fit_runs(stated_more(exact, out[name], by), fit.form, fit.speed_m_s, start=fit.six).six - fit.six
        assert (np.abs(moved - told) < AS_ITS_LINE_SAYS * np.abs(told) + FIT_TOL * six_u(budget)).all(), name


def test_an_error_of_the_tension_is_an_error_of_every_derivative() -> None:
    """On a line of constant tension forces over masses are all that a motion shows: k % in T is k % in all six."""
    constant = [replace(d, tow=replace(d.tow, line="constant"), common=d.common[:0]) for d in tows(Priors())]
    fit = fit_runs(constant)
    (c,) = [c for c in budget_of(fit, constant).components if c.name == "scale common to all runs"]
    assert c.sensitivity == pytest.approx(fit.six, rel=1e-3)


def test_a_stated_uncertainty_brings_a_line_in(budget: Budget) -> None:
    (c,) = [c for c in budget.components if c.source == "clock"]
    told = c.known(1e-4, "A", 7, "two GPS pulses an hour apart")
    assert told.included
    assert np.sqrt(np.diag(told.covariance)) == pytest.approx(1e-4 * np.abs(c.sensitivity))
    with pytest.raises(ValueError, match="nothing to add"):
        told.known(1e-4, "A", 7, "")


def test_white_noise_is_told_from_its_colour() -> None:
    """``uncoloured`` is the adjoint of the colour's filter, gaps and first samples included: <rows A x> = <A' rows, x>."""
    rng = np.random.default_rng(0)
    n, begins = 60, np.repeat([0, 25], [25, 35])
    weight = Whitener(
        np.tile(np.eye(2), (n, 1, 1)), (np.array([0.5, 0.2]), np.zeros(0)), np.ones(2), np.array([0.8, 1.0]), begins
    )
    x, rows = rng.standard_normal((2, n)), rng.standard_normal((2, 3, n))
    ahead = np.einsum("ckn,cn->k", rows, weight.along(x))
    assert np.einsum("ckn,cn->k", weight.uncoloured(rows), x) == pytest.approx(ahead)


def test_a_budget_of_the_innovations_form_is_refused(fit: Fit, runs: list[RunData]) -> None:
    with pytest.raises(EstimationError, match="--noise output"):
        budget_of(replace(fit, method="innovations"), runs)


# the camera -----------------------------------------------------------------------------------------------------------


def test_a_datums_shares_are_what_its_picks_and_places_do() -> None:
    """Each pick by its sigma, each point by its own, refitted: the squares sum to the shares' part of a place's variance."""
    lens = CameraTable(
        image_size_px=(800, 600), fx_px=900, fy_px=900, cx_px=400, cy_px=300, distortion=(0, 0, 0, 0, 0),
        sd=(5, 5, 3, 3, 0, 0, 0, 0, 0),
    )  # fmt: skip
    places = [(x, y, z) for x in (-0.5, -3.0) for y in (-1.0, 1.0) for z in (0.0, 0.3)]
    turn = np.array([[0, 1, 0], [0.6, 0, 0.8], [0.8, 0, -0.6]])
    seen = (np.array(places) - (1.0, 0.1, -2.0)) @ turn.T * (-1, 1, 1)
    seen[:, 2] *= np.sign(seen[0, 2])
    pixel = 900 * seen[:, :2] / seen[:, 2:] + (400, 300)
    points = [
        DatumPoint(pixel_px=tuple(p), tank_m=t, sigma_px=0.2, tank_sd_m=0.001)
        for p, t in zip(pixel.tolist(), places, strict=True)
    ]
    known = np.diag(np.square(lens.sd))

    def fitted(some: list[DatumPoint]):
        return fit_datum(some, lens, [0.1], (800, 600), known, robust=False)

    fit = fitted(points)
    assert sum(fit.shares.values()) == pytest.approx(np.eye(len(next(iter(fit.shares.values())))), abs=1e-6)
    at = np.array([[420.0, 330.0]])
    here = fit.mapping.to_tank(at, 0.1)
    modes = here.modes_m[:, 0]

    def moved(key: str, axis: int, by: float) -> float:
        total = 0.0
        for k, point in enumerate(points):
            value = list(getattr(point, key))
            value[axis] += by
            other = [*points[:k], point.model_copy(update={key: tuple(value)}), *points[k + 1 :]]
            total += (fitted(other).mapping.to_tank(at, 0.1).xy_m[0] - here.xy_m[0]) ** 2
        return total

    for name, key, axes, by in (("picks", "pixel_px", (0, 1), 0.2), ("places", "tank_m", (0, 1, 2), 0.001)):
        told = np.einsum("ki,kl,li->i", modes, fit.shares[name], modes)
        assert sum(moved(key, axis, by) for axis in axes) == pytest.approx(told, rel=0.05), name


# combined and carried on ----------------------------------------------------------------------------------------------


def test_degrees_of_freedom_are_those_of_the_gums_gauge_block() -> None:
    """JCGM 100, H.1.6: 32 nm of 25 (18), 9.7 (25.6), 2.9 (50), 16.6 (2): 16.7 degrees, t_99(16) = 2.92."""
    parts = np.array([25.0, 9.7, 2.9, 16.6])
    assert effective_degrees(parts, [18, 25.6, 50, 2]) == pytest.approx(16.7, abs=0.6)
    assert coverage_factor(16.7, 0.99) == pytest.approx(2.92, abs=0.005)
    assert coverage_factor(effective_degrees(parts, [np.inf] * 4)) == pytest.approx(1.96, abs=0.001)


def test_shares_of_a_quantity_are_one_and_draws_agree(budget: Budget) -> None:
    found = {q.name: q for q in carried_on(budget, 1.28, 2.66, np.random.default_rng(3)).quantities}
    x_v = found["X_v"]
    assert x_v.judged is not None
    assert x_v.judged.shares.sum() == pytest.approx(1.0)
    # 2000 draws tell the end of a 95 % interval to 5 % of its half width; twice that
    assert x_v.high - x_v.low == pytest.approx(2 * 1.96 * x_v.judged.u, rel=0.1)
    assert not any("zigzag" in name for name in found), "no rudder in these runs"


def with_rudder(budget: Budget) -> Budget:
    """The budget of a stable hull with rudder forces, known to 1 %."""
    value = np.array([149.19, 62.11, -80.0, -40.0, -30.0, -70.0, 20.0, -22.0])
    lines = [
        Component("all", n, "", "B", None, "", None, np.diag(np.eye(8)[i] * (0.01 * value[i]) ** 2), np.inf, "")
        for i, n in enumerate(DERIVATIVE_NAMES)
    ]
    return Budget(
        (*DERIVATIVE_NAMES, "y_delta", "n_delta"),
        (*budget.units[:6], "N/rad", "N m/rad"),
        value,
        budget.stated,
        tuple(lines),
    )


def test_turning_and_zigzag_are_the_integrated_hulls(budget: Budget) -> None:
    rudder = with_rudder(budget)
    found = {q.name: q for q in carried_on(rudder, 1.28, 2.66, np.random.default_rng(1)).quantities}
    m, i, y_v, y_r, n_v, n_r, y_d, n_d = rudder.value
    a, b = np.array([[y_v, y_r], [n_v, n_r]]) / [[m], [i]], np.array([y_d / m, n_d / i])
    assert found["turning ability K = r/delta"].value == pytest.approx(-np.linalg.solve(a, b)[1])
    assert found["X_r - X_v"].value == pytest.approx(n_r / y_r - n_v / y_v)

    def rates(delta: float):
        return lambda _, s: [*(a @ s[:2] + b * delta), s[1]]

    # K < 0: a rudder to port, positive, turns to port; the first heading is to starboard
    angle, state, time, peaks, thrown = np.radians(10.0), np.zeros(3), 0.0, [], []
    for k, (delta, goal) in enumerate(((-angle, angle), (angle, -angle), (-angle, angle))):
        event = lambda _, s, goal=goal: s[2] - goal  # noqa: E731
        event.terminal, event.direction = True, np.sign(goal)
        path = solve_ivp(rates(delta), (0, 60), state, events=event, rtol=1e-10, atol=1e-12, max_step=0.02)
        if k:
            peaks.append(np.abs(path.y[2]).max() - angle)
        state, time = path.y_events[0][0], time + path.t_events[0][0]
        thrown.append(time)
    seen = {name: float(v[0]) for name, _, v in zigzag(a[None], b[None], angle, 1.28, 2.66)}
    assert seen["first overshoot"] == pytest.approx(peaks[0], rel=2e-3)
    assert seen["second overshoot"] == pytest.approx(peaks[1], rel=2e-3)
    assert seen["time to the first throw"] == pytest.approx(thrown[0], rel=2e-3)
    assert seen["time between throws"] == pytest.approx(thrown[1] - thrown[0], rel=2e-3)
    ten = found["10/10 zigzag: first overshoot"]
    assert ten.value == pytest.approx(peaks[0], rel=2e-3)
    assert ten.low < ten.value < ten.high


def test_rudder_forces_that_are_stated_are_quantities_of_the_budget() -> None:
    """No rudder moves in these runs: Y_delta and N_delta stay at what [priors] says of them, and turning is carried on."""
    told = {"y_delta": ValuePrior(value=20.0, std=1.0), "n_delta": ValuePrior(value=-25.0, std=1.5)}
    runs = tows(PRIORS.model_copy(update={"derivatives": DerivativePriors(**told)}), ("a", "c"))
    budget = budget_of(fit_runs(runs), runs)
    assert budget.names[6:] == ("y_delta", "n_delta")
    assert budget.closure < CLOSES
    assert budget.value[6:] == pytest.approx([20.0, -25.0])
    assert np.sqrt(np.diag(budget.covariance))[6:] == pytest.approx([1.0, 1.5], rel=1e-3)
    found = [q.name for q in carried_on(budget, 1.28, 2.66, np.random.default_rng(1)).quantities]
    assert "turning ability K = r/delta" in found


def test_an_unstable_hull_has_no_turning_circle(budget: Budget) -> None:
    rudder = with_rudder(budget)
    rudder = replace(rudder, value=rudder.value * [1, 1, 1, 1, 6, 1, 1, 1])
    found = carried_on(rudder, 1.28, 2.66, np.random.default_rng(1))
    assert not found.stability.stable
    assert found.stability.probability < 0.01
    (turn,) = [q for q in found.quantities if q.name.startswith("turning circle")]
    assert np.isnan(turn.value)
    assert np.isnan(turn.low)


# repeats --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_repeats_that_scatter_as_stated_and_repeats_that_do_not() -> None:
    one_set_up = tuple("abcd")
    runs = [replace(d, tow=replace(d.tow, tow_point_m=1.446)) for d in repeated(one_set_up, 0.003)]
    found = repeats_of(fit_runs(runs), runs)
    assert found.groups == (one_set_up,)
    assert {r.name for r in found.derivatives} >= {"y_v", "n_r"}
    assert all(r.low < 1 < r.high or r.p_value > 0.01 for r in found.derivatives)
    worse = repeated(one_set_up, 0.05)
    off = repeats_of(fit_runs(worse), worse)
    assert min(r.p_value for r in off.derivatives) < 0.01
    assert max(r.ratio for r in off.derivatives) > 2
    assert repeats_of(fit_runs(tows()), tows()).why


def repeated(names: tuple[str, ...], scatter: float) -> list[RunData]:
    """Runs of one set-up whose gauge scatters by ``scatter``, stated as 0.3 %."""
    first, rng, found = tows(), np.random.default_rng(8), []
    for name in names:
        clean = simulate_full(HULL, first[0].tow, Start(alpha_rad=np.radians(12.0)), T_S)
        found.append(
            replace(
                first[0], name=name, common=first[0].common[:0],
                y_m=clean["y_cg_m"].to_numpy() + 1e-3 * rng.standard_normal(len(T_S)),
                beta_rad=clean["beta_rad"].to_numpy() + np.radians(0.1) * rng.standard_normal(len(T_S)),
                tow=replace(first[0].tow, tension_n=3.96 * (1 + scatter * rng.standard_normal())),
            )
        )  # fmt: skip
    return found


# the command ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folders(
    cases: ModuleType, write_runs: Callable[[list, Path], list[Path]], tmp_path_factory: pytest.TempPathFactory
) -> list[str]:
    made = cases.campaign("none", np.random.default_rng(8)).runs[:2]
    return [str(path) for path in write_runs(made, tmp_path_factory.mktemp("budget"))]


@pytest.fixture(scope="module")
def answer(folders: list[str]) -> Identified:
    return identify_batch(compute_motions(folders), noise="output")


@pytest.fixture(scope="module")
def out(folders: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out")
    assert main(["budget", *folders, *QUICK, "--docx", "-o", str(out)]) == 0
    return out


@pytest.mark.slow
def test_the_command_writes_what_it_says(out: Path) -> None:
    file = read_result(out / "budget.json", BudgetFile)
    assert file.closure < CLOSES
    assert list(file.quantities) == [*DERIVATIVE_NAMES, "x_v_m"]
    sources = {line.source: line.status for line in file.lines}
    assert sources["datum picks"] == "fit"
    assert sources["model form"] == sources["density and temperature"] == "not included"
    for name, q in file.quantities.items():
        assert sum(line.share.get(name, 0.0) for line in file.lines) == pytest.approx(1.0)
        assert q.expanded == pytest.approx(q.coverage_factor * q.combined_std)
        assert q.combined_std == pytest.approx(q.fit_std)


@pytest.mark.slow
def test_the_front_door_gives_the_same(folders: list[str], out: Path) -> None:
    found, file = towline.budget(*folders, noise="output"), read_result(out / "budget.json", BudgetFile)
    for name, q in file.quantities.items():
        assert found.quantities[name].expanded == pytest.approx(q.expanded, rel=1e-6)


@pytest.mark.slow
def test_the_tables_say_the_same(out: Path) -> None:
    file = read_result(out / "budget.json", BudgetFile)
    rows = list(csv.DictReader((out / "budget.csv").open(encoding="utf-8")))
    for name, q in file.quantities.items():
        mine = [row for row in rows if row["quantity"] == name]
        parts = [float(row["contribution"]) for row in mine if row["status"] in ("fit", "added")]
        assert np.sqrt(np.sum(np.square(parts))) == pytest.approx(q.combined_std)
        (last,) = [row for row in mine if row["source"] == "expanded"]
        assert float(last["contribution"]) == pytest.approx(q.expanded)
    tex = (out / "budget.tex").read_text(encoding="utf-8")
    lines = [line for line in tex.splitlines() if line.endswith(r"\\")]
    assert len({line.count("&") for line in lines if "multicolumn" not in line}) == 1
    assert tex.count("{") == tex.count("}")
    docx = pytest.importorskip("docx")
    document = docx.Document(str(out / "budget.docx"))
    assert len(document.tables) == 4
    assert document.tables[0].rows[3].cells[0].text == "Y_v"


@pytest.mark.slow
def test_the_page_of_the_fit_shows_the_budget_of_the_same_runs(folders: list[str], out: Path) -> None:
    assert 'id="budget"' in (out / "budget.html").read_text(encoding="utf-8")
    assert main(["identify", *folders, *QUICK, "-o", str(out)]) == 0
    assert 'id="budget"' in (out / "derivatives.html").read_text(encoding="utf-8")
    inputs = read_result(out / "derivatives.json", DerivativesFile).inputs
    assert budget_beside(out, inputs) is not None
    assert budget_beside(out, {**inputs, "another": "run"}) is None
    assert budget_beside(out / "elsewhere", inputs) is None


@pytest.mark.slow
def test_inputs_say_more_of_the_lines(answer: Identified, out: Path, tmp_path: Path) -> None:
    inputs = tmp_path / "inputs.toml"
    inputs.write_text(
        '[[input]]\nsource = "clock"\nstd = 1e-3\nevaluation = "A"\ndegrees = 5\norigin = "GPS"\n'
        '[[input]]\nsource = "density and temperature"\nname = "density_kg_m3"\nstd = 2.0\n'
        '[[input]]\nsource = "datum picks"\ndegrees = 3\n'
    )
    before, after = read_result(out / "budget.json", BudgetFile), budget_batch(answer, inputs)
    lines = {line.source: line for line in after.lines}
    assert (lines["clock"].status, lines["clock"].degrees, lines["clock"].origin) == ("added", 5, "GPS")
    assert lines["datum picks"].degrees == 3
    for name, q in after.quantities.items():
        added = lines["clock"].sensitivity[name] * 1e-3
        assert q.combined_std == pytest.approx(np.hypot(before.quantities[name].combined_std, added))
        assert q.fit_std == pytest.approx(before.quantities[name].fit_std)
        assert q.degrees is not None
    y_v = after.quantities["y_v"]
    assert y_v.prime is not None
    assert y_v.prime_std == pytest.approx(abs(y_v.prime) * np.hypot(y_v.combined_std / y_v.value, 2e-3))


@pytest.mark.slow
def test_a_temperature_gives_the_density_its_line(answer: Identified, out: Path, tmp_path: Path) -> None:
    """Against Kell's formula (J. Chem. Eng. Data 20 (1975) 97), another fit to other measurements; the two differ by 3e-3 kg/m3."""
    over, under = (-280.54253e-12, 105.56302e-9, -46.170461e-6, -7.9870401e-3, 16.945176, 999.83952), (16.87985e-3, 1.0)
    for t in np.linspace(0.5, 39.5, 14):
        assert fresh_water_density_kg_m3(t) == pytest.approx(np.polyval(over, t) / np.polyval(under, t), abs=5e-3)
        slope = (fresh_water_density_kg_m3(t + 0.1) - fresh_water_density_kg_m3(t - 0.1)) / 0.2
        assert density_slope_kg_m3_deg(t) == pytest.approx(slope, abs=1e-5)
    inputs = tmp_path / "inputs.toml"
    inputs.write_text("[water]\ntemperature_deg_c = 20.0\ntemperature_sd_deg_c = 0.5\n")
    before, after = read_result(out / "budget.json", BudgetFile), budget_batch(answer, inputs)
    (line,) = [line for line in after.lines if line.name == "density_kg_m3"]
    assert line.std == pytest.approx(0.2065 / 2, rel=1e-3)
    assert "998.21 kg/m3; run.toml states 1000" in line.origin
    for name, q in after.quantities.items():
        assert q.combined_std == pytest.approx(before.quantities[name].combined_std)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[water]\ntemperature_deg_c = 60.0\ntemperature_sd_deg_c = 0.5\n", "temperature_deg_c"),
        ('[[input]]\nsource = "clocks"\nstd = 1e-3\n', "input[0].source"),
        ('[[input]]\nsource = "datum picks"\nstd = 1.0\n', "in the fit already"),
        ('[[input]]\nsource = "density and temperature"\nname = "viscosity"\nstd = 1.0\n', "no sensitivity"),
        ('[[input]]\nsource = "clock"\nstd = -1.0\n', "std"),
    ],
)
def test_inputs_that_cannot_be_are_one_line(answer: Identified, tmp_path: Path, text: str, said: str) -> None:
    inputs = tmp_path / "inputs.toml"
    inputs.write_text(text)
    with pytest.raises(InputError) as error:
        budget_lines(answer, inputs)
    assert len(str(error.value).splitlines()) == 1
    assert "inputs.toml" in str(error.value)
    assert said in str(error.value)


@pytest.mark.slow
def test_the_diagnosis_is_a_line_where_it_is_of_these_runs(answer: Identified, out: Path, tmp_path: Path) -> None:
    """An effect of probability p that moves the derivatives by d adds p d d'; a diagnosis of other runs adds nothing."""
    file = read_result(out / "budget.json", BudgetFile)
    values = {name: file.quantities[name].value for name in DERIVATIVE_NAMES}

    def six(by: float) -> dict:
        return {name: {"value": value * by, "std": 1.0} for name, value in values.items()}

    row = {
        "effects": ["dry_friction"], "probability": 0.7, "probability_inexact": 0.1, "parameters": {}, "gap_before": 2.0,
        "gap_after": 1.0, "shrink": 0.9, "shrink_interval": [0.8, 1.0],
    }  # fmt: skip
    gap = {
        "schema": "towline/gap", "tool": "0", "inputs": file.inputs, "verdict": "effect", "runs": file.runs,
        "where": {"stage": "line", "share": {}, "runs": {}, "span_s": [0, 1], "band_hz": [0, 1]},
        "ranking": [row], "indistinguishable": [], "p_no_gap": 0.1, "p_unknown": 0.1, "set95": [], "next_run": None,
        "derivatives": {"before": six(1.0), "after": six(1.02)},
    }  # fmt: skip
    path = tmp_path / "gap.json"
    for runs, status in ((file.runs, "added"), (["another"], "not included")):
        path.write_text(json.dumps(gap | {"runs": runs}))
        found = budget_batch(answer, gap=path)
        (line,) = [one for one in found.lines if one.source == "model form"]
        assert line.status == status
        if status == "added":
            for name, value in values.items():
                assert line.contribution[name] == pytest.approx(np.sqrt(0.8) * 0.02 * abs(value))
            assert line.contribution["x_v_m"] == pytest.approx(0.0, abs=1e-9), "both of its derivatives move alike"


def test_motion_from_elsewhere_says_nothing_of_its_camera(motion_run: Callable[..., Path], tmp_path: Path) -> None:
    runs = [str(motion_run(tmp_path / name, point, name)) for name, point in (("a", 1.446), ("b", 1.751))]
    assert main(["budget", *runs, *QUICK, "--line", "constant", "--no-page", "-o", str(tmp_path)]) == 0
    file = read_result(tmp_path / "budget.json", BudgetFile)
    assert [line.run for line in file.lines if line.source == "camera"] == ["a", "b"]
    assert not any(line.share for line in file.lines if line.source == "camera")


@pytest.mark.slow
def test_what_has_no_value_has_no_budget(answer: Identified) -> None:
    rest = {name: d for name, d in answer.result.derivatives.items() if name != "n_v"}
    with pytest.raises(EstimationError, match="n_v: not determined by these runs"):
        budget_lines(replace(answer, result=answer.result.model_copy(update={"derivatives": rest})))


def test_the_diagonal_of_a_gradient_is_the_quantity_itself(budget: Budget) -> None:
    one = judged(budget, np.eye(len(budget.names))[3], budget.value[3])
    assert one.u == pytest.approx(six_u(budget)[3])
    assert one.expanded == pytest.approx(one.k * one.u)
