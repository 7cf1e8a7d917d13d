"""What is concluded from fitted hypotheses: verdict, twins, where a gap lies, how far it shrinks, what is left over.

The campaign is linear, y = a0 + rate t + what is planted, in white noise: every answer is that of a plain regression.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from linear_fits import NONE, fitted
from scipy.optimize import minimize

from towline.diagnose.effects import LIBRARY, Effect, Parameter
from towline.diagnose.effects.camera import EXACT
from towline.diagnose.effects.hull import CURRENT
from towline.diagnose.gap import NAMED, Diagnosis, best_measurement, called, diagnosed, rests_on, rival_of, twins_of
from towline.diagnose.inference.apart import Apart
from towline.diagnose.inference.engine import RUNS_AWAY, extended
from towline.diagnose.inference.evidence import LARGEST_SD, LARGEST_SHARE, Fitted, Inference, within
from towline.diagnose.inference.held_out import Shrink, removed_share, shrink, taken
from towline.diagnose.inference.hypothesis import with_effects
from towline.diagnose.inference.noise import TIMES_S
from towline.diagnose.inference.ranking import P_UNKNOWN, Candidate, Ranking
from towline.diagnose.inference.scan import BANDS, COST, LENGTHS, Leftover, leftover
from towline.diagnose.users import UsersNumber, UsersRun, UsersSimulator
from towline.diagnose.where import shortest_stretch, where

NOISE_M, STEP_S, COUNT = 1e-3, 0.2, 96
T_S = STEP_S * np.arange(COUNT)
STARTS_M, RATE_M_S = (0.1, 0.2, 0.4), 0.02
HERTZ, BEGIN_S, END_S, SIZE_M = 0.9, 6.0, 11.0, 6e-3
WAVE = np.sin(2 * np.pi * HERTZ * T_S) * ((T_S >= BEGIN_S) & (T_S < END_S))
"""What ``PUSH`` does to the second run; a line in the spectrum as wide as five seconds make it."""
PUSH = Effect(
    "push", "yaw", (Parameter("moment", "m", 0.01),), "It is pushed.", "Do not push it.", lag_s=2.0, sizes=(1.0,)
)
OTHER = Effect("bend", "sway", (Parameter("y_b", "m", 0.01),), "It bends.", "Straighten it.", sizes=(1.0,))


def shape(effect: str, run: str) -> np.ndarray:
    if effect == "push":
        return WAVE if run == "run-1" else np.zeros(COUNT)
    if effect == "early push":
        return WAVE if run == "run-0" else np.zeros(COUNT)
    if effect == "kick":
        return WAVE
    if effect == "runaway":
        return 1e70 * WAVE  # what a motion that grows beyond bounds makes of any size
    if effect == "knock" and run != "run-0":
        return np.zeros(COUNT)
    return np.sin(0.6 * T_S + 0.5)


def line(run: UsersRun, n: dict, effects: dict) -> np.ndarray:
    total = n["a0"] + n["rate"] * T_S[:, None]
    for name, (size,) in effects.items():
        total = total + size * shape(name, run.name)[:, None]
    return total[:, None]


def campaign(planted: list[np.ndarray]) -> UsersSimulator:
    """What is planted stands on the straight lines, noise included."""
    rows = zip(STARTS_M, planted, strict=False)
    runs = [
        UsersRun(f"run-{k}", T_S, (a + RATE_M_S * T_S + more)[:, None], NOISE_M**2 * np.eye(COUNT)[None])
        for k, (a, more) in enumerate(rows)
    ]
    own = [UsersNumber("a0", [*STARTS_M[: len(runs)]])]
    return UsersSimulator(runs, line, [UsersNumber("rate", RATE_M_S, size=RATE_M_S)], own, usual_force=1e-3)


def white(seed: int, runs: int = 3) -> list[np.ndarray]:
    return list(NOISE_M * np.random.default_rng(seed).normal(size=(runs, COUNT)))


def left(simulator: UsersSimulator, columns: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Coefficients, covariance and whitened residuals of the plain regression on ``columns`` of all runs, behind the starts."""
    runs = len(simulator.runs)
    design = np.zeros((runs, COUNT, runs + len(columns)))
    for k in range(runs):
        design[k, :, k] = 1.0
        design[k, :, runs:] = np.column_stack([column[k] for column in columns])
    values = np.array([run.values[:, 0] for run in simulator.runs])
    flat = design.reshape(-1, design.shape[2])
    covariance = np.linalg.inv(flat.T @ flat)
    found = covariance @ flat.T @ values.ravel()
    return found, covariance * NOISE_M**2, list((values - design @ found) / NOISE_M)


RATE = [T_S] * 3


# where a gap lies -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pushed() -> Diagnosis:
    """The second of three runs is pushed for five seconds, by six times the noise."""
    planted = white(1)
    planted[1] = planted[1] + SIZE_M * WAVE
    return diagnosed(campaign(planted), [PUSH, OTHER], "test", {}, rng=np.random.default_rng(0))


