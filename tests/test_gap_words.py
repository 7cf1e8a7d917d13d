"""What gap.json says, sentence by sentence; verdict, twins, numbers and what to measure by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from towline.diagnose.apart import Apart
from towline.diagnose.effects.hull import CURRENT, MEMORY
from towline.diagnose.effects.page import whole_library
from towline.diagnose.gap import _derivatives, _measurement, _noise, _numbers, _twins, _verdict
from towline.diagnose.hypothesis import Hypothesis
from towline.diagnose.noise import TIMES_S
from towline.diagnose.scan import Leftover
from towline.diagnose.words import sentences
from towline.record.gap_file import GapFile, NextMeasurement, NextRun, RankedEffects, Where
from towline.record.results import Measured

TITLES = {effect.name: effect.title for effect in whole_library()}

NEXT_RUN = NextRun(
    tow_point_m=1.6, line_length_m=0.9, speed_m_s=1.2, y_release_m=0.2, beta_release_rad=0.0, distance=30.0,
    why="1.20 m/s: tells a from b (expected D 30; 20 is enough)",
)  # fmt: skip
MEASURED = NextMeasurement(
    effect="elastic_line", numbers={"stiffness": 10.0}, distance=25.0, why="pull the line. Weigh it"
)
QUIET = Leftover(0.0)


def row(*effects: str, probability: float = 0.93, cure: str = "Cure it.") -> RankedEffects:
    return RankedEffects(
        effects=list(effects),
        probability=probability,
        parameters={f"{effects[0]}.size": Measured(value=0.01234, std=0.00056)},
        gap_before=2.5,
        gap_after=1.02,
        shrink=0.987,
        shrink_interval=(0.912, 0.994),
        cure=cure,
    )


def file(verdict: Any, ranking: list[RankedEffects], stage: str = "yaw", **more: Any) -> GapFile:
    place = Where(
        stage=stage,
        share={"sway": 0.1, "yaw": 0.7, "line": 0.2},
        runs={"a": 1.0},
        span_s=[3.2, 17.8],
        band_hz=[0.051, 0.148],
    )
    given: dict[str, Any] = {
        "p_no_gap": 0.85,
        "p_unknown": 0.05,
        "next_run": None,
        "indistinguishable": [],
        "set95": [],
    }
    return GapFile(
        schema="towline/gap", tool="t", inputs={}, verdict=verdict, where=place, ranking=ranking, **{**given, **more}
    )  # fmt: skip


def test_no_gap_in_words() -> None:
    sure = "The simulator explains these runs to within their noise (probability 0.85)."
    assert sentences(file("no_gap", []), None, QUIET, TITLES) == [sure]
    # what is sure asks for no further run
    told = file("no_gap", [row("cross_current", probability=0.07)], next_run=NEXT_RUN, next_measurement=MEASURED)
    assert sentences(told, None, QUIET, TITLES) == [
        sure,
        "The nearest thing to a gap would be a current across the tank (probability 0.07).",
    ]
    assert sentences(told.model_copy(update={"p_no_gap": 0.45}), None, QUIET, TITLES) == [
        "No gap is shown, nor excluded: that nothing is missing has a probability of 0.45 only.",
        "It may miss a current across the tank (probability 0.07).",
        "Without a tow: measure pull the line. Weigh it",
        "To be surer: 1.20 m/s: tells a from b (expected D 30; 20 is enough).",
    ]
    assert sentences(file("no_gap", [], p_no_gap=0.6), None, QUIET, TITLES)[0].startswith("The simulator explains")
    assert len(sentences(file("no_gap", [], p_no_gap=0.59), None, QUIET, TITLES)) == 1


def test_unknown_in_words() -> None:
    head = "There is a gap that no effect or pair of effects in the library explains (probability 0.88)."
    unknown = file("unknown", [row("cross_current")], p_unknown=0.88)
    assert sentences(unknown, None, Leftover(5.0, "a", (1.0, 2.0))) == [
        head,
        "It shows most in yaw, from 3 to 18 s, at 0.05 to 0.15 Hz.",
    ]
    assert sentences(unknown, None, Leftover(5.1, "run a", span_s=(1.6, 7.4))) == [
        head,
        "What is left over stands out in run a, from 2 to 7 s; look for what happens there.",
    ]
    assert sentences(unknown, None, Leftover(5.1, band_hz=(0.317,))) == [
        head,
        "What is left over stands out at 0.32 Hz in all runs; look for what happens there.",
    ]


@pytest.mark.parametrize(
    ("stage", "where"),
    [
        ("sway", " in the sway equation"),
        ("yaw", " in the yaw equation"),
        ("line", " in the line"),
        ("camera", " in the camera"),
        ("clock", ""),
    ],
)
def test_an_effect_in_words(stage: str, where: str) -> None:
    held: Any = SimpleNamespace(before=1.2)
    said = sentences(
        file("effect", [row("cubic_damping", "own_effect"), row("slack_line")], stage), held, QUIET, TITLES
    )
    assert said == [
        f"Your simulator misses cubic damping and own_effect{where} (probability 0.93).",
        "Its size: size 0.0123 +- 0.00056.",
        "With it, the gap on the runs kept aside falls from 2.50 to 1.02 sigma (99 %, interval 91-99).",
        "Cure it.",
    ]


def test_what_would_make_an_effect_surer() -> None:
    effect = file("effect", [row("elastic_line", cure="Weigh it")], set95=[["elastic_line"]])
    flat: Any = SimpleNamespace(before=1.0)
    assert sentences(effect, flat, QUIET, TITLES) == sentences(effect, None, QUIET, TITLES)
    assert [len(sentences(effect, held, QUIET, TITLES)) for held in (None, SimpleNamespace(before=1.01))] == [3, 4]  # pyright: ignore[reportArgumentType]
    surer = effect.model_copy(update={"next_run": NEXT_RUN, "next_measurement": MEASURED})
    assert sentences(surer, None, QUIET, TITLES)[2:] == [
        "To be surer: 1.20 m/s: tells a from b (expected D 30; 20 is enough).",
        "Weigh it",
    ]
    # a measurement is asked for where it decides between two, and says the cure itself
    asked = surer.model_copy(update={"set95": [["elastic_line"], ["slack_line"]]})
    assert sentences(asked, None, QUIET, TITLES)[2:] == [
        "To be surer: 1.20 m/s: tells a from b (expected D 30; 20 is enough).",
        "Without a tow: measure pull the line. Weigh it",
    ]
    twins = surer.model_copy(
        update={
            "indistinguishable": [
                ["a", "b"],
                ["elastic_line", "slack_line", "own"],
                ["elastic_line", "lens_distortion"],
            ]
        }
    )
    assert sentences(twins, None, QUIET, TITLES)[2:] == [
        "It cannot be told from a line that goes slack or own with these runs; 1.20 m/s would.",
        "Weigh it",
    ]
    alone = twins.model_copy(update={"next_run": None})
    assert (
        sentences(alone, None, QUIET, TITLES)[2]
        == "It cannot be told from a line that goes slack or own with these runs."
    )


def candidate(evidence: float, *names: str, **more: Any) -> Any:
    effects = [SimpleNamespace(name=n, **more) for n in names]
    return SimpleNamespace(names=names, effects=effects, log_evidence=evidence, fitted="+".join(names))


def test_a_gap_is_an_effect_where_the_effects_weigh_as_much_as_what_is_in_no_library() -> None:
    top = candidate(9.0, "a")

    def verdict(p_no_gap: float, p_unknown: float, *shares: float) -> Any:
        ranking: Any = SimpleNamespace(
            candidates=[top] * len(shares), probabilities=np.array(shares), p_no_gap=p_no_gap, p_unknown=p_unknown
        )
        return _verdict(ranking)

    assert verdict(0.21, 0.0, 0.79) == ("no_gap", None)
    assert verdict(0.2, 0.4, 0.3, 0.1) == ("effect", top)
    assert verdict(0.2, 0.41, 0.3, 0.09) == ("unknown", None)
    assert verdict(0.0, 1.0) == ("unknown", None)
    assert verdict(0.0, 0.0) == ("unknown", None)


def test_twins_are_single_effects_within_three_and_the_symmetries_that_concern_them() -> None:
    best, near, far, pair = candidate(9.0, "a"), candidate(6.01, "b"), candidate(5.9, "c"), candidate(8.9, "d", "e")
    ranking: Any = SimpleNamespace(candidates=[best, pair, near, far])
    symmetries = [("", ("m", "Y_r")), ("a", ("a", "x")), ("b", ("b", "y"))]
    assert _twins(ranking, best, symmetries) == [["a", "b"], ["m", "Y_r"], ["a", "x"]]
    assert _twins(ranking, pair, symmetries) == [["m", "Y_r"]]
    assert _twins(ranking, None, symmetries) == [["m", "Y_r"]]
    assert _twins(SimpleNamespace(candidates=[best, far]), best, []) == []  # pyright: ignore[reportArgumentType]


def test_numbers_stand_with_their_own_deviations() -> None:
    """Two effects of two and three numbers behind seven shared ones, the second with a memory whose time is its variant's."""
    memory = MEMORY[2]
    numbers = (np.array([0.1, 0.2]), np.array([0.3, 0.4, 0.5]))
    h = Hypothesis(np.zeros(7), np.zeros((1, 3)), (CURRENT, memory), numbers)
    covariance = np.diag(np.arange(1.0, 13.0) ** 2)
    one: Any = SimpleNamespace(
        effects=h.effects, fitted=SimpleNamespace(hypothesis=h, solved=SimpleNamespace(covariance=covariance))
    )
    inference: Any = SimpleNamespace(fixed=lambda h: len(h.shared))
    found = _numbers(inference, one)
    assert list(found) == [
        *(f"cross_current.{p.name}" for p in CURRENT.parameters),
        *(f"fluid_memory.{p.name}" for p in memory.parameters),
        "fluid_memory.time_s",
    ]
    assert [m.value for m in found.values()] == [0.1, 0.2, 0.3, 0.4, 0.5, 2.0]
    assert [m.std for m in found.values()] == pytest.approx([8.0, 9.0, 10.0, 11.0, 12.0, 0.8])
    one.fitted.hypothesis = SimpleNamespace(shared=np.array([-50.0, -60.0]))
    six = _derivatives(one.fitted, ["y_v", "n_r"])
    assert {k: m.value for k, m in six.items()} == {"y_v": -50.0, "n_r": -60.0}
    assert {k: m.std for k, m in six.items()} == {"y_v": 1.0, "n_r": 2.0}
    fitted: Any = SimpleNamespace(forces=SimpleNamespace(side_n=0.02, moment_n_m=0.01, time=1))
    assert _noise(fitted, 3.0) == pytest.approx({"side_n": 0.06, "moment_n_m": 0.03, "time_s": TIMES_S[1]})


