"""A look of one's own, registered here: a dark ring on bright ground, placed by the moments of its darkness. The truth is drawn."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import towline
from towline.cli import main
from towline.record import DatumPoint, InputError, TrackingError
from towline.record.looks import look_of
from towline.record.reference import reference_page
from towline.vision import Frame, Look, Rows, register_tracker
from towline.vision.datum_find import find_datum, register_finder

WIDTH, HEIGHT, RATE_HZ, FRAMES = 240, 180, 25.0, 50
RADIUS_PX, HALF_WIDTH_PX, GROUND_DN, INK_DN, NOISE_DN = 7.0, 1.5, 190.0, 110.0, 2.0
WINDOW_PX = 13
BODY_M = {"bow": (0.06, 0.0), "stern": (-0.06, 0.0)}
"""A pixel is a millimetre: the camera looks straight down."""
RING = Look("ring", words="dark on bright ground", needs={"seen_at_px": "its place in the first analysed frame"})


class Rings(Rows):
    """Every ring from frame to frame, by a window about where it was before."""

    def __init__(self, run, markers, mapping, backend) -> None:
        super().__init__(run, markers)
        self.place = {marker.name: np.array(marker.seen_at_px) for marker in markers}

    def step(self, frame: Frame) -> None:
        if self.damaged(frame):
            return
        for marker in self.markers:
            found = ring_near(frame.luma, self.place[marker.name])
            if found is None:
                self.lost(frame.index, frame.t_s, marker, "no ring")
            else:
                self.place[marker.name] = found[0]
                self.measured(frame.index, frame.t_s, marker, *found)


def ring_near(luma: NDArray[np.uint8], near_px: NDArray) -> tuple[NDArray, NDArray] | None:
    """Centroid of what is darker than the ground, and its standard deviation by the ground's noise; each (2,), px."""
    for _ in range(2):
        u0, v0 = np.rint(near_px).astype(int) - WINDOW_PX
        window = luma[v0 : v0 + 2 * WINDOW_PX + 1, u0 : u0 + 2 * WINDOW_PX + 1].astype(float)
        if min(u0, v0) < 0 or window.shape != (2 * WINDOW_PX + 1,) * 2:
            return None
        v, u = np.mgrid[-WINDOW_PX : WINDOW_PX + 1, -WINDOW_PX : WINDOW_PX + 1]
        ground = window[np.hypot(u, v) > RADIUS_PX + 5]
        dark = np.median(ground) - window
        if dark.sum() < 0.5 * 2 * np.pi * RADIUS_PX * 2 * HALF_WIDTH_PX * INK_DN:
            return None
        near_px = np.array([u0, v0]) + WINDOW_PX + np.array([(dark * u).sum(), (dark * v).sum()]) / dark.sum()
    sigma = float(ground.std() * np.sqrt((u**2).sum()) / dark.sum())
    return near_px, np.array([sigma, sigma])


def true_px(name: str, t_s: float) -> NDArray:
    """(2,) where a ring is: the model turns and sways."""
    beta = 0.15 * np.sin(2.0 * t_s)
    x, y = 1e3 * np.array(BODY_M[name])
    middle = np.array([120.0 + 3 * np.sin(1.3 * t_s), 90.0 + 25 * np.sin(1.7 * t_s)])
    return middle + np.array([np.cos(beta) * x - np.sin(beta) * y, np.sin(beta) * x + np.cos(beta) * y])


