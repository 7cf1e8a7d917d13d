"""Printed fiducials: rendered views whose truth is known, and what a follower does when tags hide, leave or come twice."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from towline.geometry.camera import Lens
from towline.vision.fiducial import FiducialFollower
from towline.vision.tag_fit import Tag
from towline.vision.tag_squares import tag_cells
from towline.vision.tag_view import SQUARE, homography, project

BLACK, WHITE, DECK = 40.0, 190.0, 120.0
FINE, TEXELS = 3, 12
"""Samples per pixel of the picture, and per cell of the tag."""
Floats = NDArray[np.float64]


def draw(picture: Floats, cells: Floats, to_px: Floats, blur_px: float = 0.9, straight=lambda p: p) -> None:
    """Draw a tag and its quiet zone of one cell into ``picture``: area samples, blur, pixels. ``straight``: pixels -> lens-free."""
    side = len(cells)
    rows, columns = picture.shape
    outer = project(to_px, SQUARE * (1 + 4 / side))
    (x0, y0), (x1, y1) = np.floor(outer.min(axis=0)).astype(int) - 6, np.ceil(outer.max(axis=0)).astype(int) + 6
    x0, y0, x1, y1 = max(x0, 0), max(y0, 0), min(x1, columns), min(y1, rows)
    u, v = (np.arange(FINE * (b - a)) / FINE + a + (0.5 / FINE - 0.5) for a, b in ((x0, x1), (y0, y1)))
    places = straight(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    tag = project(np.linalg.inv(to_px), places).T.reshape(2, len(v), len(u)).astype(np.float32)
    levels = np.full((side + 4, side + 4), WHITE, np.float32)
    levels[2:-2, 2:-2] = np.where(cells > 0, WHITE, BLACK)
    # linear between texels: edges are as soft as a texel is wide, and stand where they should
    texture = np.kron(levels, np.ones((TEXELS, TEXELS), np.float32))
    x, y = ((t + 1) * (side / 2 * TEXELS) + (2 * TEXELS - 0.5) for t in tag)
    fine = cv2.resize(picture[y0:y1, x0:x1].astype(np.float32), (len(u), len(v)), interpolation=cv2.INTER_NEAREST)
    here = np.abs(tag).max(axis=0) < 1 + 2 / side
    fine[here] = cv2.remap(texture, x, y, cv2.INTER_LINEAR)[here]
    fine = cv2.GaussianBlur(fine, (0, 0), blur_px * FINE, borderType=cv2.BORDER_REPLICATE)
    picture[y0:y1, x0:x1] = fine.reshape(y1 - y0, FINE, x1 - x0, FINE).mean(axis=(1, 3))


def noisy(rng: np.random.Generator, picture: Floats, sd_dn: float = 3.0) -> NDArray[np.uint8]:
    luma = np.clip(np.rint(picture + rng.normal(0, sd_dn, picture.shape)), 0, 255).astype(np.uint8)
    luma.setflags(write=False)
    return luma


def view(rng: np.random.Generator, side_px: float, centre_px: Floats) -> Floats:
    """A tag seen at up to 0.7 rad from a few of its sides away: (3, 3)."""
    turn, tilt, axis = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.7), rng.uniform(0, 2 * np.pi)
    about = np.array([np.cos(axis) * tilt, np.sin(axis) * tilt, 0.0])
    rotation = np.asarray(cv2.Rodrigues(about)[0]) @ np.asarray(cv2.Rodrigues(np.array([0.0, 0.0, turn]))[0])
    far = rng.uniform(8, 60)
    plane = np.column_stack([rotation[:, 0], rotation[:, 1], [0, 0, far]])
    scale = far * side_px / 2
    return np.array([[scale, 0, centre_px[0]], [0, scale, centre_px[1]], [0, 0, 1]]) @ plane / far


def flat(centre_px: tuple[float, float], side_px: float = 40.0, turn_rad: float = 0.3) -> Floats:
    """A tag on a deck seen at an angle: (3, 3)."""
    c, s = np.cos(turn_rad) * side_px / 2, np.sin(turn_rad) * side_px / 2
    u, v = centre_px
    return np.array([[c + 0.01 * u, -s, u], [0.8 * s + 0.01 * v, 0.8 * c, v], [0.01, 0, 1]])


def middle(to_px: Floats) -> Floats:
    return project(to_px, np.zeros((1, 2)))[0]


def scene(rng: np.random.Generator, *tags: tuple[str, int, Floats], cover=None) -> NDArray[np.uint8]:
    """Tags (family, number, homography) on a plain deck of 320 x 240; ``cover`` (slices) hides a part."""
    picture = np.full((240, 320), DECK)
    for family, number, to_px in tags:
        draw(picture, tag_cells(family, [number])[0], to_px)
    if cover is not None:
        picture[cover] = 90.0
    return noisy(rng, picture)


def test_the_centre_is_as_good_as_its_sigma_says() -> None:
    rng = np.random.default_rng(4)
    errors, ratios = [], []
    for turn in range(80):
        family = ("4X4_1000", "6X6_1000", "7X7_1000", "APRILTAG_36h11")[turn % 4]
        cells = tag_cells(family, [int(rng.integers(0, 200))])[0]
        side = rng.uniform(24, 50)
        size = int(2 * side + 30)
        centre = size / 2 + rng.uniform(-0.5, 0.5, 2)
        to_px = view(rng, side, centre)
        picture = np.full((size, size), DECK)
        draw(picture, cells, to_px, rng.uniform(0.7, 1.2))
        start = homography(project(to_px, SQUARE) + rng.normal(0, 0.5, (4, 2)))
        fit = Tag(cells).fit(noisy(rng, picture), start)
        assert fit is not None
        assert fit.whole
        errors.append(fit.centre_px - centre)
        ratios.append(errors[-1] / np.sqrt(np.diag(fit.covariance_px2)))
    assert np.sqrt(np.mean(np.square(errors))) < 0.007
    # 160 numbers: their standard deviation is known to 6 %
    assert 0.85 < np.std(ratios) < 1.15
    assert np.abs(ratios).max() < 5


def test_a_camera_with_gamma_or_too_long_an_exposure_does_no_harm() -> None:
    rng = np.random.default_rng(5)
    cells = tag_cells("6X6_1000", [11])[0]
    for tone in (lambda p: 255 * ((p - 30) / 255) ** (1 / 2.2), lambda p: 1.8 * p - 40):
        for _ in range(8):
            picture = np.full((130, 130), DECK)
            to_px = view(rng, 45, 65 + rng.uniform(-0.5, 0.5, 2))
            draw(picture, cells, to_px)
            fit = Tag(cells).fit(noisy(rng, tone(picture)), homography(project(to_px, SQUARE) + 0.4))
            assert fit is not None
            assert fit.whole
            assert np.abs(fit.centre_px - middle(to_px)).max() < 0.025


def test_a_lens_bends_the_tag_and_the_centre_stays() -> None:
    rng = np.random.default_rng(6)
    lens = Lens(500.0, 500.0, 159.5, 119.5, np.array([-0.3, 0.1, 0.0, 0.0, 0.0]))
    shift = np.array([159.5, 119.5])
    cells = tag_cells("5X5_1000", [3])[0]
    with_lens, without = [], []
    for _ in range(3):
        to_px = flat((265 + rng.uniform(-3, 3), 55 + rng.uniform(-3, 3)), 60)
        picture = np.full((240, 320), DECK)
        draw(picture, cells, to_px, straight=lambda p: lens.normalise(p)[0] * 500 + shift)
        bent = lens.distort((project(to_px, np.vstack([SQUARE, [[0, 0]]])) - shift) / 500)
        luma = noisy(rng, picture)
        for known, errors in ((lens, with_lens), (None, without)):
            fit = Tag(cells, lens=known).fit(luma, homography(bent[:4]))
            assert fit is not None
            assert fit.whole
            errors.append(fit.centre_px - bent[4])
            if known is lens:
                assert np.abs(fit.corners_px - bent[:4]).max() < 0.08
    assert np.sqrt(np.mean(np.square(with_lens))) < 0.012
    assert np.sqrt(np.mean(np.square(without))) > 3 * np.sqrt(np.mean(np.square(with_lens)))


def test_tags_of_two_kinds_are_followed_and_their_families_found() -> None:
    rng = np.random.default_rng(1)
    follower = FiducialFollower(("aruco:9", "apriltag:3", "aruco:7"))
    assert follower.families == {"aruco": None, "apriltag": None}
    for index in range(12):
        t_s = index / 30
        poses = [
            flat((70 + 60 * t_s, 60 + 20 * t_s), 30, 0.3 + 0.2 * t_s),
            flat((230 - 40 * t_s, 90), 44, 1.0),
            flat((120, 180 - 90 * t_s), 36, -0.5),
        ]
        luma = scene(rng, ("5X5_1000", 9, poses[0]), ("APRILTAG_36h11", 3, poses[1]), ("5X5_1000", 7, poses[2]))
        places = follower.step(index, t_s, luma)
        for place, to_px in zip(places, poses, strict=True):
            assert place.reason == ""
            assert (place.index, place.t_s) == (index, t_s)
            assert np.abs(place.centre_px - middle(to_px)).max() < 5 * place.sigma_px.max() < 0.06
            assert np.abs(place.corners_px - project(to_px, SQUARE)).max() < 0.15
    assert follower.families == {"aruco": "5X5_1000", "apriltag": "APRILTAG_36h11"}


def test_tags_that_name_their_dictionaries_are_followed_in_one_run() -> None:
    """The same number in two dictionaries, and others that say nothing: each is its own tag, wherever the other stands."""
    rng = np.random.default_rng(11)
    follower = FiducialFollower(("aruco:4x4:0", "aruco:original:0", "aruco:7", "aruco:DICT_4X4_50:1"))
    for index in range(8):
        t_s = index / 30
        poses = [
            flat((60 + 40 * t_s, 60), 34, 0.3 + t_s),
            flat((240 - 40 * t_s, 60), 34, 1.0),
            flat((70, 170 + 30 * t_s), 34, -0.5),
            flat((240, 180 - 20 * t_s), 34, 2.0),
        ]
        drawn = zip(("4X4_1000", "ARUCO_ORIGINAL", "6X6_1000", "4X4_1000"), (0, 0, 7, 1), poses, strict=True)
        places = follower.step(index, t_s, scene(rng, *drawn))
        for place, to_px in zip(places, poses, strict=True):
            assert place.reason == ""
            assert np.abs(place.centre_px - middle(to_px)).max() < 5 * place.sigma_px.max() < 0.06
    assert follower.families["aruco"] == "6X6_1000"


def worn(rng: np.random.Generator, picture: Floats, to_px: Floats) -> None:
    """Grey patches in three of a tag's cells, by up to a third of its contrast in a cell's mean, as scratched print has."""
    for _ in range(3):
        middle_px = project(to_px, rng.uniform(-0.8, 0.8, (1, 2)))[0]
        u, v = np.meshgrid(np.arange(picture.shape[1]), np.arange(picture.shape[0]))
        spot = np.exp(-((u - middle_px[0]) ** 2 + (v - middle_px[1]) ** 2) / (2 * rng.uniform(1.5, 2.5) ** 2))
        picture += spot * 0.8 * ((BLACK + WHITE) / 2 - picture)


@pytest.mark.slow
def test_a_worn_tag_that_names_its_dictionary_is_measured_with_a_sigma_that_knows_it() -> None:
    rng = np.random.default_rng(12)
    ratios, never_whole = [], 0
    for number in range(90):
        picture = np.full((100, 100), DECK)
        to_px = view(rng, rng.uniform(36, 48), 50 + rng.uniform(-0.5, 0.5, 2))
        draw(picture, tag_cells("4X4_1000", [number])[0], to_px)
        worn(rng, picture, to_px)
        luma = noisy(rng, picture)
        if FiducialFollower((f"aruco:{number}",)).step(0, 0.0, luma)[0].reason:
            (place,) = FiducialFollower((f"aruco:4x4:{number}",)).step(0, 0.0, luma)
            never_whole += 1
            if not place.reason:
                ratios.append((place.centre_px - middle(to_px)) / place.sigma_px)
    # a wear that hides a cell's colour leaves the tag unread: few are
    assert len(ratios) > 0.8 * never_whole > 20
    # n places: their spread is known to 1 / sqrt(2 n) of itself. A patch that lies over two cells pulls them against each other,
    # which taking each by itself does not know: the sigma may say too much, but less than twice
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1 + 3 / np.sqrt(2 * len(ratios))


SURGERY_TOML = """
name = "surgery"
kind = "free"
[source]
video = "multipattern.avi"
"""
REAL_RIGID_PX = {("m1", "m31"): 0.0915, ("m11", "m962"): 0.1055}
"""Scatter of the distance of two tags on one board, measured with one dictionary (0.091, 0.105), to three digits."""


def test_two_dictionaries_of_a_real_recording_are_followed_in_one_run(shared, tmp_path) -> None:
    """Boards of ARUCO_ORIGINAL and a glaring 4x4 tag, moved by hand: the rigid pairs are as good as by themselves."""
    import shutil

    import towline

    shutil.copy(shared / "real" / "surgery_aruco" / "multipattern.avi", tmp_path)
    text = SURGERY_TOML
    for u in (10, 630):
        for v in (10, 470):
            text += f"[[datum]]\npixel_px = [{u}, {v}]\ntank_m = [{(240 - v) / 1000}, {(u - 320) / 1000}, 0.0]\n"
    looks = {f"m{n}": f"aruco:original:{n}" for n in (1, 31, 11, 962)} | {"m0": "aruco:4x4:0"}
    for x, (name, look) in enumerate(looks.items()):
        text += f'[[marker]]\nname = "{name}"\nbody_m = [{x / 10}, 0]\ndepth_m = 0.0\nlook = "{look}"\n'
    (tmp_path / "run.toml").write_text(text)
    tracks = towline.track(tmp_path)
    assert (tracks.status == "measured").all()
    place = {name: rows[["u_px", "v_px"]].to_numpy() for name, rows in tracks.groupby("marker")}
    for (one, two), most_px in REAL_RIGID_PX.items():
        assert np.std(np.hypot(*(place[one] - place[two]).T)) < most_px


def test_a_tag_that_was_seen_whole_is_not_measured_where_something_covers_it() -> None:
    rng = np.random.default_rng(13)
    follower = FiducialFollower(("aruco:4x4:4",))
    to_px = flat((140.0, 100.0))
    reasons = [
        follower.step(index, index / 30, scene(rng, ("4X4_1000", 4, to_px), cover=cover))[0].reason
        for index, cover in enumerate((None, np.s_[:, 155:159], None))
    ]
    assert reasons == ["", "covered", ""]


def test_the_family_is_the_one_that_shows_all_numbers() -> None:
    rng = np.random.default_rng(2)
    follower = FiducialFollower(("aruco:1", "aruco:2"))
    one = ("4X4_1000", 1, flat((70, 60)))
    # a tag of another family with a wanted number is no reason to choose that family
    (first, second) = follower.step(0, 0.0, scene(rng, ("6X6_1000", 2, flat((220, 170))), one))
    assert first.reason == second.reason == "no tag"
    (first, second) = follower.step(
        1, 0.03, scene(rng, ("6X6_1000", 2, flat((220, 170))), one, ("4X4_1000", 2, flat((220, 60))))
    )
    assert first.reason == second.reason == ""
    assert follower.families == {"aruco": "4X4_1000"}


def test_a_tag_hidden_from_the_start_does_not_keep_the_other_waiting_for_ever() -> None:
    rng = np.random.default_rng(3)
    follower = FiducialFollower(("aruco:1", "aruco:2"))
    luma = scene(rng, ("4X4_1000", 1, flat((70, 60))))
    reasons = [[p.reason for p in follower.step(index, index / 30, luma)] for index in range(12)]
    assert reasons[-1] == ["", "no tag"]


def test_a_covered_tag_is_lost_and_found_again() -> None:
    rng = np.random.default_rng(7)
    follower = FiducialFollower(("aruco:4",))
    hidden = {3: np.s_[80:95, :], 4: np.s_[60:160, :], 5: np.s_[60:160, :], 6: np.s_[:, 155:159]}
    for index in range(9):
        to_px = flat((140 + 4.0 * index, 100.0))
        (place,) = follower.step(index, index / 30, scene(rng, ("4X4_1000", 4, to_px), cover=hidden.get(index)))
        assert (place.reason != "") == (index in hidden), index
        if place.reason:
            assert np.isnan(place.centre_px).all()
            assert np.isnan(place.sigma_px).all()
            assert place.corners_px.shape == (4, 2)
        else:
            assert np.abs(place.centre_px - middle(to_px)).max() < 0.04
    # none at all for long, then somewhere else
    for index in range(9, 40):
        (place,) = follower.step(index, index / 30, scene(rng))
        assert place.reason == "no tag"
    reasons = []
    for index in range(40, 70):
        (place,) = follower.step(index, index / 30, scene(rng, ("4X4_1000", 4, flat((50, 200)))))
        reasons.append(place.reason)
    assert reasons[-1] == ""


def test_a_tag_leaves_the_picture_and_comes_back() -> None:
    rng = np.random.default_rng(8)
    follower = FiducialFollower(("apriltag:5",))
    reasons = []
    for index in range(24):
        u = 270 + 5.0 * min(index, 24 - index)
        (place,) = follower.step(index, index / 30, scene(rng, ("APRILTAG_36h11", 5, flat((u, 120)))))
        reasons.append(place.reason)
    assert reasons[0] == reasons[1] == reasons[-1] == ""
    assert reasons[8:14] == ["outside the picture"] * 6


def test_of_two_tags_of_one_number_the_nearer_one_is_the_mark() -> None:
    rng = np.random.default_rng(9)
    both = [("4X4_1000", 4, flat((70, 60))), ("4X4_1000", 4, flat((220, 160)))]
    follower = FiducialFollower(("aruco:4",))
    (place,) = follower.step(0, 0.0, scene(rng, *both))
    assert place.reason == "ambiguous"
    follower = FiducialFollower(("aruco:4",))
    follower.step(0, 0.0, scene(rng, both[1]))
    for index in range(1, 4):
        (place,) = follower.step(index, index / 30, scene(rng, *both))
        assert place.reason == ""
        assert np.abs(place.centre_px - [220, 160]).max() < 0.04


@pytest.mark.parametrize(
    "looks",
    [
        ("led",),
        ("aruco:x",),
        ("aruco:4", "aruco:4"),
        ("aruco:5000",),
        ("aruco:",),
        ("aruco:4x4:5000",),
        ("aruco:DICT_4X4_50:50",),
        ("aruco:4x4:3", "aruco:DICT_4X4_100:3"),
        ("aruco:36h11:3",),
    ],
)
def test_a_look_that_cannot_be_is_an_error(looks: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match=r"look|aruco"):
        FiducialFollower(looks)
