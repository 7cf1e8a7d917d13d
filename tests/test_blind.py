"""The blind check: a reality of its own against closed forms, the seal, and scores that can fail."""

from __future__ import annotations

import ast
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import solve_triangular
from scipy.stats import binom

from towline.blind import judge, run
from towline.blind.baselines import baseline_calls
from towline.blind.check import diagnose, score
from towline.blind.draw import (
    ANSWERS,
    CASES,
    FAINT_D,
    SEAL,
    TRUTH,
    Wanted,
    case_of,
    dealt,
    drawn,
    fainter,
    gentle,
    opened,
    sealed,
    write_cases,
)
from towline.blind.judge import NO_GAP, UNKNOWN, Judged
from towline.blind.measure import _exact, measured
from towline.blind.next_runs import with_next_run
from towline.blind.scores import Score, calibration, interval, scores
from towline.blind.signature import RIVALS, STRENGTH, block_means, distances_of, linear
from towline.blind.truth.camera import camera_of
from towline.blind.truth.cases import Case, clean_picks, filmed, load_cell, swum
from towline.blind.truth.folders import write_case
from towline.blind.truth.forces import Now, sheared_current, strip_drag
from towline.blind.truth.hulls import MARINER
from towline.blind.truth.lanes import Lanes
from towline.blind.truth.motion import B, V, X, Y, swim
from towline.blind.truth.noise import wandering
from towline.blind.truth.sizes import EFFECTS, OUTSIDE
from towline.blind.words import score_text
from towline.diagnose.effects import LIBRARY
from towline.record import InputError, read_run, read_tracks

STIFF_TOL_M = 1e-6
"""Goldens are exact to 1e-9; a line of 8000 N/m and steps of 20 ms leave about 5e-8."""
TOW = {**MARINER, "speed": 1.28, "duration": 45.0, "x_t": 1.548, "y_release": 0.3}


def _case(effect: str, seed: int = 3, coloured: bool = False, **numbers: float) -> Case:
    """A case with numbers of one's own, on the thesis's hull."""
    for k in range(100):
        case = case_of("case-x", "effect" if effect else "null", [effect] if effect else [], [seed, k], coloured)
        if case.hull_name == "mariner" and not case.history:
            break
    own = {f"{effect}.{name}": value for name, value in numbers.items()}
    return gentle(replace(case, numbers={**case.numbers, **own}, runs=case.runs[:3]))


# --- reality


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("taut_xT1.446", {"x_t": 1.446}),
        ("taut_xT1.548", {"x_t": 1.548}),
        ("taut_xT1.649", {"x_t": 1.649}),
        ("taut_xT1.751", {"x_t": 1.751}),
        ("taut_xT1.649_L0.600", {"x_t": 1.649, "line": 0.6, "y_release": 0.35}),
        (
            "taut_xT1.300_bias",
            {"x_t": 1.3, "y_release": 0.0, "kick.side_n": 0.4, "kick.moment_n_m": -0.48, "kick.width_s": 1e6},
        ),
    ],
)
def test_a_stiff_line_without_effects_is_the_taut_line(shared: Path, name: str, numbers: dict[str, float]) -> None:
    golden = pd.read_csv(shared / "golden" / f"{name}.csv", comment="#")
    path = swim([{**TOW, **numbers}], float(golden["t_s"].max()))
    found = path.at(golden["t_s"].to_numpy(), 0, (X, Y, B, V, 5))
    for k, column in enumerate(("x_cg_m", "y_cg_m", "beta_rad", "v_m_s", "r_rad_s")):
        assert np.abs(found[:, k] - golden[column]).max() < STIFF_TOL_M


