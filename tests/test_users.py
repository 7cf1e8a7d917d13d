"""The diagnosis with a simulator and effects of one's own: a roll decay whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from towline.diagnose.effects import Effect, Parameter
from towline.diagnose.gap import Diagnosis, diagnosed
from towline.diagnose.users import UsersNumber, UsersRun, UsersSimulator
from towline.record import InputError

STEP_S, BLOCKS, NOISE_RAD = 0.2, 110, 5e-4
W2, C = 4.0, 0.08
RELEASES_RAD = (0.1, 0.25, 0.4)
EFFECTS = (
    Effect(
        "quadratic",
        "roll",
        (Parameter("q", "1/rad", 0.1, one_sided=True),),
        "Bilge keels shed vortices.",
        "Add q w|w|.",
    ),
    Effect("dry", "roll", (Parameter("f", "rad/s2", 0.01, one_sided=True),), "The pivot rubs.", "Add f sign(w)."),
    Effect("offset", "sensor", (Parameter("b", "rad", 0.005),), "The sensor's zero is off.", "Read it upright."),
)


def roll(run: UsersRun, n: dict, effects: dict) -> np.ndarray:
    """a'' = -w2 a - c a' with the effects, k rolls side by side."""
    (q,), (f,), (b,) = (effects.get(e.name, (0.0,)) for e in EFFECTS)

    def rates(x: np.ndarray) -> np.ndarray:
        a, w = x
        return np.array([w + 0 * a, -n["w2"] * a - n["c"] * w - q * w * np.abs(w) - f * np.tanh(w / 0.02)])

    x, h = np.array([n["a0"] + 0 * n["w2"], 0 * n["w2"]]), STEP_S / 2
    path = [x[0]]
    for _ in range(2 * (len(run.centre_s) - 1)):
        k1 = rates(x)
        k2 = rates(x + h / 2 * k1)
        k3 = rates(x + h / 2 * k2)
        k4 = rates(x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        path.append(x[0])
    return (np.array(path[::2]) + b)[:, None]


def runs(rng: np.random.Generator, **planted: tuple[float, ...]) -> list[UsersRun]:
    made = []
    centre_s = np.arange(BLOCKS) * STEP_S
    for k, release in enumerate(RELEASES_RAD):
        run = UsersRun(f"roll-{k + 1}", centre_s, np.zeros((BLOCKS, 1)), NOISE_RAD**2 * np.eye(BLOCKS)[None])
        numbers = {"w2": np.array([W2]), "c": np.array([C]), "a0": np.array([release])}
        values = roll(run, numbers, {name: tuple(map(np.atleast_1d, v)) for name, v in planted.items()})[..., 0]
        made.append(UsersRun(run.name, centre_s, values + NOISE_RAD * rng.normal(size=values.shape), run.covariance))
    return made


def answer(shared: dict, run: UsersRun) -> np.ndarray:
    w = np.sqrt(shared["w2"][0])
    return (STEP_S * np.exp(-shared["c"][0] * run.centre_s / 2) * np.sin(w * run.centre_s) / w)[:, None]


def judged(made: list[UsersRun]) -> Diagnosis:
    shared = [UsersNumber("w2", 3.5, size=4.0), UsersNumber("c", 0.1, size=0.1)]
    own = [UsersNumber("a0", [float(r.values[0, 0]) for r in made])]
    simulator = UsersSimulator(made, roll, shared, own, answer, usual_force=1e-3, most_force=0.05)
    return diagnosed(simulator, EFFECTS, "test", {}, rng=np.random.default_rng(0))


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_missing() -> None:
    found = judged(runs(np.random.default_rng(1)))
    assert found.file.verdict == "no_gap"
    for name, value in (("w2", W2), ("c", C)):
        fitted = found.file.derivatives["before"][name]
        assert abs(fitted.value - value) < 4 * fitted.std
    assert found.file.next_run is None


@pytest.mark.once
@pytest.mark.parametrize(("name", "size"), [("quadratic", 0.1), ("dry", 0.01), ("offset", 0.004)])
def test_a_users_effect_is_named_with_its_size(name: str, size: float) -> None:
    found = judged(runs(np.random.default_rng(2), **{name: (size,)}))
    assert found.file.verdict == "effect"
    assert found.file.ranking[0].effects == [name]
    (measured,) = found.file.ranking[0].parameters.values()
    assert abs(measured.value - size) < 4 * measured.std < size
    stage = next(e.stage for e in EFFECTS if e.name == name)
    assert found.file.where.stage == stage
    # without it the damping or the start is biased, with it the truth is inside
    for number, value in (("w2", W2), ("c", C)):
        fitted = found.file.derivatives["after"][number]
        assert abs(fitted.value - value) < 4 * fitted.std


@pytest.mark.slow
def test_what_is_in_no_list_is_unknown() -> None:
    """A moment that depends on the place: none of the three effects has it, and the random forces it asks for are too large."""
    made = runs(np.random.default_rng(3))
    changed = []
    for run in made:
        extra = 0.03 * np.sin(40 * run.values) * np.cos(0.3 * run.centre_s)[:, None]
        changed.append(UsersRun(run.name, run.centre_s, run.values + extra, run.covariance))
    assert judged(changed).file.verdict == "unknown"


def parabola(run: UsersRun, n: dict, effects: dict) -> np.ndarray:
    """y = p x + q x^2 with a wave, k of them side by side."""
    x, (size,) = run.centre_s[:, None], effects.get("wave", (0.0,))
    return (n["p"] * x + n["q"] * x**2 + size * np.sin(9 * x))[:, None]


def bent(rng: np.random.Generator, wave: float = 0.0, count: int = 2) -> list[UsersRun]:
    """y = 2 x + 3 x^2, noise 0.01."""
    x = np.arange(120) * 0.02
    noise = 0.01**2 * np.eye(len(x))[None]
    y = 2 * x + 3 * x**2 + wave * np.sin(9 * x)
    return [UsersRun(f"r{k}", x, (y + 0.01 * rng.normal(size=len(x)))[:, None], noise) for k in range(count)]


WAVE = Effect("wave", "sensor", (Parameter("a", "", 0.1),), "It waves.", "Add a sin 9x.")


@pytest.mark.once
@pytest.mark.parametrize("start", [(0.0, 0.0), (1.0, 0.0), (-5.0, 0.0), (2.0, 0.035), (-10.0, 30.0)])
def test_a_number_may_begin_anywhere_at_zero_and_on_the_wrong_side_too(start: tuple[float, float]) -> None:
    """The optimum of a problem that is linear in its numbers, by least squares in closed form, from any start."""
    made = bent(np.random.default_rng(1))
    x = np.concatenate([r.centre_s for r in made])
    known, *_ = np.linalg.lstsq(np.column_stack([x, x**2]), np.concatenate([r.values[:, 0] for r in made]), rcond=None)
    found = diagnosed(
        UsersSimulator(made, parabola, [UsersNumber("p", start[0]), UsersNumber("q", start[1])], []),
        (WAVE,), "test", {}, rng=np.random.default_rng(0),
    )  # fmt: skip
    assert found.file.verdict == "no_gap"
    for name, value in zip("pq", known, strict=True):
        fitted = found.file.derivatives["before"][name]
        # random forces, hardly any, weigh the samples a little otherwise; a number that is stuck is a thousand sd off
        assert abs(fitted.value - value) < 0.3 * fitted.std


@pytest.mark.slow
@pytest.mark.parametrize("shares", [(0.34, 2.9), (2.9, 0.34), (2.0, 2.0), (0.5, 0.5)])
def test_a_swing_begins_within_a_factor_of_three_of_its_numbers(shares: tuple[float, float]) -> None:
    """Seven swings, w2 or c three times off: out of phase from the first swing on, and the same optimum all the same."""
    made = runs(np.random.default_rng(1))
    own = [UsersNumber("a0", [float(r.values[0, 0]) for r in made], size=0.1)]
    ends = []
    for share in (shares, (1.0, 1.0)):
        shared = [UsersNumber("w2", share[0] * W2, size=W2), UsersNumber("c", share[1] * C, size=C)]
        simulator = UsersSimulator(made, roll, shared, own, answer, usual_force=1e-3, most_force=0.05)
        ends.append(diagnosed(simulator, EFFECTS[:1], "test", {}, rng=np.random.default_rng(0)).file)
    assert [file.verdict for file in ends] == ["no_gap", "no_gap"]
    for name in ("w2", "c"):
        here, there = (file.derivatives["before"][name] for file in ends)
        assert abs(here.value - there.value) < 0.1 * there.std


@pytest.mark.once
@pytest.mark.parametrize(
    ("wave", "library", "verdict"), [(0.0, (), "no_gap"), (0.2, (), "unknown"), (0.2, (WAVE,), "effect")]
)
@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("free", [True, False])
def test_one_run_no_free_number_and_an_empty_library_are_answered(
    wave: float, library: tuple[Effect, ...], verdict: str, count: int, free: bool
) -> None:
    shared = [UsersNumber("p", 1.0), UsersNumber("q", 0.0)] if free else []

    def simulate(run: UsersRun, n: dict, effects: dict) -> np.ndarray:
        k = 1 + sum(len(v) for v in effects.values())
        return parabola(run, n if free else {"p": np.full(k, 2.0), "q": np.full(k, 3.0)}, effects)

    made = bent(np.random.default_rng(2), wave, count)
    found = diagnosed(
        UsersSimulator(made, simulate, shared, []), library, "test", {}, rng=np.random.default_rng(0)
    ).file
    assert found.verdict == verdict
    assert found.kept_aside == (count > 1)
    if verdict == "effect":
        assert found.ranking[0].effects == ["wave"]


@pytest.mark.slow
def test_a_fit_that_does_not_come_to_its_end_is_no_answer() -> None:
    """A number in the wrong units: begun, and of a size, twelve orders below what it is, too far for the steps that are taken."""
    made = bent(np.random.default_rng(1))

    def simulate(run: UsersRun, n: dict, effects: dict) -> np.ndarray:
        return parabola(run, {"p": 1e-6 * n["p"], "q": 1e-6 * n["q"]}, effects)

    shared = [UsersNumber("p", 1e-6, size=1e-6), UsersNumber("q", 1e-6, size=1e-6)]
    found = diagnosed(
        UsersSimulator(made, simulate, shared, []), (WAVE,), "test", {}, rng=np.random.default_rng(0)
    ).file
    assert found.verdict == "not_converged"
    assert found.promised > 3
    assert "did not come to its end" in found.sentences[0]


def test_linear_algebra_runs_on_one_thread_meanwhile() -> None:
    """A thread each for small matrices cost four times the time; what the caller had set holds again afterwards."""
    seen = set()

    def threads() -> set[int]:
        return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}

    def simulate(run: UsersRun, n: dict, effects: dict) -> np.ndarray:
        seen.update(threads())
        return parabola(run, n, effects)

    made = bent(np.random.default_rng(1))
    with threadpool_limits(2, user_api="blas"):
        before = threads()
        diagnosed(
            UsersSimulator(made, simulate, [UsersNumber("p", 1.0), UsersNumber("q", 1.0)], []),
            (WAVE,), "test", {}, rng=np.random.default_rng(0),
        )  # fmt: skip
        assert threads() == before
    assert seen == {1}


def test_wrong_shapes_are_said() -> None:
    made = runs(np.random.default_rng(4))
    shared, own = [UsersNumber("w2", 4.0), UsersNumber("c", 0.1)], [UsersNumber("a0", 0.1)]
    with pytest.raises(InputError, match="expected at least one"):
        UsersSimulator([], roll, shared, own)
    uneven = UsersRun("x", np.r_[0.0, 0.1, np.arange(2, BLOCKS) * STEP_S], made[0].values, made[0].covariance)
    with pytest.raises(InputError, match="evenly spaced"):
        UsersSimulator([uneven], roll, shared, own)
    wrong = UsersSimulator(made, lambda run, n, effects: np.zeros(3), shared, own)
    with pytest.raises(InputError, match=r"gave shape \(3,\)"):
        wrong.linear(wrong.starts(), 0)
