"""What gap.json says, sentence by sentence, for every verdict."""

from __future__ import annotations

import re
from typing import Any

import pytest

from towline.diagnose.effects.page import whole_library
from towline.diagnose.inference.held_out import Shrink
from towline.diagnose.inference.scan import Leftover
from towline.diagnose.sizes import size_of
from towline.diagnose.words import sentences
from towline.record.gap_file import GapFile, NextMeasurement, NextRun, RankedEffects, Where
from towline.record.results import Measured
from towline.report.gap_page import headline

TITLES = {effect.name: effect.title for effect in whole_library()}

NEXT_RUN = NextRun(
    tow_point_m=1.6, line_length_m=0.9, speed_m_s=1.2, y_release_m=0.2, beta_release_rad=0.0, distance=30.0,
    why="1.20 m/s: tells a from b (expected D 30; 20 is enough)",
)  # fmt: skip
MEASURED = NextMeasurement(
    effect="elastic_line", numbers={"stiffness": 10.0}, distance=25.0, why="pull the line. Weigh it"
)
SURER = "To be surer: 1.20 m/s: tells a from b (expected D 30; 20 is enough)."
MEASURE = "Without a tow: measure pull the line. Weigh it"
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


def kept_aside(before: float) -> Shrink:
    return Shrink(before, 1.0, 0.9, (0.8, 0.95), {})


CURRENT = [row("cross_current", probability=0.07)]
ASKED = {"next_run": NEXT_RUN, "next_measurement": MEASURED}
OPEN = "No gap is shown, nor excluded: that nothing is missing has a probability of {} only."


@pytest.mark.parametrize(
    ("p_no_gap", "ranking", "asked", "said"),
    [
        (0.85, [], {}, ["The simulator explains these runs to within their noise (probability 0.85)."]),
        (0.6, [], {}, ["The simulator explains these runs to within their noise (probability 0.60)."]),
        (0.59, [], {}, [OPEN.format("0.59")]),
        (
            0.85, CURRENT, ASKED,  # what is sure asks for no further run
            [
                "The simulator explains these runs to within their noise (probability 0.85).",
                "The nearest thing to a gap would be a current across the tank (probability 0.07).",
            ],
        ),
        (
            0.45, CURRENT, ASKED,
            [OPEN.format("0.45"), "It may miss a current across the tank (probability 0.07).", MEASURE, SURER],
        ),
    ],
)  # fmt: skip
def test_no_gap(p_no_gap: float, ranking: list[RankedEffects], asked: dict[str, Any], said: list[str]) -> None:
    assert sentences(file("no_gap", ranking, p_no_gap=p_no_gap, **asked), None, QUIET, TITLES) == said


@pytest.mark.parametrize(
    ("verdict", "p_no_gap", "said"),
    [
        ("no_gap", 0.9, "No gap"),
        ("no_gap", 0.3, "Open"),
        ("effect", 0.1, "An effect is missing"),
        ("form_not_exact", 0.1, "An effect is missing, its form not exact"),
        ("unknown", 0.1, "Something unknown is missing"),
    ],
)
def test_the_pages_headline_says_no_gap_only_where_it_is_shown(verdict: str, p_no_gap: float, said: str) -> None:
    assert headline(file(verdict, [], p_no_gap=p_no_gap)) == said


@pytest.mark.parametrize(
    ("before", "shrink", "shown"),
    [
        (2.5, 0.0, False),
        (2.5, 0.0049, False),  # reads 0.00
        (2.5, 0.006, True),
        (0.98, 0.0, True),  # noise without it, too: it shows in what else is measured, and nothing is there to shrink
    ],
)  # fmt: skip
def test_an_effect_is_never_called_missing_beside_a_shrink_of_nothing(
    before: float, shrink: float, shown: bool
) -> None:
    """Headline, first sentence and the gaps' sentence agree on whether it is shown."""
    first = row("elastic_line").model_copy(update={"gap_before": before, "gap_after": 2.49, "shrink": shrink})
    for verdict, head in (
        ("effect", "An effect is missing"),
        ("form_not_exact", "An effect is missing, its form not exact"),
    ):
        found = file(verdict, [first])
        said = sentences(found, kept_aside(before), QUIET, TITLES)
        assert headline(found) == (head if shown else "An effect fits, but no other run shows it")
        assert ("by the fitted runs alone" in said[0]) == (not shown)
        assert any("falls from" in one for one in said) == (shown and before > 1)
        assert any("(2.50 sigma without it, 2.49 with it)" in one for one in said) == (not shown)


