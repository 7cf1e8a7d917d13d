"""The gap of any simulator, scored on sealed cases: five systems with an effect, with it left out of the library, and complete.

    python benchmarks/any_simulator.py --kept FILE.jsonl --python PEERS/bin/python [--seed 1] > benchmarks/any_simulator.txt

The truth is made by ``truth`` below with scipy's solve_ivp; it shares no code with the engine. Beside it in the table, on the
same records: scipy's least squares of the model and of the model with each effect, the one of the smallest BIC named (eight steps
at most, begun at the truth); and sparse regression (pysindy, by an interpreter of its own). D is twice the log likelihood that
the true model has over the best of what is left without its effect: of the model as it is, and, where the effect is left out of
the library, of the model with any other effect of the case, too, of which the two best are fitted to their end, and with what the
engine answers. Cases of D below 20 are not scored: no method could tell. One counts as named where it is the headline or is told
as not to be distinguished from it. What is done stands in the file of --kept, and is not done again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from towline.diagnose.own import Input, Model, Number, Output, State
from towline.diagnose.own.gap import own_gap
from towline.diagnose.own.records import Record, SampleNoise, together

LEAST_D = 20.0
STEP = 1e-3
"""Of the differences of least squares: with a tenth of it the integrator's own errors, at its tolerance of 1e-6, end fits early."""
BIC_STEPS, LAST_STEPS, NEAREST = 8, 100, 2
"""Steps of a fit for BIC; of the nearest fits that tell how far an effect that is left out is from all others."""
LONGEST_S = 120
"""Sparse regression may take so long."""
TURN = 0.01
"""Dry friction turns within this share of the usual speed."""
FAR = 1e4
"""A state beyond this has run off: the integrator would go on in steps of nothing."""
Array = np.ndarray


@dataclass(frozen=True)
class Case:
    """A system.

    Attributes
    ----------
    name : of it
    model : what the engine is given
    plain : (x, u, p) -> rates, for the truth: its own code
    numbers : truth of the model's numbers, and a share by which they scatter from case to case
    starts : of each record
    step_s, count : of the samples
    drive : (rng, t) -> input, or None
    equation, place, speed : state whose equation an effect acts in, its integral or "", its usual size
    outputs : columns of the state that are measured
    noise : sd of each
    effects : name of the engine -> (kind, usual size); kinds are of ``truth``
    """

    name: str
    model: Model
    plain: Callable[[Array, float, Array], list[float]]
    numbers: tuple[float, ...]
    starts: tuple[tuple[float, ...], ...]
    step_s: float
    count: int
    drive: Callable[[np.random.Generator, Array], Array] | None
    equation: int
    place: int | None
    speed: float
    outputs: tuple[int, ...]
    noise: tuple[float, ...]
    effects: dict[str, tuple[str, float]]
    give: float = 0.0
    """How far bristles give before they slide."""


FORCES: dict[str, Callable[[float, float, float], float]] = {
    "constant": lambda v, y, v0: -1.0,
    "dry": lambda v, y, v0: float(np.tanh(v / v0)),
    "quadratic": lambda v, y, v0: v * abs(v),
    "cubic": lambda v, y, v0: v**3,
    "cubic_stiffness": lambda v, y, v0: y**3,
    "above": lambda v, y, v0: max(y, 0.0),
    "below": lambda v, y, v0: min(y, 0.0),
    "bristles": lambda v, y, v0: 0.0,
}
"""Kind -> what a rate loses by a unit of it, of the rate's own state, its integral and the speed at which dry friction turns."""


