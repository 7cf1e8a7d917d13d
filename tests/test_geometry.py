"""Geometry against cameras whose place is known: exact places, true uncertainties, the thesis's trapezoid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from towline.geometry import Camera, Lens, fit_datum, fit_rigid, motion_from_tracks, run_datum, trapezoid_from_datum
from towline.geometry.linear import focal_from_plane, plane_matrix, pose_start
from towline.geometry.trapezoid import TrapezoidMapping
from towline.record import CameraTable, DatumPoint, GeometryError, InputError, Marker, Run, RunFile, read_run
from towline.record.toml import check_tables

SIZE = (960, 720)
TOP = [(x, y, 0.0) for x in (-0.6, -2.3, -4.0) for y in (-0.9, 0.9)]
LOW = [(x, y, 0.25) for x in (-0.6, -4.0) for y in (-0.9, 0.9)]


def camera(roll_rad: float = 0.02, yaw_m: float = 0.2, k1: float = -0.08, height_m: float = 1.9) -> Camera:
    lens = Lens(900.0, 905.0, 470.0, 365.0, np.array([k1, 0.01, 1e-3, -5e-4, 0.0]))
    return Camera.looking_at(lens, np.array([-5.2, 0.1, -height_m]), np.array([-2.4, 0.1 + yaw_m, 0.1]), roll_rad)


def table(seen: Camera) -> CameraTable:
    lens = seen.lens
    return CameraTable(
        image_size_px=SIZE,
        fx_px=lens.fx_px,
        fy_px=lens.fy_px,
        cx_px=lens.cx_px,
        cy_px=lens.cy_px,
        distortion=tuple(float(x) for x in lens.distortion),  # pyright: ignore
    )


def picks(seen: Camera, places: list[tuple[float, float, float]], noise: np.ndarray | None = None) -> list[DatumPoint]:
    pixel = seen.project(np.array(places))
    if noise is not None:
        pixel = pixel + noise
    return [
        DatumPoint(name=f"p{i}", pixel_px=(float(u), float(v)), tank_m=place, sigma_px=0.15)
        for i, (place, (u, v)) in enumerate(zip(places, pixel, strict=True))
    ]


def test_the_camera_is_opencvs() -> None:
    import cv2

    seen = camera(k1=-0.25)
    points = np.random.default_rng(1).uniform([-4, -0.9, 0], [-0.6, 0.9, 0.4], (60, 3))
    theirs, _ = cv2.projectPoints(
        points, cv2.Rodrigues(seen.rotation)[0], seen.translation, seen.lens.matrix, seen.lens.distortion
    )
    np.testing.assert_allclose(seen.project(points), theirs[:, 0], atol=1e-9)


@pytest.mark.parametrize("k1", [-0.3, -0.05, 0.0, 0.3])
def test_undistortion_inverts_distortion_and_its_slope_is_true(k1: float) -> None:
    lens = Lens(900.0, 900.0, 480.0, 360.0, np.array([k1, 0.02, 1e-3, -1e-3, 0.0]))
    ideal = np.random.default_rng(2).uniform(-0.45, 0.45, (200, 2))
    pixel = lens.distort(ideal)
    back, slope = lens.normalise(pixel)
    np.testing.assert_allclose(back, ideal, atol=1e-12)
    step = 1e-3
    for axis in range(2):
        moved = np.zeros(2)
        moved[axis] = step
        difference = (lens.normalise(pixel + moved)[0] - lens.normalise(pixel - moved)[0]) / (2 * step)
        np.testing.assert_allclose(slope[:, :, axis], difference, atol=1e-9)


def test_a_folding_lens_is_named() -> None:
    with pytest.raises(GeometryError, match="folds over"):
        Lens(500.0, 500.0, 480.0, 360.0, np.array([-0.6, 0, 0, 0, 0])).normalise(np.array([[5.0, 5.0]]))


@pytest.mark.parametrize("way", ["pose", "two_planes", "homography", "square_pixels"])
def test_exact_places_from_exact_picks(way: str) -> None:
    """Each way returns the truth from picks without error where its assumptions hold (square pixels, centred, no lens)."""
    lens = Lens(900.0, 900.0, (SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2)
    seen = camera() if way == "pose" else replace(camera(), lens=lens)
    places = TOP + (LOW if way == "two_planes" else [])
    depth = 0.0 if way == "homography" else 0.17
    fit = fit_datum(picks(seen, places), table(seen) if way == "pose" else None, [depth], SIZE)
    assert fit.mapping.method == way
    truth = np.random.default_rng(3).uniform([-4, -0.8], [-0.6, 0.8], (40, 2))
    points = np.column_stack([truth, np.full(40, depth)])
    found = fit.mapping.to_tank(seen.project(points), depth)
    np.testing.assert_allclose(found.xy_m, truth, atol=2e-8)
    np.testing.assert_allclose(fit.mapping.to_pixel(points), seen.project(points), atol=1e-5)


def test_place_derivatives_against_differences() -> None:
    seen = camera()
    fit = fit_datum(picks(seen, TOP), table(seen), [0.17])
    pixel = seen.project(np.array([[-2.0, 0.4, 0.17], [-3.5, -0.6, 0.17]]))
    found = fit.mapping.to_tank(pixel, 0.17)
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = 1e-3
        up, down = (fit.mapping.to_tank(pixel + s * step, 0.17).xy_m for s in (1, -1))
        np.testing.assert_allclose(found.per_px[:, :, axis], (up - down) / 2e-3, rtol=1e-6, atol=1e-10)
    for k in range(len(found.modes_m)):
        up, down = (
            replace(fit.mapping, matrix=fit.mapping.matrix + s * 1e-3 * fit.mapping.matrix_modes[k])
            .to_tank(pixel, 0.17)
            .xy_m
            for s in (1, -1)
        )
        np.testing.assert_allclose(found.modes_m[k], (up - down) / 2e-3, rtol=1e-4, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["pose", "two_planes"])
def test_the_common_uncertainty_is_true_over_many_picks(way: str) -> None:
    """Standardised errors of places over 300 draws of the picks: std 1 within 4 standard errors (1/sqrt(2 n) each)."""
    rng = np.random.default_rng(11)
    lens = Lens(900.0, 900.0, 470.0, 365.0)
    seen = camera() if way == "pose" else replace(camera(), lens=lens)
    places = TOP + (LOW if way == "two_planes" else [])
    truth = np.array([[-1.2, 0.3, 0.17], [-3.4, -0.5, 0.17]])
    pixel = seen.project(truth)
    scores, inside = [], 0
    draws = 300
    for _ in range(draws):
        noise = rng.normal(0, 0.15, (len(places), 2))
        fit = fit_datum(picks(seen, places, noise), table(seen) if way == "pose" else None, [0.17], SIZE)
        found = fit.mapping.to_tank(pixel, 0.17)
        covariance = np.einsum("kni,knj->nij", found.modes_m, found.modes_m)
        gap = found.xy_m - truth[:, :2]
        scores.append(gap / np.sqrt(np.einsum("nii->ni", covariance)))
        inside += int((np.einsum("ni,nij,nj->n", gap, np.linalg.inv(covariance), gap) < 5.991).sum())
    std = np.std(np.array(scores), axis=0)
    assert (np.abs(std - 1) < 4 / np.sqrt(2 * draws)).all(), std
    share = inside / (2 * draws)
    assert abs(share - 0.95) < 4 * np.sqrt(0.95 * 0.05 / draws), share


@pytest.mark.parametrize("bad", range(6))
def test_a_badly_picked_point_is_left_out_by_name(bad: int) -> None:
    """What is left is a camera as good as one from five good points."""
    seen = camera()
    noise = np.zeros((6, 2))
    noise[bad] = [6.0, -5.0]
    points = picks(seen, TOP, noise)
    fit = fit_datum(points, table(seen), [0.17])
    assert fit.excluded == (bad,)
    assert any(f"p{bad}" in note and "7.8" in note and "mm" in note for note in fit.notes)
    np.testing.assert_allclose(fit.residual_px[bad], noise[bad], atol=1e-6)
    stands = seen.project(np.array([[*TOP[bad][:2], 0.0]]))[0] + noise[bad]
    apart = fit.mapping.to_tank(stands[None], 0.0).xy_m[0] - TOP[bad][:2]
    np.testing.assert_allclose(fit.residual_m[bad], apart, atol=1e-9)
    assert fit.rms_px < 1e-6


def test_two_badly_picked_points_are_left_out_by_consensus() -> None:
    seen = camera(k1=0.0)
    places = [(x, y, 0.0) for x in (-0.6, -1.5, -2.3, -3.2, -4.0) for y in (-0.9, 0.9)]
    noise = np.zeros((10, 2))
    noise[2], noise[7] = [9.0, 4.0], [-7.0, 6.0]
    assert fit_datum(picks(seen, places, noise), table(seen), [0.17]).excluded == (2, 7)


def test_without_points_to_spare_a_bad_one_widens_the_camera() -> None:
    """Four points and a lens leave two degrees of freedom: that something is wrong shows, not what."""
    seen = camera()
    four = [TOP[i] for i in (0, 1, 4, 5)]
    noise = np.zeros((4, 2))
    noise[3] = [6.0, -5.0]
    fit = fit_datum(picks(seen, four, noise), table(seen), [0.17])
    assert fit.excluded == ()
    assert any("largest at" in note for note in fit.notes)
    good = fit_datum(picks(seen, four), table(seen), [0.17])
    assert np.linalg.norm(fit.mapping.matrix_modes) > 5 * np.linalg.norm(good.mapping.matrix_modes)


def test_errors_of_the_points_own_places_widen_the_camera() -> None:
    """1 mm on the tank top is about 0.4 px here: beside picks of 0.15 px the camera's scatter must grow, and be stated."""
    seen = camera()
    rng = np.random.default_rng(8)
    scores = []
    for _ in range(80):
        moved = [(x + e, y + f, 0.0) for (x, y, _), (e, f) in zip(TOP, rng.normal(0, 1e-3, (6, 2)), strict=True)]
        points = picks(seen, moved, rng.normal(0, 0.15, (6, 2)))
        told = [p.model_copy(update={"tank_m": t, "tank_sd_m": 1e-3}) for p, t in zip(points, TOP, strict=True)]
        place = np.array([[-2.4, 0.2, 0.17]])
        found = fit_datum(told, table(seen), [0.17]).mapping.to_tank(seen.project(place), 0.17)
        scores.append((found.xy_m[0] - place[0, :2]) / np.sqrt((found.modes_m[:, 0] ** 2).sum(axis=0)))
    assert (np.abs(np.std(scores, axis=0) - 1) < 4 / np.sqrt(160)).all(), np.std(scores, axis=0)