def test_a_planted_push_is_named_with_the_regressions_size_and_deviation(pushed: Diagnosis) -> None:
    """Slow random forces are estimated beside it, which widens it a little."""
    file = pushed.file
    assert (file.verdict, file.ranking[0].effects) == ("effect", ["push"])
    columns = [RATE, [shape("push", f"run-{k}") for k in range(3)]]
    found, covariance, _ = left(pushed.inference.simulator, columns)  # pyright: ignore[reportArgumentType]
    size, sd = file.ranking[0].parameters["push.moment"].value, file.ranking[0].parameters["push.moment"].std
    assert size == pytest.approx(found[-1], abs=0.3 * np.sqrt(covariance[-1, -1]))
    assert sd == pytest.approx(np.sqrt(covariance[-1, -1]), rel=0.15)
    # a time constant is told by its variant, good to 40 %
    lag = file.ranking[0].parameters["push.time_s"]
    assert (lag.value, lag.std) == pytest.approx((2.0, 0.8))
    rate = file.derivatives["after"]["rate"]
    assert rate.value == pytest.approx(found[3], abs=0.5 * rate.std)
    assert 0.9 * np.sqrt(covariance[3, 3]) < rate.std < 2 * np.sqrt(covariance[3, 3])


def test_where_it_lies_is_where_it_was_planted(pushed: Diagnosis) -> None:
    place = pushed.file.where
    assert place.stage == "yaw"
    assert place.share["yaw"] == pytest.approx(1 - pushed.file.p_no_gap - pushed.file.p_unknown, abs=0.01)
    assert place.runs["run-1"] > 0.95
    assert BEGIN_S <= place.span_s[0] < place.span_s[1] <= END_S + STEP_S
    assert place.band_hz[0] <= HERTZ <= place.band_hz[1]
    assert place.band_hz[1] - place.band_hz[0] < 2 / (END_S - BEGIN_S)
    assert pushed.file.sentences[0].startswith("Your simulator misses push in the yaw equation")


def test_the_drop_of_a_run_is_what_its_squares_lose(pushed: Diagnosis) -> None:
    """Against the regressions without the push and with it; all of it is in the five seconds of the push."""
    simulator: Any = pushed.inference.simulator
    before = left(simulator, [RATE])[2]
    after = left(simulator, [RATE, [shape("push", f"run-{k}") for k in range(3)]])[2]
    drop = pushed.place.drop["run-1"]
    assert drop.shape == (COUNT,)
    assert drop.sum() == pytest.approx(before[1] @ before[1] - after[1] @ after[1], rel=0.1)
    assert drop[WAVE != 0].sum() > 0.95 * drop.sum()


def test_the_random_forces_are_stated_in_the_simulators_unit(pushed: Diagnosis) -> None:
    assert pushed.best is not None
    forces, scale = pushed.best.fitted.forces, pushed.inference.simulator.force_scale
    assert pushed.file.noise == pytest.approx(
        {"side_n": scale * forces.side_n, "moment_n_m": scale * forces.moment_n_m, "time_s": TIMES_S[forces.time]}
    )
    assert scale != 1.0


@pytest.mark.parametrize(
    ("course", "share", "stretch"),
    [
        ((0.0, 1.0, 0.0, 3.0, 4.0, 2.0, 0.0, 0.0), 0.4, (4, 5)),
        ((0.0, 1.0, 0.0, 3.0, 4.0, 2.0, 0.0, 0.0), 0.6, (3, 5)),
        ((0.0, 1.0, 0.0, 3.0, 4.0, 2.0, 0.0, 0.0), 1.0, (1, 6)),
        ((0.0, 0.0, 0.0, 0.0, 0.0), 0.6, (0, 5)),
        ((2.0, 0.0, 0.0), 0.6, (0, 1)),
    ],
)
def test_the_shortest_stretch_that_holds_a_share(
    course: tuple[float, ...], share: float, stretch: tuple[int, int]
) -> None:
    assert shortest_stretch(np.array(course), share) == stretch


# from a ranking to a verdict --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def base() -> tuple[Inference, Fitted]:
    return fitted(campaign(white(2)))


def named(name: str, stage: str = "line", *parameters: Parameter) -> Effect:
    return Effect(name, stage, parameters or (Parameter("k", "", 1.0),), "", f"cure {name}")


def candidate(base: Fitted, evidence: float, *effects: Effect, numbers: tuple[Any, ...] = ()) -> Candidate:
    given = tuple(np.asarray(n, dtype=float) for n in numbers) or tuple(np.ones(len(e.parameters)) for e in effects)
    h = replace(base.hypothesis, effects=effects, numbers=given)
    return Candidate(effects, replace(base, hypothesis=h), evidence, 0.0)


def ranking_of(base: Fitted, *candidates: Candidate, probabilities: tuple[float, ...] = (), **more: Any) -> Ranking:
    shares = np.array(probabilities or [1 / max(len(candidates), 1)] * len(candidates))
    given = {"p_no_gap": 0.0, "p_unknown": 0.0, "free": None, "rest": Leftover(0.0), "excluded": {}, **more}
    return Ranking(base, candidates, shares, **given)


