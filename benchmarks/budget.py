"""The uncertainty budget against what it promises, on tows with surge in full made by code of their own (``surge_cases``).

    python benchmarks/budget.py lines [--count 10]        # every input wrong by one sd, refitted, against its line
    python benchmarks/budget.py draws [--count 2000]      # JCGM 101: every input drawn, refitted, against the combined uncertainty
    python benchmarks/budget.py coverage [--count 500]    # do expanded intervals hold the truth?
    python benchmarks/budget.py repeats [--count 20]      # repeats of a run: is the type A check honest, and does it see a fault?
    python benchmarks/budget.py film [--count 30]         # sample videos: marks, datum, settings changed, all refitted
    python benchmarks/budget.py all                       # one after the other
    python benchmarks/budget.py tables                    # all of it from what was kept

Every refit is a whole one: the noise is weighed anew, nothing is linearised.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from identify_surge import options_of, runs_of
from surge_cases import NAMES, SurgeCampaign, surge_campaigns

from towline.identify import Fit, RunData, fit_runs
from towline.identify.budget import Budget, budget_of, judged, repeats_of
from towline.identify.budget.carried import carried_on, stability_index
from towline.identify.fit import Near
from towline.record import EstimationError, Priors

SEED = 2929
RATE_HZ = 12.5
"""Of the records: half the usual, so that a refit takes a fifth of a second."""
SEEN = 0.1
"""A line is held against refits where it makes at least this share of a derivative's combined uncertainty: a fit ends 1e-8 of its
chi-square above its optimum, which is 0.01 of it."""
Array = np.ndarray
Runs = list[RunData]


def campaigns(count: int) -> list[SurgeCampaign]:
    """Of four tows with a gauge, released at 3 to 20 degrees."""
    return surge_campaigns(SEED, count, replace(options_of("gauge"), rate_hz=RATE_HZ))


def of_six(budget: Budget) -> Array:
    """Combined standard uncertainties of the six."""
    return np.sqrt(np.diag(budget.covariance))[:6]


# what is stated, by one unit more -------------------------------------------------------------------------------------


def with_priors(runs: Runs, change: Callable[[Priors], dict[str, Any]]) -> Runs:
    """Other priors in every run."""
    return [replace(d, priors=d.priors.model_copy(update=change(d.priors))) for d in runs]


def with_tow(runs: Runs, only: str, change: Callable[[RunData], dict[str, float]]) -> Runs:
    """Another tow in every run, or in the one that is named."""
    return [replace(d, tow=replace(d.tow, **change(d))) if only in ("", d.name) else d for d in runs]


def moved(runs: Runs, source: str, name: str, run: str, by: float) -> Runs:
    """The runs with an input of the budget stated ``by`` units more."""
    if (source, name) == ("tension gauge", "tension_n"):
        return with_tow(runs, run, lambda d: {"tension_n": d.tow.tension_n + by})
    if (source, name) == ("tension gauge", "scale common to all runs"):
        return with_tow(runs, run, lambda d: {"tension_n": d.tow.tension_n * np.exp(by)})
    if source == "tow point":
        return with_tow(runs, run, lambda d: {"tow_point_m": d.tow.tow_point_m + by})
    if source == "line length":
        return with_tow(runs, run, lambda d: {"line_length_m": d.tow.line_length_m + by})
    if source == "speed":
        return with_tow(runs, run, lambda d: {"speed_m_s": d.tow.speed_m_s + by})
    if source == "surge":

        def other(priors: Priors) -> dict[str, Any]:
            stated = getattr(priors.surge, name)
            return {
                "surge": priors.surge.model_copy(update={name: stated.model_copy(update={"value": stated.value + by})})
            }

        return with_priors(runs, other)
    if name == "mass_kg":
        return [replace(d, mass_kg=d.mass_kg + by) for d in runs]
    if source == "clock":
        return [replace(d, t_s=d.t_s * (1 + by)) for d in runs]
    if source == "camera":
        return [
            replace(d, y_m=d.y_m + by * d.common[int(name)][:, 0], beta_rad=d.beta_rad + by * d.common[int(name)][:, 1])
            for d in runs
        ]
    raise KeyError(f"{source}: {name}")


EXACT = {"mass_kg": 0.2, "rate of the recording's clock": 2e-4, "tow_point_m, all runs": 5e-4}
"""Inputs that the fit takes as exact: by how much they are wrong here."""


def refitted(fit: Fit, runs: Runs, others: Runs) -> Array:
    """The six of the same records with other inputs."""
    return fit_runs(others, fit.form, fit.speed_m_s, near=Near.of(fit, runs, range(len(runs)))).six


def with_camera(runs: Runs) -> Runs:
    """The runs with common errors of a camera: a scale of 0.1 %, a tilt that bends y, a heading that reads 0.2 % too far.

    Each is a function of where the model was seen, its noise included, as those of a film are.
    """
    return [replace(d, common=camera_modes(d.y_m, d.beta_rad), common_key="camera") for d in runs]


def camera_modes(y: Array, beta: Array) -> Array:
    """(3, n, 2), change of y and beta with each mode, the model standing at ``y (n,)``, ``beta (n,)``."""
    none = np.zeros_like(y)
    shapes = ((1e-3 * y, none), (2e-3 * y**2, 2e-3 * y), (none, 2e-3 * beta))
    return np.array([np.column_stack(s) for s in shapes])


def lines(count: int) -> dict[str, Any]:
    """Every line by a refit with that input one sd wrong; every second campaign with a camera's common errors."""
    rows, closure = [], []
    for k, made in enumerate(campaigns(count)):
        runs = runs_of(made)
        if k % 2:
            runs = with_camera(runs)
        fit = fit_runs(runs)
        budget = budget_of(fit, runs)
        closure.append(budget.closure)
        u = of_six(budget)
        for c in budget.components:
            by = c.u if c.included else EXACT.get(c.name)
            if c.sensitivity is None or by is None:
                continue
            told = c.sensitivity[:6] * by
            more, less = (
                refitted(fit, runs, moved(runs, c.source, c.name, c.run, sign * by)) - fit.six for sign in (1, -1)
            )
            rows.append([k, c.source, c.name, c.run, *((x / u).tolist() for x in (told, more, (more - less) / 2))])
        if k % 2:
            (line,) = [c for c in budget.components if c.source == "camera"]
            real = [refitted(fit, runs, moved(runs, "camera", str(m), "", 1.0)) - fit.six for m in range(3)]
            told = np.sqrt(np.diag(line.covariance)[:6])
            real = np.linalg.norm(real, axis=0)
            rows.append([k, "camera", "common modes", "", *((x / u).tolist() for x in (told, real, real))])
    return {"rows": rows, "closure": closure}