def test_measured_is_what_tells_best_of_the_headline_and_its_rival(monkeypatch: pytest.MonkeyPatch) -> None:
    from towline.diagnose import gap

    def effect(name: str) -> Any:
        return SimpleNamespace(name=name, cure=f"cure {name}")

    offers = {
        "a": [(12.4, effect("a"), {"stretch": 0.01, "sag": 0.002})],
        "c": [(20.0, effect("c"), {"k1": 1e-4})],
        "d": [(1e6, effect("d"), {})],
    }
    monkeypatch.setattr(gap, "measurement", lambda hypothesis, _: offers.get(hypothesis, []))

    def one(evidence: float, name: str) -> Any:
        found = candidate(evidence, name)
        found.fitted = SimpleNamespace(hypothesis=name)
        return found

    a, b, c, d = one(9.0, "a"), one(8.0, "b"), one(8.5, "c"), one(1.0, "d")
    known: dict[str, Apart] = {}
    ranking: Any = SimpleNamespace(candidates=[a, b, c, d])
    found = _measurement(ranking, a, known)  # c is a's nearest, d too far behind to be asked
    assert found is not None
    assert (found.effect, found.distance) == ("c", 20.0)
    assert found.why == "k1 to 0.0001: tells whether it is c (expected D 20; 20 is enough). cure c"
    ranking = SimpleNamespace(candidates=[a, b])
    found = _measurement(ranking, a, known)
    assert found is not None
    assert found.why == (
        "stretch to 0.01, sag to 0.002: tells best, though not surely, whether it is a (expected D 12; 20 is enough). cure a"
    )
    found = _measurement(SimpleNamespace(candidates=[d]), None, known)  # pyright: ignore[reportArgumentType]
    assert found is not None
    assert "(expected D over 1000; 20 is enough)" in found.why
    assert _measurement(SimpleNamespace(candidates=[b]), b, known) is None  # pyright: ignore[reportArgumentType]
