"""A missing law, written down: the grammar, the search on laws that other code planted, and what is handed on."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from towline.blind.draw import gentle
from towline.blind.one_case import case_of
from towline.blind.seal import CASES, write_cases
from towline.blind.signature import distances_of, linear
from towline.blind.truth.cases import Case
from towline.cli.main import main
from towline.diagnose.effects import Effect, Parameter, Seen, Situation, load_effects
from towline.diagnose.inference.evidence import Inference
from towline.diagnose.inference.grams import Grams
from towline.diagnose.inference.hypothesis import with_effects
from towline.diagnose.inference.noise import Forces
from towline.diagnose.law.answer import without_linear
from towline.diagnose.law.field import SMOOTH, basis_of, field_effect, field_force
from towline.diagnose.law.functions import Range, State, term, written
from towline.diagnose.law.grammar import grammar, heels, resistances
from towline.diagnose.law.table import Choice, Table
from towline.diagnose.law.terms import ACTS, AHEAD, HEEL, effect_of, state_of, values_of
from towline.diagnose.simulated import effects_of
from towline.diagnose.users import UsersNumber, UsersRun, UsersSimulator
from towline.record.errors import InputError, TowlineError
from towline.record.law_file import LawFile
from towline.record.results import DerivativesFile, read_result
from towline.record.scenario import EffectTable, LawScenario
from towline.simulate.model import Hull, Tow, full_state, line_force

SEEN = Range(
    {"v": -0.03, "r": -0.1, "y": -0.2, "beta": -0.1, "turn": -0.3, "time": 0.0, "alpha": -0.3},
    {"v": 0.03, "r": 0.1, "y": 0.2, "beta": 0.1, "turn": 0.3, "time": 1.0, "alpha": 0.3},
    {"v": 0.01, "r": 0.04, "y": 0.07, "beta": 0.05, "turn": 0.15, "time": 0.58, "alpha": 0.12},
)


def states(n: int = 400) -> State:
    """Drawn within SEEN."""
    rng = np.random.default_rng(1)
    drawn = {name: rng.uniform(low, SEEN.high[name], n) for name, low in SEEN.low.items()}
    return State(v_late=drawn["v"], r_late=drawn["r"], **drawn)


def situation(s: State) -> Situation:
    """A tow at 1.5 m/s of a hull of 3 m in a tank of 4 m."""
    speed, length, width = 1.5, 3.0, 4.0
    nothing = 0.0 * s.v
    return Situation(
        t_s=s.time * 40.0, y_m=s.y * width / 2, beta_rad=s.beta, v_m_s=s.v * speed, r_rad_s=s.r * speed / length, alpha_rad=nothing,
        speed_m_s=speed, line_length_m=1.0, tow_point_m=1.5, tension_n=4.0, alpha_rate=(s.turn - s.r) * speed / length,
        length_pp_m=length, density_kg_m3=1000.0, half_width_m=width / 2, v_lag=s.v_late * speed,
        r_lag=s.r_late * speed / length, duration_s=40.0, y_v=-50.0, n_v=-50.0, n_r=-50.0, history=lambda _: 1.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("v|v|", lambda s: s.v * np.abs(s.v)),
        ("sign |r|^1.7", lambda s: np.sign(s.r) * np.abs(s.r) ** 1.7),
        ("|v|^2.5", lambda s: np.abs(s.v) ** 2.5),
        ("tanh(turn/0.01)", lambda s: np.tanh(s.turn / 0.01)),
        ("beyond(v/0.02)", lambda s: np.sign(s.v) * np.clip(np.abs(s.v) / 0.02 - 1, 0, None)),
        ("beyond(v/0.02, 0.1 round)", lambda s: np.sign(s.v) * 0.1 * np.log1p(np.exp((np.abs(s.v) / 0.02 - 1) / 0.1))),
        ("bump(beta at -0.02, 0.03 wide)", lambda s: np.exp(-(((s.beta + 0.02) / 0.03) ** 2) / 2)),
        ("(v+-0.3 r)|v+-0.3 r|", lambda s: (s.v - 0.3 * s.r) * np.abs(s.v - 0.3 * s.r)),
        ("1/(1-y)-1/(1+y)", lambda s: 2 * s.y / (1 - s.y**2)),
    ],
)
@pytest.mark.parametrize("acts", [acts for acts in ACTS if acts != HEEL])
def test_a_term_is_the_force_that_its_text_says(text: str, value: Any, acts: str) -> None:
    """rho/2 U^2 L^2 a side force, rho/2 U^2 L^3 a moment, at 1.5 m/s and 3 m."""
    s, effect = states(), effect_of(text, acts)
    numbers = [2.0e-3 * (k + 1) for k in range(len(ACTS[acts]))] + [shape.value for shape in term(text).shapes]
    by = dict(zip(ACTS[acts], numbers, strict=False))
    if acts == AHEAD:
        ahead = effect.ahead(situation(s), *numbers)
        np.testing.assert_allclose(ahead, by["x"] * 500 * 1.5**2 * 3**2 * value(s), rtol=1e-6, atol=1e-9)
        return
    side, moment = effect.force(situation(s), *numbers)
    np.testing.assert_allclose(side, by.get("y", 0.0) * 500 * 1.5**2 * 3**2 * value(s), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(moment, by.get("n", 0.0) * 500 * 1.5**2 * 3**3 * value(s), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(values_of(text, acts, numbers, s)[0], by.get("y", 0.0) * value(s), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("v|v|", lambda v, r: v * abs(v)),
        ("r^2", lambda v, r: r**2),
        ("tanh(v/0.02)", lambda v, r: np.tanh(v / 0.02)),
        ("(v+0.2 r)|v+0.2 r|", lambda v, r: (v + 0.2 * r) * abs(v + 0.2 * r)),
    ],
)
def test_a_heel_moves_the_marks_as_its_text_says_once_the_roll_has_died_away(text: str, value: Any) -> None:
    """A steady turn of 3 m at 1.5 m/s with v/U -0.03 and r L/U 0.1: the marks stand aside by k U^2/g of the term, the heading of
    marks of unlike height is off by 0.4 rad a metre, and the model is where it was."""
    u, length, v, r = 1.5, 3.0, -0.03, 0.1
    t_s = np.arange(0.0, 60.0, 0.1)[:, None, None]
    beta = r * u / length * t_s
    rates = (
        u * np.cos(beta) - v * u * np.sin(beta) - u, u * np.sin(beta) + v * u * np.cos(beta), r * u / length + 0.0 * t_s,
    )  # fmt: skip
    nothing = 0.0 * t_s
    seen = Seen(
        t_s,
        (nothing, nothing, beta),
        rates,
        nothing,
        nothing,
        4.0,
        np.zeros(0),
        speed_m_s=u,
        length_pp_m=length,
        duration_s=60.0,
    )
    numbers = [0.02, *(shape.value for shape in term(text).shapes), 1.1, 0.2, 0.4]
    effect = effect_of(text, HEEL)
    assert effect.observe is not None
    x, y, heading, apart = effect.observe(seen, *numbers)
    aside = 0.02 * u**2 / 9.81 * value(v, r)
    assert y[-1, 0, 0] == pytest.approx(aside, rel=1e-6)
    assert heading[-1, 0, 0] == pytest.approx(0.4 * aside, rel=1e-6)
    assert not x.any()
    assert not apart.any()
    # let go upright it swings beyond, by exp(-pi zeta / sqrt(1 - zeta^2)) of where it ends
    assert y[:, 0, 0][np.abs(y[:, 0, 0]).argmax()] / aside == pytest.approx(
        1 + np.exp(-np.pi * 0.2 / np.sqrt(0.96)), rel=0.01
    )


def test_what_acts_ahead_is_what_another_resistance_would_be() -> None:
    """A straight tow's R of 4 N and 1.5 N more as a push ahead, against R of 5.5 N: the same tension and the same rates."""
    hull = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28, mass_kg=78.0, x_udot_kg=-4.0)
    state = np.array([0.2, -0.05, 0.03, -0.02])
    tows = [Tow(1.28, 0.91, 1.6, pull, line="surge") for pull in (4.0, 5.5)]
    faster = full_state(0.0, state, hull, tows[0]).u_m_s / 1.28
    more = full_state(0.0, state, hull, tows[0], lambda *_: (0.0, 0.0, -1.5 * faster**hull.resistance_exponent))
    other = full_state(0.0, state, hull, tows[1])
    np.testing.assert_allclose(more.rates, other.rates, rtol=1e-12)
    assert more.tension_n == pytest.approx(other.tension_n, rel=1e-12)
    # aside it is about X tan(alpha + beta) at the tow point, as laws are compared with one another
    term_of = values_of("v^2", AHEAD, [-1.5], State(1.0, 0, 0, -0.05, 0, 0, 0, 0, 0.2, 1.6))
    assert term_of[0] == pytest.approx(-1.5 * np.tan(0.15))
    assert term_of[1] == pytest.approx(1.6 * term_of[0])
    without = full_state(0.0, state, hull, tows[0])
    aside = line_force(tows[0], more.tension_n - without.tension_n, np.sin(0.15), np.cos(0.15))
    np.testing.assert_allclose(aside, term_of[:2], rtol=5 * 0.15**2)