def truth(case: Case, p: Array, start: Array, drive: Array, largest: float, sizes: dict[str, float]) -> Array:
    """Outputs (n, c), by solve_ivp, with effects kind -> size; ``largest``: of the drives of all records."""
    t = np.arange(case.count) * case.step_s
    index, place, v0 = case.equation, case.place, TURN * case.speed
    fine = np.linspace(0, t[-1], 8 * (case.count - 1) + 1)
    u_fine = np.interp(fine, t, drive)
    if "saturation" in sizes:
        most = largest - sizes["saturation"]
        u_fine = np.clip(u_fine, -most, most)
    if "backlash" in sizes:
        now, out, half = u_fine[0], [], sizes["backlash"] / 2
        for value in u_fine:
            now = min(max(now, value - half), value + half)
            out.append(now)
        u_fine = np.array(out)
    u_fine = u_fine * (1 + sizes.get("input_scale", 0.0)) + sizes.get("input_offset", 0.0)
    late = sizes.get("delay", 0.0)
    lag = max(sizes.get("lag", 0.0), 0.0)
    lag = lag if lag > 1e-6 else 0.0
    forces = [(kind, size) for kind, size in sizes.items() if kind in FORCES]

    levels, last = u_fine.tolist(), float(len(u_fine) - 1)

    def rates(time: float, state: Array) -> list[float]:
        x = state[: len(start)]
        if not np.abs(x).max() < FAR:
            raise OverflowError("it has run off")
        u = 0.0
        if case.drive is not None:
            at = min(max((time - late) / fine[1], 0.0), last)
            before = min(int(at), len(levels) - 2)
            u = levels[before] + (at - before) * (levels[before + 1] - levels[before])
        found = list(case.plain(x, state[len(start)] if lag else u, p))
        more = [(u - state[len(start)]) / lag] if lag else []
        v, y = x[index], x[place] if place is not None else 0.0
        for kind, size in forces:
            if kind == "bristles":
                # LuGre's z in its own units: half as much again at rest, no sigma_1
                z, sigma = state[-1], 1.5 * abs(size) / case.give
                grip = abs(size) * (1 + 0.5 * np.exp(-((v / (0.1 * case.speed)) ** 2)))
                more.append(v - sigma * abs(v) * z / max(grip, 1e-12))
                found[index] -= np.sign(size) * sigma * z
            else:
                found[index] -= size * FORCES[kind](v, y, v0)
        return [*found, *more]

    at = t * (1 + sizes.get("clock", 0.0))
    first = [*start, *([drive[0]] if lag else []), *([0.0] if "bristles" in sizes else [])]
    try:
        solved = solve_ivp(
            rates, (0, at[-1]), first, t_eval=at, method="LSODA", rtol=1e-6, atol=1e-9, max_step=4 * case.step_s
        )
        y = solved.y[list(case.outputs)].T
    except OverflowError:
        y = np.zeros((0, len(case.outputs)))
    if len(y) < case.count:
        return np.full((case.count, len(case.outputs)), 1e3)
    y[:, -1] = y[:, -1] * (1 + sizes.get("scale", 0.0)) + sizes.get("offset", 0.0) + sizes.get("drift", 0.0) * t / t[-1]
    return y


def chirp(size: float, slow: float, fast: float) -> Callable[[np.random.Generator, Array], Array]:
    """A sweep with steps in it."""

    def made(rng: np.random.Generator, t: Array) -> Array:
        phase = 2 * np.pi * (slow * t + 0.5 * (fast - slow) * t**2 / t[-1]) + rng.uniform(0, 6)
        steps = rng.uniform(-0.5, 0.5, 6)[np.minimum((6 * t / t[-1]).astype(int), 5)]
        return size * (0.7 * np.sin(phase) + steps)

    return made


def _pumped(rng: np.random.Generator, t: Array) -> Array:
    return rng.uniform(0.3, 1.6, 10)[np.minimum((10 * t / t[-1]).astype(int), 9)]


