"""Runs of one camera share its errors: what is wrong in the datum's picks is wrong in all of them alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from towline.identify import fit_runs, run_data
from towline.pipeline.checking import set_ups
from towline.pipeline.stages import RunMotion, compute_run_motion
from towline.record import Run, read_run


@pytest.fixture(scope="module")
def tows(worked: Path) -> list[tuple[Run, RunMotion]]:
    """Two tows whose datum was picked once: the second one's own picks, which differ, are not looked at."""
    first, other = (read_run(worked / "sample_videos" / "mariner" / name) for name in ("x1446", "x1649"))
    file = other.file.model_copy(
        update={"camera": first.file.camera, "datum": first.file.datum, "marker": first.file.marker}
    )
    return [(first, compute_run_motion(first)), (replace(other, file=file), compute_run_motion(other))]


def variances(tows: list[tuple[Run, RunMotion]]) -> np.ndarray:
    return np.diag(fit_runs([run_data(run, m.motion, m.common) for run, m in tows]).covariance)


def marked(run: Run, **changed: object) -> Run:
    markers = tuple(m.model_copy(update=changed) for m in run.file.marker)
    return replace(run, file=run.file.model_copy(update={"marker": markers}))


def test_where_marks_are_first_seen_and_how_they_look_is_no_other_camera(tows: list[tuple[Run, RunMotion]]) -> None:
    """Six filmed runs whose marks were clicked had each been given a camera of its own, and intervals too narrow for it."""
    hinted = [
        (marked(run, seen_at_px=(400.0 + 10 * k, 30.0), look=look), m)
        for k, ((run, m), look) in enumerate(zip(tows, ("led", "disc"), strict=True))
    ]
    np.testing.assert_array_equal(variances(hinted), variances(tows))


def test_runs_of_one_camera_are_checked_together(tows: list[tuple[Run, RunMotion]]) -> None:
    """However their marks look: what is wrong with the camera shows in all of them."""
    first, other = (run for run, _ in tows)
    tables = [pd.DataFrame(), pd.DataFrame()]
    (together,) = set_ups([first, marked(other, look="disc", seen_at_px=(400.0, 30.0))], tables)
    assert (together[0], len(together[1]), len(together[2])) == ("check", 2, 2)
    apart = set_ups([first, marked(other, depth_m=first.file.marker[0].depth_m + 0.01)], tables)
    assert [stem for stem, *_ in apart] == ["check-1", "check-2"]


def test_marks_at_another_depth_are_another_mapping(tows: list[tuple[Run, RunMotion]]) -> None:
    """Then the picks' errors do not go through the same plane: two mappings' errors are no longer one."""
    (first, m), other = tows
    apart = [(marked(first, depth_m=first.file.marker[0].depth_m + 0.01), m), other]
    assert (variances(apart) != variances(tows)).all()