def test_a_line_that_stretches_is_longer_and_springs() -> None:
    compliance = 0.005
    path = swim(
        [{**TOW, "elastic_line.compliance_m_n": compliance, "elastic_line.damping": 0.08, "elastic_line.shock": 0.5}],
        40,
    )
    x, y, b = path.states[:, X, 0], path.states[:, Y, 0], path.states[:, B, 0]
    length = np.hypot(x + 1.548 * np.cos(b), y + 1.548 * np.sin(b))
    assert length[-500:].mean() == pytest.approx(0.91 + compliance * 3.96, abs=2e-4)
    spring = path.tension_n[:, 0] - path.tension_n[:, 0].mean()
    rate = np.fft.rfftfreq(len(spring), 0.02)[np.argmax(np.abs(np.fft.rfft(spring * np.hanning(len(spring)))))]
    # a mass on a spring; the swing of the hull's end adds little to its mass
    assert rate == pytest.approx(np.sqrt(1 / compliance / MARINER["surge_mass"]) / 2 / np.pi, rel=0.15)


def test_a_slack_line_does_not_push() -> None:
    slack = {"slack_line.nearer_m": 0.02, "slack_line.length_s": 3.0, "slack_line.begin_s": 10.0}
    path = swim([{**TOW, **slack}], 20)
    during = (path.t_s > 10.3) & (path.t_s < 12.7)
    assert path.tension_n.min() == 0.0
    assert path.tension_n[during].max() == 0.0
    assert path.tension_n[path.t_s < 9.9].min() > 3.9
    assert path.tension_n[-100:].mean() == pytest.approx(3.96, rel=0.02)


def test_a_line_that_follows_the_resistance_pulls_as_one_over_cosine() -> None:
    path = swim([{**TOW, "tension_variation.power": 1.0, "tension_variation.period_s": 0.3}], 20)
    alpha = np.arcsin((path.states[:, Y, 0] + 1.548 * np.sin(path.states[:, B, 0])) / 0.91)
    # the servo and the damped line answer 0.14 s late, to a pull that changes by up to 0.15 N/s
    assert path.tension_n[50:, 0] == pytest.approx(3.96 / np.cos(alpha[50:]), abs=0.022)
    assert np.ptp(path.tension_n[50:, 0]) > 0.15


def test_strips_of_one_drag_are_the_closed_form() -> None:
    q = Lanes([{**MARINER, "crossflow_drag.drag_m": 0.1}])
    now = Now(
        0.0, *(np.array([value]) for value in (0.0, 0.0, 0.2, 0.0, 1.28, 0.0, 0.0)), np.zeros((4, 1)), np.zeros(1)
    )
    side, moment = strip_drag(q, now)
    assert side[0] == pytest.approx(-0.5 * 1000 * 0.1 * 2.66 * 0.2**2)
    assert moment[0] == pytest.approx(0.0, abs=1e-12)
    turning = replace(now, v=np.array([0.0]), r=np.array([0.1]))
    # the integral of |x| x^3 from -L/2 to L/2 is L^4/32; 24 strips miss it by 2/24^2
    assert strip_drag(q, turning)[1][0] == pytest.approx(-0.5 * 1000 * 0.1 * 0.1**2 * 2.66**4 / 32, rel=5e-3)


def test_a_current_is_a_sway_velocity() -> None:
    q = Lanes([{**MARINER, "cross_current.flow_m_s": 0.02}])
    now = Now(
        0.0, *(np.array([value]) for value in (0.1, 0.0, 0.2, 0.0, 1.28, 0.0, 0.0)), np.zeros((4, 1)), np.zeros(1)
    )
    side, moment = sheared_current(q, now)
    assert (side[0], moment[0]) == pytest.approx((52.87 * 0.02, 48.51 * 0.02))


