"""Campaigns with surge in full whose truth is known, from equations of their own: only numpy stands below this file.

A hull in surge, sway and yaw, its CG in Cartesian carriage axes, towed on a line of constant length. The line is one row of
a constraint (J (u', v', r') = what keeps |p| = L) and its pull the row's multiplier; nothing is written in alpha, and the
closed form of T (theory.md 10) is not used. The line has no stretch at all, so that no error of a fit can come from it.

    found = surge_campaigns(seed=7, count=200, options=SurgeOptions(rudder="mixed"), path=Path("surge-7.npz"))
    found[0].y_m            # (4, 1500), measured; found[0].stated, found[0].truth: plain numbers

Campaign k of a seed is the same whatever the count. Nuisances are drawn from the priors that ``stated`` names; what is stated
is what a person in the hall would write down.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray
Rng = np.random.Generator
NAMES = ("m_minus_y_vdot", "i_minus_n_rdot", "y_v", "y_r_minus_mu", "n_v", "n_r")
MARINER = dict(zip(NAMES, (149.19, 62.11, -52.87, -66.33, -48.51, -57.60), strict=True))
"""ITTC, thesis Table 8.2: kg, kg m2, N s/m, N s, N s, N m s at 1.28 m/s."""
SPEED_M_S, LINE_M, MASS_KG, LENGTH_M, RESISTANCE_N = 1.28, 0.91, 78.0, 2.66, 3.96
POINTS_M = (1.446, 1.548, 1.649, 1.751)
GROWTH_1_S = 0.012
"""A hull whose tow grows faster than this from the foremost or the aftmost point is none that a tank would tow."""
LARGEST_RAD = float(np.radians(40.0))
"""Of alpha and of alpha + beta, anywhere in a tow."""
GENTLER, RUDDER_FIRST = 0.7, 8
"""A rudder that swings a tow further than that is laid less hard, by this factor and again (15 degrees of 20 N/rad would hold
this hull beyond 70 degrees: of constants 1 to 4 degrees are left); after so many turns the release is made smaller, too."""
TURN_RAD_S = float(np.radians(25.0))
"""Of the rudder's servo: no sample is further from the next than a straight line of this slope."""
SUBSTEPS = 2
"""Runge-Kutta steps to a sample at 25 Hz: step errors below 1e-8 m."""
X, Y, B, U, V, R = range(6)


@dataclass(frozen=True)
class SurgeOptions:
    """What the campaigns are.

    Attributes
    ----------
    rudder : "none"; "constant" (each run's its own, up to ``rudder_deg``); "history" (steps, PRBS, zigzag); "mixed": campaigns
        of odd number have histories, the others constants
    speed : "constant" or "history" (a drift and a sine, slow enough for a taut line)
    gauge : False: nobody measured the pull; ``stated`` has no tension
    release_deg : least and largest alpha of the releases
    rudder_deg : the largest angle drawn
    y_delta_n_rad : Y_delta about which it is drawn
    scatter : of each derivative about MARINER, even within +- this share
    resistance_scatter : of R about 3.96 N, standard deviation, relative
    mass_sd_rel : error of the weighing (0: exact)
    rate_hz, span_s : of the records
    y_sd_m, beta_sd_rad : white noise
    """

    rudder: str = "none"
    speed: str = "constant"
    gauge: bool = True
    release_deg: tuple[float, float] = (3.0, 20.0)
    rudder_deg: float = 15.0
    y_delta_n_rad: float = 20.0
    scatter: float = 0.2
    resistance_scatter: float = 0.05
    mass_sd_rel: float = 0.0
    rate_hz: float = 25.0
    span_s: float = 60.0
    y_sd_m: float = 1e-3
    beta_sd_rad: float = float(np.radians(0.1))