def test_a_wave_has_both_phases_and_a_number_that_is_fitted() -> None:
    s = states()
    found = values_of("wave(12 y)", "N", [3e-4, 4e-4, 13.0], s)[1]
    np.testing.assert_allclose(found, 5e-4 * np.sin(13.0 * s.y + np.arctan2(4, 3)), atol=1e-12)
    assert written("wave(12 y)", [13.0]) == "wave(13 y)"


def test_a_situation_made_dimensionless_comes_back() -> None:
    s = states()
    found = state_of(situation(s))
    for name in ("v", "r", "y", "beta", "turn", "time", "v_late", "r_late"):
        np.testing.assert_allclose(getattr(found, name), getattr(s, name), atol=1e-12)


def test_every_term_of_the_grammar_reads_back_from_its_text() -> None:
    searched = grammar(SEEN, True), resistances(SEEN), heels(SEEN)
    for terms in searched:
        assert len({one.text for one in terms}) == len(terms)
    for one in [one for terms in searched for one in terms]:
        again = term(one.text)
        assert (again.variables, again.parts, again.shapes) == (one.variables, one.parts, one.shapes)
        moved = [1.1 * shape.value for shape in one.shapes]
        assert [s.value for s in term(written(one.text, moved)).shapes] == pytest.approx(moved, rel=1e-3)
    assert not any("1/(1" in t.text for t in grammar(SEEN, False))