def test_every_effect_of_the_library_can_be_drawn_and_moves_the_picture() -> None:
    assert set(EFFECTS) == {effect.name for effect in LIBRARY} | {"slack_line"}
    assert set(STRENGTH) == {*EFFECTS, *OUTSIDE}
    assert set(RIVALS) == {*EFFECTS} - {"slack_line"}
    for name in [*EFFECTS, *OUTSIDE]:
        case = case_of("case-x", "effect", [name], [4, 1], False)
        numbers = {key.split("@")[0]: value for key, value in case.numbers.items()}
        # what happens at a time happens early, so that a short tow holds it
        numbers = {n: 6.0 if n.endswith((".time_s", ".begin_s")) else v for n, v in numbers.items()}
        case = replace(case, duration_s=14.0, static_s=1.0, runs=case.runs[1:2], numbers=numbers)
        if name == "sync_delay":
            assert case.history
            late, right = load_cell(case, 0)[0], load_cell(replace(case, numbers={}), 0)[0]
            assert right - late == pytest.approx(numbers["sync_delay.delay_s"])
            continue
        with_it, without = (swum(case, effects, random=False, step_s=0.06) for effects in (True, False))
        films = [filmed(case, p, 0, e, noisy=False).clean for p, e in ((with_it, True), (without, False))]
        picked = np.abs(clean_picks(case) - clean_picks(case, effects=False)).max()
        assert max(np.abs(films[0] - films[1]).max(), picked) > 0.1, name


def test_the_camera_is_a_pinhole_behind_a_bent_lens() -> None:
    case = _case("")
    camera = camera_of({**case.camera, "k1": 0.0, "k2": 0.0})
    f, cx, cy = case.camera["f_px"], case.camera["cx_px"], case.camera["cy_px"]
    assert np.linalg.det(camera.matrix[:, :3]) == pytest.approx(1.0)
    # the aim is seen at the centre, starboard to the right, ahead above
    aim = np.array([case.camera["aim_x_m"], 0.0, 0.1])
    assert camera.pixels(aim) == pytest.approx([cx, cy], abs=1e-6)
    assert camera.pixels(aim + np.array([0, 0.1, 0]))[0] > cx
    assert camera.pixels(aim + np.array([0.1, 0, 0]))[1] < cy
    bent, aside = replace(camera, fault=0.1), aim + np.array([0, 0.5, 0])
    off = camera.pixels(aside) - [cx, cy]
    share = (off @ off) / f**2
    assert bent.pixels(aside) - [cx, cy] == pytest.approx(off * (1 + 0.1 * share))


def test_wandering_noise_has_its_size_and_memory() -> None:
    noise = wandering(1000, 0.04, 2.0, 0.6, np.random.default_rng(1), 400)
    # 400 records of 40 s, each about 33 independent values: 0.9 % of the variance
    assert noise.var() == pytest.approx(4.0, rel=0.04)
    assert (noise[:, :-15] * noise[:, 15:]).mean() == pytest.approx(4.0 * np.exp(-1.0), rel=0.06)


def test_the_generator_shares_no_code_with_what_it_tests(root: Path) -> None:
    """truth/, and every module of the room on which it stands, import no simulate, geometry, identify, diagnose, vision."""
    seen: set[Path] = set()
    todo = sorted((root / "blind" / "truth").glob("*.py"))
    while todo:
        path = todo.pop()
        if path in seen or not path.is_file():
            continue
        seen.add(path)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names = [a.name for a in node.names]
                assert not any(name.startswith("towline") for name in names)
            if not isinstance(node, ast.ImportFrom):
                continue
            assert not (node.module or "").startswith("towline")
            if not node.level:
                continue
            base = path.parents[node.level - 1]
            names = [node.module] if node.module else [a.name for a in node.names]
            for name in names:
                target = base.joinpath(*name.split("."))
                room = target.relative_to(root).parts[0]
                assert room in ("record", "blind", "processes"), f"{path.name} imports {name}"
                if room != "record":
                    todo += [target.with_suffix(".py"), target / "__init__.py"]
    assert len(seen) >= 8


# --- what the truth measures


@pytest.mark.parametrize("coloured", [False, True])
def test_the_noise_that_the_score_takes_is_the_generators(coloured: bool) -> None:
    """Pixels less their noise-free motion, whitened by ``linear``'s covariance, have unit variance."""
    case = _case("", seed=8, coloured=coloured)
    case = replace(case, runs=case.runs[:2])
    sensed, path, still = linear(case), swum(case), swum(case, random=False)
    total, count = 0.0, 0
    for i, factor in enumerate(sensed.whiteners):
        rest = block_means(case, filmed(case, path, i).pixel) - _exact(case, still, i)
        white = solve_triangular(factor, rest, lower=True)
        total, count = total + float(white @ white), count + len(white)
    # chi-square of 1120 values, about a dozen of which per run belong to settings that this motion has not moved
    assert total / count == pytest.approx(1.0, abs=5 * np.sqrt(2 / count) + 12 * len(case.runs) / count)


