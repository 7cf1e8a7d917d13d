"""Identification of tows with surge in full, made by code that shares nothing with simulate/ (``surge_cases``).

    python benchmarks/identify_surge.py gauge [--count 500] [--out build/identify_surge]   # T to 0.5 %; beside it constant T
    python benchmarks/identify_surge.py weighed                                              # nobody measured T
    python benchmarks/identify_surge.py rudder                                               # 0-15 degrees, half of them histories
    python benchmarks/identify_surge.py all                                                  # one after the other
    python benchmarks/identify_surge.py tables                                               # all three from what was kept

Every campaign is kept in a line of JSON, so that a run goes on where it stopped. Errors are held against the Cramer-Rao bound at
the true parameters with the priors in it; 95 % intervals against the truth (that of the scale on its logarithm).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from surge_cases import NAMES, SurgeCampaign, SurgeOptions, surge_campaigns

from towline.identify import Fit, RunData, fit_runs
from towline.identify.joint.problem import Problem
from towline.identify.joint.solve import normal
from towline.identify.limits.bound import information_of_six
from towline.identify.noise import stated as stated_noise
from towline.identify.tension import WEIGHED_LOG_SD
from towline.record import EstimationError, Priors
from towline.record.priors import SurgePriors, ValuePrior
from towline.simulate import Tow

SEED = 2311
WIDE = 1.96
PLAIN = 100
"""Campaigns that are fitted with constant T as well."""
RELEASES_DEG = (3.1, 6.3, 9.5, 12.7, 19.0)
ALONG = {
    "x_udot_kg": "x_udot",
    "x_vr_kg": "x_vr",
    "x_vv_kg_m": "x_vv",
    "x_rr_kg_m": "x_rr",
    "resistance_exponent": "power",
}
TOLD = {"resistance_exponent": "power"}
HEADS = " ".join(f"{name:>7s}" for name in ("m'", "I'", "Y_v", "Y_R", "N_v", "N_r"))
Array = np.ndarray


def options_of(what: str, release_deg: float | None = None) -> SurgeOptions:
    """What the campaigns of a table are."""
    release = (3.0, 20.0) if release_deg is None else (release_deg, release_deg)
    if what == "rudder":
        return SurgeOptions(rudder="mixed", release_deg=release, y_delta_n_rad=2.0)
    return SurgeOptions(gauge=what == "gauge", release_deg=release)


def runs_of(made: SurgeCampaign, line: str = "surge") -> list[RunData]:
    """The campaign as the estimators take it."""
    say = made.stated
    told = say["priors"]
    priors = Priors(
        **{k: v for k, v in told.items() if k.endswith(("_sd_rel", "_sd_m")) and k != "mass_sd_rel"},
        surge=SurgePriors(
            **{
                name: ValuePrior(value=told[TOLD.get(name, name)][0], std=told[TOLD.get(name, name)][1])
                for name in ALONG
            }
        ),
    )
    n = len(made.t_s)
    covariance = np.zeros((n, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = 1e-6, np.radians(0.1) ** 2
    runs = []
    for i, point in enumerate(say["tow_points_m"]):
        tension = say["tension_n"][i] if "tension_n" in say else 4.4
        rudder = None if made.rudder_rad is None else made.rudder_rad[i]
        still = rudder is not None and np.ptp(rudder) == 0.0
        tow = Tow(say["speed_m_s"], say["line_m"], point, tension, line=line)  # pyright: ignore[reportArgumentType]
        if still:
            tow = replace(tow, rudder_rad=float(rudder[0]))
        runs.append(
            RunData(
                name=f"run-{i + 1}",
                t_s=made.t_s,
                y_m=made.y_m[i],
                beta_rad=made.beta_rad[i],
                covariance=covariance,
                common=np.zeros((0, n, 2)),
                common_key="",
                tow=tow,
                tension=None,
                speed=None,
                priors=priors,
                assumed_sigma=False,
                mass_kg=say["mass_kg"],
                length_pp_m=say["length_pp_m"],
                rudder=None if rudder is None or still else (made.t_s, rudder),
                tension_stated="tension_n" in say,
            )
        )
    return runs


def straight_n(made: SurgeCampaign) -> float:
    """R at the true speed, which is what a perfect gauge reads on a straight tow."""
    truth = made.truth
    return truth["resistance_n"] * truth["speed_scale"] ** truth["power"]


def bound_of(made: SurgeCampaign, runs: list[RunData]) -> tuple[Array, float]:
    """Cramer-Rao standard deviations of the six, (6,), and of the logarithm of the common scale (nan with a gauge)."""
    problem = Problem(runs, "full", made.stated["speed_m_s"])
    truth, theta = made.truth, np.zeros(problem.size)
    theta[:6] = [truth[n] for n in NAMES]
    true = {ours: truth[theirs] for ours, theirs in ALONG.items()}
    true |= {"line_length": truth["line_m"] - made.stated["line_m"], "y_delta": truth["y_delta"]}
    true |= {"speed": made.stated["speed_m_s"] * (truth["speed_scale"] - 1), "n_delta": truth["n_delta"]}
    for common in problem.commons:
        if common.name in true:
            theta[problem.common_at[common.name]] = (true[common.name] - common.base[0]) / common.sd[0]
    for i in range(len(runs)):
        at = problem.own_at(i)
        theta[at] = truth["release_rad"][i]
        theta[at + 6 : at + 8] = straight_n(made), truth["tow_points_m"][i]
    weights = [stated_noise(d.covariance, d.t_s) for d in runs]
    matrix, _, _ = normal(problem, theta, problem.evaluate(theta), weights)
    six = np.linalg.inv(information_of_six(matrix.dense(), problem))
    scale = np.nan
    if not runs[0].tension_stated:
        dense, free = matrix.dense(), np.flatnonzero(problem.free)
        inner = dense[np.ix_(free, free)]
        size = np.sqrt(np.diag(inner))
        inverse = np.linalg.inv(inner / size[:, None] / size) / size[:, None] / size
        at = int(np.flatnonzero(free == problem.common_at["tension"])[0])
        scale = float(np.sqrt(inverse[at, at]))
    return np.sqrt(np.diag(six)), scale


def judged(made: SurgeCampaign, what: str, plain_too: bool) -> dict[str, Any]:
    """One campaign fitted, against its truth; with constant T as well."""
    runs = runs_of(made)
    true = np.array([made.truth[n] for n in NAMES])
    bound, scale_bound = bound_of(made, runs)
    begun = time.process_time()
    answer: dict[str, Any] = {"true": true.tolist(), "bound": bound.tolist(), "scale_bound": scale_bound}
    try:
        fit = fit_runs(runs)
    except EstimationError as error:
        return answer | {"error": str(error)}
    answer["seconds"] = time.process_time() - begun
    answer |= {"six": fit.six.tolist(), "sd": np.sqrt(np.diag(fit.covariance)).tolist(), "converged": fit.converged}
    size, size_sd = fit.common["tension"]
    if what == "weighed":
        found = np.log(4.4) + size
        answer["scale"] = [float(found - np.log(straight_n(made))), size_sd]
    else:
        answer["tension"] = _tension(made, fit)
    if plain_too:
        plain = fit_runs([replace(d, tow=replace(d.tow, line="constant")) for d in runs])
        answer["constant"] = [plain.six.tolist(), np.sqrt(np.diag(plain.covariance)).tolist()]
    return answer


def _tension(made: SurgeCampaign, fit: Fit) -> list[float]:
    """Error of R of the first run as fitted, relative, and its standard deviation."""
    value, sd = fit.resistance[0]
    return [float(value / straight_n(made) - 1), float(sd / value)]


def kept(path: Path) -> list[dict[str, Any]]:
    """Campaigns done before."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []


def _made(out: Path, what: str, count: int) -> Iterator[tuple[str, list[SurgeCampaign]]]:
    releases = RELEASES_DEG if what == "weighed" else (None,)
    for release in releases:
        name = what if release is None else f"{what}-{release:g}"
        yield name, surge_campaigns(SEED, count, options_of(what, release), out / f"{name}.npz")


def run(out: Path, what: str, count: int) -> None:
    """Fit what is not yet kept."""
    for name, campaigns in _made(out, what, count):
        path = out / f"{name}.jsonl"
        done = len(kept(path))
        with path.open("a") as file:
            for k, made in enumerate(campaigns):
                if k < done:
                    continue
                file.write(json.dumps(judged(made, what, what == "gauge" and k < PLAIN)) + "\n")
                file.flush()
                if k % 20 == 0:
                    print(f"{name}: {k + 1} of {len(campaigns)}", flush=True)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _row(label: str, error: Array, sd: Array, bound: Array) -> str:
    share = np.sqrt(np.mean((error / bound) ** 2, axis=0))
    return (
        f"{label:34s} {_numbers(share, 3)}           {_numbers(100 * np.mean(np.abs(error) <= WIDE * sd, axis=0), 1)}"
    )


def _numbers(values: Array, decimals: int) -> str:
    return " ".join(f"{v:7.{decimals}f}" for v in values)