@pytest.mark.parametrize("text", ["v|v", "tanh(q/0.1)", "wave(y)", "v(t-0 s)", ""])
def test_what_is_no_term_is_refused(text: str) -> None:
    with pytest.raises(TowlineError, match="no term of the grammar"):
        effect_of(text)


def test_what_is_linear_in_v_and_r_counts_for_nothing() -> None:
    s = states()
    linear_force = np.array([3 * s.v - 2 * s.r, s.v + s.r, s.v])
    left = without_linear(linear_force, s)
    assert np.abs(left[:2]).max() < 1e-12
    np.testing.assert_array_equal(left[2], s.v)  # a heel is in no derivative


def planted(numbers: dict[str, float], seed: int, d: float) -> Case:
    """A campaign of the blind check's reality with a law that its own code makes (blind/truth/laws.py), of this D."""
    case = case_of("law", "null", [], [seed], coloured=False)
    case = gentle(replace(case, kind="unknown", effects=["law"], numbers=numbers))
    by = float(np.sqrt(d / distances_of(case, linear(case)).strength))
    return gentle(
        replace(case, numbers={k: v * by if k[4:8] in ("side", "turn", "lean") else v for k, v in case.numbers.items()})
    )


def test_the_judge_reads_every_term_as_the_grammar_means_it(laws_truth: ModuleType) -> None:
    """Two readers of one text, the benchmark's and the grammar's: the same force. What lags is no function of the state."""
    s, rng = states(), np.random.default_rng(3)
    of = {name: getattr(s, name) for name in laws_truth.NAMES}
    for one in [*grammar(SEEN, True), *resistances(SEEN), *heels(SEEN)]:
        if one.lag_s:
            continue
        basis, inside, variables = laws_truth.told_term(one.text)
        assert variables == set(one.variables)
        numbers = rng.normal(size=one.functions)
        told = sum(a * f for a, f in zip(numbers, basis(of, inside), strict=True))
        meant = values_of(one.text, "Y", [*numbers, *(shape.value for shape in one.shapes)], s)[0]
        np.testing.assert_allclose(told, meant, rtol=1e-6, atol=1e-9)