@pytest.mark.parametrize(
    ("name", "unit", "value", "text"),
    [
        ("compliance_m_n", "m/N", 0.00242, "compliance 2.42 +- 0.24 mm/N"),
        ("drag_depth_m", "m", 0.15, "drag depth 150 +- 15 mm"),
        ("roll_rad", "rad", 0.01, "roll 0.573 +- 0.057 deg"),
        ("y_vvv", "N s3/m3", 2000.0, "Y_vvv 2e+03 +- 2e+02 N s3/m3"),
        ("y_star_n_s2_m2", "N s2/m2", 0.05, "Y* 0.05 +- 0.005 N s2/m2"),
        ("n_vdot", "kg m", 15.0, "N_vdot 15 +- 1.5 kg m"),
        ("y_v_r_m", "m", 0.05, "Y_v|r| 50 +- 5 mm"),
        ("share", "", 0.02, "share 0.02 +- 0.002"),
    ],
)
def test_sizes_have_words_and_millimetres(name: str, unit: str, value: float, text: str) -> None:
    assert size_of(name, unit, Measured(value=value, std=0.1 * value)).text == text


def test_no_number_of_the_library_is_shown_by_its_key() -> None:
    """A key ends in its unit; words do not."""
    one = Measured(value=1.0, std=0.1)
    for effect in whole_library():
        for parameter in effect.parameters:
            size = size_of(parameter.name, parameter.unit, one)
            assert "_" not in size.word or re.fullmatch(r"[YXNK]_[vru]+(dot|\|[vr]\|)?", size.word), parameter
            ending = parameter.unit.lower().replace("/", " ").replace(" ", "_")
            assert not parameter.unit or not f" {size.word}".endswith(f" {ending.replace('_', ' ')}"), parameter


@pytest.mark.parametrize(
    ("rest", "said"),
    [
        (Leftover(5.0, "a", (1.0, 2.0)), "It shows most in yaw, from 3 to 18 s, at 0.05 to 0.15 Hz."),
        (
            Leftover(5.1, "run a", span_s=(1.6, 7.4)),
            "What is left over stands out in run a, from 2 to 7 s; look for what happens there.",
        ),
        (
            Leftover(5.1, band_hz=(0.317,)),
            "What is left over stands out at 0.32 Hz in all runs; look for what happens there.",
        ),
    ],
)
def test_unknown(rest: Leftover, said: str) -> None:
    assert sentences(file("unknown", [row("cross_current")], p_unknown=0.88), None, rest) == [
        "There is a gap that no effect or pair of effects in the library explains (probability 0.88).",
        said,
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
def test_an_effect(stage: str, where: str) -> None:
    found = file("effect", [row("cubic_damping", "own_effect"), row("slack_line")], stage)
    assert sentences(found, kept_aside(1.2), QUIET, TITLES) == [
        f"Your simulator misses cubic damping and own_effect{where} (probability 0.93).",
        "Its size: size 0.0123 +- 0.00056.",
        "With it, the gap on the runs kept aside falls from 2.50 to 1.02 sigma (99 %, interval 91-99).",
        "Cure it.",
    ]


@pytest.mark.parametrize(
    ("rest", "left"),
    [
        (QUIET, "What is left over stands out nowhere: it follows the motion, as a force of another form would."),
        (
            Leftover(9.0, band_hz=(0.317,)),
            "What is left over stands out at 0.32 Hz in all runs; look for what happens there.",
        ),
    ],
)
def test_an_effect_in_another_form(rest: Leftover, left: str) -> None:
    """Sure of its name by both probabilities together; which form fits best, and which are excluded, is told."""
    first = row("bank_suction", probability=0.03).model_copy(
        update={
            "probability_inexact": 0.92,
            "form": "near wall, gap^-2",
            "forms": {"both walls, gap^-2": -2.9, "near wall, gap^-1": -3.1, "both walls, gap^-3": -40.0},
        }
    )
    assert sentences(file("form_not_exact", [first], "sway"), kept_aside(1.2), rest, TITLES) == [
        "Your simulator misses suction of the near wall in the sway equation, in a form that is not exactly the library's "
        "(probability 0.95).",
        "Its size: size 0.0123 +- 0.00056.",
        "With it, the gap on the runs kept aside falls from 2.50 to 1.02 sigma (99 %, interval 91-99).",
        left,
        "Of its forms fits best: near wall, gap^-2; as well as that: both walls, gap^-2; excluded: near wall, gap^-1, both walls, "
        "gap^-3.",
        "Cure it.",
    ]


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (9.9, []),
        (
            72.4,
            [
                "Beside it lens faults would take some more (log evidence 72); the form of what is named may leave as much over."
            ],
        ),
    ],
)
def test_a_second_effect_that_the_firsts_form_may_leave_over_is_spoken_of(more: float, said: list[str]) -> None:
    """The best pair with the headline's effect in it; a pair of two others is another answer."""
    ranking = [
        first.model_copy(update={"log_evidence": 100.0 + gain})
        for first, gain in (
            (row("elastic_line"), 0.0),
            (row("elastic_line", "slack_line"), 4.0),
            (row("lens_distortion", "elastic_line"), more),
            (row("slack_line", "lens_distortion"), 90.0),
        )
    ]
    found = sentences(file("effect", ranking), None, QUIET, TITLES | {"lens_distortion": "lens faults"})
    assert [s for s in found if s.startswith("Beside it")] == said
    pair = file("effect", [ranking[2], ranking[0]])
    assert not any(s.startswith("Beside it") for s in sentences(pair, None, QUIET, TITLES))