def tables(out: Path) -> str:
    """What docs/how-well.md quotes."""
    lines = [
        f"{'':34s} {'rms error over the bound':58s} 95 % intervals hold, %",
        f"{'':34s} " + f"{HEADS}           {HEADS}",
    ]
    for what in ("gauge", "rudder"):
        rows = [r for r in kept(out / f"{what}.jsonl") if "six" in r]
        lost = len(kept(out / f"{what}.jsonl")) - len(rows)
        if not rows:
            continue
        true, six, sd, bound = (np.array([r[k] for r in rows]) for k in ("true", "six", "sd", "bound"))
        lines.append(_row(f"{what}: {len(rows)} campaigns, {lost} without answer", six - true, sd, bound))
        error, error_sd = np.array([r["tension"] for r in rows]).T
        holds = 100 * np.mean(np.abs(error) <= WIDE * error_sd)
        lines.append(f"    T of a run: rms z {_rms(error / error_sd):.3f}, intervals hold {holds:.1f} %")
        lines.append(f"    seconds of a fit (processor): median {np.median([r['seconds'] for r in rows]):.2f}")
        if what == "gauge":
            some = [i for i, r in enumerate(rows) if "constant" in r]
            plain, plain_sd = np.array([rows[i]["constant"] for i in some]).transpose(1, 0, 2)
            middle = np.median(np.abs(plain - true[some]) / bound[some], axis=0)
            holds = 100 * np.mean(np.abs(plain - true[some]) <= WIDE * plain_sd, axis=0)
            label = f"    {len(some)} of them, T held constant"
            lines.append(f"{label:34s} {_numbers(middle, 3)} (median)  {_numbers(holds, 1)}")
    lines += [
        "",
        "nobody measured T: sd of the scale (median), its bound, rms error, 95 % intervals that hold, told to measure T; rms",
        "errors of the six, %",
    ]
    for release in RELEASES_DEG:
        rows = [r for r in kept(out / f"weighed-{release:g}.jsonl") if "six" in r]
        if not rows:
            continue
        error, sd = np.array([r["scale"] for r in rows]).T
        bound = np.array([r["scale_bound"] for r in rows])
        refused, holds = np.mean(sd > WEIGHED_LOG_SD), np.mean(np.abs(error) <= WIDE * sd)
        six = np.array([np.array(r["six"]) / r["true"] - 1 for r in rows])
        numbers = [np.median(sd), np.median(bound), _rms(error), holds, refused]
        each = " ".join(f"{100 * _rms(v):.1f}" for v in six.T)
        lines.append(
            f"{release:5.1f} degrees, {len(rows):4d} campaigns        {' '.join(f'{100 * v:9.1f} %' for v in numbers)}   {each}"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("gauge", "weighed", "rudder", "tables", "all"))
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--out", type=Path, default=Path("build/identify_surge"))
    options = parser.parse_args()
    if options.what == "tables":
        print(tables(options.out), end="")
        return
    options.out.mkdir(parents=True, exist_ok=True)
    for what in ("gauge", "weighed", "rudder") if options.what == "all" else (options.what,):
        run(options.out, what, options.count)
    if options.what == "all":
        print(tables(options.out), end="")


if __name__ == "__main__":
    main()
