"""Peers of the laws' benchmark, by libraries of others: run by an interpreter that has them (``laws_peers.py`` calls it).

    python benchmarks/laws_peers_fit.py TABLES.npz ANSWER.json

Knows nothing of towline. TABLES.npz has the measured y and beta of a campaign's tows with their noise, the tow's numbers and the
line's true tension, and the states at which the missing force is asked. ANSWER.json: method -> side force and moment there by
rho/2 U^2 L^2 (L^3), the variables it goes with, its text, seconds; or why not.
"""

from __future__ import annotations

import json
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.interpolate import make_smoothing_spline

NAMES = ("v", "r", "y", "beta")
BAGS, INCLUDED = 40, 0.6
"""Of the ensemble: models, and the share of them that a term must be in (Fasel et al. 2022)."""
ENDS = 8
"""Means at either end of a run that are left out: a spline's rates are worst there."""
SEED = 0


def functions() -> list[tuple[str, Callable[..., np.ndarray]]]:
    """The library that sparse regression picks from: what the grammar's plain terms are, in columns of v, r, y, beta."""
    one = [("1", lambda v, r, y, b: 1.0 + 0 * v), ("v", lambda v, r, y, b: v), ("r", lambda v, r, y, b: r)]
    for k, x in enumerate(NAMES):
        one += [
            (f"{x}|{x}|", lambda *s, k=k: s[k] * np.abs(s[k])),
            (f"{x}^3", lambda *s, k=k: s[k] ** 3),
            (f"|{x}|", lambda *s, k=k: np.abs(s[k])),
            (f"{x}^2", lambda *s, k=k: s[k] ** 2),
        ]
    one += [
        ("y", lambda v, r, y, b: y), ("beta", lambda v, r, y, b: b), ("v|r|", lambda v, r, y, b: v * np.abs(r)),
        ("|v|r", lambda v, r, y, b: np.abs(v) * r), ("v y^2", lambda v, r, y, b: v * y**2),
        ("r y^2", lambda v, r, y, b: r * y**2), ("sign v", lambda v, r, y, b: np.tanh(v / 0.003)),
        ("sign r", lambda v, r, y, b: np.tanh(r / 0.005)),
    ]  # fmt: skip
    for k in (5.0, 10.0, 20.0):
        one += [
            (f"sin({k:g} y)", lambda v, r, y, b, k=k: np.sin(k * y)),
            (f"cos({k:g} y)", lambda v, r, y, b, k=k: np.cos(k * y)),
        ]
        one += [
            (f"sin({k:g} beta)", lambda v, r, y, b, k=k: np.sin(k * b)),
            (f"cos({k:g} beta)", lambda v, r, y, b, k=k: np.cos(k * b)),
        ]
    return one


def smoothed(d: dict) -> dict[str, np.ndarray]:
    """(runs, n): states, dimensionless, their rates, and the line's force; by smoothing splines (generalised cross-validation)."""
    found: dict[str, list[np.ndarray]] = {}
    for y, beta, pull, u, line, x_t in zip(
        d["y"], d["beta"], d["tension"], d["speed"], d["line"], d["x_t"], strict=True
    ):
        t = d["t"]
        a, b = make_smoothing_spline(t, y), make_smoothing_spline(t, beta)
        place, heading, rate = a(t), b(t), b(t, nu=1)
        # the line keeps its length, which says how the model surges
        alpha = np.arcsin(np.clip((place + x_t * np.sin(heading)) / line, -1, 1))
        aside, turn = a(t, nu=1), (a(t, nu=1) + x_t * np.cos(heading) * rate) / (line * np.cos(alpha))
        ahead = u + line * np.sin(alpha) * turn + x_t * np.sin(heading) * rate
        drift, along = (
            aside * np.cos(heading) - ahead * np.sin(heading),
            aside * np.sin(heading) + ahead * np.cos(heading),
        )
        gain = make_smoothing_spline(t, drift)(t, nu=1)
        by, faster = d["length"] / u, along / u
        side = -pull * np.sin(alpha + heading)
        whole = 0.5 * d["density"] * u**2 * d["length"] ** 2
        values = {
            "v": drift / u, "r": rate * d["length"] / u, "y": place / d["half_width"], "beta": heading,
            "v_rate": gain * by / u, "r_rate": b(t, nu=2) * by**2, "v_damped": drift / u * faster,
            "r_damped": rate * by * faster, "Y": side / whole, "N": side * x_t / whole / d["length"],
        }  # fmt: skip
        for name, value in values.items():
            found.setdefault(name, []).append(value)
    return {name: np.array(rows)[:, ENDS:-ENDS] for name, rows in found.items()}


def residual(s: dict[str, np.ndarray], which: str) -> tuple[np.ndarray, np.ndarray]:
    """Features (n, 4) and what is left of the line's force by mass, damping and a constant: minus the missing force."""
    rate = s["v_rate" if which == "Y" else "r_rate"].ravel()
    table = np.column_stack([rate, s["v_damped"].ravel(), s["r_damped"].ravel(), np.ones(rate.size)])
    target = s[which].ravel()
    left = target - table @ np.linalg.lstsq(table, target, rcond=None)[0]
    return np.column_stack([s[n].ravel() for n in NAMES]), -left