def test_d_grows_with_the_square_of_the_size_and_drag_is_near_to_cubic() -> None:
    small = _case("crossflow_drag", drag_m=0.01, tilt=0.0, ends=0.0)
    large = replace(small, numbers={**small.numbers, "crossflow_drag.drag_m": 0.02})
    one, two = (distances_of(case, linear(case)) for case in (small, large))
    assert two.strength == pytest.approx(4 * one.strength, rel=0.05)  # taken at a twentieth, not at nothing
    assert one.nearest == min(one.rivals.values())
    assert one.rivals["cubic_damping"] < 0.8 * one.strength


def test_an_oracle_leaves_noise() -> None:
    case = _case("speed_drift", share=0.02, settle_s=30.0)
    found = measured(case)
    # 840 values; their root mean square scatters by 2.4 %, settings that the motion has not moved take as much away
    assert found["oracle_after"] == pytest.approx(1.0, abs=0.08)
    assert found["oracle_before"] > 1.5
    assert found["oracle_shrink"] > 0.9


def test_a_faint_effect_has_the_d_that_was_drawn() -> None:
    case = _case("hull_asymmetry")
    faint = fainter(case, np.random.default_rng(4))
    low, high = FAINT_D
    # within the rounding of differences taken at a twentieth of so small a size
    assert 0.95 * low < distances_of(faint, linear(faint)).nearest < 1.05 * high
    assert faint.numbers["hull_asymmetry.place"] == case.numbers["hull_asymmetry.place"]


# --- seal, folders, answers


def test_the_seal_comes_first_and_holds(tmp_path: Path) -> None:
    wanted = Wanted(2, 11, nulls=2)
    cases, digest = sealed(tmp_path, wanted)
    assert not (tmp_path / CASES).exists()
    assert (tmp_path / SEAL).read_text().split()[0] == digest
    again, same = sealed(tmp_path, wanted)
    assert (again, same) == (cases, digest)
    assert drawn(wanted) == cases
    with pytest.raises(InputError, match="drawn"):
        sealed(tmp_path, Wanted(2, 12, nulls=2))
    text = (tmp_path / TRUTH).read_text()
    (tmp_path / TRUTH).write_text(text.replace('"seed"', '"Seed"', 1))
    with pytest.raises(InputError, match="seal"):
        opened(tmp_path)


def test_the_drawing_has_its_shares() -> None:
    cases = dealt(Wanted(400, 6))
    kinds = Counter(each.kind for each in cases)
    assert kinds == {"null": 100, "unknown": 60, "pair": 40, "effect": 200}
    assert sum(bool(each.coloured) for each in cases if each.kind == "null") == 50
    single = Counter(name for each in cases if each.kind == "effect" for name in each.effects)
    assert set(single) == set(EFFECTS)
    assert max(single.values()) - min(single.values()) <= 1
    outside = Counter(name for each in cases if each.kind == "unknown" for name in each.effects)
    assert set(outside) == set(OUTSIDE)
    # the order tells nothing: nulls in the first half are half of them, within a binomial's 1 in 10000
    assert abs(sum(each.kind == "null" for each in cases[:200]) - 50) < 20
    assert dealt(Wanted(400, 6)) == cases
    assert dealt(Wanted(400, 7)) != cases


