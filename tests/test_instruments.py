"""Motion from instruments: the thesis's bars, lamps, potentiometers and LVDT on a simulated tow, several rates and clocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from towline.cli import main
from towline.record.errors import EstimationError, InputError, TowlineError
from towline.record.instruments import (
    BarTable,
    Channel,
    ChannelTable,
    SetupFile,
    clock_from_events,
    clock_from_match,
    motion_from_channels,
    read_channels,
    read_setup,
)
from towline.record.tables import read_motion
from towline.simulate import Hull, Start, Tow, simulate_full

LENGTH = 0.91
MARINER = BarTable(lcg_m=0.0421, station_m=1.099, hole=8)
HULL = Hull(149.19, 62.11, -52.87, -66.33, -48.51, -57.60, speed_m_s=1.28)
EXACT = 1e-9
PULLEY_M = 0.0456
SEEDS = 20
SDS = 4.0
"""No recovered value may lie farther off than this many of its own standard deviations; by chance 1 in 16,000 does."""


def tow_at(times: np.ndarray) -> pd.DataFrame:
    """A MARINER tow from hole 8 at the given times, exact; they may start before 0 by up to 20 s."""
    tow = Tow(1.28, LENGTH, MARINER.ahead_m(0), 3.96, post_m=(0.0, 0.05))
    order = np.argsort(times)
    grid = np.concatenate([[-20.0], times[order]])
    motion = simulate_full(HULL, tow, Start(alpha_rad=0.3, beta_rad=0.02), grid).iloc[1:]
    back = np.empty(len(times), dtype=int)
    back[order] = np.arange(len(times))
    return motion.iloc[back].reset_index(drop=True)


def lamp(motion: pd.DataFrame, ahead: float, side: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """x and y of a lamp (theory.md 9.1)."""
    beta = motion["beta_rad"].to_numpy()
    x = motion["x_cg_m"] + ahead * np.cos(beta) - side * np.sin(beta)
    y = motion["y_cg_m"] + ahead * np.sin(beta) + side * np.cos(beta)
    return x.to_numpy(), y.to_numpy()


def table(name: str, measures: str, sd: float = 1e-3, **more: object) -> dict[str, object]:
    return {"name": name, "measures": measures, "sd": sd, **more}


def setup_of(channels: list[dict[str, object]], **more: object) -> SetupFile:
    return SetupFile.model_validate(
        {
            "tow": {"line_length_m": LENGTH, "post_m": (0.0, 0.05)},
            "bar": MARINER.model_dump(),
            "channel": tuple(channels),
            **more,
        }
    )


def recorded(setup: SetupFile, values: dict[str, tuple[np.ndarray, np.ndarray]]) -> dict[str, Channel]:
    """Channels from (times, values) by name."""
    return {one.name: Channel(one, *values[one.name]) for one in setup.channel}


# the thesis's bars -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("hole", "tow_point"), [(6, 1.446), (8, 1.548), (10, 1.649), (12, 1.751)])
def test_the_mariner_bar_gives_the_published_tow_points(hole: int, tow_point: float) -> None:
    """(7.5) at the thesis's four holes, printed to the millimetre."""
    bar = BarTable(lcg_m=0.0421, station_m=1.099, hole=hole)
    assert bar.ahead_m(0) == pytest.approx(tow_point, abs=5.1e-4)
    assert bar.ahead_m(1) - bar.ahead_m(21) == pytest.approx(1.016, abs=1e-12)  # D of (7.4)
    assert bar.ahead_m(1) == pytest.approx(0.0421 + 1.099 + 0.0508 * (hole - 1), abs=1e-12)  # (7.6)


def test_the_bombardier_bar_follows_7_10_and_7_11() -> None:
    for n in (1, 5, 9):
        bar = BarTable(lcg_m=-0.035, station_m=1.1875, hole=n)
        distance = -0.035 + 1.1875 + 2 * 0.0254 * (n - 1)
        assert bar.ahead_m(1) == pytest.approx(distance, abs=1e-12)
        assert bar.ahead_m(0) == pytest.approx(distance + 2 * 0.0254, abs=1e-12)


# exact ways --------------------------------------------------------------------------------------------------------