def pictures() -> list[NDArray[np.uint8]]:
    """Each pixel the mean of 4 x 4 points of the drawing, with white noise."""
    rng = np.random.default_rng(3)
    v, u = (np.mgrid[0 : 4 * HEIGHT, 0 : 4 * WIDTH] - 1.5) / 4
    found = []
    for index in range(FRAMES):
        fine = np.full(u.shape, GROUND_DN)
        for name in BODY_M:
            at = true_px(name, index / RATE_HZ)
            fine[np.abs(np.hypot(u - at[0], v - at[1]) - RADIUS_PX) < HALF_WIDTH_PX] -= INK_DN
        picture = fine.reshape(HEIGHT, 4, WIDTH, 4).mean(axis=(1, 3)) + rng.normal(0, NOISE_DN, (HEIGHT, WIDTH))
        found.append(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    return found


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two rings, without loss."""
    import av

    path = tmp_path_factory.mktemp("rings") / "rings.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=int(RATE_HZ))
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "gray"
        for picture in pictures():
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="gray")))
        container.mux(stream.encode())
    return path


@pytest.fixture
def run(film: Path, tmp_path: Path) -> Path:
    """A run folder whose run.toml says ``look = "ring"``."""
    (tmp_path / "rings.mkv").write_bytes(film.read_bytes())
    text = 'name = "rings"\nkind = "free"\n[source]\nvideo = "rings.mkv"\n'
    for px, py in ((10, 10), (230, 10), (10, 170), (230, 170)):
        text += f"[[datum]]\npixel_px = [{px}.0, {py}.0]\ntank_m = [{px / 1000}, {py / 1000}, 0.0]\nsigma_px = 0.05\n"
    for name, body in BODY_M.items():
        u, v = np.rint(true_px(name, 0.0))
        text += f'[[marker]]\nname = "{name}"\nbody_m = {list(body)}\ndepth_m = 0.0\nlook = "ring"\nseen_at_px = [{u}, {v}]\n'
    (tmp_path / "run.toml").write_text(text)
    return tmp_path


@pytest.fixture
def ring(registries: None) -> None:
    register_tracker(RING)(Rings)


def test_a_registered_look_is_tracked_to_its_sigma(ring: None, run: Path) -> None:
    """Errors in units of the stated sigma: rms 1 within 3 standard errors of 200 of them."""
    tracks = towline.track(run)
    assert (tracks.status == "measured").all()
    assert len(tracks) == 2 * FRAMES
    truth = np.array([true_px(name, t_s) for name, t_s in zip(tracks.marker, tracks.t_s, strict=True)])
    pulls = (tracks[["u_px", "v_px"]] - truth).to_numpy() / tracks[["sigma_u_px", "sigma_v_px"]].to_numpy()
    assert np.sqrt((pulls**2).mean()) == pytest.approx(1.0, abs=3 / np.sqrt(2 * pulls.size))
    assert tracks[["sigma_u_px", "sigma_v_px"]].to_numpy().max() < 0.1


def test_the_motion_of_registered_marks_is_the_models(ring: None, run: Path) -> None:
    motion = towline.compute_motion(run)
    beta = 0.15 * np.sin(2.0 * motion.t_s)
    assert np.sqrt((((motion.beta_rad - beta) / motion.sigma_beta_rad) ** 2).mean()) < 1.5


def test_the_command_and_the_pages_know_it(ring: None, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["track", str(run)]) == 0
    assert "bow measured in 100.00 % of 50 frames" in capsys.readouterr().out
    assert (run / "out" / "overlay.mp4").is_file()
    listed = r"\| aruco:N \| apriltag:N \| ring (dark on bright ground) |"
    assert reference_page().count(listed) == 2  # run.toml's and scenario.toml's markers
    assert "needed for template and ring, helps the others" in reference_page()


def test_what_it_needs_is_asked_for(ring: None, run: Path) -> None:
    path = run / "run.toml"
    whole = path.read_text()
    path.write_text(re.sub(r"seen_at_px = .*\n", "", whole))
    with pytest.raises(InputError, match=r'look = "ring" needs seen_at_px, its place in the first analysed frame'):
        towline.track(run)
    path.write_text(whole.replace('look = "ring"', 'look = "rink"'))
    with pytest.raises(InputError, match=r"expected led, disc, template, .*aruco:N, apriltag:N or ring"):
        towline.track(run)


def test_a_mark_that_is_not_there_is_one_line(ring: None, run: Path) -> None:
    path = run / "run.toml"
    path.write_text(re.sub(r"seen_at_px = .*", "seen_at_px = [20.0, 20.0]", path.read_text(), count=1))
    with pytest.raises(TrackingError, match=r"marker 'bow' \(ring\) was never followed"):
        towline.track(run)


def test_other_code_tracks_anew(ring: None, run: Path) -> None:
    """Tracks are kept until the module that follows the look is another."""
    towline.track(run)
    path = run / "out" / "tracks.csv"
    kept = path.stat().st_mtime_ns
    towline.track(run)
    assert path.stat().st_mtime_ns == kept

    @register_tracker("ring")
    class Elsewhere(Rings):
        __module__ = "colorsys"  # another module, with a source of its own

    towline.track(run)
    assert path.stat().st_mtime_ns > kept


def test_a_datum_point_may_have_one_too(registries: None) -> None:
    """Found within 4 standard deviations, in one frame, from a pick that is 3 px off."""

    @register_finder(Look("ring", words="dark on bright ground"))
    class RingPoints:
        reason = "no ring near pixel_px"

        def __init__(self, points, white_dn, lens) -> None:
            self.near = [np.array(point.pixel_px) for point in points]

        def look(self, number, luma):
            nowhere = (np.full(2, np.nan),) * 2
            found = [ring_near(luma, near) or nowhere for near in self.near]
            return np.array([place for place, _ in found]), np.array([sigma for _, sigma in found])

    truth = true_px("bow", 0.0)
    picks = {"there": truth + np.array([2.0, -2.0]), "nowhere": np.array([30.0, 30.0])}
    points = [
        DatumPoint(name=name, pixel_px=(float(u), float(v)), tank_m=(0.0, 0.0, 0.0), look="ring")
        for name, (u, v) in picks.items()
    ]
    there, nowhere = find_datum(points, pictures()[:1]).points
    assert there is not None
    assert np.abs(there.pixel_px - truth).max() < 4 * there.sigma_px < 0.4
    assert nowhere is not None
    assert nowhere.reason == "no ring near pixel_px"
    with pytest.raises(ValueError, match=r"CORNER \(0\.\.3\), checker:COLSxROWS:I,J or ring"):
        DatumPoint(name="x", pixel_px=(0.0, 0.0), tank_m=(0.0, 0.0, 0.0), look="rink")


@pytest.mark.slow
def test_an_installed_package_brings_it_to_the_command(run: Path, tmp_path: Path) -> None:
    """By an entry point, in a process that nobody told of it."""
    brought = tmp_path / "packages"
    (brought / "rings-1.dist-info").mkdir(parents=True)
    (brought / "rings-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: rings\nVersion: 1\n")
    (brought / "rings-1.dist-info" / "entry_points.txt").write_text("[towline.looks]\nring = rings\n")
    (brought / "rings.py").write_text(
        f"import sys\nsys.path.append({str(Path(__file__).parent)!r})\nfrom test_looks import *\nregister_tracker(RING)(Rings)\n"
    )
    paths = os.pathsep.join([str(brought), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-m", "towline", "track", str(run), "--no-overlay"]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": paths}, timeout=120
    )
    assert "stern measured in 100.00 % of 50 frames" in done.stdout, done.stderr
    (brought / "rings.py").write_text("import nothing_of_this_name\n")
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": paths}, timeout=120
    )
    assert done.returncode == 1
    assert done.stderr.startswith("towline: error: entry point towline.looks ring: ModuleNotFoundError"), done.stderr


def test_the_table_is_as_it_was_without_it() -> None:
    assert look_of("ring") is None
    assert look_of("aruco:7") is not None
    with pytest.raises(ValueError, match="no look is called 'ring'"):
        register_tracker("ring")(Rings)


def test_a_look_without_a_tracker_is_one_line(registries: None, run: Path) -> None:
    from towline.record.looks import register_look

    register_look(RING)
    with pytest.raises(InputError, match=r"marker 'bow'\.look: 'ring': no tracker is registered"):
        towline.track(run)


def test_a_spot_of_another_name_is_followed_with_the_leds(registries: None, run_folder: Path) -> None:
    """One tracker for both: a spot alone would be refused."""
    from towline.vision.looks import TRACKERS

    spots = TRACKERS.get("led")
    assert spots is not None
    register_tracker(Look("bulb", spot=True))(spots.begin)
    path = run_folder / "run.toml"
    text = path.read_text().replace('look = "led"', 'look = "bulb"', 1)
    path.write_text(text.replace("[camera]", "span_s = [0.0, 1.0]\n[camera]", 1))
    assert (towline.track(run_folder).status == "measured").mean() > 0.9


def test_a_registered_look_begins_anew_at_a_seed(ring: None, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Both rings are sent astray by a wrong first place; from the seeds on they are where they are drawn."""
    text = (run / "run.toml").read_text()
    for name in BODY_M:
        u, v = np.rint(true_px(name, 0.0))
        text = text.replace(f"seen_at_px = [{u}, {v}]", "seen_at_px = [120.0, 30.0]")
    (run / "run.toml").write_text(text)
    one, two = (f"{name}={','.join(f'{c:.0f}' for c in true_px(name, 20 / RATE_HZ))}" for name in BODY_M)
    assert main(["track", str(run), "--no-overlay", "--from", "20", "--seed", one]) == 1
    assert (
        "'stern' (ring) is not seen in frame 20, where others are seeded: give it a seed too" in capsys.readouterr().err
    )
    assert main(["track", str(run), "--no-overlay", "--from", "20", "--seed", one, "--seed", two]) == 0
    tracks = towline.track(run)
    assert (tracks[tracks.frame < 20].status == "lost").all()
    late = tracks[tracks.frame >= 20]
    assert (late.status == "measured").all()
    truth = np.array([true_px(name, t_s) for name, t_s in zip(late.marker, late.t_s, strict=True)])
    pulls = (late[["u_px", "v_px"]] - truth).to_numpy() / late[["sigma_u_px", "sigma_v_px"]].to_numpy()
    assert np.sqrt((pulls**2).mean()) == pytest.approx(1.0, abs=4 / np.sqrt(2 * pulls.size))