def test_folders_tell_nothing_and_read_back(tmp_path: Path) -> None:
    case = _case("swivel_friction")
    write_cases(tmp_path, [case])
    folder = tmp_path / CASES / case.name
    files = {p.name for p in folder.rglob("*") if p.is_file()}
    assert files <= {"run.toml", "tracks.parquet", "static.parquet", "tension.csv"}
    for path in folder.rglob("run.toml"):
        text = path.read_text()
        assert "swivel" not in text
        assert "seed" not in text
    read = read_run(folder / "run-1")
    tracks = read_tracks(folder / "run-1" / "tracks.parquet")
    assert len(tracks) == 2 * 45 * 25
    assert read.file.tow is not None
    assert read.file.tow.line_length_m == case.runs[0].stated["line_m"]
    # what is whole is not written again; what is not, is
    stamp = (folder / "run-1" / "tracks.parquet").stat().st_mtime_ns
    write_cases(tmp_path, [case])
    assert (folder / "run-1" / "tracks.parquet").stat().st_mtime_ns == stamp
    (folder / "run-2" / "run.toml").unlink()
    write_cases(tmp_path, [case])
    assert (folder / "run-2" / "run.toml").is_file()


def test_a_filmed_case_is_tracked_to_its_pixels(tmp_path: Path) -> None:
    from towline.stages import tracked

    case = case_of("case-x", "null", [], [5, 1], False, video=True)
    case = replace(case, duration_s=1.6, static_s=0.4, runs=case.runs[:1])
    (folder,) = write_case(tmp_path, case)
    table = tracked(read_run(folder)).table
    clean = filmed(case, swum(case), 0).clean
    for m, name in enumerate(case.marks):
        mark = table[table["marker"] == name]
        off = mark[["u_px", "v_px"]].to_numpy() - clean[mark["frame"].to_numpy(), m]
        # grain of 2.5 grey levels on a spot of 170 and 2 px: 0.02 px; the codec's own error at crf 18: 0.03 px
        assert np.sqrt((off**2).mean()) < 0.06


def _fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wanted: Wanted) -> list[Case]:
    """Campaigns on paper, and a diagnosis that always says no gap."""
    cases, _ = sealed(tmp_path, wanted)
    for case in cases:
        for i in range(len(case.runs)):
            (tmp_path / CASES / case.name / f"run-{i + 1}").mkdir(parents=True)

    def answer(name: str, folders: list[Path], to: Path) -> str:
        assert all(TRUTH.split("/")[0] not in p.parts for p in folders)
        to.parent.mkdir(exist_ok=True)
        to.write_text(json.dumps({"case": name, "gap": _gap("no_gap"), "seconds": 1.0}))
        return name

    monkeypatch.setattr(run, "_answer", answer)
    return cases


def test_answers_go_on_where_they_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = _fake(tmp_path, monkeypatch, Wanted(3, 3, nulls=3))
    first = tmp_path / ANSWERS / f"{cases[2].name}.json"
    first.parent.mkdir()
    first.write_text(json.dumps({"case": cases[2].name, "gap": _gap("no_gap"), "seconds": 99.0}))
    (tmp_path / ANSWERS / ".case-001-x.tmp.json").write_text("{")  # a worker was killed here
    assert diagnose(tmp_path, 1) == 2
    assert diagnose(tmp_path, 1) == 0
    assert json.loads(first.read_text())["seconds"] == 99.0


def test_a_check_is_scored_from_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _fake(tmp_path, monkeypatch, Wanted(4, 3, nulls=4))
    diagnose(tmp_path, 1)
    outcome = score(tmp_path)
    text = score_text(outcome)
    assert "0/2" in text
    assert outcome.missing == []
    kept = json.loads((tmp_path / "score.json").read_text())
    assert kept["truth_sha256"] == outcome.digest
    from towline.report.blind_page import blind_page

    page = blind_page(outcome)
    assert outcome.digest in page
    assert "http://" not in page.replace("http://www.w3.org", "")


# --- scores on answers whose score is known


