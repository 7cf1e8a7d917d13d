"""The joint fit against truth: efficiency, intervals, nuisances, coloured forces, large swings, lost transients, speed.

    python benchmarks/identify.py [--only speed efficiency nuisance coloured oscillation large] [--campaigns 2000]
                                  [--seeds 200] [--store FOLDER]

Campaigns are kept in --store as they are done, so that a stopped run goes on where it was. Seeds: campaign k of a part takes
numpy's default_rng([part, k]). Writes a table to standard output; benchmarks/identify.txt is a run of it.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from identify_cases import (
    LARGE_STARTS_RAD,
    NUISANCE,
    POINTS_M,
    SIX,
    campaign,
    noisy,
    nuisance_campaign,
    pushed_run,
    still_run,
    times,
    unaware,
)

from towline.identify import fit_runs
from towline.identify.colour.innovations import maximise
from towline.identify.limits.bound import cramer_rao
from towline.identify.limits.cure import cure
from towline.identify.report import examined
from towline.record import Priors
from towline.simulate import Start

NAMES = ("m'", "I'", "Y_v", "Y_R", "N_v", "N_r")
KEEP_EVERY = 50
Row = np.ndarray
"""(12,) or (24,): estimates and their standard deviations, of one or two estimators."""


def collect(part: str, index: int, count: int, store: Path | None, one: Callable[[np.random.Generator], Row]) -> Row:
    """Rows of ``count`` campaigns, (count, k); those kept in ``store`` are not done again."""
    path = None if store is None else store / f"{part}.npy"
    rows = list(np.load(path)) if path is not None and path.exists() else []
    while len(rows) < count:
        rows.append(one(np.random.default_rng([index, len(rows)])))
        if path is not None and (len(rows) % KEEP_EVERY == 0 or len(rows) == count):
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, np.array(rows))
    return np.array(rows[:count])


def row(fit) -> Row:
    return np.concatenate([fit.six, np.sqrt(np.diag(fit.covariance))])


def say(title: str, values: np.ndarray, form: str = "8.3f") -> None:
    print(f"{title:44}" + "".join(f"{v:{form}}" for v in values), flush=True)


def table(rows: Row, bound: np.ndarray | None) -> None:
    error, sd = rows[:, :6] - SIX, rows[:, 6:12]
    rms = np.sqrt((error**2).mean(axis=0))
    if bound is not None:
        say("Cramer-Rao bound, %", 100 * bound / np.abs(SIX))
    say("rms error, %", 100 * rms / np.abs(SIX))
    if bound is not None:
        say("rms error / bound", rms / bound)
    say("bias / its standard error", error.mean(axis=0) / (error.std(axis=0) / np.sqrt(len(rows))), "8.2f")
    say("stated sd / rms error", np.sqrt((sd**2).mean(axis=0)) / rms)
    say("95 % intervals hold the truth, %", 100 * (np.abs(error) < 1.96 * sd).mean(axis=0), "8.1f")


def heading(text: str) -> None:
    print(f"\n== {text}\n{'':44}" + "".join(f"{n:>8}" for n in NAMES), flush=True)


def efficiency(options: argparse.Namespace) -> None:
    still = [still_run(x, times()) for x in POINTS_M]
    rows = collect(
        "efficiency", 1, options.campaigns, options.store, lambda rng: row(fit_runs(campaign(still, rng), "linear"))
    )
    heading(f"efficiency: {len(rows)} campaigns, four tow points, 64 Hz, 60 s, 1 mm, 0.1 deg, released at 0.15 m")
    table(rows, np.sqrt(np.diag(cramer_rao(still, SIX))))


def nuisance(options: argparse.Namespace) -> None:
    t = times()

    def one(rng: np.random.Generator) -> Row:
        runs = nuisance_campaign(rng, t)
        return np.concatenate([row(fit_runs(runs, "linear")), row(fit_runs([unaware(r) for r in runs], "linear"))])

    rows = collect("nuisance", 2, options.campaigns, options.store, one)
    heading(
        f"nuisances: {len(rows)} campaigns, T_i 1 %, X_T,i 1 mm, y_b 2 mm, beta_b 0.2 deg per run, each with its prior"
    )
    table(rows, np.sqrt(np.diag(cramer_rao([still_run(x, t, priors=NUISANCE) for x in POINTS_M], SIX))))
    print("the same campaigns, nuisances not modelled:")
    table(rows[:, 12:], None)


def coloured(options: argparse.Namespace) -> None:
    t = times()

    def one(rng: np.random.Generator) -> Row:
        runs = [noisy(pushed_run(x, rng, t), rng) for x in POINTS_M]
        naive = fit_runs(runs, "linear")
        found = maximise(runs, "linear", naive.speed_m_s, naive.theta)
        assert naive.naive_covariance is not None
        return np.concatenate(
            [
                found.theta[:6],
                np.sqrt(np.diag(found.covariance)[:6]),
                naive.six,
                np.sqrt(np.diag(naive.naive_covariance)),
                np.sqrt(np.diag(naive.covariance)),
                np.exp(found.noise),
            ]
        )

    from identify_bound import coloured_bound

    rows = collect("coloured", 3, options.seeds, options.store, one)
    heading(
        f"coloured force: {len(rows)} campaigns, 0.02 N and 0.02 N m on the hull, 0.5 s; Kalman filter's prediction errors"
    )
    table(rows, coloured_bound())
    say("force N, moment N m, time s, scales y, beta: mean", rows[:, 30:].mean(axis=0))
    print("output error on the same records, naive covariance (residuals taken as white):")
    table(rows[:, 12:24], None)
    print("output error with its autoregression:")
    table(np.column_stack([rows[:, 12:18], rows[:, 24:30]]), None)


def oscillation(options: argparse.Namespace) -> None:
    t = times()
    kept = t >= 20.0
    print(
        f"\n== first 20 s removed from a single run: {options.seeds} seeds each, biases free\n"
        "intervals of what is given: Y_v, N_r (alone where given), Y_R + a m', N_v - b I'"
    )
    print(
        f"{'tow point':12}{'refused: m, I, Y_R, N_v':>26}{'combinations given':>20}{'in 95 %':>10}{'z std':>8}   run proposed"
    )
    for point in POINTS_M:
        still = still_run(point, t, "modal", priors=Priors())
        cut = {n: getattr(still, n)[kept] for n in ("t_s", "y_m", "beta_rad", "covariance")}
        still = replace(still, common=np.zeros((0, int(kept.sum()), 2)), **cut)
        refused = given = 0
        scores: list[float] = []
        factors, words = [], Counter()
        for seed in range(options.seeds):
            run = noisy(still, np.random.default_rng([4, seed]))
            found = examined(fit_runs([run], "linear"), [run])
            parts = found.parts
            refused += set(parts.refused) >= {0, 1, 3, 4}
            single = [
                ((found.fit.six[i] - SIX[i]) / np.sqrt(found.covariance[i, i])) for i in parts.single if i in (2, 5)
            ]
            joined = [(c.value - c.coefficients @ SIX) / c.sd for c in parts.combinations]
            scores += single + joined
            given += len(joined) >= 2
            by = {c.leading: c.coefficients for c in parts.combinations}
            if 3 in by and 4 in by:
                factors.append([by[3][0], by[4][1]])
            if seed < 20:
                proposed = cure(found.fit, found.fit.six, found.covariance, [run])
                words[f"{proposed[0].move_m:+.1f} m" if proposed else "none"] += 1
        z = np.array(scores)
        print(
            f"{point:<12.3f}{refused:>20} of {options.seeds}{given:>20}{100 * (np.abs(z) < 1.96).mean():10.1f}{z.std():8.2f}   "
            f"{np.mean(factors, axis=0).round(3)}; {dict(words)}",
            flush=True,
        )


def large(options: argparse.Namespace) -> None:
    t = times()
    still = [
        still_run(x, t, "full", Start(alpha_rad=float(a))) for x, a in zip(POINTS_M, LARGE_STARTS_RAD, strict=True)
    ]
    spent: list[float] = []

    def one(rng: np.random.Generator) -> Row:
        runs = campaign(still, rng)
        began = time.perf_counter()
        fit = fit_runs(runs, "full")
        spent.append(time.perf_counter() - began)
        return row(fit)

    rows = collect("large", 5, 50, None, one)
    heading(f"large swings: {len(rows)} seeds, alpha to 48-50 degrees, full form")
    table(rows, None)
    print(f"time of a joint fit of four runs: median {np.median(spent):.2f} s, longest {max(spent):.2f} s")
    linear = [fit_runs(campaign(still, np.random.default_rng([5, k])), "linear").six for k in range(10)]
    say("linear form on the same records: bias, %", 100 * (np.mean(linear, axis=0) / SIX - 1))


def speed(options: argparse.Namespace) -> None:
    from identify_peers import peers

    t = times()
    still = [still_run(x, t) for x in POINTS_M]
    runs = campaign(still, np.random.default_rng([6, 0]))
    fit_runs(runs, "linear")
    print("\n== speed: joint fit of four runs, 3840 samples each, from the same data, one core")
    ours, fit = {}, None
    for form in ("linear", "full"):
        spans = []
        for _ in range(7):
            began = time.perf_counter()
            fit = fit_runs(runs, form)
            spans.append(time.perf_counter() - began)
        ours[form] = float(np.median(spans))
        print(f"towline, {form} form: {ours[form]:.3f} s (no guess asked for)")
    assert fit is not None
    wanted = fit_runs(runs, "linear")
    for name, call in peers():
        began = time.perf_counter()
        six = call(runs)
        spent = time.perf_counter() - began
        far = np.abs((six - wanted.six) / np.sqrt(np.diag(wanted.covariance))).max()
        print(
            f"{name}: {spent:.1f} s, {spent / ours['linear']:.0f} times the linear form's time; "
            f"largest distance from towline's optimum {far:.2g} sd, largest error {100 * np.abs(six / SIX - 1).max():.2g} %",
            flush=True,
        )


PARTS = {
    "speed": speed,
    "efficiency": efficiency,
    "nuisance": nuisance,
    "coloured": coloured,
    "oscillation": oscillation,
    "large": large,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=tuple(PARTS), default=tuple(PARTS))
    parser.add_argument("--campaigns", type=int, default=2000)
    parser.add_argument("--seeds", type=int, default=200, help="campaigns of the slower parts")
    parser.add_argument("--store", type=Path, help="folder that keeps what is done")
    options = parser.parse_args()
    for name in options.only:
        PARTS[name](options)


if __name__ == "__main__":
    main()