def law_seen(laws_truth: ModuleType) -> Any:
    s = states()
    return laws_truth.Seen(
        {name: getattr(s, name) for name in laws_truth.NAMES}, None, None, np.ones((2, len(s.v))), 1.0
    )


def test_the_judge_knows_a_heel_at_every_speed(laws_truth: ModuleType) -> None:
    """What heels a model grows with U^2, and so does what is told of it: of two speeds one number says both."""
    numbers = {"law.kind0": 2.0, "law.lean0": 0.3, "law.p0": 1.0, "law.b0": 2.0}
    case = case_of("law", "null", [], [6], coloured=False)
    case = replace(case, effects=["law"], numbers=numbers | {"marker_roll.period_s": 1.3, "marker_roll.damping": 0.15})
    slower = replace(case.runs[1], stated=case.runs[1].stated | {"speed_m_s": 0.7 * case.hull["speed_ref"]})
    case = replace(case, runs=[case.runs[0], slower])
    seen = laws_truth.seen_by(case, range(2))
    # at the reference speed's own U^2/g, by the usual sizes of v and r of blind/truth/laws.py
    k = 0.3 / 0.05 / 0.2**2 * laws_truth.sways_m(case) * 9.81 / case.hull["speed_ref"] ** 2
    roll = {"period_s": 1.3, "damping": 0.15, "turn_rad_m": 0.0}
    told = laws_truth.told([{"text": "v r^2", "acts": "K", "numbers": {"k": k} | roll}])
    true = laws_truth.true_force(seen)
    assert laws_truth.apart(told[0].force(seen), true, seen) < 1e-9
    assert laws_truth.right_form(told, seen, true)


@pytest.mark.parametrize(
    ("terms", "right"),
    [
        ([("sign |v|^1.7", {"y": 1.0, "power": 1.7})], True),
        ([("v|v|", {"y": 0.4})], True),
        ([("v^3", {"y": 1.0})], False),
        ([("v|v|", {"y": 1.0}), ("y^2", {"y": 1e-4})], True),
        ([("v|v|", {"y": 1.0}), ("y^2", {"y": 1.0})], False),
    ],
)
def test_a_form_is_right_with_other_numbers_and_without_needless_terms(
    laws_truth: ModuleType, terms: Any, right: bool
) -> None:
    """The truth is a side force by v|v|."""
    seen = law_seen(laws_truth)
    target = np.array([3.0 * seen.of["v"] * np.abs(seen.of["v"]), 0.0 * seen.of["v"], 0.0 * seen.of["v"]])
    told = laws_truth.told([{"text": text, "acts": "Y", "numbers": numbers} for text, numbers in terms])
    assert laws_truth.right_form(told, seen, target) is right


def test_a_force_without_a_form_varies_as_a_smooth_one_does() -> None:
    """Its prior covariance is the squared exponential's of its length, where the box's edges are far (Solin and Särkkä 2020)."""
    basis = basis_of(("y",), SEEN)
    half, middle = basis.half[0], basis.middle[0]
    place = middle + half * np.linspace(-0.3, 0.3, 7)
    here, there = (np.array(basis.values(replace(states(1), y=x))) for x in (np.array([middle]), place))
    covariance = (np.array(basis.sd)[:, None] ** 2 * here * there).sum(axis=0)
    np.testing.assert_allclose(covariance, np.exp(-0.5 * ((place - middle) / (SMOOTH * half)) ** 2), atol=0.01)