@pytest.mark.parametrize(
    ("p_no_gap", "p_unknown", "p_effects", "verdict"),
    [
        (0.9, 0.05, 0.05, "no_gap"),
        (0.21, 0.0, 0.79, "no_gap"),  # something is likely missing, but not surely
        (0.2, 0.4, 0.4, "effect"),
        (0.2, 0.41, 0.39, "unknown"),
        (0.19, 0.01, 0.8, "effect"),
        (0.0, 1.0, 0.0, "unknown"),
    ],
)
def test_a_gap_is_called_where_one_is_almost_sure(
    p_no_gap: float, p_unknown: float, p_effects: float, verdict: str
) -> None:
    assert called(p_no_gap, p_unknown, p_effects) == verdict


def test_a_free_force_weighs_by_the_prior_that_it_has(base: tuple[Inference, Fitted]) -> None:
    """A law of evidence 118 and prior e^-5.9, a free force of 115.5: with all of the unknown's prior it stands against the law, as
    one of thirty forces without a form it does not. Odds by hand; nothing is left over, and no gap is out of the question."""
    inference, fit = base
    with_law = fitted(campaign(white(2)), replace(OTHER, name="law", form=0.0))[1]
    law = Candidate(with_law.hypothesis.effects, with_law, 118.0, -5.9)
    shares = {}
    for fields in (1, 30):
        prior = float(np.log(P_UNKNOWN / fields))
        free = replace(candidate(fit, 115.5, replace(named("unknown"), form=0.0)), log_prior=prior)
        shares[fields] = extended(inference, ranking_of(fit, free=free), [law]).p_unknown
        odds = np.exp(115.5 + prior - (118.0 - 5.9))
        assert shares[fields] == pytest.approx(odds / (1 + odds), abs=1e-6)
    assert shares[1] > 0.5 > 0.2 > shares[30]


@pytest.mark.parametrize(
    ("before", "after", "noise", "share"),
    [
        (4.0, 1.0, 1.0, 1.0),
        (4.0, 0.9, 1.0, 1.0),
        (4.0, 1.3, 1.0, 0.9),
        (1.4, 0.8, 0.7, 6 / 7),
        (0.9, 0.8, 1.0, 0.0),
        (2.0, 3.0, 1.0, 0.0),
    ],
)
def test_the_share_of_a_gap_that_is_taken(before: float, after: float, noise: float, share: float) -> None:
    assert taken(before, after, noise) == pytest.approx(share, rel=1e-12)


def test_an_effect_whose_motion_runs_off_ends_no_diagnosis() -> None:
    """It is excluded in words, and the one that is there is named; with nothing else to try it is said as well."""
    runaway = Effect("runaway", "yaw", (Parameter("moment", "m", 0.01),), "It grows.", "", sizes=(1.0,))
    data = [n + SIZE_M * shape("push", f"run-{k}") for k, n in enumerate(white(4))]
    for library, verdict in (([runaway, PUSH], "effect"), ([runaway], "unknown")):
        found = diagnosed(campaign(data), library, "test", {}, rng=np.random.default_rng(0)).file
        assert (found.verdict, found.excluded["runaway"]) == (verdict, RUNS_AWAY)
        assert all("runaway" not in row.effects for row in found.ranking)
        assert verdict == "unknown" or found.ranking[0].effects == ["push"]