T_S = np.arange(0.0, 30.0, 0.1)
WAYS = {
    "two lamps (7.4, 7.7, 7.9)": [table("y1", "y", hole=1), table("y21", "y", hole=21)],
    "lamps with x, one aside": [
        table("y1", "y", hole=1),
        table("y21", "y", ahead_m=-0.4, side_m=0.15),
        table("x1", "x", hole=1),
        table("x21", "x", ahead_m=-0.4, side_m=0.15),
    ],
    "both potentiometers": [table("p1", "alpha"), table("p2", "alpha_beta")],
    "lamp at LCG and LVDT (7.13)": [table("y", "y", ahead_m=0.0), table("l", "lvdt", pulley_m=PULLEY_M)],
    "lamp and gyro": [table("y", "y", hole=1), table("g", "beta")],
    "all": [
        table("y1", "y", hole=1),
        table("y21", "y", hole=21),
        table("p1", "alpha", 0.01),
        table("p2", "alpha_beta", 0.01),
        table("l", "lvdt", 1e-4, pulley_m=PULLEY_M),
    ],
}


def reading(setup: SetupFile, one: ChannelTable, motion: pd.DataFrame) -> np.ndarray:
    """What a perfect channel reads, from the simulated motion by the sensors' own definitions."""
    if one.measures in ("x", "y"):
        return lamp(motion, setup.place_m(one), one.side_m)[one.measures == "y"]
    alpha, beta = motion["alpha_rad"].to_numpy(), motion["beta_rad"].to_numpy()
    return {
        "alpha": alpha,
        "alpha_beta": alpha + beta,
        "beta": beta,
        "lvdt": np.degrees(alpha) * np.pi * PULLEY_M / 360,  # (7.12)
    }[one.measures]


@pytest.mark.parametrize("way", WAYS)
def test_perfect_readings_give_the_motion_back(way: str) -> None:
    truth = tow_at(T_S)
    setup = setup_of(WAYS[way])
    channels = recorded(setup, {one.name: (T_S, reading(setup, one, truth)) for one in setup.channel})
    motion = motion_from_channels(setup, channels).motion
    assert (motion["status"] == "measured").all()
    for name in ("y_cg_m", "beta_rad", "alpha_rad", *(["x_cg_m"] if "x_cg_m" in motion else [])):
        assert np.abs(motion[name] - truth[name]).max() < EXACT, name


def test_a_hole_is_lost_and_nothing_else(tmp_path: Path) -> None:
    truth = tow_at(T_S)
    setup = setup_of(WAYS["two lamps (7.4, 7.7, 7.9)"])
    values = {one.name: reading(setup, one, truth).copy() for one in setup.channel}
    values["y21"][40:43] = np.nan
    values["y1"][0] = np.nan
    motion = motion_from_channels(setup, recorded(setup, {k: (T_S, v) for k, v in values.items()})).motion
    lost = motion["status"] == "lost"
    assert np.flatnonzero(lost).tolist() == [0, 40, 41, 42]
    assert motion.loc[lost, ["y_cg_m", "beta_rad", "alpha_rad", "sigma_y_cg_m"]].isna().all(axis=None)
    motion.to_csv(tmp_path / "motion.csv", index=False)
    assert np.flatnonzero(read_motion(tmp_path / "motion.csv")["status"] == "lost").tolist() == [0, 40, 41, 42]


def test_between_samples_a_cubic_and_across_a_hole_nothing() -> None:
    """A cubic comes back exactly off its samples; beside a hole a straight line; inside it, and outside the record, nothing."""
    t_s = np.arange(0.0, 2.0, 0.1)
    curve = lambda t: 1 + t - 2 * t**2 + 0.5 * t**3  # noqa: E731
    value = curve(t_s)
    value[10] = np.nan
    channel = Channel(ChannelTable(name="a", measures="beta", sd=0.02), t_s, value)
    times = np.array([0.25, 0.5, 0.85, 0.95, 1.0, 1.05, 1.15, -0.01, 1.95])
    found, sd = channel.at(times)
    assert np.abs(found[:2] - curve(times[:2])).max() < 1e-12
    assert found[2] == pytest.approx((value[8] + value[9]) / 2, abs=1e-12)
    assert np.isnan(found[[3, 4, 5, 7, 8]]).all()
    assert sd[1] == 0.02
    assert sd[2] == pytest.approx(0.02 / np.sqrt(2), rel=1e-9)
    # half way the four weights are (-1, 9, 9, -1)/16
    assert sd[0] == pytest.approx(0.02 * np.sqrt(164) / 16, rel=1e-9)