def _gap(verdict: str, effects: tuple[str, ...] = ("crossflow_drag",), p: float = 0.95, **more: object) -> dict:
    row = {
        "effects": list(effects),
        "probability": p if verdict == "effect" else 0.01,
        "shrink": 0.9,
        "shrink_interval": [0.8, 1.0],
        "log_evidence": 5.0,
    }
    held = [[]] if verdict == "no_gap" else [["unknown"]] if verdict == "unknown" else [list(effects)]
    return {
        "verdict": verdict,
        "ranking": [row],
        "p_no_gap": p if verdict == "no_gap" else 0.01,
        "p_unknown": p if verdict == "unknown" else 0.01,
        "set95": held,
        "indistinguishable": [["tension scale", "all derivatives together"]],
        "next_run": None,
        **more,
    }


D = {
    "nearest": 50.0,
    "rivals": {"cubic_damping": 50.0, "fluid_memory": 10.0},
    "oracle_shrink": 0.95,
    "oracle_before": 2.0,
}


def _judged(kind: str, effects: list[str], gap: dict | None, coloured: bool = False, **measure: object) -> Judged:
    case = case_of("case-x", kind, effects, [1, 1], coloured)
    answer = {"gap": gap, "seconds": 10.0} if gap is not None else {"error": "no", "seconds": 1.0}
    measures = {**D, **measure} if kind in ("effect", "pair", "unknown") else {}
    return judge.judged(case, answer, measures, {"always null": NO_GAP})


def _find(table: list[Score], what: str, stratum: str, method: str = "towline") -> Score:
    (found,) = [s for s in table if (s.what, s.stratum, s.method) == (what, stratum, method)]
    return found


def test_scores_of_known_answers() -> None:
    effect = ["crossflow_drag"]
    cases = [
        _judged("effect", effect, _gap("effect")),
        _judged("effect", effect, _gap("effect", ("fluid_memory",), 0.6)),  # D 10: of its class
        _judged("effect", effect, _gap("effect", ("cubic_damping",), 0.99)),  # D 50: plainly wrong
        _judged("effect", effect, _gap("effect"), nearest=3.0),
        _judged("effect", effect, None),
        _judged("null", [], _gap("no_gap")),
        _judged("null", [], _gap("effect", p=0.95)),
        _judged("null", [], _gap("effect", p=0.6), coloured=True),
        _judged("unknown", ["kick"], _gap("unknown")),
        _judged("unknown", ["kick"], _gap("effect", p=0.97)),
        _judged("unknown", ["kick"], _gap("no_gap")),
        _judged("pair", ["deck_height", "frame_rate"], _gap("effect", ("deck_height", "frame_rate"))),
        _judged("pair", ["deck_height", "frame_rate"], _gap("effect", ("frame_rate",))),
    ]
    table = scores(cases)

    def hits(what: str, stratum: str, method: str = "towline") -> tuple[int | None, int]:
        found = _find(table, what, stratum, method)
        return found.hits, found.of

    assert hits("right outright", "D > 20") == (1, 4)
    assert hits("right within its class", "D > 20") == (2, 4)
    assert hits("right outright", "D < 5") == (1, 1)
    assert hits("right outright", "D > 20", "always null") == (0, 4)
    assert hits("truth in the 95 % set", "D > 20") == (1, 3)
    assert _find(table, "mean size of the set", "D > 20").value == 1.0
    assert hits("false alarms", "nulls, white") == (1, 2)
    assert hits("false alarms", "nulls, coloured") == (1, 1)
    assert hits("false alarms", "nulls, white", "always null") == (0, 2)
    assert hits("false alarms with p > 0.9", "nulls") == (1, 3)
    assert hits("no gap in the 95 % set", "nulls") == (1, 3)
    assert hits("rejected", "in no library") == (1, 3)
    assert hits("named as an effect", "in no library") == (1, 3)
    assert hits("taken for no gap", "in no library") == (1, 3)
    assert hits("named wrongly with p > 0.9", "in no library") == (1, 3)
    assert hits("both right", "pairs") == (1, 2)
    assert hits("one right at least", "pairs") == (2, 2)
    assert hits("no answer", "all") == (1, 13)
    assert _find(table, "|shrink - oracle|, median", "D > 20").value == pytest.approx(0.05)
    assert hits("oracle in the 90 % interval", "D > 20") == (2, 2)