def test_an_effect_whose_equations_have_no_solution_without_a_run_ends_no_diagnosis(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A motion that is about to run off: slopes cancel beyond all digits as soon as one run less holds it."""

    def measured(inference: Inference, base: Fitted, best: Fitted, *others: Any) -> Shrink:
        if best.hypothesis.effects[0].name == "bend":
            raise np.linalg.LinAlgError("Singular matrix")
        return shrink(inference, base, best, *others)

    monkeypatch.setattr("towline.diagnose.gap.shrink", measured)
    data = [n + SIZE_M * shape("push", f"run-{k}") for k, n in enumerate(white(4))]
    found = diagnosed(campaign(data), [OTHER, PUSH], "test", {}, rng=np.random.default_rng(0)).file
    assert (found.verdict, found.excluded) == ("effect", {"bend": RUNS_AWAY})
    assert [row.effects for row in found.ranking] == [["push"]]


def test_an_effect_in_another_form_is_named_and_something_else_is_not() -> None:
    """The library's bend goes over the whole run; one with a ripple leaves something, a burst is no bend."""
    other_form = [n + SIZE_M * (3 * shape("bend", "") + 0.7 * np.sin(3.1 * T_S)) for n in white(3)]
    found = diagnosed(campaign(other_form), [OTHER], "test", {}, rng=np.random.default_rng(0)).file
    assert (found.verdict, found.ranking[0].effects) == ("form_not_exact", ["bend"])
    first = found.ranking[0]
    assert first.probability + first.probability_inexact > 0.5  # more than all else together
    assert found.p_unknown + found.p_no_gap + sum(
        r.probability + r.probability_inexact for r in found.ranking
    ) == pytest.approx(1)
    assert found.sentences[0].startswith(
        "Your simulator misses bend in the sway equation, in a form that is not exactly"
    )
    assert found.ranking[0].gap_after < found.ranking[0].gap_before
    burst = white(3)
    burst[1] = burst[1] + SIZE_M * WAVE
    found = diagnosed(campaign(burst), [OTHER], "test", {}, rng=np.random.default_rng(0)).file
    assert found.verdict == "unknown"


@pytest.mark.parametrize(
    ("pushed", "form", "named"),
    [
        (0.0, PUSH.form, {"bend"}),
        (1.0, PUSH.form, {"bend", "push"}),
        (3.0, PUSH.form, {"bend", "push"}),
        (0.0, EXACT, {"bend"}),
        (3.0, EXACT, {"bend", "push"}),
    ],
)
def test_two_effects_are_named_though_one_has_another_form(pushed: float, form: float, named: set[str]) -> None:
    """Beside a bend with a ripple something is left whatever else there is: a push of one run is named where there was one, with
    most of the probability, and is not where the ripple alone is left. Nor need both be of a kind that comes in other forms.
    """
    both = [n + SIZE_M * (3 * shape("bend", "") + 0.5 * np.sin(3.1 * T_S)) for n in white(5)]
    both[1] = both[1] + pushed * SIZE_M * WAVE
    push = replace(PUSH, form=form)
    found = diagnosed(campaign(both), [push, OTHER], "test", {}, rng=np.random.default_rng(0)).file
    assert (found.verdict, set(found.ranking[0].effects)) == ("form_not_exact", named)
    assert found.ranking[0].probability + found.ranking[0].probability_inexact > 0.5


@pytest.mark.slow
def test_beside_a_gross_effect_a_second_one_is_told_where_it_leaves_nothing() -> None:
    """The bend is a thousand times the noise; three hundredths of what it explains, which its form may leave over, are far more
    than what the push explains. Beside both there is noise alone. A ripple of all runs, which the push follows in one, is no push.
    """
    gross = replace(OTHER, parameters=(replace(OTHER.parameters[0], sd=1.0),))
    bend = 1000 * NOISE_M * shape("bend", "")
    both = [n + bend for n in white(5)]
    both[1] = both[1] + SIZE_M * WAVE
    found = diagnosed(campaign(both), [PUSH, gross], "test", {}, rng=np.random.default_rng(0)).file
    assert (found.verdict, set(found.ranking[0].effects)) == ("effect", {"bend", "push"})
    push = found.ranking[0].parameters["push.moment"]
    assert push.value == pytest.approx(SIZE_M, abs=3 * push.std)
    assert push.std < 0.1 * SIZE_M
    ripple = [n + bend + SIZE_M * np.sin(2 * np.pi * HERTZ * T_S) for n in white(6)]
    found = diagnosed(campaign(ripple), [PUSH, gross], "test", {}, rng=np.random.default_rng(0)).file
    assert found.ranking[0].effects == ["bend"]


@pytest.mark.once
@pytest.mark.parametrize(("second", "named"), [(None, {"bend"}), (1e-5, {"bend", "push"})])
def test_how_much_a_second_effect_may_take_of_a_gross_one_without_being_there(
    second: float | None, named: set[str]
) -> None:
    """Something else is left, too, so that the pair is no whole explanation: what the push takes is less than the form of such a
    bend may leave over, unless the bend is of a kind whose form is followed closely.
    """
    gross = replace(OTHER, parameters=(replace(OTHER.parameters[0], sd=1.0),), second=second)
    both = [n + 1000 * NOISE_M * shape("bend", "") + SIZE_M * np.sin(3.1 * T_S) for n in white(5)]
    both[1] = both[1] + SIZE_M * WAVE
    found = diagnosed(campaign(both), [PUSH, gross], "test", {}, rng=np.random.default_rng(0)).file
    assert (found.verdict, set(found.ranking[0].effects)) == ("form_not_exact", named)


@pytest.mark.parametrize(("push", "run", "named"), [("push", 1, {"knock", "push"}), ("early push", 0, {"knock"})])
def test_what_shows_where_a_gross_effect_is_not_at_work_is_none_of_its_form(
    push: str, run: int, named: set[str]
) -> None:
    """The first run alone is knocked, and something else is left there. A push of another run is no part of that; one of the same
    run may be.
    """
    gross = replace(OTHER, name="knock", parameters=(replace(OTHER.parameters[0], sd=1.0),))
    planted = white(5)
    planted[0] = planted[0] + 1000 * NOISE_M * shape("knock", "run-0") + SIZE_M * np.sin(3.1 * T_S)
    planted[run] = planted[run] + 0.6 * SIZE_M * WAVE
    library = [replace(PUSH, name=push), gross]
    found = diagnosed(campaign(planted), library, "test", {}, rng=np.random.default_rng(0)).file
    assert set(found.ranking[0].effects) == named


@pytest.mark.once
@pytest.mark.parametrize(("kicked", "named"), [((1,), {"bend"}), ((0, 1, 2), {"bend", "kick"})])
def test_a_second_effect_that_the_other_runs_do_not_bear_out_is_not_there(
    kicked: tuple[int, ...], named: set[str]
) -> None:
    """The library's kick is in every run. Of one that is in a single run it explains a third, and the runs kept aside are followed
    worse with it than with the bend alone, whatever its evidence is.
    """
    planted = [n + SIZE_M * 3 * shape("bend", "") for n in white(5)]
    for run in kicked:
        planted[run] = planted[run] + 2 * SIZE_M * WAVE
    found = diagnosed(
        campaign(planted), [replace(PUSH, name="kick"), OTHER], "test", {}, rng=np.random.default_rng(0)
    ).file
    assert found.verdict in NAMED
    assert set(found.ranking[0].effects) == named


def test_something_unknown_rests_on_no_base_that_follows_nothing(base: tuple[Inference, Fitted]) -> None:
    free, moving = candidate(base[1], 9.0, named("free")), cast("Fitted", SimpleNamespace(promised=9.0))
    follows, lost = (
        replace(ranking_of(base[1], free=free, follows=f), base=moving, p_no_gap=0.1) for f in (True, False)
    )
    assert rests_on(follows, "unknown") == [moving]
    assert rests_on(lost, "unknown") == []
    assert rests_on(lost, "no_gap") == [moving]


@pytest.mark.parametrize(("promised", "waits"), [(1.0, False), (12.0, True)])
def test_a_gap_far_larger_than_the_way_left_to_the_base_does_not_wait_for_its_end(
    base: tuple[Inference, Fitted], promised: float, waits: bool
) -> None:
    """A model that grows heavier in mid-tow: the fit without it never ends, and nothing is nearer to noise for that."""
    moving = cast("Fitted", SimpleNamespace(promised=promised))
    ranking = replace(
        ranking_of(base[1], free=candidate(base[1], 40.0, named("free"))), base=moving, p_no_gap=np.exp(-40.0)
    )
    assert (moving in rests_on(ranking, "unknown")) == waits


def test_a_one_sided_number_stays_on_its_side() -> None:
    """What pulls the other way is no reason for it: at its bound, the fit is at its end, and nothing is named."""
    sided = replace(OTHER, parameters=(replace(OTHER.parameters[0], one_sided=True),))
    against = [n - SIZE_M * shape("bend", "") for n in white(4)]
    _, fit = fitted(campaign(against), sided)
    assert fit.hypothesis.numbers[0][0] == 0.0
    assert fit.promised == pytest.approx(0.0, abs=1e-6)
    # the other numbers end where they would without it
    _, plain = fitted(campaign(against))
    assert fit.hypothesis.shared == pytest.approx(plain.hypothesis.shared, rel=1e-6)
    along = [n + SIZE_M * shape("bend", "") for n in white(4)]
    _, fit = fitted(campaign(along), sided)
    assert fit.hypothesis.numbers[0][0] == pytest.approx(SIZE_M, rel=0.05)


def test_twins_are_single_effects_within_three_and_the_symmetries_that_concern_them(
    base: tuple[Inference, Fitted],
) -> None:
    a, b, c, d, e = (named(n) for n in "abcde")
    best, near, far, pair = (
        candidate(base[1], evidence, *effects)
        for evidence, *effects in ((9.0, a), (6.01, b), (5.9, c), (8.9, d, e))
    )  # fmt: skip
    ranking = ranking_of(base[1], best, pair, near, far)
    symmetries = [("", ("m", "Y_r")), ("a", ("a", "x")), ("b", ("b", "y"))]
    assert twins_of(ranking, best, symmetries) == [["a", "b"], ["m", "Y_r"], ["a", "x"]]
    assert twins_of(ranking, pair, symmetries) == [["m", "Y_r"]]
    assert twins_of(ranking, None, symmetries) == [["m", "Y_r"]]
    assert twins_of(ranking_of(base[1], best, far), best, []) == []


def test_the_rival_is_the_nearest_single_effect_beside_the_headline(base: tuple[Inference, Fitted]) -> None:
    a, b, c = (named(n) for n in "abc")
    pair, near, far = (
        candidate(base[1], evidence, *effects) for evidence, *effects in ((9.0, a, b), (7.0, c), (2.0, b))
    )
    ranking = ranking_of(base[1], pair, far, near)
    assert rival_of(ranking, pair) is near
    assert rival_of(ranking, near) is far
    assert rival_of(ranking, None) is near
    assert rival_of(ranking_of(base[1], pair), pair) is None


CLOCK = next(e for e in LIBRARY if e.name == "frame_rate")
SLACKER = named("sag", "line", Parameter("stretch", "m", 1.0, apart=0.01), Parameter("sag", "m", 1.0, apart=0.002))


@pytest.mark.parametrize(
    ("sag", "clock", "known", "chosen"),
    [
        # 0.03 m is 3, 0.004 m is 2 of what a rule tells: D = 13; a clock off by 2e-3 is 20 of its 1e-4: D = 400
        (
            (0.03, 0.004),
            2e-3,
            (),
            ("frame_rate", 400.0, "tells whether it is frame_rate (expected D 400; 20 is enough)"),
        ),
        ((0.03, 0.004), 2e-4, (), ("sag", 13.0, "tells best, though not surely, whether it is sag (expected D 13; ")),
        ((0.03, 0.004), 2e-3, ("frame_rate.rate",), ("sag", 13.0, "sag.stretch to 0.01, sag.sag to 0.002: ")),
        ((0.0, 0.0), 5e-3, (), ("frame_rate", 2500.0, "(expected D over 1000; 20 is enough)")),
        # half of what a rule tells: D = 0.25, odds by a tenth
        (
            (0.005, 0.0),
            0.0,
            ("frame_rate.rate",),
            ("sag", 0.25, "would hardly tell whether it is sag (expected D below 1; "),
        ),
        ((0.0, 0.0), 0.0, ("frame_rate.rate", "sag.stretch", "sag.sag"), None),
    ],
)
def test_measured_is_what_tells_best_of_the_headline_and_its_rival(
    base: tuple[Inference, Fitted],
    sag: tuple[float, float],
    clock: float,
    known: tuple[str, ...],
    chosen: tuple[str, float, str] | None,
) -> None:
    """Both can be measured without a tow; what is farther behind could, too, and is not asked for."""
    first = candidate(base[1], 9.0, SLACKER, numbers=(sag,))
    second = candidate(base[1], 8.0, CLOCK, numbers=((clock,),))
    third = candidate(base[1], 1.0, replace(SLACKER, name="far"), numbers=((9.0, 9.0),))
    ranking = ranking_of(base[1], first, second, third)
    found = best_measurement(ranking, first, {name: Apart(0.0, 1.0) for name in known})
    if chosen is None:
        assert found is None
        return
    assert found is not None
    assert (found.effect, found.distance) == (chosen[0], pytest.approx(chosen[1]))
    assert chosen[2] in found.why
    assert found.why.endswith(SLACKER.cure if chosen[0] == "sag" else CLOCK.cure)


HULL = named(
    "both", "sway", Parameter("y_a", "", 2.0, none=1.0), Parameter("n_b", "", 0.5), Parameter("moment_c", "", 1.0)
)
SEEN = named("seen", "camera", Parameter("n_d", "", 1.0), Parameter("e", "", 1.0))


@pytest.mark.parametrize(
    ("effects", "numbers", "share"),
    [
        # in units of their usual size 2, 2 and -2: squares 4 in sway, 8 in yaw
        ((HULL,), ((5.0, 1.0, -2.0),), {"sway": 4 / 12, "yaw": 8 / 12}),
        ((HULL,), ((1.0, 0.0, 0.0),), {"sway": 1.0}),
        ((SEEN,), ((1.0, 2.0),), {"camera": 1.0}),
        ((named("single", "yaw", Parameter("y_f", "", 1.0)),), ((3.0,),), {"yaw": 1.0}),
        ((HULL, SEEN), ((5.0, 1.0, -2.0), (1.0, 2.0)), {"sway": 2 / 12, "yaw": 4 / 12, "camera": 0.5}),
        ((CURRENT,), ((0.01, 0.0),), {"sway": 1.0}),
    ],
)
def test_a_hull_effect_is_in_sway_and_yaw_by_its_numbers(
    base: tuple[Inference, Fitted], effects: tuple[Effect, ...], numbers: tuple[Any, ...], share: dict[str, float]
) -> None:
    """By the squares of what each is in units of its usual size; an effect of another stage is wholly there."""
    ranking = ranking_of(base[1], candidate(base[1], 9.0, *effects, numbers=numbers))
    found = where(base[0], ranking, None).share
    assert {stage: part for stage, part in found.items() if part} == pytest.approx(share)


@pytest.mark.parametrize(
    ("p_unknown", "probabilities", "stage", "share"),
    [
        (0.6, (0.1, 0.2), "line", {"camera": 0.2, "line": 0.7}),
        (0.1, (0.4, 0.2), "camera", {"camera": 0.5, "line": 0.2}),
        (0.1, (0.2, 0.1), "", {"camera": 0.25, "line": 0.15}),  # more likely nowhere at all
    ],
)
def test_what_is_in_no_library_counts_by_the_free_forms_stage(
    base: tuple[Inference, Fitted],
    p_unknown: float,
    probabilities: tuple[float, float],
    stage: str,
    share: dict[str, float],
) -> None:
    """One effect in the camera, and one pair of it and another in the line: a pair counts half in each."""
    seen, free = named("seen", "camera"), named("free", "line")
    inference, fit = base
    alone, pair = candidate(fit, 9.0, seen), candidate(fit, 9.0, seen, free)
    form = candidate(fit, 9.0, free)
    ranking = ranking_of(fit, alone, pair, probabilities=probabilities, p_unknown=p_unknown, free=form)
    found = where(inference, ranking, replace(alone, fitted=fit))
    assert {k: v for k, v in found.share.items() if v} == pytest.approx(share)
    assert found.stage == stage


def test_without_anything_to_compare_there_is_no_place(base: tuple[Inference, Fitted]) -> None:
    found = where(base[0], ranking_of(base[1]), None)
    assert (found.stage, found.runs, found.span_s, found.band_hz) == ("", {}, (0.0, 0.0), (0.0, 0.0))


# how far it shrinks -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "after", "share"),
    [(2.0, 1.0, 1.0), (2.0, np.sqrt(2.5), 0.5), (2.0, 0.7, 1.0), (2.0, 3.0, 0.0), (1.0, 1.0, 0.0), (0.6, 0.5, 0.0)],
)
def test_a_gap_shrinks_by_the_share_of_its_excess_that_goes(before: float, after: float, share: float) -> None:
    assert removed_share(before, after) == pytest.approx(share)