def test_the_stated_sigmas_are_the_scatter() -> None:
    """All channels, 8 seeds x 300 samples: the scatter over the stated sigma is 1 to 5 sd of its own, 1/sqrt(2 x 2400)."""
    setup = setup_of(WAYS["all"])
    truth = tow_at(T_S)
    exact = {one.name: reading(setup, one, truth) for one in setup.channel}
    pulls = {name: [] for name in ("y_cg_m", "beta_rad", "alpha_rad")}
    for seed in range(8):
        draw = np.random.default_rng(seed)
        noisy = {one.name: (T_S, exact[one.name] + draw.normal(0, one.sd, len(T_S))) for one in setup.channel}
        motion = motion_from_channels(setup, recorded(setup, noisy)).motion
        for name, found in pulls.items():
            found.append((motion[name] - truth[name]) / motion[f"sigma_{name}"])
    for name, found in pulls.items():
        assert np.sqrt(np.mean(np.square(found))) == pytest.approx(1.0, abs=5 / np.sqrt(2 * 2400)), name


def test_residuals_judge_each_channel() -> None:
    """All as stated: near 1 (300 samples: 5/sqrt(600) = 0.2). One that sticks in steps of 4 degrees stands out, with
    the lamp that checks it (two readings of one thing cannot say which of them is wrong); those of the line angle stay."""
    setup = setup_of(WAYS["all"])
    truth, draw = tow_at(T_S), np.random.default_rng(2)
    values = {one.name: reading(setup, one, truth) + draw.normal(0, one.sd, len(T_S)) for one in setup.channel}

    def residuals() -> dict[str, float]:
        found = motion_from_channels(setup, recorded(setup, {name: (T_S, v) for name, v in values.items()}))
        return {s.partition(":")[0]: float(s.partition("residual ")[2].split()[0]) for s in found.sentences}

    assert residuals() == pytest.approx(dict.fromkeys(values, 1.0), abs=0.2)
    values["p2"] = np.round(values["p2"] / np.radians(4)) * np.radians(4)
    worse = residuals()
    assert worse["p2"] > 1.5
    assert max(worse["p1"], worse["l"]) < 1.2


# clocks ------------------------------------------------------------------------------------------------------------


def test_events_give_offset_and_drift_within_their_sd() -> None:
    """20 seeds; the mean square of 40 pulls is 1 to 5 of its sd, sqrt(2/40) (the pair is correlated little about the middle)."""
    pulls = []
    for seed in range(SEEDS):
        draw = np.random.default_rng(seed)
        offset, drift = draw.normal(0, 5), draw.normal(0, 1e-4)
        own = np.sort(draw.uniform(0, 600, 6))
        clock = clock_from_events(own, own + offset + drift * own + draw.normal(0, 0.01, 6), 0.01, 1e-4)
        truth = np.array([offset + drift * clock.middle_s, drift])
        pulls.append((np.array([clock.offset_s, clock.drift]) - truth) / clock.sd)
    assert np.abs(pulls).max() < SDS
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=5 * np.sqrt(2 / (2 * SEEDS)))


def test_one_event_gives_the_offset_and_leaves_the_drift_as_known() -> None:
    clock = clock_from_events(np.array([12.0]), np.array([9.5]), 0.01, 1e-4)
    assert (clock.offset_s, clock.drift) == (-2.5, 0.0)
    assert clock.sd == pytest.approx((0.01, 1e-4))
    assert clock.time_sd(np.array([112.0]))[0] == pytest.approx(np.hypot(0.01, 100 * 1e-4))


def one_match(seed: int):
    """A potentiometer at 10 Hz with 0.3 degree against lamps at 30 Hz; offset, drift and a bias drawn."""
    draw = np.random.default_rng(seed)
    offset, drift = draw.uniform(-5, 5), draw.normal(0, 1e-4)
    own = np.arange(0.0, 60.0, 0.1)
    reference = np.arange(0.0, 60.0, 1 / 30)
    both = tow_at(np.concatenate([own + offset + drift * (own - 30.0), reference]))
    seen, other = both.iloc[: len(own)], both.iloc[len(own) :]
    a = np.degrees(seen["alpha_rad"] + seen["beta_rad"]).to_numpy() + draw.normal(0, 0.3, len(own)) + 0.7
    b = np.degrees(other["alpha_rad"] + other["beta_rad"]).to_numpy() + draw.normal(0, 0.1, len(reference))
    clock = clock_from_match((own, a), (reference, b), search_s=(-8, 8))
    return clock, np.array([offset + drift * (clock.middle_s - 30.0), drift])