@dataclass(frozen=True)
class SurgeCampaign:
    """Four tows of a hull.

    Attributes
    ----------
    t_s : ``(n,)``
    y_m, beta_rad : ``(4, n)`` measured: CG across, from the post, and heading
    clean_y_m, clean_beta_rad : the same without noise
    tension_n : ``(4, n)`` the line's pull as it was (no gauge's record: it has no error)
    rudder_rad : ``(4, n)`` or None; straight between samples, known exactly
    speed_m_s : ``(4, n)`` or None: the carriage's record, with ``stated``'s scale error
    stated : speed_m_s, line_m, tow_points_m, tension_n (absent without a gauge), mass_kg, length_pp_m, and ``priors``: what
        the person knows of each nuisance
    truth : the six derivatives (``NAMES``, quoted at ``speed_m_s`` of ``stated``), x_udot, x_vr, x_vv, x_rr, power,
        resistance_n (at that speed, too), mass_kg, y_delta, n_delta, speed_scale, line_m, tow_points_m, release_rad (alpha;
        beta, v, r are zero)
    """

    t_s: Array
    y_m: Array
    beta_rad: Array
    clean_y_m: Array
    clean_beta_rad: Array
    tension_n: Array
    rudder_rad: Array | None
    speed_m_s: Array | None
    stated: dict[str, Any]
    truth: dict[str, Any]


@dataclass(frozen=True)
class Towed:
    """Motions of many tows, ``(n, samples)`` each: CG ahead of the post and across, heading, sway, yaw rate, the line's pull."""

    x_m: Array
    y_m: Array
    beta_rad: Array
    v_m_s: Array
    r_rad_s: Array
    tension_n: Array


def rigid_tows(
    numbers: Mapping[str, Array],
    times_s: Array,
    rudder_rad: Array | None = None,
    speed_m_s: Array | None = None,
    speed_rate_m_s2: Array | None = None,
    substeps: int = SUBSTEPS,
) -> Towed:
    """Integrate tows on a line of constant length, released at rest on the carriage (classical Runge-Kutta).

    Parameters
    ----------
    numbers : name -> ``(n,)``: the six of ``NAMES``, speed_ref, mass_kg, x_udot, x_vr, x_vv, x_rr, power, resistance_n, speed_m_s,
        line_m, tow_point_m, release_rad (alpha); and, where not zero, offset_m (of the tow point to starboard), y_delta, n_delta,
        and of the release, which is then none at rest: release_beta_rad, release_v_m_s, release_r_rad_s
    times_s : ``(k,)`` evenly spaced
    rudder_rad : ``(n, k)``, straight between the samples
    speed_m_s, speed_rate_m_s2 : ``(n, 2 (k - 1) substeps + 1)`` carriage speed and its rate at every half step; None: the number's
    """
    q = {name: np.asarray(value, float) for name, value in numbers.items()}
    n, k = len(q["line_m"]), len(times_s)
    for name in ("offset_m", "y_delta", "n_delta", "release_beta_rad", "release_v_m_s", "release_r_rad_s"):
        q.setdefault(name, np.zeros(n))
    step, still = float(times_s[1] - times_s[0]) / substeps, np.zeros(n)

    def inputs(half: int) -> tuple[Array, Array, Array]:
        u = q["speed_m_s"] if speed_m_s is None else speed_m_s[:, half]
        rate = still if speed_rate_m_s2 is None else speed_rate_m_s2[:, half]
        if rudder_rad is None:
            return still, u, rate
        at, part = divmod(half, 2 * substeps)
        share = part / (2 * substeps)
        over = rudder_rad[:, at] if not part else (1 - share) * rudder_rad[:, at] + share * rudder_rad[:, at + 1]
        return over, u, rate

    state = _released(q, inputs(0)[1])
    found = np.empty((6, n, k))
    for j in range(k):
        for sub in range(substeps):
            half = 2 * (j * substeps + sub)
            k1, pull = _rates(q, state, *inputs(half))
            if sub == 0:
                found[:, :, j] = state[X], state[Y], state[B], state[V], state[R], pull
            if j == k - 1:
                break
            k2, _ = _rates(q, state + step / 2 * k1, *inputs(half + 1))
            k3, _ = _rates(q, state + step / 2 * k2, *inputs(half + 1))
            k4, _ = _rates(q, state + step * k3, *inputs(half + 2))
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return Towed(*found)


