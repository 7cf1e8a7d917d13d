"""What ``towline check`` says of a fault: its side, size and place in words a tank hall can act on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from towline.geometry import run_datum
from towline.geometry.checks.bundle import Extra
from towline.geometry.checks.check import Check, check_geometry
from towline.geometry.checks.faults import Fault, Scored
from towline.geometry.checks.words import found_fault
from towline.record.check_file import FoundFault


@pytest.fixture(scope="module")
def check(cameras: ModuleType) -> Check:
    """Of a camera and two marks, without a fault; k1 is stated as -0.1."""
    scene = cameras.random_scene(np.random.default_rng(3), 60)
    case = cameras.film(scene, np.random.default_rng(4))
    found = check_geometry([case.run], [case.tracks], run_datum(case.run, None))
    rig = found.bundle.rig
    lens = replace(rig.lens, distortion=np.array([-0.1, 0.02, 0, 0, 0]))
    return replace(found, bundle=replace(found.bundle, rig=replace(rig, lens=lens)))


Said = Callable[..., FoundFault]


@pytest.fixture
def said(check: Check) -> Said:
    """(kind, values, item, extra) -> the fault whose numbers are ``values``, each good to a tenth of itself.

    By parameter of the rig, or of the extra, whose places come behind these.
    """

    def fault_of(kind: str, values: dict[str, float], item: int = -1, extra: Extra | None = None) -> FoundFault:
        names = list(check.bundle.names)
        theta = np.zeros(len(names) + 3)
        for place, (name, value) in enumerate(values.items()):
            theta[names.index(name) if extra is None else len(names) + place] = value
        solution = replace(check.null, theta=theta, covariance=np.diag((0.1 * theta) ** 2))
        released = {} if extra is not None else dict.fromkeys(values, 1.0)
        fault = Fault(kind, released, extra, np.ones(len(values)), item)
        return found_fault(
            check, Scored(fault, 12.0, 30.0, solution), ["p0", "p1"], ["bow", "stern"], ["run a", "run b"]
        )

    return fault_of


@pytest.mark.parametrize(
    ("kind", "values", "item", "sentence"),
    [
        ("lens", {"k1": 0.05}, -1, "the lens: k1 is -0.0500 +- 0.0050, stated -0.1000; calibrate it again"),
        (
            "lens: focal length", {"fx": 0.03, "fy": -0.02}, -1,
            "lens: focal length off: fx by +0.03 +- 0.003, fy by -0.02 +- 0.002; calibrate the lens again",
        ),
        ("deck height", {"deck height": 0.02}, -1, "the marks lie 20.0 +- 2.0 mm lower than depth_m says"),
        ("deck height", {"deck height": -0.02}, -1, "the marks lie 20.0 +- 2.0 mm higher than depth_m says"),
        ("height of a mark", {"depth 1": 0.004}, 1, "mark stern lies 4.0 +- 0.4 mm lower than its depth_m says"),
        ("height of a mark", {"depth 0": -0.004}, 0, "mark bow lies 4.0 +- 0.4 mm higher than its depth_m says"),
        (
            "place of a mark", {"ahead 0": 0.003, "aside 0": -0.002}, 0,
            "mark bow stands elsewhere on deck than body_m says: ahead by +3.0 +- 0.3 mm, aside by -2.0 +- 0.2 mm",
        ),
        (
            "datum width", {"datum length": -0.004, "datum width": 0.01}, -1,
            "the datum points stand elsewhere than tank_m says: length by -0.40 +- 0.04 %, width by +1.00 +- 0.10 %; "
            "measure them again",
        ),
        ("line length", {"line length": 0.01}, -1, "the line is 10.0 +- 1.0 mm longer than line_length_m says"),
        ("line length", {"line length": -0.01}, -1, "the line is 10.0 +- 1.0 mm shorter than line_length_m says"),
        ("tow point", {"tow point": 0.006}, -1, "the tow point lies 6.0 +- 0.6 mm more ahead of LCG than tow_point_m says"),
        ("post ahead", {"post ahead": -0.006}, -1, "the tow post stands 6.0 +- 0.6 mm less ahead than post_m says"),
    ],
)  # fmt: skip
def test_numbers_of_the_rig(said: Said, kind: str, values: dict[str, float], item: int, sentence: str) -> None:
    found = said(kind, values, item)
    assert found.sentence == sentence
    assert found.span_s is None
    assert {name: m.value for name, m in found.sizes.items()} == values
    assert all(m.std == pytest.approx(0.1 * abs(m.value)) for m in found.sizes.values())
    assert found.item == ({0: "bow", 1: "stern"}[item] if item >= 0 else "")


def test_a_point_a_turn_and_a_slack_line_have_their_place(said: Said) -> None:
    found = said("datum point", {"u_px": 3.0, "v_px": -4.0}, 1, Extra("point", 1))
    assert (
        found.sentence == "datum point p1 was picked 5.0 px off (u +3.0 +- 0.3, v -4.0 +- 0.4), or its tank_m is wrong"
    )
    assert (found.item, found.span_s) == ("p1", None)
    degree = np.radians(1.0)
    found = said(
        "camera turned",
        {"right": 2 * degree, "down": -degree, "ahead": 2 * degree},
        1,
        Extra("turn", 1, (7.25, np.inf)),
    )
    assert found.sentence == (
        "the camera turned by 3.00 degrees at 7.25 s in run b; cut the run there, or let datum points be tracked"
    )
    assert (found.item, found.span_s) == ("run b", (7.25, 7.25))
    found = said("slack line", {"shortest": 0.012}, 0, Extra("slack", 0, (3.0, 5.5)))
    assert found.sentence == (
        "the line was slack from 3.0 to 5.5 s in run a: the tow point came 12.0 +- 1.2 mm nearer to the post than a taut line "
        "lets it"
    )
    assert (found.item, found.span_s) == ("run a", (3.0, 5.5))


def test_what_was_screened_only_has_no_size(check: Check) -> None:
    found = found_fault(check, Scored(Fault("deck height", {"deck height": 0.01}), 1.0, 2.0), [], [], [])
    assert found.sentence == "deck height"
    assert found.sizes == {}
    assert found.evidence == 1.0