def shown_lines(found: dict[str, Any]) -> str:
    """Table of ``lines``."""
    said = [f"closure (lines combined over the fit's sd, less 1): at most {max(found['closure']):.1e}"]
    said.append(
        f"{'source':18s}{'input':32s}{'held':>6s}{'within 10 %':>13s}{'worst':>8s}{'worst of +- half':>18s}{'largest line/u':>16s}"
    )
    groups: dict[tuple[str, str], list[list[list[float]]]] = {}
    for _, source, name, _, *three in found["rows"]:
        groups.setdefault((source, name), []).append(three)
    every = []
    for (source, name), rows in groups.items():
        told, real, half = (np.concatenate([row[i] for row in rows]) for i in range(3))
        held = np.abs(told) >= SEEN
        off = np.abs(np.array([real[held], half[held]]) / told[held] - 1)
        every.append(off)
        if held.any():
            said.append(
                f"{source:18s}{name:32s}{held.sum():6d}{np.sum(off[0] <= 0.1):13d}{off[0].max():8.4f}{off[1].max():18.4f}"
                f"{np.abs(told).max():16.2f}"
            )
        else:
            gap = np.abs(real - told).max()
            said.append(
                f"{source:18s}{name:32s}{0:6d}   moves by at most {np.abs(told).max():.4f} u by its line, off by {gap:.4f} u"
            )
    one, both = np.concatenate(every, axis=1)
    said.append(
        f"all: {np.sum(one <= 0.1)} of {len(one)} within 10 %, median {np.median(one):.4f}, worst {one.max():.4f}; half of what "
        f"+1 and -1 sd do (without curvature): {np.sum(both <= 0.1)} of {len(both)}, worst {both.max():.4f}"
    )
    return "\n".join(said)