def cases() -> list[Case]:
    """The five."""
    swing = Model(
        [State("angle", "rad"), State("rate", "rad/s", equation="pendulum")],
        [], [Number("w2", "1/s2", 40.0, least=0.0), Number("c", "1/s", 0.2, least=0.0)], [Output("angle", "rad", "encoder")],
        lambda t, x, u, p: (x.rate, -p.w2 * np.sin(x.angle) - p.c * x.rate),
    )  # fmt: skip
    drive = Model(
        [State("speed", "rad/s", equation="drive")],
        [Input("volt", "V", "amplifier")],
        [Number("b", "1/s", 2.0, least=0.0), Number("f", "rad/s2", 5.0, least=0.0), Number("k", "rad/(s2 V)", 20.0)],
        [Output("speed", "rad/s", "tachometer")],
        lambda t, x, u, p: (-p.b * x.speed - p.f * np.tanh(x.speed / (TURN * 20)) + p.k * u.volt,),
    )
    duffing = Model(
        [State("x", "V"), State("v", "V/s", equation="oscillator")],
        [Input("u", "V", "source")],
        [Number("k", "1/s2", 30.0, least=0.0), Number("c", "1/s", 0.5, least=0.0), Number("k3", "1/(V2 s2)", 20.0)],
        [Output("x", "V", "voltmeter")],
        lambda t, x, u, p: (x.v, -p.k * x.x - p.c * x.v - p.k3 * x.x**3 + u.u),
    )
    tanks = Model(
        [State("h1", "m", 0.3, equation="upper tank"), State("h2", "m", 0.3, equation="lower tank")],
        [Input("pump", "", "pump")],
        [
            Number("q", "m/s", 0.008, least=0.0),
            Number("a1", "m^0.5/s", 0.02, least=0.0),
            Number("a2", "m^0.5/s", 0.02, least=0.0),
        ],
        [Output("h1", "m", "gauge 1"), Output("h2", "m", "gauge 2")],
        lambda t, x, u, p: (
            p.q * u.pump - p.a1 * np.sqrt(np.maximum(x.h1, 1e-9)),
            p.a1 * np.sqrt(np.maximum(x.h1, 1e-9)) - p.a2 * np.sqrt(np.maximum(x.h2, 1e-9)),
        ),
    )
    yaw = Model(
        [State("heading", "rad"), State("turn", "rad/s", equation="yaw balance")],
        [Input("rudder", "rad", "steering gear")],
        [Number("inverse_t", "1/s", 0.08, least=0.0), Number("k", "1/s2", 0.008)],
        [Output("heading", "rad", "compass")],
        lambda t, x, u, p: (x.turn, -p.inverse_t * x.turn + p.k * u.rudder),
    )
    return [
        Case("pendulum", swing, lambda x, u, p: [x[1], -p[0] * np.sin(x[0]) - p[1] * x[1]], (55.0, 0.15),
             ((0.6, 0.0), (1.3, 0.0)), 0.04, 200, None, 1, 0, 8.0, (0,), (0.004,),
             {"rate_dry_friction": ("dry", 0.3), "rate_quadratic_damping": ("quadratic", 0.02),
              "rate_cubic_stiffness": ("cubic_stiffness", 2.0),
              "rate_stiffness_above": ("above", 1.0), "angle_offset": ("offset", 0.02), "angle_drift": ("drift", 0.03),
              "rate_lugre_friction": ("bristles", 0.3)}, give=0.05),
        Case("drive", drive, lambda x, u, p: [-p[0] * x[0] - p[1] * np.tanh(x[0] / (TURN * 20)) + p[2] * u], (1.5, 6.0, 25.0),
             ((0.0,), (5.0,)), 0.02, 200, chirp(2.0, 0.2, 1.5), 0, None, 20.0, (0,), (0.1,),
             {"speed_quadratic_damping": ("quadratic", 0.03), "volt_backlash": ("backlash", 0.3), "volt_delay": ("delay", 0.02),
              "volt_lag": ("lag", 0.03), "volt_saturation": ("saturation", 0.7), "speed_cubic_damping": ("cubic", 0.001)}),
        Case("Duffing", duffing, lambda x, u, p: [x[1], -p[0] * x[0] - p[1] * x[1] - p[2] * x[0] ** 3 + u], (36.0, 0.4, 25.0),
             ((0.5, 0.0), (-0.3, 0.0)), 0.04, 200, chirp(12.0, 0.3, 1.8), 1, 0, 4.0, (0,), (0.004,),
             {"v_dry_friction": ("dry", 0.5), "v_quadratic_damping": ("quadratic", 0.06), "v_stiffness_above": ("above", 3.0),
              "u_delay": ("delay", 0.02), "u_lag": ("lag", 0.03), "x_offset": ("offset", 0.02),
              "v_lugre_friction": ("bristles", 0.5)}, give=0.03),
        Case("two tanks", tanks,
             lambda x, u, p: [p[0] * u - p[1] * np.sqrt(max(x[0], 1e-9)),
                              p[1] * np.sqrt(max(x[0], 1e-9)) - p[2] * np.sqrt(max(x[1], 1e-9))], (0.01, 0.018, 0.017),
             ((0.25, 0.2), (0.4, 0.5)), 3.0, 200, _pumped, 1, None, 0.4, (0, 1), (0.002, 0.002),
             {"h2_constant": ("constant", -0.001), "pump_lag": ("lag", 8.0), "pump_delay": ("delay", 5.0),
              "h2_offset": ("offset", 0.02),
              "h2_scale": ("scale", 0.05), "pump_saturation": ("saturation", 0.4)}),
        Case("ship yaw", yaw, lambda x, u, p: [x[1], -p[0] * x[1] + p[1] * u], (0.06, 0.006),
             ((0.0, 0.0), (0.1, 0.01)), 1.5, 200, chirp(0.5, 0.005, 0.04), 1, 0, 0.03, (0,), (0.003,),
             {"turn_cubic_damping": ("cubic", 15.0), "turn_quadratic_damping": ("quadratic", 0.5), "rudder_lag": ("lag", 3.0),
              "rudder_backlash": ("backlash", 0.06), "rudder_saturation": ("saturation", 0.15),
              "rudder_offset": ("input_offset", 0.03)}),
    ]  # fmt: skip