def test_marks_on_the_post_give_the_carriage() -> None:
    """The camera is fixed to the tank, the carriage drives by at 0.1 m/s: the model's motion against it comes out."""
    seen = camera()
    run = run_of(seen, picks(seen, TOP), Path(), post_m=[0.05, 0.12])
    post = Marker(name="post", body_m=(-0.3, 0.2), depth_m=0.0, on="post")
    file = run.file.model_copy(update={"marker": (*run.file.marker, post)})
    moving = Run(run.folder, file)
    t = np.arange(60) / 25
    pose = np.column_stack([np.full(60, -2.35), 0.1 * np.sin(t), 0.05 * np.cos(t)])
    gone = np.column_stack([0.1 * t - 0.1, np.zeros((60, 2))])
    rng = np.random.default_rng(3)
    hull = tracks_of(seen, run, pose + gone, 0.0, rng)
    mark = tracks_of(
        seen, Run(run.folder, file.model_copy(update={"marker": (post,)})), gone + np.array([0.05, 0.12, 0.0]), 0.0, rng
    )
    made = motion_from_tracks(moving, pd.concat([hull, mark]), run_datum(moving, None)).motion
    np.testing.assert_allclose(made[["x_cg_m", "y_cg_m", "beta_rad"]], pose, atol=1e-6)
    still = motion_from_tracks(run, hull, run_datum(run, None)).motion
    assert (made["sigma_y_cg_m"] > still["sigma_y_cg_m"]).all()  # the carriage's own mark is measured too
    lost = mark.assign(status=np.where(mark["frame"] < 5, "lost", "measured"))
    made = motion_from_tracks(moving, pd.concat([hull, lost]), run_datum(moving, None)).motion
    assert list(made["status"]) == ["lost"] * 5 + ["measured"] * 55


