"""What is measured without a tow counts as data: against the closed form of a linear number, and its errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

from towline.diagnose.effects import LIBRARY, Effect, Parameter
from towline.diagnose.inference.apart import Apart, measured_apart, measurement
from towline.diagnose.inference.evidence import Fitted, Inference
from towline.diagnose.inference.grams import Grams
from towline.diagnose.inference.hypothesis import Hypothesis, with_effects
from towline.diagnose.inference.noise import Forces
from towline.diagnose.inference.screen import screened
from towline.diagnose.users import UsersNumber, UsersRun, UsersSimulator
from towline.record import InputError, read_run

WAVE = Effect("wave", "sensor", (Parameter("b", "rad", 0.005),), "It shakes.", "Hold it.", sizes=(1.0,))
BEYOND = Effect(
    "beyond", "sensor", (Parameter("c", "", 1.0), Parameter("d", "", 1.0)), "It runs off.", "", sizes=(1.0,)
)
"""Its two numbers do the same, by so much that the prior is lost in rounding."""
TOL = 1e-5
"""Of log evidences near 1e4, from slopes that are differences."""
STEP_S, SIZE, NOISE = 0.2, 2e-5, 5e-4


def line(run: UsersRun, n: dict, effects: dict) -> np.ndarray:
    """A straight line, and a wave as the effect: all linear; k side by side."""
    (size,) = effects.get("wave", (0.0,))
    t_s = run.centre_s[:, None]
    gone = 1e16 * sum(effects.get("beyond", (0.0, 0.0))) * np.sin(2 * t_s)
    return (n["a0"] + n["rate"] * t_s + size * np.cos(t_s) + gone)[:, None]


def fitted(effect: Effect | None, apart: dict[str, Apart]) -> tuple[Inference, Fitted]:
    """A small wave stands in the data exactly linearly."""
    rng, centre_s, made = np.random.default_rng(5), np.arange(100) * STEP_S, []
    for k, start in enumerate((0.1, 0.2, 0.4)):
        values = start + 0.02 * centre_s + SIZE * np.cos(centre_s) + NOISE * rng.normal(size=100)
        made.append(UsersRun(f"run-{k}", centre_s, values[:, None], NOISE**2 * np.eye(100)[None]))
    own = [UsersNumber("a0", [0.1, 0.2, 0.4])]
    simulator = UsersSimulator(made, line, [UsersNumber("rate", 0.02, size=0.02)], own, apart=apart)
    start = simulator.starts()[0]
    inference = Inference(simulator, simulator.noise(start))
    h = with_effects(start, [effect]) if effect is not None else start
    for _ in range(4):
        linear = inference.linear([h])[0]
        grams = Grams(linear.columns, inference.noise)
        found = inference._fitted(linear, grams, Forces(), inference.solve(grams, h, Forces()))
        h = inference.stepped(found, 1.0)
    return inference, found


def told(value: float, sd: float) -> dict[str, Apart]:
    return {"wave.b": Apart(value, sd)}


@pytest.mark.parametrize(("value", "sd"), [(3e-5, 1e-5), (0.0, 2e-5), (-1e-4, 5e-5)])
def test_a_measured_number_weighs_as_its_predictive_density(value: float, sd: float) -> None:
    inference, free = fitted(WAVE, {})
    at = inference.fixed(free.hypothesis)
    mean, spread = free.hypothesis.numbers[0][0], np.sqrt(free.solved.covariance[at, at])
    with_effect = fitted(WAVE, told(value, sd))[1]
    without = fitted(None, told(value, sd))[1].log_evidence - fitted(None, {})[1].log_evidence
    # the measurement's own normalising constant stands in neither
    constant = np.log(sd * np.sqrt(2 * np.pi))
    assert without == pytest.approx(norm.logpdf(value, 0.0, sd) + constant, abs=TOL)
    gained = with_effect.log_evidence - free.log_evidence
    assert gained == pytest.approx(norm.logpdf(value, mean, np.hypot(spread, sd)) + constant, abs=TOL)
    # and the number is drawn to it by both inverse variances
    both = (mean / spread**2 + value / sd**2) / (spread**-2 + sd**-2)
    assert with_effect.hypothesis.numbers[0][0] == pytest.approx(both, abs=1e-4 * spread)


@pytest.mark.parametrize("apart", [{}, told(3e-5, 1e-5)])
def test_sizes_are_a_mixture_with_and_without_a_measurement(apart: dict[str, Apart]) -> None:
    shares = (1.0, 0.1, 0.01)
    whole = fitted(replace(WAVE, sizes=shares), apart)[1].log_evidence
    (parameter,) = WAVE.parameters
    each = [
        fitted(replace(WAVE, parameters=(replace(parameter, sd=share * parameter.sd),)), apart)[1].log_evidence
        for share in shares
    ]
    assert whole == pytest.approx(logsumexp(each) - np.log(len(shares)), abs=TOL)


def test_a_score_foresees_what_a_measurement_adds() -> None:
    inference, base = fitted(None, told(3e-5, 1e-5))
    score = screened(inference, base, [WAVE], (1.0,)).seen["wave"]
    assert score == pytest.approx(fitted(WAVE, told(3e-5, 1e-5))[1].log_evidence - base.log_evidence, abs=TOL)


def test_slopes_that_have_run_off_take_no_other_effect_with_them() -> None:
    inference, base = fitted(None, {})
    both = screened(inference, base, [BEYOND, WAVE], (1.0,)).seen
    assert both["beyond"] == -np.inf
    assert both["wave"] == screened(inference, base, [WAVE], (1.0,)).seen["wave"]


def test_what_can_be_measured_is_offered_once() -> None:
    clock = next(e for e in LIBRARY if e.name == "frame_rate")
    h = replace(fitted(None, {})[1].hypothesis, effects=(clock,), numbers=(np.array([3e-3]),))
    ((distance, effect, numbers),) = measurement(h, {})
    assert (effect, numbers) == (clock, {"frame_rate.rate": 1e-4})
    assert distance == pytest.approx(30.0**2)
    assert measurement(h, {"frame_rate.rate": Apart(0.0, 1e-4)}) == []


def test_a_measurement_is_read_and_its_faults_are_named(root: Path, tmp_path: Path) -> None:
    text = (root / "sample_videos" / "mariner" / "x1446" / "run.toml").read_text()
    folders = []
    for name, value in (("one", 0.0031), ("two", 0.0031), ("other", 0.0032)):
        folder = tmp_path / name
        folder.mkdir()
        own = f'\n[[measured]]\nnumber = "frame_rate.rate"\nvalue = {value}\nsd = 1e-4\n'
        (folder / "run.toml").write_text(text + own)
        (folder / "video.mp4").touch()
        for path in (root / "sample_videos" / "mariner" / "x1446").iterdir():
            if path.is_file() and path.name != "run.toml":
                (folder / path.name).touch()
        folders.append(folder)
    one, two, other = (read_run(folder) for folder in folders)
    assert measured_apart([one, two], LIBRARY) == {"frame_rate.rate": Apart(0.0031, 1e-4)}
    with pytest.raises(InputError, match=r"0\.0032 \+- 0\.0001 here and 0\.0031"):
        measured_apart([one, other], LIBRARY)
    (folders[0] / "run.toml").write_text(text + '\n[[measured]]\nnumber = "frame_rate.fast"\nvalue = 0\nsd = 1\n')
    with pytest.raises(InputError, match=r"measured\[0\].number: 'frame_rate.fast': expected one of .*frame_rate.rate"):
        measured_apart([read_run(folders[0])], LIBRARY)
    (folders[0] / "run.toml").write_text(text + '\n[[measured]]\nnumber = "frame_rate.rate"\nvalue = 0\nsd = 0\n')
    with pytest.raises(InputError, match="sd"):
        read_run(folders[0])


def test_each_number_has_its_own_measurement() -> None:
    """Two effects of two and one numbers: what was measured of the second and third lands there, and nowhere else."""
    pair = Effect("pair", "sensor", (Parameter("a", "m", 2.0), Parameter("b", "m", 4.0, none=1.0)), "", "")
    single = Effect("single", "sensor", (Parameter("c", "m", 0.5),), "", "")
    h = Hypothesis(np.zeros(2), np.zeros((1, 1)), (pair, single), (np.array([1.0, 2.0]), np.array([0.2])))
    known = {"pair.b": Apart(2.5, 0.1), "single.c": Apart(0.0, 0.25), "other.d": Apart(3.0, 1.5)}
    simulator = SimpleNamespace(shared_prior=None, apart=known)
    engine: Any = SimpleNamespace(simulator=simulator, mode_count=3, fixed=lambda h: len(h.shared) + 3)
    found = Inference.priors(engine, h)
    own = np.array([1 / 2**2, 1 / 4**2, 1 / 0.5**2])
    np.testing.assert_allclose(found.precision, [0, 0, 1, 1, 1, *(own + np.array([0, 100, 16]))])
    np.testing.assert_allclose(found.pull, [0] * 5 + list(own * [-1, 1 - 2, -0.2] + [0, 0.5 * 100, -0.2 * 16]))
    # of an effect that is not there the measurement says how far its absence is from it
    chi_square = own @ np.array([1, 1, 0.04]) + 0.5**2 * 100 + 0.2**2 * 16 + (3.0 / 1.5) ** 2
    assert found.chi_square == pytest.approx(chi_square)
    assert found.spread == pytest.approx(2 * np.log(2.0 * 4.0 * 0.5))