def weak_sindy(d: dict, s: dict[str, np.ndarray], asked: np.ndarray) -> dict:
    """pysindy: weak form (integrals against test functions, no acceleration), an ensemble of STLSQ, its threshold by BIC."""
    import pysindy as ps

    terms = functions()
    count, t = len(terms), d["t"][ENDS:-ENDS]
    force, text, variables = [], [], set()
    for which, state in (("Y", "v"), ("N", "r")):
        columns = np.stack([f(*(s[n] for n in NAMES)) for _, f in terms], axis=2)  # (runs, n, terms)
        columns = np.concatenate([columns, s[which][..., None]], axis=2)
        size = columns.reshape(-1, count + 1).std(axis=0)
        size[size == 0] = 1.0
        rows, lefts = [], []
        for run in range(len(columns)):
            library = ps.WeakPDELibrary(
                function_library=ps.PolynomialLibrary(degree=1, include_bias=False),
                spatiotemporal_grid=t,
                K=150,
                H_xt=[2.5],
            )
            x = np.column_stack([s[state][run], columns[run] / size])
            library.fit([ps.AxesArray(x, {"ax_time": 0, "ax_coord": 1})])
            rows.append(np.asarray(library.transform([ps.AxesArray(x, {"ax_time": 0, "ax_coord": 1})])[0])[:, 1:])
            lefts.append(
                np.asarray(library.convert_u_dot_integral(ps.AxesArray(x[:, :1], {"ax_time": 0, "ax_coord": 1})))[:, :1]
            )
        table, left = np.concatenate(rows), np.concatenate(lefts)
        rng = np.random.default_rng(SEED)
        best = None
        for threshold in np.abs(left).std() * np.array([0.003, 0.01, 0.03, 0.1, 0.3]):
            kept = []
            for _ in range(BAGS):
                some = rng.integers(0, len(table), len(table))
                optimizer = ps.STLSQ(threshold=threshold / max(np.abs(table).std(), 1e-12) / 10, alpha=1e-6)
                optimizer.fit(table[some], left[some])
                kept.append(np.asarray(optimizer.coef_)[0])
            inside = np.mean([np.abs(k) > 0 for k in kept], axis=0) >= INCLUDED
            inside[[1, 2, count]] = True  # damping and the line's force are known to be there
            fit = np.zeros(count + 1)
            fit[inside] = np.linalg.lstsq(table[:, inside], left[:, 0], rcond=None)[0]
            rest = float(np.sum((left[:, 0] - table @ fit) ** 2))
            bic = len(left) * np.log(rest / len(left)) + inside.sum() * np.log(len(left))
            if best is None or bic < best[0]:
                best = (bic, fit / size, inside)
        assert best is not None
        _, fit, inside = best
        mass = 1.0 / fit[count] if fit[count] else 0.0
        there = [k for k in range(count) if inside[k] and k not in (1, 2)]
        force.append(sum((mass * fit[k] * terms[k][1](*asked) for k in there), np.zeros(asked.shape[1])))
        text.append(f"{which}: " + " + ".join(f"{mass * fit[k]:.3g} {terms[k][0]}" for k in there))
        for k in there:
            variables |= {x for x in NAMES if re.search(rf"(?<![a-z]){x}(?![a-z])", terms[k][0])}
    return {"force": [f.tolist() for f in force], "variables": sorted(variables), "text": "; ".join(text)}


def process(d: dict, s: dict[str, np.ndarray], asked: np.ndarray) -> dict:
    """scikit-learn: a Gaussian process on residual accelerations, with a length of its own for each variable."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    force = []
    for which in ("Y", "N"):
        x, left = residual(s, which)
        size, height = x.std(axis=0), max(left.std(), 1e-12)
        kernel = ConstantKernel(0.5) * RBF(np.ones(4), (0.05, 1e3)) + WhiteKernel(0.5)
        fitted = GaussianProcessRegressor(kernel, n_restarts_optimizer=1, random_state=SEED).fit(
            x / size, left / height
        )
        force.append(fitted.predict(asked.T / size) * height)
    return {"force": [f.tolist() for f in force], "variables": None, "text": "a function of v, r, y, beta"}


def symbolic(d: dict, s: dict[str, np.ndarray], asked: np.ndarray) -> dict:
    """pyoperon: symbolic regression on residual accelerations; of its front the one of the least description length."""
    from pyoperon.sklearn import SymbolicRegressor

    force, text, variables = [], [], set()
    for which in ("Y", "N"):
        x, left = residual(s, which)
        size, height = x.std(axis=0), max(left.std(), 1e-12)
        fitted = SymbolicRegressor(
            allowed_symbols="add,sub,mul,abs,square,sqrt,tanh,sin,constant,variable", generations=200, population_size=500,
            max_length=20, optimizer_iterations=3, n_threads=1, random_state=SEED, max_evaluations=200000,
            objectives=["r2", "length"], model_selection_criterion="minimum_description_length",
        )  # fmt: skip
        fitted.fit(x / size, left / height)
        force.append(np.broadcast_to(np.ravel(fitted.predict(asked.T / size)), asked.shape[1:]) * height)
        said = fitted.get_model_string(fitted.model_, 3)
        text.append(f"{which}: {said}")
        variables |= {NAMES[int(k) - 1] for k in re.findall(r"X([1-4])", said)}
    return {"force": [f.tolist() for f in force], "variables": sorted(variables), "text": "; ".join(text)}


METHODS = {"pysindy": weak_sindy, "GP": process, "pyoperon": symbolic}


def main() -> None:
    """Every method's answer."""
    tables = dict(np.load(sys.argv[1]))
    states, asked = smoothed(tables), tables["asked"]
    answers = {}
    for name, method in METHODS.items():
        began = time.monotonic()
        try:
            answers[name] = method(tables, states, asked) | {"seconds": time.monotonic() - began}
        except Exception as error:  # a library that is not there, or changed: said in the table
            answers[name] = {"why": f"{type(error).__name__}: {error}"}
    Path(sys.argv[2]).write_text(json.dumps(answers))


if __name__ == "__main__":
    main()