def test_a_datum_that_does_not_fix_the_camera_is_refused() -> None:
    seen = camera()
    line = [(-0.6, -0.9, 0.0), (-0.6, 0.0, 0.0), (-0.6, 0.9, 0.0), (-4.0, 0.9, 0.0)]
    with pytest.raises(GeometryError, match="do not fix the camera"):
        fit_datum(picks(seen, line), None, [0.0], SIZE)
    with pytest.raises(GeometryError, match="picture's size is not known"):
        fit_datum(picks(seen, TOP), None, [0.2])
    with pytest.raises(GeometryError, match="no camera pose fits"):  # all seen at one place
        pose_start(np.array(TOP), np.zeros((len(TOP), 2)))


@pytest.mark.parametrize("offset_m", [0.0, 0.35, -0.6])
def test_the_trapezoid_is_the_homography_without_roll_and_yaw(offset_m: float) -> None:
    """(AII-2), (AII-5): exact for a camera level across the channel and along it; an offset from the axis does no harm."""
    lens = Lens(900.0, 900.0, 479.5, 359.5)
    seen = Camera.looking_at(lens, np.array([-5.0, offset_m, -2.0]), np.array([-2.4, offset_m, 0.0]))
    corners = [(x, y, 0.0) for x in (-0.6, -4.0) for y in (-0.9, 0.9)]
    points = picks(seen, corners)
    fit = fit_datum(points, table(seen), [0.0])
    trapezoid, _ = trapezoid_from_datum(points, fit.mapping)
    # the outermost of several rectangles, whatever their order
    for places in (
        TOP,
        TOP[::-1],
        [*corners, (-2.0, -0.5, 0.0), (-2.0, 0.5, 0.0), (-1.0, -0.5, 0.0), (-1.0, 0.5, 0.0)],
    ):
        widest, _ = trapezoid_from_datum(picks(seen, places), fit.mapping)
        assert {widest.far_x_m, widest.near_x_m} == {-0.6, -4.0}
        assert (widest.left_y_m, widest.right_y_m) == (-0.9, 0.9)
    truth = np.random.default_rng(5).uniform([-4, -0.9], [-0.6, 0.9], (50, 2))
    pixel = seen.project(np.column_stack([truth, np.zeros(50)]))
    assert np.abs(trapezoid.place(pixel, 0.0) - truth).max() < 1e-9