def test_a_force_without_a_form_pushes_as_its_numbers_say() -> None:
    """A side force by rho/2 U^2 L^2 and a moment by rho/2 U^2 L^3, at 1.5 m/s and 3 m; groups are added up."""
    s, groups = states(), [("y",), ("v", "r")]
    effect = field_effect(groups, SEEN, 1e-3, 0.25)
    numbers = np.random.default_rng(2).normal(size=len(effect.parameters))
    side, moment = field_force([basis_of(group, SEEN) for group in groups], numbers, s)
    found = effect.force(situation(s), *numbers)
    np.testing.assert_allclose(found[0], 500 * 1.5**2 * 3**2 * side, rtol=1e-9)
    np.testing.assert_allclose(found[1], 500 * 1.5**2 * 3**3 * moment, rtol=1e-9)


def test_a_resistance_without_a_form_pushes_ahead_as_a_side_force_of_its_numbers_would_aside() -> None:
    s = states()
    ahead, aside = field_effect([("y",)], SEEN, 3e-3, 0.25, AHEAD), field_effect([("y",)], SEEN, 3e-3, 0.25)
    assert [p.sd for p in ahead.parameters] == [p.sd for p in aside.parameters[: len(ahead.parameters)]]
    numbers = np.random.default_rng(3).normal(size=len(ahead.parameters))
    assert ahead.force is None
    np.testing.assert_allclose(
        ahead.ahead(situation(s), *numbers), aside.force(situation(s), *numbers, *(0.0 * numbers))[0], rtol=1e-12
    )


def test_a_choice_of_the_table_has_the_evidence_of_its_fit() -> None:
    """Where the simulation is linear in all numbers one step is the whole fit: terms alone and together."""
    rng, t_s, noise = np.random.default_rng(6), 0.1 * np.arange(60), 0.05
    shapes = {"square": lambda t: t**2, "wave": lambda t: np.sin(3 * t), "cube": lambda t: t**3}
    runs = [
        UsersRun(
            f"run-{k}",
            t_s,
            (0.5 * t_s + 0.02 * t_s**2 + noise * rng.normal(size=60))[:, None],
            noise**2 * np.eye(60)[None],
        )
        for k in range(2)
    ]

    def simulate(run: UsersRun, n: dict, effects: dict) -> np.ndarray:
        found = n["x0"] + n["k"] * t_s[:, None, None]
        for name, shape in shapes.items():
            if name in effects:
                found = found + effects[name][0] * shape(t_s)[:, None, None]
        return found

    simulator = UsersSimulator(
        runs, simulate, [UsersNumber("k", 0.5, size=0.5)], [UsersNumber("x0", [0.0] * 2)], usual_force=1e-3
    )
    effects = [
        Effect(name, "tank", (Parameter("size", "", 0.01 * (k + 1)),), "", "", sizes=(1.0,))
        for k, name in enumerate(shapes)
    ]
    start = simulator.starts()[0]
    inference = Inference(simulator, simulator.noise(start))
    base = inference.fit([start], [Forces()], 3, (1,))[0]
    table = Table(inference, base.hypothesis, effects, base.forces)
    choices = [Choice((0,), (0,), 0.0), Choice((0, 2), (0, 2), 1.5)]
    for choice, score, forces in zip(choices, *table.scores(choices), strict=True):
        h = with_effects(base.hypothesis, [effects[k] for k in choice.effects])
        grams = Grams(inference.linear([h])[0].columns, inference.noise)
        alone = inference.solve(grams, h, forces)
        log_evidence = alone.log_evidence + forces.log_prior(simulator.most_force)
        assert score == pytest.approx(log_evidence - choice.cost, abs=1e-3)
        numbers = table.solved(choice, forces)[1]
        np.testing.assert_allclose(numbers, alone.shared[-len(numbers) :], atol=1e-5)


@pytest.fixture(scope="module")
def bump(made_once: Callable[[str, Callable[[Path], None]], Path]) -> tuple[Path, Path]:
    """Runs with a side force at one place of the tank, and what the command wrote of them."""

    def make(folder: Path) -> None:
        case = planted({"law.kind0": 10.0, "law.side0": 0.02, "law.a0": 0.04, "law.phase0": 0.05}, 12, 1500.0)
        write_cases(folder, [replace(case, runs=case.runs[:4], duration_s=30.0)])
        runs = sorted((folder / CASES / "law").glob("run-*"))
        assert main(["diagnose", *map(str, runs), "--law", "-o", str(folder / "out")]) == 0

    folder = made_once("bump", make)
    return folder, folder / "out"