def test_a_gap_is_that_of_runs_the_fit_has_not_seen() -> None:
    """Each run kept aside in turn: the rate by a regression of the other two, its own start alone fitted to it."""
    simulator = campaign([more + 2e-3 * shape("bend", "") for more in white(3)])
    inference, fit = fitted(simulator)
    with_effect = fitted(simulator, OTHER)[1]
    found = shrink(inference, fit, with_effect, None, np.random.default_rng(0))
    values = np.array([run.values[:, 0] for run in simulator.runs])
    for columns, told in (([T_S], found.before), ([T_S, shape("bend", "")], found.after)):
        squares = 0.0
        for run in range(3):
            others = [k for k in range(3) if k != run]
            free = np.column_stack(columns)
            centred = np.concatenate([free - free.mean(axis=0)] * 2)
            target = np.concatenate([values[k] - values[k].mean() for k in others])
            slope = np.linalg.lstsq(centred, target, rcond=None)[0]
            rest = values[run] - free @ slope
            squares += float((((rest - rest.mean()) / NOISE_M) ** 2).sum())
        assert told == pytest.approx(np.sqrt(squares / (3 * (COUNT - 1))), rel=2e-3)
    assert found.before > 1.2 > 1.1 > found.after
    assert found.shrink == pytest.approx(removed_share(found.before, found.after))