TWINS = {"rudder_offset": ("turn_constant", "heading_drift"), "h2_scale": ("h1_scale",)}
"""What effects do alike to the model, whatever the records: k (u + b) = k u + k b, which turns a linear ship at k b/a all the time,
as a drift of its compass does; sqrt(h), twice, takes up either scale."""


def left_out(case: Case, effect: str) -> list[str]:
    """Names that are not offered: the effect's, and those that do the same to these records in all but name."""
    if effect in TWINS:
        return [effect, *TWINS[effect]]
    if effect.endswith("_friction"):
        return [
            effect.replace("_dry_", f"_{kind}_").replace("_lugre_", f"_{kind}_") for kind in ("dry", "static", "lugre")
        ]
    if effect.endswith(("_lag", "_delay")):
        names = [*(i.name for i in case.model.inputs), *(o.name for o in case.model.outputs)]
        return ["clock_offset", *(f"{name}_{what}" for name in names for what in ("lag", "delay"))]
    if effect.endswith("_stiffness_above"):
        # beside a free stiffness on both sides one on the other side is the same
        return [effect, effect.replace("above", "below")]
    return [effect]


@dataclass(frozen=True)
class Made:
    """A sealed case: its records, and what is true."""

    case: Case
    p: Array
    starts: list[Array]
    drives: list[Array]
    values: list[Array]
    effect: str
    size: float

    @property
    def sizes(self) -> dict[str, float]:
        """Kind -> size of what is missing."""
        return {self.case.effects[self.effect][0]: self.size} if self.effect else {}

    @property
    def largest(self) -> float:
        """Of the drives."""
        return _largest(self.drives)


def _largest(drives: list[Array]) -> float:
    return max(float(np.abs(drive).max()) for drive in drives)


def drawn(case: Case, effect: str, rng: np.random.Generator) -> Made:
    """One."""
    p = np.array(case.numbers) * rng.uniform(0.8, 1.25, len(case.numbers))
    t = np.arange(case.count) * case.step_s
    drives = [np.zeros(case.count) if case.drive is None else case.drive(rng, t) for _ in case.starts]
    kind, usual = case.effects[effect] if effect else ("", 0.0)
    size = usual * rng.uniform(0.6, 1.6)
    values, starts = [], []
    for start, drive in zip(case.starts, drives, strict=True):
        begin = np.array(start) * rng.uniform(0.8, 1.2)
        starts.append(begin)
        clean = truth(case, p, begin, drive, _largest(drives), {kind: size} if kind else {})
        values.append(clean + np.array(case.noise) * rng.normal(size=clean.shape))
    return Made(case, p, starts, drives, values, effect, size)


def fitted(made: Made, usual: dict[str, float], steps: int = BIC_STEPS, begun: float = 0.3) -> tuple[float, int]:
    """Chi-square and numbers of scipy's least squares with effects (kind -> usual size), begun at the truth's numbers and sizes; at
    a share of the usual ones of what is not there."""
    case = made.case
    q, states, kinds = len(made.p), len(case.starts[0]), list(usual)
    scale = np.array([usual[kind] for kind in kinds])

    def residuals(z: Array) -> Array:
        found, sizes = [], dict(zip(kinds, (z[len(z) - len(kinds) :] * scale).tolist(), strict=True))
        for k, (drive, values) in enumerate(zip(made.drives, made.values, strict=True)):
            begin = z[q + states * k : q + states * (k + 1)] * (np.abs(case.starts[k]) + 0.1 * case.speed)
            clean = truth(case, z[:q] * np.array(case.numbers), begin, drive, made.largest, sizes)
            found.append(((values - clean) / np.array(case.noise)).ravel())
        return np.nan_to_num(np.concatenate(found), nan=1e3)

    begin = [s / (np.abs(given) + 0.1 * case.speed) for s, given in zip(made.starts, case.starts, strict=True)]
    first = [made.sizes[kind] / usual[kind] if kind in made.sizes else begun for kind in kinds]
    z = np.concatenate([made.p / np.array(case.numbers), *begin, first])
    found = least_squares(residuals, z, diff_step=STEP, max_nfev=steps, x_scale="jac")
    return 2 * float(found.cost), len(z)