@pytest.mark.slow
def test_a_force_at_one_place_is_written_down_as_one(bump: tuple[Path, Path]) -> None:
    """A bump of 0.04 half widths at 0.05: place and width within four of their standard deviations, and these below a fifth."""
    file = read_result(bump[1] / "law.json", LawFile)
    assert file.verdict == "law"
    (found,) = file.laws[0].terms
    assert found.text.startswith("bump(y at ")
    for name, truth in (("at", 0.05), ("wide", 0.04)):
        number = found.numbers[name]
        assert abs(number.value - truth) < 4 * number.std
        assert number.std < 0.2 * truth
    assert file.laws[0].probability > 0.9
    assert file.laws[0].shrink is not None
    assert file.laws[0].shrink > 0.8


@pytest.mark.slow
def test_what_it_goes_with_is_told_without_an_equation_too(bump: tuple[Path, Path]) -> None:
    """The place has most of the evidence, as a function of its own, and the page draws that."""
    file = read_result(bump[1] / "law.json", LawFile)
    assert file.goes_with[0].variables == [["y"]]
    assert sum(one.share for one in file.goes_with) == pytest.approx(1.0, abs=0.05)
    assert file.field is not None
    assert file.field.probability < file.laws[0].probability
    page = (bump[1] / "gap.html").read_text()
    assert "Without an equation" in page
    assert "the missing force without an equation" in page


@pytest.mark.slow
def test_a_resistance_at_one_place_is_told_with_an_equation_and_without(tmp_path: Path) -> None:
    """The line's pull shows it. That it is ahead, and goes with y, is told by terms, and by a force without a form beside them."""
    case = planted({"law.kind0": 10.0, "law.along0": -0.02, "law.a0": 0.04, "law.phase0": 0.05}, 12, 1500.0)
    write_cases(tmp_path, [replace(case, runs=case.runs[:4], duration_s=30.0)])
    runs = sorted((tmp_path / CASES / "law").glob("run-*"))
    assert main(["diagnose", *map(str, runs), "--law", "-o", str(tmp_path / "out")]) == 0
    file = read_result(tmp_path / "out/law.json", LawFile)
    assert {term.acts for law in file.laws for term in law.terms} == {"X"}
    assert file.goes_with[0].variables == [["y"]]
    assert file.field is not None
    assert (file.field.acts, file.field.variables) == ("X", [["y"]])
    assert file.field.shrink is not None
    assert file.field.shrink > 0.5
    assert "Its mean is not drawn." in (tmp_path / "out/gap.html").read_text()


@pytest.mark.slow
def test_what_heels_the_model_is_told_and_handed_on(tmp_path: Path) -> None:
    """A model that lies over by v|v|, with its own roll of 1.3 s: the law, the roll's period within four standard deviations;
    law.py reads back; a scenario says that it moves no model."""
    case = planted(
        {"law.kind0": 0.0, "law.lean0": 0.02, "law.p0": 2.0, "marker_roll.period_s": 1.3, "marker_roll.damping": 0.15},
        12,
        8000.0,
    )
    write_cases(tmp_path, [replace(case, runs=case.runs[:4], duration_s=30.0)])
    runs = sorted((tmp_path / CASES / "law").glob("run-*"))
    out = tmp_path / "out"
    assert main(["diagnose", *map(str, runs), "--law", "-o", str(out)]) == 0
    file = read_result(out / "law.json", LawFile)
    assert file.verdict == "law"
    (found,) = file.laws[0].terms
    power = found.numbers["power"]
    assert (found.acts, found.text.split("^")[0]) == ("K", "sign |v|")
    assert abs(power.value - 2.0) < 3 * power.std
    assert power.std < 0.3
    assert "K: v|v|" in file.laws[0].same
    period = found.numbers["period_s"]
    assert abs(period.value - 1.3) < 4 * period.std
    assert period.std < 0.05
    # the marks' height above the roll axis, by which the truth's angle moves them
    height = np.interp(0.0, *zip(*sorted((ahead, above) for ahead, _, above in case.marks.values()), strict=True))
    truth = -case.numbers["law.lean0"] / 0.05**2 * height
    k = found.numbers["k"]
    assert abs(k.value * case.hull["speed_ref"] ** 2 / 9.81 - truth) < 4 * k.std * case.hull["speed_ref"] ** 2 / 9.81
    assert "Where marks above the roll axis would stand" in (out / "gap.html").read_text()
    (effect,) = load_effects(out / "law.py")
    assert (effect.name.split("^")[0], effect.variant) == ("law sign |v|", "K")
    with pytest.raises(InputError, match="shows in the marks and does not move the model"):
        effects_of(LawScenario(effect=(EffectTable(name=effect.name, form="K"),)), out / "law.toml", [effect])