def _released(q: Mapping[str, Array], speed: Array) -> Array:
    state = np.zeros((6, len(speed)))
    alpha, state[B], state[V], state[R] = (
        q[name] for name in ("release_rad", "release_beta_rad", "release_v_m_s", "release_r_rad_s")
    )
    cb, sb, ahead, aside = np.cos(state[B]), np.sin(state[B]), q["tow_point_m"], q["offset_m"]
    state[X] = -q["line_m"] * np.cos(alpha) - (ahead * cb - aside * sb)
    state[Y] = q["line_m"] * np.sin(alpha) - (ahead * sb + aside * cb)
    # along the line the tow point goes as the carriage does
    nx, ny = -np.cos(alpha), np.sin(alpha)
    across = state[V] + state[R] * ahead
    state[U] = (nx * speed - (ny * cb - nx * sb) * across) / (nx * cb + ny * sb) + state[R] * aside
    return state


def _rates(q: Mapping[str, Array], s: Array, over: Array, speed: Array, speed_rate: Array) -> tuple[Array, Array]:
    """Time derivatives of (x, y, beta, u, v, r), and the line's pull: the multiplier of the constraint n . p'' = -|p'|^2/L."""
    b, u, v, r = s[B], s[U], s[V], s[R]
    cb, sb = np.cos(b), np.sin(b)
    ahead, aside = q["tow_point_m"], q["offset_m"]
    share = u / q["speed_ref"]
    # forces without the line, over their inertia
    surge_mass = q["mass_kg"] - q["x_udot"]
    drag = q["resistance_n"] * share * np.abs(share) ** (q["power"] - 1)
    side = (
        share * (q["y_v"] * v + (q["y_r_minus_mu"] + q["mass_kg"] * q["speed_ref"]) * r)
        + share**2 * q["y_delta"] * over
    )
    turn = share * (q["n_v"] * v + q["n_r"] * r) + share**2 * q["n_delta"] * over
    du = (-drag + q["x_vv"] * v**2 + q["x_vr"] * v * r + q["x_rr"] * r**2 + q["mass_kg"] * v * r) / surge_mass
    dv = (side - q["mass_kg"] * u * r) / q["m_minus_y_vdot"]
    dr = turn / q["i_minus_n_rdot"]
    # the tow point from the post, its velocity, and the line's direction in body axes
    px, py = s[X] + ahead * cb - aside * sb, s[Y] + ahead * sb + aside * cb
    length = np.hypot(px, py)
    nx, ny = (px * cb + py * sb) / length, (py * cb - px * sb) / length
    along, across = u - r * aside, v + r * ahead
    px_rate, py_rate = along * cb - across * sb - speed, along * sb + across * cb
    lever = ahead * ny - aside * nx
    # n . p'' = J . (u', v', r') + what turning and a carriage that changes its speed add
    added = nx * (-v * r - r**2 * ahead) + ny * (u * r - r**2 * aside) - px / length * speed_rate
    swing = px_rate**2 + py_rate**2 - ((px * px_rate + py * py_rate) / length) ** 2
    wanted = -swing / length - added
    give = nx**2 / surge_mass + ny**2 / q["m_minus_y_vdot"] + lever**2 / q["i_minus_n_rdot"]
    pull = (nx * du + ny * dv + lever * dr - wanted) / give
    return np.stack(
        [
            u * cb - v * sb - speed,
            u * sb + v * cb,
            r,
            du - pull * nx / surge_mass,
            dv - pull * ny / q["m_minus_y_vdot"],
            dr - pull * lever / q["i_minus_n_rdot"],
        ]
    ), pull


@dataclass
class _Drawn:
    """A campaign before its tows are known: numbers ``name -> (4,)``, inputs, and what is drawn once a campaign."""

    numbers: dict[str, Array]
    stated: dict[str, Any]
    truth: dict[str, Any]
    rudder: Array | None
    swell: Array
    drift: Array
    tries: int = 0
    made: dict[str, Array] = field(default_factory=dict)