def drawn(fit: Fit, runs: Runs, rng: np.random.Generator) -> Runs:
    """The runs with every input drawn (JCGM 101, 6.4.7): records about the fitted motion, what is stated about what was fitted."""
    priors = runs[0].priors
    at = {name: theta * float(common.sd[0]) for name, (common, theta) in fit.commons.items()}
    sds = priors.tension_common_sd_rel, priors.line_length_sd_m, priors.speed_sd_rel * runs[0].tow.speed_m_s
    scale, line, speed = (
        at.get(name, 0.0) + sd * rng.standard_normal()
        for name, sd in zip(("tension", "line_length", "speed"), sds, strict=True)
    )
    camera = rng.standard_normal(len(runs[0].common))
    found = []
    for k, (d, path, over) in enumerate(zip(runs, fit.response, fit.scale, strict=True)):
        noise = np.linalg.cholesky(d.covariance) @ rng.standard_normal((len(d.t_s), 2, 1))
        records = path + noise[:, :, 0] * over
        if len(d.common):
            records += np.einsum("k,knc->nc", camera - fit.modes[d.common_key], camera_modes(*path.T))
        tow = replace(
            d.tow,
            tension_n=fit.own[k, 6] * np.exp(scale) + priors.tension_sd_rel * d.tow.tension_n * rng.standard_normal(),
            tow_point_m=fit.own[k, 7] + priors.tow_point_sd_m * rng.standard_normal(),
            line_length_m=d.tow.line_length_m + line,
            speed_m_s=d.tow.speed_m_s + speed,
        )
        found.append(replace(d, y_m=records[:, 0], beta_rad=records[:, 1], tow=tow))
    if camera.size:
        found = with_camera(found)
    surge = {
        name: stated.model_copy(update={"value": fit.beside[name][0] + stated.std * rng.standard_normal()})
        for name, stated in priors.surge
    }
    return with_priors(found, lambda p: {"surge": p.surge.model_copy(update=surge)})


def draws(count: int) -> dict[str, Any]:
    """Monte Carlo of one campaign: the fit refitted to draws, against its budget."""
    runs = with_camera(runs_of(campaigns(1)[0]))
    fit = fit_runs(runs)
    budget = budget_of(fit, runs)
    rng = np.random.default_rng(SEED)
    six, failed = [], 0
    for _ in range(count):
        try:
            six.append(refitted(fit, runs, drawn(fit, runs, rng)))
        except EstimationError:
            failed += 1
    six = np.array(six)
    carried = carried_on(budget, fit.speed_m_s, 2.66, rng)
    one = {q.name: q for q in carried.quantities}
    x_v = six[:, 4] / six[:, 2]
    index = stability_index(six.T) / (six[:, 0] * six[:, 1]) * (2.66 / fit.speed_m_s) ** 2
    return {
        "draws": len(six),
        "failed": failed,
        "sd": [*six.std(axis=0, ddof=1), x_v.std(ddof=1), index.std(ddof=1)],
        "u": [*of_six(budget), one["X_v"].judged.u, one["C' of straight-line stability"].judged.u],
        "shift": ((six.mean(axis=0) - fit.six) / of_six(budget)).tolist(),
        "correlation": float(np.abs(np.corrcoef(six.T) - budget.correlation[:6, :6]).max()),
    }