def test_the_shrinks_coverage_can_fail() -> None:
    off = [_judged("effect", ["crossflow_drag"], _gap("effect"), oracle_shrink=0.3)] * 3
    table = scores(off)
    assert _find(table, "oracle in the 90 % interval", "D > 20").hits == 0
    assert _find(table, "|shrink - oracle|, median", "D > 20").value == pytest.approx(0.6)
    # a gap that hardly shows has a stratum of its own
    small = [_judged("effect", ["crossflow_drag"], _gap("effect"), oracle_before=1.3)]
    table = scores([*off, *small])
    assert _find(table, "|shrink - oracle|, median", "D > 20").of == 4
    assert _find(table, "|shrink - oracle|, median", "D > 20, gap >= 2").of == 3


def test_calibration_of_honest_and_boastful_answers() -> None:
    right = _judged("null", [], _gap("no_gap", p=0.75))
    wrong = _judged("null", [], _gap("effect", p=0.75))
    honest, bins = calibration([right] * 3 + [wrong])
    assert honest == pytest.approx(0.0, abs=1e-9)
    assert [(b.count, b.right) for b in bins] == [(4, 3)]
    boastful, _ = calibration([right] + [wrong] * 3)
    assert boastful == pytest.approx(0.5)


def test_intervals_are_clopper_and_pearsons() -> None:
    assert interval(0, 10) == pytest.approx((0.0, 0.3085), abs=1e-4)
    assert interval(5, 10) == pytest.approx((0.1871, 0.8129), abs=1e-4)
    assert interval(10, 10) == pytest.approx((0.6915, 1.0), abs=1e-4)


def test_the_diagnosis_own_class_counts_for_it_alone() -> None:
    twins = _gap("effect", ("cubic_damping",), indistinguishable=[["cubic_damping", "crossflow_drag"]])
    table = scores([_judged("effect", ["crossflow_drag"], twins)])
    assert _find(table, "right within the class it states", "D > 20").hits == 1
    assert _find(table, "right within its class", "D > 20").hits == 0


def test_a_next_run_is_one_more_tow() -> None:
    case = _case("crossflow_drag", drag_m=0.1)
    proposed = {
        "tow_point_m": 1.6,
        "line_length_m": 0.5,
        "speed_m_s": 0.896,
        "y_release_m": 0.2,
        "beta_release_rad": 0.1,
    }
    more = with_next_run(case, proposed)
    assert len(more.runs) == len(case.runs) + 1
    added, first = more.runs[-1].stated, case.runs[0].stated
    assert added["tension_n"] == pytest.approx(first["tension_n"] * (0.896 / first["speed_m_s"]) ** 2, abs=1e-4)
    # the tows that were made stay as they were, pixel for pixel
    old, new = swum(case, random=False), swum(more, random=False)
    assert np.array_equal(filmed(case, old, 0).pixel, filmed(more, new, 0).pixel)


# --- the diagnosis itself, on a slice


LEVEL, ODDS = 0.8, 0.01
"""A diagnosis that is right in 80 % of clear cases falls below the slice's threshold once in a hundred slices."""


def test_a_slice_of_the_blind_check(tmp_path: Path) -> None:
    cases, _ = sealed(tmp_path, Wanted(4, 21, nulls=1, only=("crossflow_drag", "speed_drift", "deck_height")))
    write_cases(tmp_path, cases)
    diagnose(tmp_path, 2)
    outcome = score(tmp_path, 2)
    clear = [c for c in outcome.cases if c.kind == "null" or c.clear]
    right = sum(c.in_class(c.said) for c in clear)
    least = int(binom.ppf(ODDS, len(clear), LEVEL))
    assert len(clear) >= 3
    assert right >= least, score_text(outcome)
    calls = baseline_calls(sorted((tmp_path / CASES / cases[0].name).glob("run-*")), {})
    assert set(calls) == {"always null", "BIC on forces", "sparse regression"}
    assert UNKNOWN not in calls.values()