@pytest.mark.parametrize(
    ("axis", "least_m", "most_m"),
    [("optical", 0.0, 1e-9), ("along", 1e-3, 0.025), ("down", 1e-3, 0.025)],
)
def test_what_a_degree_of_roll_or_yaw_costs_the_trapezoid(axis: str, least_m: float, most_m: float) -> None:
    """theory.md 4 gives 25 mm (roll) and 10 mm (yaw) on a 3 m frame for distances taken along the picture's own axes.

    Here they are taken along and across the strings as they are seen, so a picture turned about the optical axis costs
    nothing, and a camera turned against the channel no more than the theory's largest figure.
    """
    from scipy.spatial.transform import Rotation

    lens = Lens(900.0, 900.0, 479.5, 359.5)
    place = np.array([-4.6, 0.0, -2.6])
    level = Camera.looking_at(lens, place, np.array([-2.0, 0.0, 0.0]))
    axes = {"optical": level.rotation[2], "along": np.array([1.0, 0, 0]), "down": np.array([0, 0, 1.0])}
    rotation = level.rotation @ Rotation.from_rotvec(np.radians(1.0) * axes[axis]).as_matrix()
    seen = Camera(lens, rotation, -rotation @ place)
    points = picks(seen, [(x, y, 0.0) for x in (-0.5, -3.5) for y in (-0.9, 0.9)])
    trapezoid, _ = trapezoid_from_datum(points, fit_datum(points, table(seen), [0.0]).mapping)
    truth = np.random.default_rng(5).uniform([-3.5, -0.9], [-0.5, 0.9], (200, 2))
    pixel = seen.project(np.column_stack([truth, np.zeros(len(truth))]))
    assert least_m <= np.abs(trapezoid.place(pixel, 0.0) - truth).max() < most_m


def test_the_deck_shift_ranks_as_in_the_theory() -> None:
    """theory.md 9.9, a 45 degree camera, d'' 0.17, D'' 0.25 m: nothing >> shift of d13, d23 > corners moved > H(z) = 0."""
    lens = Lens(900.0, 900.0, 479.5, 359.5)
    seen = Camera.looking_at(lens, np.array([-4.8, 0.0, -2.6]), np.array([-2.2, 0.0, 0.0]))
    corners = [(x, y, z) for z in (0.0, 0.25) for x in (-0.6, -4.0) for y in (-0.9, 0.9)]
    points = picks(seen, corners)
    fit = fit_datum(points, table(seen), [0.17])
    trapezoid, _ = trapezoid_from_datum(points, fit.mapping)
    truth = np.random.default_rng(6).uniform([-3.8, -0.7], [-0.8, 0.7], (200, 2))
    pixel = seen.project(np.column_stack([truth, np.full(200, 0.17)]))

    def worst(found: np.ndarray) -> np.ndarray:
        return np.abs(found - truth).max(axis=0)

    nothing, shifted = worst(trapezoid.place(pixel, 0.0)), worst(trapezoid.place(pixel, 0.17))
    moved, exact = worst(trapezoid.place(pixel, 0.17, move_corners=True)), worst(fit.mapping.to_tank(pixel, 0.17).xy_m)
    assert moved.max() < shifted.max() < nothing.max()
    assert exact.max() < 1e-8