def shown_draws(found: dict[str, Any]) -> str:
    """Table of ``draws``."""
    ratio = np.array(found["sd"]) / np.array(found["u"])
    heads = (*NAMES, "X_v", "C'")
    return "\n".join([
        f"{found['draws']} draws, each refitted ({found['failed']} failed); ratios known to {1 / np.sqrt(2 * found['draws']):.3f}",
        *(f"{n:18s} sd of the draws over u {r:6.3f}" for n, r in zip(heads, ratio, strict=True)),
        f"mean of the draws less the estimate, in u: at most {np.abs(found['shift']).max():.3f}",
        f"correlations of the draws less the budget's: at most {found['correlation']:.3f}",
    ])  # fmt: skip


def coverage(count: int) -> dict[str, Any]:
    """Do expanded intervals hold the truth: the six, X_v, and C' by its draws."""
    hits, z, closure = [], [], []
    for k, made in enumerate(campaigns(count)):
        runs = runs_of(made)
        fit = fit_runs(runs)
        budget = budget_of(fit, runs)
        closure.append(budget.closure)
        truth = np.array([made.truth[name] for name in NAMES])
        one = [judged(budget, np.eye(len(budget.names))[i], budget.value[i]) for i in range(6)]
        carried = {
            q.name: q for q in carried_on(budget, fit.speed_m_s, 2.66, np.random.default_rng([SEED, k])).quantities
        }
        x_v, c = carried["X_v"], carried["C' of straight-line stability"]
        true_c = float(stability_index(truth) / (truth[0] * truth[1]) * (2.66 / fit.speed_m_s) ** 2)
        hits.append([
            *(bool(abs(q.value - t) <= q.expanded) for q, t in zip(one, truth, strict=True)),
            bool(abs(x_v.value - truth[4] / truth[2]) <= x_v.judged.expanded),
            bool(c.low <= true_c <= c.high),
        ])  # fmt: skip
        z.append([(q.value - t) / q.u for q, t in zip(one, truth, strict=True)])
    return {"hits": hits, "z": z, "closure": closure}


def shown_coverage(found: dict[str, Any]) -> str:
    """Table of ``coverage``."""
    hits, z = np.array(found["hits"]), np.array(found["z"])
    rms = [*np.sqrt((z**2).mean(axis=0)), np.nan, np.nan]
    rows = [f"{len(hits)} campaigns; closure at most {max(found['closure']):.1e}"]
    for name, share, r in zip((*NAMES, "X_v", "C' (by draws)"), hits.mean(axis=0), rms, strict=True):
        rows.append(
            f"{name:18s} expanded intervals hold {100 * share:5.1f} %"
            + (f", rms error/u {r:.3f}" if np.isfinite(r) else "")
        )
    return "\n".join(rows)


def repeats(count: int) -> dict[str, Any]:
    """Four repeats each of two set-ups about a fitted motion; then with a scatter of the gauge that nobody stated."""
    found: dict[str, Any] = {"honest": [], "faulty": []}
    for k, made in enumerate(campaigns(count)):
        runs = runs_of(made)
        fit = fit_runs(runs)
        rng = np.random.default_rng([SEED, k, 2])
        for kind, extra in (("honest", 0.0), ("faulty", 0.03)):
            again = []
            for n in range(4):
                for i in (0, 2):
                    d = drawn(fit, runs, rng)[i]
                    point = runs[i].tow.tow_point_m
                    # what the repeats share, the gauge's scale, the line and the speed, is as stated
                    off = np.hypot(d.priors.tension_sd_rel, extra) * rng.standard_normal()
                    tension = runs[i].tow.tension_n * (1 + off)
                    slip = d.priors.tow_point_sd_m * rng.standard_normal()
                    again.append(
                        moved_path(
                            fit,
                            replace(d, name=f"{runs[i].name}-{n}", priors=runs[i].priors),
                            i,
                            tension,
                            point,
                            slip,
                            runs,
                        )
                    )
            joint = fit_runs(again)
            found[kind].append([[r.ratio, r.p_value, r.degrees] for r in repeats_of(joint, again).derivatives])
    return found