@pytest.mark.slow
def test_a_match_gives_offset_and_drift_within_their_sd() -> None:
    pulls, sds = [], []
    for seed in range(SEEDS):
        clock, truth = one_match(seed)
        pulls.append((np.array([clock.offset_s, clock.drift]) - truth) / clock.sd)
        sds.append(clock.sd[0])
    assert np.abs(pulls).max() < SDS
    assert np.mean(np.square(pulls)) == pytest.approx(1.0, abs=5 * np.sqrt(2 / (2 * SEEDS)))
    assert max(sds) < 0.02  # a fifth of the potentiometer's own step


def test_a_steady_swing_matches_at_every_period_and_is_refused() -> None:
    t_s = np.arange(0.0, 60.0, 0.1)
    swing = np.sin(2 * np.pi * t_s / 6)
    with pytest.raises(EstimationError, match="alike; narrow search_s"):
        clock_from_match((t_s, swing), (t_s, swing), search_s=(-20, 20))
    near = clock_from_match((t_s + 1.3, swing), (t_s, swing + 1e-3 * np.cos(40 * t_s)), search_s=(-3, 1))
    assert near.offset_s + near.drift * (30 - near.middle_s) == pytest.approx(-1.3, abs=1e-3)


def test_records_of_different_things_are_refused() -> None:
    t_s = np.arange(0.0, 60.0, 0.1)
    draw = np.random.default_rng(3)
    with pytest.raises(EstimationError, match="do not look alike"):
        clock_from_match((t_s, draw.normal(size=600)), (t_s, draw.normal(size=600)), search_s=(-20, 20))
    with pytest.raises(EstimationError, match="overlap by half"):
        clock_from_match((t_s, np.sin(t_s)), (t_s, np.sin(t_s)), search_s=(100, 120))


SETUP = """
[tow]
line_length_m = 0.91
post_m = [0.0, 0.05]
[bar]
lcg_m = 0.0421
station_m = 1.099
hole = 8
[[clock]]
name = "logger"
match = "p2"
search_s = [-6.0, 6.0]
[[channel]]
name = "y1"
measures = "y"
hole = 1
scale = 0.001
sd = 0.001
[[channel]]
name = "y21"
measures = "y"
hole = 21
scale = 0.001
sd = 0.001
[[channel]]
name = "p1"
measures = "alpha"
time = "t_log_s"
clock = "logger"
scale = 0.017453292519943295
zero = 2.5
sd = 0.003
[[channel]]
name = "p2"
measures = "alpha_beta"
time = "t_log_s"
clock = "logger"
scale = 0.017453292519943295
sd = 0.003
[[channel]]
name = "T"
measures = "tension"
sd = 0.05
"""


def write_channels(folder: Path, seed: int) -> pd.DataFrame:
    """Lamps in mm and tension at 20 Hz, potentiometers in degrees at 8 Hz on a logger 2.31 s late that drifts by 80 ppm."""
    draw = np.random.default_rng(seed)
    t_s, own = np.arange(0.0, 40.0, 0.05), np.arange(0.0, 38.0, 0.125)
    truth, seen = tow_at(t_s), tow_at(own + 2.31 + 8e-5 * (own - 19.0))
    columns = {"t_s": t_s}
    for name, hole in (("y1", 1), ("y21", 21)):
        columns[name] = 1e3 * lamp(truth, MARINER.ahead_m(hole))[1] + draw.normal(0, 1.0, len(t_s))
    columns["T"] = 3.96 + draw.normal(0, 0.05, len(t_s))
    alpha, beta = np.degrees(seen["alpha_rad"]).to_numpy(), np.degrees(seen["beta_rad"]).to_numpy()
    noise = np.degrees(draw.normal(0, 0.003, (2, len(own))))
    frame = pd.DataFrame(columns)
    slow = pd.DataFrame({"t_log_s": own, "p1": alpha + 2.5 + noise[0], "p2": alpha + beta + noise[1]})
    pd.concat([frame, slow], axis=1).to_csv(folder / "channels.csv", index=False)
    (folder / "setup.toml").write_text(SETUP)
    return truth