def carried(pose: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Where points of the model stand in the tank, (n, m, 2), at poses (n, 3)."""
    cosine, sine = np.cos(pose[:, 2])[:, None], np.sin(pose[:, 2])[:, None]
    along = pose[:, :1] + cosine * body[:, 0] - sine * body[:, 1]
    return np.stack([along, pose[:, 1:2] + sine * body[:, 0] + cosine * body[:, 1]], axis=2)


def test_rigid_fit_against_closed_form_and_its_covariance() -> None:
    rng = np.random.default_rng(7)
    body = np.array([[1.2, 0.0], [-1.1, 0.1], [0.1, -0.2]])
    pose = np.column_stack([rng.uniform(-3, -2, 2000), rng.uniform(-0.5, 0.5, 2000), rng.uniform(-0.6, 0.6, 2000)])
    place = carried(pose, body)
    root = np.array([[1e-3, 0.0], [5e-4, 8e-4]])
    covariance = np.broadcast_to(root @ root.T, (2000, 3, 2, 2))
    exact = fit_rigid(place, covariance, body)
    np.testing.assert_allclose(exact.pose, pose, atol=1e-12)
    noisy = place + rng.normal(size=place.shape) @ root.T
    noisy[::10, 2] = np.nan
    noisy[5, :2] = np.nan
    found = fit_rigid(noisy, covariance, body)
    assert np.isnan(found.pose[5]).all()
    good = found.seen >= 2
    score = (found.pose - pose)[good] / np.sqrt(np.einsum("nii->ni", found.covariance))[good]
    assert (np.abs(score.std(axis=0) - 1) < 4 / np.sqrt(2 * good.sum())).all()
    assert found.chi_square[good].mean() == pytest.approx((2 * found.seen[good] - 3).mean(), rel=0.1)


def test_the_pose_is_exact_for_exact_places() -> None:
    """Marks beside the origin and off the axis, one of three hidden in some frames."""
    rng = np.random.default_rng(8)
    body = np.array([[1.2, 0.3], [-0.9, -0.1], [0.4, 0.5]])
    pose = np.column_stack([rng.uniform(-3, 3, 40), rng.uniform(-1, 1, 40), rng.uniform(-3, 3, 40)])
    place = carried(pose, body)
    place[::4, 1] = np.nan
    found = fit_rigid(place, np.tile(1e-6 * np.eye(2), (40, 3, 1, 1)), body)
    np.testing.assert_allclose(found.pose, pose, atol=1e-12)


def run_of(seen: Camera, points: list[DatumPoint], folder: Path, **tow) -> Run:
    content = {
        "name": "g",
        "source": {"tracks": "tracks.csv"},
        "camera": table(seen).model_dump(),
        "datum": [p.model_dump() for p in points],
        "marker": [
            {"name": "bow", "body_m": [1.2, 0.0], "depth_m": 0.12},
            {"name": "stern", "body_m": [-1.1, 0.0], "depth_m": 0.15},
        ],
        "tow": {"speed_m_s": 1.28, "line_length_m": 0.91, "tow_point_m": 1.5, "tension_n": 4.0} | tow,
        "model": {"length_pp_m": 2.66, "mass_kg": 78.0},
        "water": {},
    }
    return Run(folder, check_tables(content, RunFile, folder / "run.toml"))


def tracks_of(seen: Camera, run: Run, pose: np.ndarray, noise_px: float, rng: np.random.Generator) -> pd.DataFrame:
    frames = []
    for marker in run.file.marker:
        across = carried(pose, np.array([marker.body_m]))[:, 0]
        place = np.column_stack([across, np.full(len(pose), marker.depth_m)])
        pixel = seen.project(place) + rng.normal(0, noise_px, (len(pose), 2)) if noise_px else seen.project(place)
        frames.append(
            pd.DataFrame(
                {
                    "frame": np.arange(len(pose)),
                    "t_s": np.arange(len(pose)) / 25,
                    "marker": marker.name,
                    "u_px": pixel[:, 0],
                    "v_px": pixel[:, 1],
                    "sigma_u_px": noise_px or 0.05,
                    "sigma_v_px": noise_px or 0.05,
                    "status": "measured",
                }
            )
        )
    return pd.concat(frames)


def test_tracks_whose_times_fall_have_no_motion(tmp_path: Path) -> None:
    seen = camera()
    run = run_of(seen, picks(seen, TOP), tmp_path)
    pose = np.column_stack([np.full(12, -2.4), np.linspace(-0.1, 0.1, 12), np.zeros(12)])
    tracks = tracks_of(seen, run, pose, 0.0, np.random.default_rng(0))
    for times, place in ((tracks["t_s"].max() - tracks["t_s"], 1), (tracks["t_s"].clip(upper=0.2), 6)):
        with pytest.raises(InputError, match=f"frame {place}, t_s: .*times must rise strictly"):
            motion_from_tracks(run, tracks.assign(t_s=times), run_datum(run, None))


@pytest.mark.parametrize("post_y_m", [0.0, 0.12])
def test_motion_of_a_known_pose_with_offset_tow_point(tmp_path: Path, post_y_m: float) -> None:
    """alpha from the reconstructed tow point: the pose is made from alpha by (2.10) with Y_T and a post off the axis."""
    seen = camera()
    run = run_of(seen, picks(seen, TOP), tmp_path, tow_point_offset_m=0.03, post_m=[0.05, post_y_m])
    alpha, beta = np.linspace(-0.5, 0.6, 30), np.linspace(0.2, -0.15, 30)
    x = 0.05 - 0.91 * np.cos(alpha) - 1.5 * np.cos(beta) + 0.03 * np.sin(beta)
    y = post_y_m + 0.91 * np.sin(alpha) - 1.5 * np.sin(beta) - 0.03 * np.cos(beta)
    pose = np.column_stack([x, y, beta])
    made = motion_from_tracks(run, tracks_of(seen, run, pose, 0.0, np.random.default_rng(0)), run_datum(run, None))
    np.testing.assert_allclose(made.motion["alpha_rad"], alpha, atol=1e-7)
    np.testing.assert_allclose(made.motion[["x_cg_m", "y_cg_m", "beta_rad"]], pose, atol=1e-7)
    assert abs(made.camera.invariants["taut line"].value) < 1e-7
    assert abs(made.camera.invariants["distance bow-stern"].value) < 1e-7


def test_frame_and_common_parts_are_true(tmp_path: Path) -> None:
    """y_CG, beta, alpha over 150 draws of picks and noise: frame part by its scatter, common part by the run's mean error."""
    rng = np.random.default_rng(21)
    seen = camera()
    beta = np.radians(np.linspace(-8, 8, 40))
    alpha = np.linspace(0.3, -0.3, 40)
    pose = np.column_stack(
        [-0.91 * np.cos(alpha) - 1.5 * np.cos(beta), 0.91 * np.sin(alpha) - 1.5 * np.sin(beta), beta]
    )
    truth = np.column_stack([pose[:, 1], beta, alpha])
    frame_scores, common_scores = [], []
    draws = 150
    for _ in range(draws):
        run = run_of(seen, picks(seen, TOP, rng.normal(0, 0.15, (6, 2))), tmp_path)
        made = motion_from_tracks(run, tracks_of(seen, run, pose, 0.08, rng), run_datum(run, None))
        gap = made.motion[["y_cg_m", "beta_rad", "alpha_rad"]].to_numpy() - truth
        frame_sd = made.motion[["sigma_y_cg_m", "sigma_beta_rad", "sigma_alpha_rad"]].to_numpy()
        frame_scores.append(np.diff(gap, axis=0) / np.hypot(frame_sd[1:], frame_sd[:-1]))
        mean_mode = made.common.mean(axis=1)
        mean_sd = np.sqrt((mean_mode**2).sum(axis=0) + (frame_sd**2).mean(axis=0) / len(gap))
        common_scores.append(gap.mean(axis=0) / mean_sd)
    frame_std = np.std(np.array(frame_scores), axis=(0, 1))
    common_std = np.std(np.array(common_scores), axis=0)
    assert (np.abs(frame_std - 1) < 0.03).all(), frame_std  # 6000 differences, neighbours correlated: 4 standard errors
    assert (np.abs(common_std - 1) < 4 / np.sqrt(2 * draws)).all(), common_std


def test_lost_marks_stay_lost(tmp_path: Path) -> None:
    seen = camera()
    run = run_of(seen, picks(seen, TOP), tmp_path)
    pose = np.column_stack([np.full(10, -2.4), np.linspace(0, 0.1, 10), np.zeros(10)])
    tracks = tracks_of(seen, run, pose, 0.0, np.random.default_rng(0)).reset_index(drop=True)
    hidden = (tracks["marker"] == "bow") & tracks["frame"].between(3, 5)
    tracks.loc[hidden, ["u_px", "v_px"]] = np.nan
    tracks.loc[hidden, "status"] = "lost"
    made = motion_from_tracks(run, tracks, run_datum(run, None))
    assert list(made.motion["status"]) == ["measured"] * 3 + ["lost"] * 3 + ["measured"] * 4
    assert made.motion.loc[3:5, ["y_cg_m", "beta_rad", "alpha_rad", "sigma_y_cg_m"]].isna().all().all()
    tracks["status"] = "lost"
    with pytest.raises(InputError, match="no frame shows two markers"):
        motion_from_tracks(run, tracks, run_datum(run, None))


def test_a_mark_seen_alone_does_not_spoil_the_stated_uncertainty(tmp_path: Path) -> None:
    """Marks' own places on the hull err along a heading; where one mark is seen there is none; the others say what it costs."""
    seen = camera()
    run = run_of(seen, picks(seen, TOP), tmp_path)
    pose = np.column_stack([np.full(10, -2.4), np.linspace(0, 0.1, 10), np.zeros(10)])
    tracks = tracks_of(seen, run, pose, 0.0, np.random.default_rng(0)).reset_index(drop=True)
    sure = {"marker_place_sd_m": 1e-3, "marker_depth_sd_m": 1e-3}
    run = replace(run, file=run.file.model_copy(update={"priors": run.file.priors.model_copy(update=sure)}))
    whole = motion_from_tracks(run, tracks, run_datum(run, None)).camera.uncertainty_mm
    hidden = (tracks["marker"] == "stern") & tracks["frame"].between(4, 4)
    tracks.loc[hidden, ["u_px", "v_px"]] = np.nan
    tracks.loc[hidden, "status"] = "lost"
    stated = motion_from_tracks(run, tracks, run_datum(run, None)).camera.uncertainty_mm
    assert stated.keys() == whole.keys()
    for name, value in stated.items():
        assert value == pytest.approx(whole[name], rel=0.2)


def test_true_pixels_of_the_film_give_its_motion(shared: Path) -> None:
    """What is left is the picks of the datum (0.15 px): 0.34 mm, 0.004 and 0.014 degrees by the issue's own account."""
    run = read_run(shared / "film")
    truth = pd.read_csv(shared / "film" / "truth.csv")
    tracks = pd.concat(
        pd.DataFrame(
            {
                "frame": np.arange(len(truth)),
                "t_s": truth["t_s"],
                "marker": name,
                "u_px": truth[f"{name}_u"],
                "v_px": truth[f"{name}_v"],
                "sigma_u_px": 0.05,
                "sigma_v_px": 0.05,
                "status": "measured",
            }
        )
        for name in ("bow", "stern")
    )
    made = motion_from_tracks(run, tracks, run_datum(run, None)).motion
    assert 1e3 * np.sqrt(((made["y_cg_m"] - truth["y_cg_m"]) ** 2).mean()) < 0.35
    assert np.degrees(np.sqrt(((made["beta_rad"] - truth["beta_rad"]) ** 2).mean())) < 0.005
    assert np.degrees(np.sqrt(((made["alpha_rad"] - truth["alpha_rad"]) ** 2).mean())) < 0.015


def test_hand_written_derivatives_against_the_differentiable_chain() -> None:
    """kornia's operations under torch's reverse mode against ``mapping``, ``rigid``, ``motion``: the same motion and slopes.

    At exact pixels the weights' own derivative drops out (the residual is zero): 1e-6 relative. The common modes of datum, lens,
    heights and places are the chain's slopes along the same directions.
    """
    pytest.importorskip("kornia")
    from towline.geometry.chain import Chain, chain_motion
    from towline.geometry.poses import poses_from_tracks

    seen = camera()
    run = run_of(seen, picks(seen, TOP), Path())
    lens_sd = (2.0, 2.0, 3.0, 3.0, 3e-3, 3e-3, 1e-4, 1e-4, 1e-3)
    unsure = run.file.camera.model_copy(update={"sd": lens_sd})
    priors = run.file.priors.model_copy(update={"marker_depth_sd_m": 1e-3, "marker_place_sd_m": 1e-3})
    run = Run(run.folder, run.file.model_copy(update={"camera": unsure, "priors": priors}))
    rng = np.random.default_rng(31)
    pose = np.column_stack([rng.uniform(-2.6, -2.2, 12), rng.uniform(-0.3, 0.3, 12), rng.uniform(-0.2, 0.2, 12)])
    tracks = tracks_of(seen, run, pose, 0.0, rng)
    fit = run_datum(run, None)
    found = poses_from_tracks(run, tracks, fit.mapping)
    made = motion_from_tracks(run, tracks, fit)
    markers, tow = run.file.marker, run.tow
    chain = Chain(
        fit.mapping.lens,
        fit.mapping.matrix,
        np.array([m.depth_m for m in markers]),
        np.array([m.body_m for m in markers]),
        np.array([tow.tow_point_m, tow.tow_point_offset_m]),
        np.array(tow.post_m),
    )
    result = chain_motion(found.pixel_px, chain, np.linalg.inv(found.covariance_m2), found.rigid.pose)
    np.testing.assert_allclose(result.motion, made.motion[["y_cg_m", "beta_rad", "alpha_rad"]], atol=1e-8)
    variance = np.einsum("ncmi,nmi->nc", result.per_px**2, found.sigma_px**2)
    stated = made.motion[["sigma_y_cg_m", "sigma_beta_rad", "sigma_alpha_rad"]].to_numpy()
    np.testing.assert_allclose(np.sqrt(variance), stated, rtol=1e-6)
    mapping, k = fit.mapping, len(fit.mapping.matrix_modes)
    datum = np.einsum("ncij,kij->knc", result.per_matrix, mapping.matrix_modes)
    lens = np.einsum("ncl,kl->knc", result.per_lens, mapping.lens_modes)
    scale = np.abs(made.common).max(axis=(0, 1))
    assert (np.abs(made.common[:k] - datum - lens) < 1e-5 * scale).all()
    depth = 1e-3 * result.per_depth.transpose(2, 0, 1)
    assert (np.abs(made.common[k : k + 2] - depth) < 1e-3 * scale).all()  # a difference over 0.1 mm stands for it
    body = 1e-3 * result.per_body.transpose(2, 3, 0, 1).reshape(4, len(pose), 3)
    assert (np.abs(made.common[k + 2 :] - body) < 1e-5 * scale).all()


def test_what_is_behind_the_camera_is_not_seen() -> None:
    camera = Camera.looking_at(
        Lens(1000.0, 1000.0, 640.0, 360.0), np.array([-6.0, 0.0, -3.0]), np.array([-1.0, 0.0, 0.0])
    )
    ahead = camera.rotation[2]
    found = camera.project(camera.place_m + np.outer([2.0, -0.5, -2.0], ahead))
    np.testing.assert_allclose(found[0], [640.0, 360.0], atol=1e-9)
    assert np.isnan(found[1:]).all()
    # a ray through a pixel leads back to it
    pixel = np.array([[100.0, 50.0], [640.0, 360.0], [1200.0, 700.0]])
    rays = camera.rays(pixel)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0)
    np.testing.assert_allclose(camera.project(camera.place_m + 3.3 * rays), pixel, atol=1e-9)