def test_what_came_once_is_measured_on_its_own_run_alone() -> None:
    """The others tell nothing of a push that one run had: its size is a regression of that run, with the rate of the other two."""
    planted = white(4)
    planted[1] = planted[1] + SIZE_M * WAVE
    simulator = campaign(planted)
    inference, fit = fitted(simulator)
    found = shrink(inference, fit, fitted(simulator, PUSH)[1], None, np.random.default_rng(0))
    values, squares = np.array([run.values[:, 0] for run in simulator.runs]), 0.0
    for run in range(3):
        design = [np.column_stack([T_S, shape("push", f"run-{k}")]) for k in range(3)]
        centred = [columns - columns.mean(axis=0) for columns in design]
        others = [k for k in range(3) if k != run]
        target = np.concatenate([values[k] - values[k].mean() for k in others])
        rate = np.linalg.lstsq(np.concatenate([centred[k] for k in others]), target, rcond=None)[0][0]
        rest, push = values[run] - values[run].mean() - rate * centred[run][:, 0], centred[run][:, 1]
        rest = rest - push * (push @ rest) / max(push @ push, 1.0)
        squares += float((rest / NOISE_M) @ (rest / NOISE_M))
    assert found.alone == 1
    assert found.after == pytest.approx(np.sqrt(squares / (3 * (COUNT - 1) - 1)), rel=2e-3)
    assert found.before > 1.5 > 1.1 > found.after
    # what all runs tell is nobody's own
    assert shrink(inference, fit, fitted(simulator, OTHER)[1], None, np.random.default_rng(0)).alone == 0