def test_two_rates_and_two_clocks_from_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = write_channels(tmp_path, 5)
    source, setup, out = (str(tmp_path / name) for name in ("channels.csv", "setup.toml", "motion.csv"))
    assert main(["import", source, "--from", "instruments", "--setup", setup, "-o", out]) == 0
    said = capsys.readouterr().out
    assert "clock logger: offset +2.3" in said
    assert "tow point 1.5475 m" in said
    motion = read_motion(out)
    assert np.array_equal(motion["t_s"], np.round(truth["t_s"], 9))
    assert (motion["status"] == "measured").all()
    assert motion["tension_n"].mean() == pytest.approx(3.96, abs=5 * 0.05 / np.sqrt(800))
    both = (motion["t_s"] > 3) & (motion["t_s"] < 39.5)
    for name in ("y_cg_m", "beta_rad", "alpha_rad"):
        error = (motion[name] - truth[name])[both]
        size = np.hypot(motion[f"sigma_{name}"], motion[f"common_{name}"])[both]
        assert 0.8 < np.sqrt(np.mean((error / size) ** 2)) < 1.2, (
            name
        )  # 8 Hz noise in 20 Hz samples: fewer than 730 independent
    # the potentiometers add to what the lamps say
    lamps = (motion["t_s"] < 2) | (motion["t_s"] > 39.8)
    assert motion.loc[both, "sigma_beta_rad"].median() < 0.97 * motion.loc[lamps, "sigma_beta_rad"].median()


# wrong input -------------------------------------------------------------------------------------------------------

WRONG_SETUP = {
    "no such clock": ('clock = "logger"\nscale', 'clock = "loger"\nscale', "clock 'loger' is no"),
    "a match on another clock": ('match = "p2"', 'match = "y1"', "match = 'y1' is no channel on it"),
    "both ways": ('match = "p2"', 'match = "p2"\nevents_s = [[1.0, 2.0]]', "events_s or match is expected"),
    "a lamp nowhere": ("hole = 21\n", "", "hole or ahead_m is expected"),
    "a hole without a bar": ("[bar]\nlcg_m = 0.0421\nstation_m = 1.099\nhole = 8\n", "", "needs"),
    "two of a name": ('name = "p1"', 'name = "p2"', "two are called 'p2'"),
    "an LVDT without its pulley": ('measures = "alpha"', 'measures = "lvdt"', "pulley_m is missing"),
    "a deviation of nothing": ("sd = 0.05", "sd = 0.0", "greater than 0"),
}


@pytest.mark.parametrize("case", [name for name, (old, _, _) in WRONG_SETUP.items() if old in SETUP])
def test_a_wrong_setup_names_its_key(tmp_path: Path, case: str) -> None:
    old, new, said = WRONG_SETUP[case]
    (tmp_path / "setup.toml").write_text(SETUP.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_setup(tmp_path / "setup.toml")
    assert said in str(caught.value)
    assert str(tmp_path / "setup.toml") in str(caught.value)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("t_s,b\n0,1\n0.1,x\n0.2,1\n", "row 2, b: 'x' is not a finite number"),
        ("t_s,b\n0,1\n0.2,2\n0.1,1\n", "row 3, t_s: 0.1 after 0.2; times must rise"),
        ("t_s,b\n0,1\n,2\n0.1,1\n", "row 2, t_s: is empty beside a value of b"),
        ("t_s,c\n0,1\n", "column b: missing; found t_s, c"),
        ("t_s,b\n0,1\n0.1,\n0.2,1\n", "column b: 2 values; at least 4"),
    ],
)
def test_wrong_channels_name_row_and_column(tmp_path: Path, rows: str, said: str) -> None:
    (tmp_path / "channels.csv").write_text(rows)
    setup = setup_of([table("b", "beta")])
    with pytest.raises(InputError) as caught:
        read_channels(tmp_path / "channels.csv", setup)
    assert said in str(caught.value)


def test_channels_that_do_not_fix_the_motion_are_refused() -> None:
    setup = setup_of([table("p1", "alpha"), table("l", "lvdt", pulley_m=PULLEY_M)])
    truth = tow_at(T_S)
    channels = recorded(setup, {one.name: (T_S, reading(setup, one, truth)) for one in setup.channel})
    with pytest.raises(TowlineError, match="never fix y_CG and beta together"):
        motion_from_channels(setup, channels)