def usual_of(case: Case, effect: str) -> dict[str, float]:
    """Kind -> usual size of an effect; "": the model as it is."""
    return dict([case.effects[effect]]) if effect else {}


def told_by(case: Case, file: Any) -> dict[str, float] | None:
    """Kind -> size of what the engine answers; None where ``truth`` cannot make it."""
    name, found = case.model.states[case.equation].name, {}
    endings = {"dry_friction": "dry", "static_friction": "dry", "lugre_friction": "bristles", "constant": "constant"}
    endings |= {"quadratic_damping": "quadratic", "cubic_damping": "cubic", "cubic_stiffness": "cubic_stiffness"}
    endings |= {"stiffness_above": "above", "stiffness_below": "below"}
    known = {f"{name}_{ending}": kind for ending, kind in endings.items()}
    known |= {effect: kind for effect, (kind, _) in case.effects.items()}
    row = file.ranking[0]
    for effect in row.effects:
        if effect not in known or (known[effect] == "bristles" and not case.give):
            return None
        size = next(v.value for key, v in row.parameters.items() if key.startswith(f"{effect}."))
        found[known[effect]] = float(size) or 1e-6
    return found


def by_bic(made: Made, offered: list[str]) -> tuple[str, dict[str, float]]:
    """Name of the smallest BIC ("" : the model as it is), and every chi-square."""
    count = sum(v.size for v in made.values)
    best, name, chi = np.inf, "", {}
    for effect in ["", *offered]:
        chi[effect], numbers = fitted(made, usual_of(made.case, effect))
        bic = chi[effect] + numbers * np.log(count)
        if bic < best:
            best, name = bic, effect
    return name, chi


def record_of(case: Case, name: str, drive: Array, values: Array) -> Record:
    """As the engine has it."""
    inputs = drive[:, None] if case.drive is not None else np.zeros((case.count, 0))
    noises = tuple(SampleNoise(s) for s in case.noise)
    return Record(name, case.step_s, inputs, values, noises, (False,) if case.drive is not None else ())


def answered(made: Made, without: list[str]) -> Any:
    """The engine's gap.json."""
    case = made.case
    records = [
        record_of(case, f"record {k + 1}", drive, values)
        for k, (drive, values) in enumerate(zip(made.drives, made.values, strict=True))
    ]
    return own_gap(case.model, together(records), "benchmark", {}, rng=np.random.default_rng(0), without=without).file


def by_sparse(made: Made, python: str) -> str:
    """Terms that sparse regression takes beside the model's own, joined by " + " ("": none), by an interpreter of its own."""
    case = made.case
    others = [v[:, 0] if v.shape[1] > 1 else np.full(len(v), np.nan) for v in made.values]
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "case.npz", Path(folder) / "found.json"
        np.savez(
            given,
            system=case.name,
            t=np.arange(case.count) * case.step_s,
            x=[v[:, -1] for v in made.values],
            x2=others,
            u=made.drives,
            speed=case.speed,
        )
        script = Path(__file__).with_name("any_simulator_sparse.py")
        subprocess.run([python, "-W", "ignore", str(script), str(given), str(found)], check=True, timeout=LONGEST_S)
        return " + ".join(json.loads(found.read_text()))


def judged(case: Case, kind: str, effect: str, seed: list[int], bic: bool, python: str) -> dict[str, Any]:
    """One case by all methods."""
    names = list(case.effects)
    made = drawn(case, effect, np.random.default_rng(seed))
    gone = left_out(case, effect) if kind == "left out" else []
    began = monotonic()
    file = answered(made, gone)
    took = monotonic() - began
    named = " + ".join(file.ranking[0].effects) if file.verdict in ("effect", "form_not_exact") else file.verdict
    named = f"about {named}" if file.verdict == "form_not_exact" else named
    alike = [n for group in file.indistinguishable for n in group]
    right = {
        "effect": file.verdict in ("effect", "form_not_exact") and effect in (*file.ranking[0].effects, *alike),
        "left out": file.verdict == "unknown",
        "complete": file.verdict == "no_gap",
    }[kind]
    row: dict[str, Any] = {
        "system": case.name,
        "kind": kind,
        "effect": effect,
        "named": named,
        "right": right,
        "took": took,
    }
    if bic:
        chosen, chi = by_bic(made, [n for n in names if n not in gone])
        own = chi[effect] if effect in chi else fitted(made, usual_of(case, effect))[0]
        others = [chi[""]]
        if kind == "left out":
            near = sorted(chi, key=lambda name: chi[name])[:NEAREST]
            usual = [usual_of(case, name) for name in near]
            told = told_by(case, file) if file.verdict in ("effect", "form_not_exact") else None
            others = [fitted(made, one, LAST_STEPS)[0] for one in usual]
            others += [] if told is None else [fitted(made, told, LAST_STEPS, 1.0)[0]]
            others += [c for name, c in chi.items() if name not in near]
        right = {"effect": chosen == effect, "left out": False, "complete": chosen == ""}[kind]
        row |= {"d": min(others) - own, "bic": chosen, "bic_right": right}
    if python:
        terms = by_sparse(made, python)
        row |= {"sparse": terms, "sparse_right": terms == effect if kind != "left out" else False}
    return row