def surge_campaigns(
    seed: int, count: int, options: SurgeOptions | None = None, path: Path | None = None
) -> list[SurgeCampaign]:
    """Campaigns of four tows.

    Parameters
    ----------
    seed : campaign k takes default_rng([seed, k])
    count : how many
    options : None: the defaults
    path : .npz that keeps the motions, so that a second call does not integrate

    Raises
    ------
    ValueError : the file at ``path`` holds other campaigns
    """
    options = options or SurgeOptions()
    if options.rudder not in ("none", "constant", "history", "mixed") or options.speed not in ("constant", "history"):
        raise ValueError(f"rudder = {options.rudder!r}, speed = {options.speed!r}: no such kind")
    times = np.arange(round(options.rate_hz * options.span_s)) / options.rate_hz
    key = json.dumps({"seed": seed, "count": count, **asdict(options)}, sort_keys=True)
    if path is not None and path.is_file():
        with np.load(path) as kept:
            if str(kept["key"]) != key:
                raise ValueError(f"{path} holds {kept['key']}, not {key}")
            words = json.loads(str(kept["words"]))
            arrays = {name: kept[name] for name in ("y", "beta", "tension", "rudder", "speed")}
    else:
        drawn = _calm(seed, count, options, times)
        words = [{"stated": each.stated, "truth": each.truth} for each in drawn]
        arrays = {
            name: np.stack([each.made[name] for each in drawn]) for name in ("y", "beta", "tension", "rudder", "speed")
        }
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            np.savez(path, key=np.array(key), words=np.array(json.dumps(words)), **arrays)
    return [_measured(seed, k, options, times, words[k], {n: a[k] for n, a in arrays.items()}) for k in range(count)]


def _measured(
    seed: int, k: int, options: SurgeOptions, times: Array, words: dict[str, Any], made: dict[str, Array]
) -> SurgeCampaign:
    rng = np.random.default_rng([seed, k, 1])
    y, beta = made["y"], made["beta"]
    return SurgeCampaign(
        times,
        y + options.y_sd_m * rng.normal(size=y.shape),
        beta + options.beta_sd_rad * rng.normal(size=y.shape),
        y,
        beta,
        made["tension"],
        None if options.rudder == "none" else made["rudder"],
        None if options.speed == "constant" else made["speed"],
        words["stated"],
        words["truth"],
    )


def _calm(seed: int, count: int, options: SurgeOptions, times: Array) -> list[_Drawn]:
    """Drawn campaigns with their motions; a tow that swings too far or slackens has its rudder or release made smaller."""
    drawn = [_draw(np.random.default_rng([seed, k]), k, options, times) for k in range(count)]
    todo = list(range(count))
    while todo:
        names = drawn[todo[0]].numbers
        numbers = {name: np.concatenate([drawn[k].numbers[name] for k in todo]) for name in names}
        rudders = None if options.rudder == "none" else np.concatenate([drawn[k].rudder for k in todo])
        speed = speed_rate = None
        if options.speed == "history":
            halves = np.arange(2 * (len(times) - 1) * SUBSTEPS + 1) * (times[1] - times[0]) / (2 * SUBSTEPS)
            parts = [_speeds(drawn[k], halves, options.span_s) for k in todo]
            speed, speed_rate = (np.concatenate([p[i] for p in parts]) for i in range(2))
        with np.errstate(all="ignore"):
            towed = rigid_tows(numbers, times, rudders, speed, speed_rate)
        wild = _wild(numbers, towed)
        again = []
        for place, k in enumerate(todo):
            rows = slice(4 * place, 4 * place + 4)
            one = drawn[k]
            if wild[rows].any():
                _gentler(one, wild[rows])
                again.append(k)
                continue
            one.made = {
                "y": towed.y_m[rows],
                "beta": towed.beta_rad[rows],
                "tension": towed.tension_n[rows],
                "rudder": np.zeros(0) if one.rudder is None else one.rudder,
                "speed": _stated_speed(one, times, options),
            }
            one.truth["release_rad"] = one.numbers["release_rad"].tolist()
        todo = again
    return drawn


def _wild(numbers: Mapping[str, Array], towed: Towed) -> Array:
    """Tows that swing beyond ``LARGEST_RAD`` or slacken, ``(n,)``."""
    sine = (towed.y_m + numbers["tow_point_m"][:, None] * np.sin(towed.beta_rad)) / numbers["line_m"][:, None]
    alpha = np.arcsin(np.clip(sine, -1, 1))
    far = np.maximum(np.abs(alpha), np.abs(alpha + towed.beta_rad)).max(axis=1)
    return ~((far < LARGEST_RAD) & (towed.tension_n.min(axis=1) > 0))