@pytest.mark.parametrize(("sizes", "narrow"), [((1.0, 1.0, 1.0), True), ((1.0, 1.0, 1.8), False)])
def test_the_interval_of_a_shrink_is_what_runs_and_stretches_differ_by(sizes: tuple[float, ...], narrow: bool) -> None:
    """Residuals that are alike at all times and in all runs leave nothing to chance. Where one run keeps nearly all of its gap,
    the draws of three runs hold it twice or more in 7 of 27, never in 8 of 27: these are the ends."""
    fast, slow = np.tile([1.0, -1.0], COUNT // 2), np.tile([1.0, 1.0, -1.0, -1.0], COUNT // 4)
    before = [NOISE_M * (3 * fast + 2 * slow) for _ in sizes]
    inference, fit = fitted(campaign(before))
    after = fitted(campaign([NOISE_M * size * 2 * slow for size in sizes]))[1]
    found = shrink(inference, fit, after, None, np.random.default_rng(0))
    low, high = found.interval
    assert found.residuals[0][0].shape == (COUNT,)
    if narrow:
        assert (low, high) == pytest.approx((found.shrink, found.shrink), abs=0.01)
        return
    good, bad = (np.mean(np.square(found.residuals[run]), axis=1) for run in (0, 2))
    ends = [removed_share(*np.sqrt(both)) for both in ((good + 2 * bad) / 3, good)]
    assert (low, high) == pytest.approx(ends, abs=0.01)


# what is left over ------------------------------------------------------------------------------------------------


def test_a_burst_in_one_run_stands_out_by_its_likelihood_ratio() -> None:
    """Six blocks of four times the noise: log likelihood ratio of their squares, less the choice of a place and the price of
    looking at all."""
    planted = white(4)
    planted[1][40:46] *= 4
    inference, fit = fitted(campaign(planted))
    found = leftover(inference, fit)
    assert found.run == "run-1"
    first, last = (round(s / STEP_S) for s in found.span_s)
    assert 40 <= first < last <= 46
    rest = left(campaign(planted), [RATE])[2][1][first:last]
    ratio, tiles = rest @ rest / len(rest), 3 * sum(COUNT - length + 1 for length in LENGTHS)
    likelihood = 0.5 * len(rest) * (ratio - 1 - np.log(ratio))
    assert found.log_evidence == pytest.approx(likelihood - np.log(tiles) - COST, rel=1e-3)


def test_a_line_in_the_spectrum_of_all_runs_stands_out_at_its_frequency() -> None:
    """Five times the noise's power in a band of one or three frequencies, at another phase in each run."""
    hertz = 24 / (COUNT * STEP_S)
    phases = (0.1, 2.0, 4.0)
    planted = [e + 1.2 * NOISE_M * np.sin(2 * np.pi * hertz * T_S + p) for e, p in zip(white(5), phases, strict=True)]
    found = leftover(*fitted(campaign(planted)))
    assert (found.run, found.span_s) == ("", ())
    assert found.band_hz == pytest.approx((hertz, hertz))
    assert found.log_evidence > 5


@pytest.mark.parametrize("seed", range(6, 11))
def test_noise_leaves_nothing_over(seed: int) -> None:
    found = leftover(*fitted(campaign(white(seed))))
    assert found.log_evidence < 0
    assert len(BANDS) > 1


# a step of the fit ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [1.0, 0.3])
def test_a_number_that_would_go_too_far_is_held_and_the_others_take_the_best_step_beside_it(share: float) -> None:
    """A bend of six of its prior's deviations: it goes three (or a share of that), the rate and the starts as a regression says
    that has the bend there."""
    sd = OTHER.parameters[0].sd
    planted = [more + 6 * sd * shape("bend", "") for more in white(9)]
    simulator = campaign(planted)
    inference, fit = fitted(simulator)
    with_effect = inference.fit([with_effects(fit.hypothesis, [OTHER])], [NONE], 0)[0]
    found = inference.stepped(with_effect, share)
    bend = share * LARGEST_SD * sd
    assert found.numbers[0][0] == pytest.approx(bend)
    left_over = [run.values[:, 0] - bend * shape("bend", "") for run in simulator.runs]
    free = np.kron(np.eye(3), np.ones((COUNT, 1)))
    wanted = np.linalg.lstsq(np.column_stack([np.tile(T_S, 3), free]), np.concatenate(left_over), rcond=None)[0]
    limit = share * LARGEST_SHARE * max(abs(fit.hypothesis.shared[0]), RATE_M_S)
    assert abs(wanted[0] - fit.hypothesis.shared[0]) < limit  # else the rate would be held as well
    assert found.shared[0] == pytest.approx(wanted[0], rel=1e-4)
    np.testing.assert_allclose(found.own[:, 0], wanted[1:], rtol=1e-4)


def test_a_step_that_nothing_holds_is_taken_or_shortened_as_a_whole(base: tuple[Inference, Fitted]) -> None:
    inference, fit = base
    h = with_effects(fit.hypothesis, [PUSH])
    step = np.array([0.1 * RATE_M_S, 0.5 * PUSH.parameters[0].sd])
    solved = replace(fit.solved, shared=step, own=np.ones((3, 1)))
    for share in (1.0, 0.5):
        found = inference.stepped(replace(fit, hypothesis=h, solved=solved), share)
        np.testing.assert_allclose(found.shared, h.shared + share * step[:1])
        np.testing.assert_allclose(found.numbers[0], share * step[1:])
        np.testing.assert_allclose(found.own, h.own + share)


def test_the_best_step_between_bounds_is_a_quadratic_programs() -> None:
    """Against scipy's bounded minimum of the same quadratic, for 40 drawn ones with one bound at work."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        root = rng.normal(size=(4, 4))
        covariance, step = root @ root.T + 0.1 * np.eye(4), rng.normal(size=4)
        most = np.full(4, np.inf)
        most[0] = 0.5 * abs(step[0])
        least = np.where(np.isfinite(most), -most, -np.inf)
        found, cost = within(step, covariance, least, most)
        information = np.linalg.inv(covariance)
        wanted = minimize(
            lambda x, a=information, at=step: 0.5 * (x - at) @ a @ (x - at),
            np.zeros(4),
            jac=lambda x, a=information, at=step: a @ (x - at),
            bounds=list(zip(least, most, strict=True)),
            method="L-BFGS-B",
            options={"ftol": 1e-15, "gtol": 1e-10},
        )
        np.testing.assert_allclose(found, wanted.x, atol=1e-5)
        assert cost == pytest.approx(wanted.fun, rel=1e-5)