def moved_path(fit: Fit, d: RunData, index: int, tension: float, point: float, slip: float, runs: Runs) -> RunData:
    """A repeat whose true tow point is off by ``slip`` and whose gauge reads ``tension``, stated at ``point``."""
    from towline.identify.joint.problem import Problem

    problem = Problem(runs, fit.form, fit.speed_m_s, path=fit.path)
    theta = fit.theta.copy()
    theta[problem.own_at(index) + 7] += slip
    path = d_measured(runs[index]) - problem.residuals(theta)[index]
    noise = np.column_stack([d.y_m, d.beta_rad]) - fit.response[index]
    return replace(
        d, y_m=path[0] + noise[:, 0], beta_rad=path[1] + noise[:, 1],
        tow=replace(runs[index].tow, tension_n=tension, tow_point_m=point),
    )  # fmt: skip


def d_measured(d: RunData) -> Array:
    """(2, n) as measured."""
    return np.stack([d.y_m, d.beta_rad])


def shown_repeats(found: dict[str, Any]) -> str:
    """Table of ``repeats``."""
    rows = []
    for kind, said in (("honest", "as stated"), ("faulty", "the gauge scatters by 3 %, which nobody stated")):
        every = np.array([r for one in found[kind] for r in one])
        rows.append(
            f"{said}: {len(found[kind])} campaigns of two set-ups with four repeats, {len(every)} checks: root mean square of "
            f"pooled/stated {np.sqrt(np.mean(every[:, 0] ** 2)):.3f}, p < 0.05 in {100 * np.mean(every[:, 1] < 0.05):.1f} %"
        )
    return "\n".join(rows)


# film -----------------------------------------------------------------------------------------------------------------


def film(count: int, out: Path) -> dict[str, Any]:
    """The sample videos' tracks through the commands' own stages, run.toml stated otherwise; picks drawn ``count`` times."""
    import tomlkit

    from towline.pipeline.analysis import compute_motions, identify_batch
    from towline.pipeline.budgeting import budget_lines

    source = Path(__file__).parents[1] / "sample_videos" / "mariner"
    base = out / "film"
    shutil.rmtree(base, ignore_errors=True)
    shutil.copytree(source, base)
    folders = sorted(p.parent for p in base.glob("*/run.toml"))
    compute_motions(folders)
    texts = {}
    for folder in folders:
        shutil.copy(folder / "out" / "tracks.csv", folder / "kept.csv")
        document = tomlkit.parse((folder / "run.toml").read_text(encoding="utf-8"))
        document["source"] = {"tracks": "kept.csv"}
        document["priors"] = {"marker_depth_sd_m": 0.002, "tow_point_sd_m": 0.001}
        texts[folder] = tomlkit.dumps(document)

    def answered(change: Callable[[Any], None] | None = None, same_fit: bool = True) -> Any:
        for folder in folders:
            document = tomlkit.parse(texts[folder])
            if change is not None:
                change(document)
            (folder / "run.toml").write_text(tomlkit.dumps(document), encoding="utf-8")
        return identify_batch(compute_motions(folders))

    first = answered()
    budget = budget_lines(first)
    u = of_six(budget)
    slopes: dict[tuple[str, str], Array] = {}
    for c in (one for one in budget.components if one.sensitivity is not None):
        # each run has picks of its own, and with them lines of its own; what is changed here is changed in all of them
        slopes[c.source, c.name] = slopes.get((c.source, c.name), np.zeros(6)) + c.sensitivity[:6]

    def marker(index: int, key: str, by: float, place: int | None = None) -> Callable[[Any], None]:
        def change(document: Any) -> None:
            if place is None:
                document["marker"][index][key] += by
            else:
                document["marker"][index][key][place] += by

        return change

    def tow(key: str, by: float) -> Callable[[Any], None]:
        def change(document: Any) -> None:
            document["tow"][key] += by

        return change

    asked = {
        ("deck height", "depth_m of bow"): (0.002, marker(0, "depth_m", 0.002)),
        ("deck height", "depth_m of stern"): (0.002, marker(1, "depth_m", 0.002)),
        ("marks' places", "body_m of bow, along"): (0.001, marker(0, "body_m", 0.001, 0)),
        ("marks' places", "body_m of stern, along"): (0.001, marker(1, "body_m", 0.001, 0)),
        ("marks' places", "body_m of bow, across"): (0.001, marker(0, "body_m", 0.001, 1)),
        ("line length", "line_length_m"): (0.001, tow("line_length_m", 0.001)),
        ("speed", "speed_m_s"): (0.00128, tow("speed_m_s", 0.00128)),
        ("tension gauge", "scale common to all runs"): (0.005, tow("tension_n", 0.0198)),
    }
    rows = []
    for key, (by, change) in asked.items():
        answer = answered(change)
        six = answer.fit.six.copy()
        six[2:] *= first.fit.speed_m_s / answer.fit.speed_m_s if key[0] == "speed" else 1.0
        told, real = slopes[key] * by / u, (six - first.fit.six) / u
        rows.append([0, *key, "", *(x.tolist() for x in (told, real, real))])
    rng = np.random.default_rng(SEED)
    six = []
    for _ in range(count):

        def redrawn(document: Any) -> None:
            for point in document["datum"]:
                for axis in (0, 1):
                    point["pixel_px"][axis] += float(point["sigma_px"] * rng.standard_normal())

        six.append(answered(redrawn).fit.six)
    picks = sum(c.covariance for c in budget.components if c.source == "datum picks")
    answered()
    return {
        "rows": rows,
        "closure": [budget.closure],
        "draws": len(six),
        "picks": (np.std(six, axis=0, ddof=1) / np.sqrt(np.diag(picks)[:6])).tolist(),
        "share": (np.diag(picks)[:6] / u**2).tolist(),
    }