@pytest.mark.parametrize(("tilt_m", "aside_m", "roll_rad"), [(2.0, 0.0, 0.0), (1.5, 1.2, 0.1), (3.0, -2.0, -0.3)])
def test_a_plane_seen_with_square_pixels_tells_the_focal_length(tilt_m: float, aside_m: float, roll_rad: float) -> None:
    """Its axes stand at right angles and are equally long: exact, for any tilt, roll and principal point."""
    lens = Lens(870.0, 870.0, 400.0, 300.0)
    seen = Camera.looking_at(lens, np.array([-5.0, aside_m, -tilt_m]), np.array([-2.4, 0.2, 0.0]), roll_rad)
    xy = np.random.default_rng(3).uniform([-4, -0.9], [-0.6, 0.9], (8, 2))
    plane = plane_matrix(xy, seen.project(np.column_stack([xy, np.zeros(8)])))
    centre = np.array([400.0, 300.0])
    assert focal_from_plane(plane, centre, 800) == pytest.approx(870.0, rel=1e-6)
    # where no focal length can be had from it, the usual one: 1.2 times the picture's width
    assert focal_from_plane(np.diag([1.0, 2.0, 1.0]), np.zeros(2), 800) == 960.0


def test_the_trapezoids_slopes_are_the_homographys() -> None:
    """For a camera level along the channel; d(place)/d(pixel) and the modes of the corners' picks."""
    lens = Lens(900.0, 900.0, 479.5, 359.5)
    seen = Camera.looking_at(lens, np.array([-5.0, 0.2, -2.0]), np.array([-2.4, 0.2, 0.0]))
    points = picks(seen, [(x, y, 0.0) for x in (-0.6, -4.0) for y in (-0.9, 0.9)])
    fit = fit_datum(points, table(seen), [0.0])
    shape, sigma = trapezoid_from_datum(points, fit.mapping)
    mapping = TrapezoidMapping(shape, sigma, fit.mapping)
    pixel = seen.project(np.array([[-1.0, 0.5, 0.0], [-3.0, -0.7, 0.0]]))
    found, exact = mapping.to_tank(pixel, 0.0), fit.mapping.to_tank(pixel, 0.0)
    np.testing.assert_allclose(found.xy_m, exact.xy_m, atol=1e-9)
    np.testing.assert_allclose(found.per_px, exact.per_px, rtol=1e-5, atol=1e-9)
    for corner in range(4):
        for axis in range(2):
            moved = [
                replace(shape, corners_px=shape.corners_px + s * 1e-3 * np.outer(np.eye(4)[corner], np.eye(2)[axis]))
                for s in (1, -1)
            ]
            slope = (moved[0].place(pixel, 0.0) - moved[1].place(pixel, 0.0)) / 2e-3
            np.testing.assert_allclose(found.modes_m[2 * corner + axis], slope * sigma[corner], rtol=1e-4, atol=1e-9)
    np.testing.assert_array_equal(
        mapping.to_pixel(np.array([[-1.0, 0.5, 0.0]])), fit.mapping.to_pixel(np.array([[-1.0, 0.5, 0.0]]))
    )


@pytest.mark.parametrize("error", [(9.0, 7.0), (-9.0, -7.0), (8.0, -8.0)])
@pytest.mark.parametrize("index", [0, 7])
def test_a_datum_that_does_not_fit_names_its_worst_point(error: tuple[float, float], index: int) -> None:
    """Whatever side it was picked to."""
    seen, places = camera(), TOP + LOW
    points = picks(seen, places, 0.2 * np.random.default_rng(2).normal(size=(len(places), 2)))
    moved = np.array(points[index].pixel_px) + error
    points[index] = points[index].model_copy(update={"pixel_px": (float(moved[0]), float(moved[1]))})
    fit = fit_datum(points, table(seen), [0.1], robust=False)
    (note,) = [n for n in fit.notes if "does not fit its stated picking errors" in n]
    assert f"largest at {points[index].name or f'point {index + 1}'}, " in note