def main() -> None:
    """All cases, a line each, and the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--effects", type=int, default=4)
    parser.add_argument("--left-out", type=int, default=4)
    parser.add_argument("--complete", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--systems", nargs="+", default=[])
    parser.add_argument("--no-bic", action="store_true")
    parser.add_argument("--python", default="", help="an interpreter that has pysindy")
    parser.add_argument(
        "--kept", type=Path, help="what is done, a line a case; a score that was cut short goes on from it"
    )
    given = parser.parse_args()
    lines = given.kept.read_text().splitlines() if given.kept is not None and given.kept.is_file() else []
    rows: dict[str, dict[str, Any]] = {row["key"]: row for row in map(json.loads, lines)}
    todo: list[tuple[int, int, str, str, Case]] = []
    for index, case in enumerate(cases()):
        if given.systems and case.name not in given.systems:
            continue
        names = list(case.effects)
        todo += [(k, index, "effect", names[k % len(names)], case) for k in range(given.effects)]
        todo += [(k, index, "left out", names[(k + given.effects) % len(names)], case) for k in range(given.left_out)]
        todo += [(k, index, "complete", "", case) for k in range(given.complete)]
    # all systems in turn, so that a score that is cut short has some of each
    for k, index, kind, effect, case in sorted(todo, key=lambda one: one[:3]):
        key = f"{given.seed} {case.name} {kind} {k} {effect}"
        if key not in rows:
            seed = [given.seed, index, ("effect", "left out", "complete").index(kind), k]
            rows[key] = {"key": key, **judged(case, kind, effect, seed, not given.no_bic, given.python)}
            if given.kept is not None:
                with given.kept.open("a") as file:
                    file.write(json.dumps(rows[key]) + "\n")
        print(_line(rows[key]), flush=True)
    _table(list(rows.values()))


def _line(r: dict[str, Any]) -> str:
    others = f"BIC {r['bic'] or 'the model as it is':24}" if "bic" in r else ""
    others += f" sparse {r['sparse'] or 'the model as it is'}" if "sparse" in r else ""
    d = f"D {r['d']:8.0f}" if "d" in r else ""
    said = "right" if r["right"] else "WRONG"
    return f"{r['system']:10} {r['kind']:9} {r['effect'] or '-':24} {d} engine {r['named']:42} {said:6}{r['took']:6.1f} s {others}"


def _table(rows: list[dict[str, Any]]) -> None:
    print()
    print(f"{'':12}{'effect named':>24}{'left out: unknown':>24}{'complete: no_gap':>24}")
    for name in [*dict.fromkeys(r["system"] for r in rows), "all"]:
        mine = [r for r in rows if name in ("all", r["system"])]
        cells = [_cell([r for r in mine if r["kind"] == kind]) for kind in ("effect", "left out", "complete")]
        print(f"{name:12}{''.join(cells)}")
    print(
        f"Each cell: the engine, least squares with BIC, sparse regression, of how many (cases of D below {LEAST_D:g} are not "
        "counted). The two others have no word for the unknown."
    )
    print(f"Median time of the engine: {np.median([r['took'] for r in rows]):.1f} s on one busy core.")


def _cell(rows: list[dict[str, Any]]) -> str:
    counted = [r for r in rows if r["kind"] == "complete" or r.get("d", np.inf) > LEAST_D]
    said = "".join(f"{sum(r[key] for r in counted if key in r):5d}" for key in ("right", "bic_right", "sparse_right"))
    return f"{said} of {len(counted):3d}  "


if __name__ == "__main__":
    main()