def shown_film(found: dict[str, Any]) -> str:
    """Table of ``film``."""
    rows = [
        shown_lines(found),
        f"datum picks redrawn {found['draws']} times, all fitted anew (ratios known to {1 / np.sqrt(2 * found['draws']):.2f}):",
    ]
    rows += [
        f"{n:18s} sd of the refits over the lines' {r:6.3f} ({100 * s:.1f} % of the variance)"
        for n, r, s in zip(NAMES, found["picks"], found["share"], strict=True)
    ]
    return "\n".join(rows)


# ----------------------------------------------------------------------------------------------------------------------

COUNTS = {"lines": 10, "draws": 2000, "coverage": 500, "repeats": 20, "film": 30}
"""How many where nothing is asked."""
SHOWN = {
    "lines": shown_lines,
    "draws": shown_draws,
    "coverage": shown_coverage,
    "repeats": shown_repeats,
    "film": shown_film,
}
TITLES = {
    "lines": "Every input wrong by one standard uncertainty (of what the fit takes as exact: mass 0.2 kg, clock 2e-4), refitted",
    "draws": "Monte Carlo (JCGM 101) of a campaign with a camera's common errors",
    "coverage": "Expanded intervals against the truth",
    "repeats": "Repeats: the type A check of the whole",
    "film": "The four sample videos: run.toml stated otherwise, from tracks to derivatives",
}


def main() -> None:
    """Parse, make, keep, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=(*COUNTS, "all", "tables"))
    parser.add_argument("--count", type=int)
    parser.add_argument("--out", type=Path, default=Path("build/budget"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for what in COUNTS if options.what == "all" else () if options.what == "tables" else (options.what,):
        start = time.time()
        count = options.count or COUNTS[what]
        found = film(count, options.out) if what == "film" else globals()[what](count)
        found["seconds"] = time.time() - start
        (options.out / f"{what}.json").write_text(json.dumps(found), encoding="utf-8")
    for what, show in SHOWN.items():
        path = options.out / f"{what}.json"
        if options.what in (what, "all", "tables") and path.is_file():
            found = json.loads(path.read_text(encoding="utf-8"))
            print(f"{TITLES[what]} ({found['seconds']:.0f} s)\n{show(found)}\n")


if __name__ == "__main__":
    main()