@pytest.mark.parametrize(
    ("without", "beside", "said"),
    [
        ({"side_n": 0.03, "moment_n_m": 0.002}, {"side_n": 0.01, "moment_n_m": 0.002}, "3 times"),
        ({"side_n": 0.019, "moment_n_m": 0.002}, {"side_n": 0.01, "moment_n_m": 0.002}, ""),
        ({"side_n": 0.0005, "moment_n_m": 0.0009}, {"side_n": 1e-5, "moment_n_m": 1e-5}, ""),
    ],
)
def test_random_forces_that_would_have_to_be_believed(
    without: dict[str, float], beside: dict[str, float], said: str
) -> None:
    found = file("effect", [row("elastic_line")], noise=beside, noise_without=without)
    forces = [one for one in sentences(found, None, QUIET, TITLES) if "random forces" in one]
    assert forces == ([f"Without it, random forces {said} as large would have to be believed."] if said else [])


@pytest.mark.parametrize(("held", "told"), [(None, False), (kept_aside(1.0), False), (kept_aside(1.01), True)])
def test_a_gap_that_is_no_larger_than_noise_is_not_said_to_shrink(held: Shrink | None, told: bool) -> None:
    said = sentences(file("effect", [row("elastic_line")]), held, QUIET, TITLES)
    assert any("falls from" in s for s in said) == told


TWINS = [["a", "b"], ["elastic_line", "slack_line", "own"], ["elastic_line", "lens_distortion"]]


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({}, ["Weigh it"]),
        ({"set95": [["elastic_line"]], **ASKED}, [SURER, "Weigh it"]),
        # a measurement is asked for where it decides between two, and says the cure itself
        ({"set95": [["elastic_line"], ["slack_line"]], **ASKED}, [SURER, MEASURE]),
        (
            {"indistinguishable": TWINS, **ASKED},
            ["It cannot be told from a line that goes slack or own with these runs; 1.20 m/s would.", "Weigh it"],
        ),
        (
            {"indistinguishable": TWINS},
            ["It cannot be told from a line that goes slack or own with these runs.", "Weigh it"],
        ),
    ],
)
def test_what_would_make_an_effect_surer(more: dict[str, Any], said: list[str]) -> None:
    found = file("effect", [row("elastic_line", cure="Weigh it")], **more)
    assert sentences(found, None, QUIET, TITLES)[2:] == said


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ({"y_v": -55.0, "n_r": -57.0}, {"y_v": -50.0, "n_r": -60.0}, ["10 % (Y_v)"]),
        ({"y_v": -50.2}, {"y_v": -50.0}, []),  # less than a per cent is not worth a sentence
        ({}, {}, []),
    ],
)
def test_the_bias_that_an_effect_had_made(before: dict[str, float], after: dict[str, float], said: list[str]) -> None:
    """Y_v is 10 % too large without the effect, N_r 5 % too small."""
    hulls = {
        when: {name: Measured(value=value, std=0.1) for name, value in hull.items()}
        for when, hull in (("before", before), ("after", after))
    }
    found = sentences(file("effect", [row("elastic_line")], derivatives=hulls), None, QUIET, TITLES)
    assert found[3:] == [f"Left out, it biases the derivatives by up to {one}." for one in said]


def test_an_effect_whose_fit_is_not_at_its_end_is_named_with_a_warning() -> None:
    sure, moving = (file("effect", [row("cubic_damping")], promised=gain) for gain in (0.2, 12.0))
    warning = "its fit has not come to its end"
    assert warning not in " ".join(sentences(sure, kept_aside(2.5), QUIET))
    said = sentences(moving, kept_aside(2.5), QUIET)
    assert sum(warning in one for one in said) == 1
    assert any(one.startswith("Its size: ") and warning in one for one in said)


def test_a_fit_that_is_not_at_its_end_is_no_verdict() -> None:
    said = sentences(file("not_converged", CURRENT, promised=45.2), None, QUIET)
    assert said[0].startswith("There is no answer")
    assert "a log evidence of 45 more" in said[0]
    assert not any("misses" in one for one in said)