def _gentler(one: _Drawn, wild: Array) -> None:
    one.tries += 1
    if one.tries > 25:
        raise ValueError(f"no release keeps this hull towing: {one.truth}")
    by = np.where(wild, GENTLER, 1.0)
    if one.rudder is not None:
        one.rudder = one.rudder * by[:, None]
    if one.rudder is None or one.tries > RUDDER_FIRST:
        one.numbers["release_rad"] = one.numbers["release_rad"] * by


def _draw(rng: Rng, k: int, options: SurgeOptions, times: Array) -> _Drawn:
    while True:
        six = {name: value * (1 + options.scatter * float(rng.uniform(-1, 1))) for name, value in MARINER.items()}
        if max(growth(six, x) for x in (POINTS_M[0], POINTS_M[-1])) < GROWTH_1_S:
            break
    weighed = MASS_KG
    mass = weighed * (1 + options.mass_sd_rel * float(rng.normal()))
    while True:
        x_udot = weighed * (-0.05 + 0.03 * float(rng.normal()))
        if x_udot < 0:
            break
    y_delta = options.y_delta_n_rad * (1 + options.scatter * float(rng.uniform(-1, 1)))
    truth: dict[str, Any] = {
        **six,
        "x_udot": x_udot,
        "x_vr": weighed * (0.45 + 0.26 * float(rng.normal())),
        "x_vv": weighed / LENGTH_M * (-0.4 + 1.2 * float(rng.normal())),
        "x_rr": 0.02 * weighed * LENGTH_M * float(rng.normal()),
        "power": 1.85 + 0.1 * float(rng.normal()),
        "resistance_n": RESISTANCE_N * (1 + options.resistance_scatter * float(rng.normal())),
        "mass_kg": mass,
        "y_delta": y_delta,
        "n_delta": -0.45 * LENGTH_M * y_delta * (1 + 0.05 * float(rng.normal())),
        "speed_scale": 1 + 0.001 * float(rng.normal()),
        "line_m": LINE_M + 0.0005 * float(rng.normal()),
        "tow_points_m": [x + 0.0005 * float(rng.normal()) for x in POINTS_M],
    }
    speed = SPEED_M_S * truth["speed_scale"]
    # a gauge on a straight tow reads what the true speed asks for
    straight = truth["resistance_n"] * truth["speed_scale"] ** truth["power"]
    read = straight * (1 + 0.005 * float(rng.normal())) * (1 + 0.002 * rng.normal(size=4))
    stated: dict[str, Any] = {
        "speed_m_s": SPEED_M_S,
        "line_m": LINE_M,
        "tow_points_m": list(POINTS_M),
        "mass_kg": weighed,
        "length_pp_m": LENGTH_M,
        "priors": {
            "tension_common_sd_rel": 0.005,
            "tension_sd_rel": 0.002,
            "tow_point_sd_m": 0.0005,
            "line_length_sd_m": 0.0005,
            "speed_sd_rel": 0.001,
            "x_udot_kg": [-0.05 * weighed, 0.03 * weighed],
            "x_vr_kg": [0.45 * weighed, 0.26 * weighed],
            "x_vv_kg_m": [-0.4 * weighed / LENGTH_M, 1.2 * weighed / LENGTH_M],
            "x_rr_kg_m": [0.0, 0.02 * weighed * LENGTH_M],
            "power": [1.85, 0.1],
            "mass_sd_rel": options.mass_sd_rel,
        },
    }
    if options.gauge:
        stated["tension_n"] = read.tolist()
    release = np.radians(rng.uniform(*options.release_deg, 4)) * rng.choice([-1.0, 1.0], 4)
    same = (
        *NAMES,
        "x_udot",
        "x_vr",
        "x_vv",
        "x_rr",
        "power",
        "resistance_n",
        "mass_kg",
        "y_delta",
        "n_delta",
        "line_m",
    )
    numbers = {name: np.full(4, truth[name]) for name in same}
    numbers |= {
        "speed_ref": np.full(4, SPEED_M_S),
        "speed_m_s": np.full(4, speed),
        "tow_point_m": np.array(truth["tow_points_m"]),
        "release_rad": release,
    }
    swell, drift = rng.uniform(size=(4, 3)), rng.uniform(-1, 1, size=4)
    return _Drawn(numbers, stated, truth, _rudder(rng, k, options, times), swell, drift)