@pytest.mark.slow
def test_a_law_is_handed_on_to_the_simulator_with_its_range(
    bump: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """law.toml and law.py make a scenario whose motion differs from that without the law; beyond the range it says so."""
    folder, out = bump
    scenario = folder / "scenario.toml"
    tables = (out / "law.toml").read_text().replace("[tow]\n", "")
    head = """name = "again"
[model]
length_pp_m = 2.66
mass_kg = 78.0
[water]
density_kg_m3 = 1000.0
tank_width_m = 4.6
[time]
duration_s = 20.0
rate_hz = 25.0
[tow]
speed_m_s = 1.28
line_length_m = 0.91
tow_point_m = 1.6
tension_n = 3.96
[start]
y_cg_m = 0.15
"""
    scenario.write_text(head.replace("[start]", 'line = "surge"\n[start]') + tables.replace('line = "surge"\n', ""))
    capsys.readouterr()
    assert (
        main(["simulate", str(scenario), "--effects", str(out / "law.py"), "-o", str(folder / "with.csv"), "--json"])
        == 0
    )
    told = json.loads(capsys.readouterr().out)
    assert told["result"]["notes"] == []
    plain = folder / "plain.toml"
    plain.write_text(scenario.read_text().split("[[effect]]")[0])
    assert main(["simulate", str(plain), "-o", str(folder / "without.csv")]) == 0
    one, two = (
        np.loadtxt(folder / f"{name}.csv", delimiter=",", skiprows=1, usecols=1) for name in ("with", "without")
    )
    assert np.abs(one - two).max() > 3e-4  # a hundred times what an integrator errs by
    far = folder / "far.toml"
    far.write_text(scenario.read_text().replace("y_cg_m = 0.15", "y_cg_m = 0.7"))
    capsys.readouterr()
    assert main(["simulate", str(far), "--effects", str(out / "law.py"), "-o", str(folder / "far.csv")]) == 0
    assert "where nothing is known of it" in capsys.readouterr().out


@pytest.mark.slow
def test_derivatives_are_fitted_beside_a_law_and_say_so(bump: tuple[Path, Path], tmp_path: Path) -> None:
    """The law that was found is a note and an input of derivatives.json; runs that it was found in stay within its range."""
    folder, out = bump
    runs = [str(run) for run in sorted((folder / CASES / "law").glob("run-*"))]
    law = [str(out / name) for name in ("law.toml", "law.py")]
    assert main(["identify", *runs, "--effects", *law, "--no-page", "-o", str(tmp_path)]) == 0
    file = read_result(tmp_path / "derivatives.json", DerivativesFile)
    assert any("fitted beside a law" in note and "bump(y at" in note for note in file.notes)
    assert {"law.toml", "law.py"} <= set(file.inputs)
    # a fit leaves a little more than the measured range at a run's ends, or less
    assert sum("nothing is known of it" in note for note in file.notes) <= 2


@pytest.mark.slow
def test_no_law_is_looked_for_in_noise(tmp_path: Path) -> None:
    case = gentle(case_of("none", "null", [], [5], coloured=True))
    write_cases(tmp_path, [replace(case, runs=case.runs[:2], duration_s=26.0)])
    runs = sorted((tmp_path / CASES / "none").glob("run-*"))
    assert main(["diagnose", *map(str, runs), "--law", "--no-page", "-o", str(tmp_path / "out")]) == 0
    file = read_result(tmp_path / "out" / "law.json", LawFile)
    assert (file.verdict, file.laws) == ("no_gap", [])
    assert "noise" in file.sentences[0]
    assert not (tmp_path / "out" / "law.py").exists()