def growth(six: Mapping[str, float], x_t: float) -> float:
    """The largest real part of the roots of the linear tow with constant T (theory.md 2), 1/s."""
    m, i, y_v, y_r, n_v, n_r = (six[name] for name in NAMES)
    pull = np.array([RESISTANCE_N / LINE_M, RESISTANCE_N * (1 + x_t / LINE_M)])
    matrix = np.zeros((4, 4))
    matrix[0, 1:3] = SPEED_M_S, 1
    matrix[1, 3] = 1
    matrix[2] = [*(-pull / m), y_v / m, y_r / m]
    matrix[3] = [*(-x_t * pull / i), n_v / i, n_r / i]
    return float(np.linalg.eigvals(matrix).real.max())


def _rudder(rng: Rng, k: int, options: SurgeOptions, times: Array) -> Array | None:
    """``(4, n)`` rad at the samples, or None."""
    if options.rudder == "none":
        return None
    largest = np.radians(options.rudder_deg)
    if options.rudder == "constant" or (options.rudder == "mixed" and k % 2 == 0):
        return np.repeat((largest * rng.uniform(0, 1, 4) * rng.choice([-1.0, 1.0], 4))[:, None], len(times), axis=1)
    return np.stack([_history(rng, times, largest) for _ in range(4)])


def _history(rng: Rng, times: Array, largest: float) -> Array:
    """Steps, a pseudo-random binary sequence, or a zigzag by the clock, as a servo of limited rate follows them."""
    kind, size = int(rng.integers(3)), largest * float(rng.uniform(0.4, 1.0))
    if kind == 0:
        changes = np.sort(rng.uniform(3, times[-1] - 3, int(rng.integers(2, 5))))
        wanted = np.concatenate([[0.0], size * rng.uniform(-1, 1, len(changes))])[np.searchsorted(changes, times)]
    elif kind == 1:
        hold = float(rng.uniform(1.5, 4.0))
        wanted = size * rng.choice([-1.0, 1.0], int(times[-1] / hold) + 1)[(times / hold).astype(int)]
    else:
        period = float(rng.uniform(8.0, 16.0))
        wanted = size * np.where(((times - times[0]) / period + float(rng.uniform())) % 1 < 0.5, 1.0, -1.0)
    found, most = np.empty_like(wanted), TURN_RAD_S * (times[1] - times[0])
    found[0] = wanted[0] if kind else 0.0
    for j in range(1, len(times)):
        found[j] = found[j - 1] + np.clip(wanted[j] - found[j - 1], -most, most)
    return found


def _speeds(one: _Drawn, at_s: Array, span_s: float) -> tuple[Array, Array]:
    """The carriage's true speed and its rate at some times, ``(4, n)``.

    A drift of up to 1 % either way and a sine of up to 1 %, 6 to 20 s long: at most 0.014 m/s2; R/(m - X_udot) is about 0.048.
    """
    mean = one.numbers["speed_m_s"][:, None]
    size, w = 0.01 * one.swell[:, :1], 2 * np.pi / (6 + 14 * one.swell[:, 1:2])
    phase, slope = 2 * np.pi * one.swell[:, 2:], 0.02 * one.drift[:, None] / span_s
    share = 1 + slope * (at_s - span_s / 2) + size * np.sin(w * at_s + phase)
    return mean * share, mean * (slope + size * w * np.cos(w * at_s + phase))


def _stated_speed(one: _Drawn, times: Array, options: SurgeOptions) -> Array:
    if options.speed == "constant":
        return np.zeros(0)
    return _speeds(one, times, options.span_s)[0] / one.truth["speed_scale"]
