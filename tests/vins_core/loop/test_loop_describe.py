import cv2
import numpy as np
import pytest
from plane_world import HEIGHT, WIDTH, homography, move, render, texture

from vins_core.errors import VocabularyError
from vins_core.loop.describe import (
    CELL_PX,
    Brief,
    OrientedOrb,
    UprightOrb,
    describer_named,
    fast_corners,
    patch_angles_deg,
    read_brief,
)
from vins_core.loop.hamming import distances, packed

IMAGE = render(homography())
NONE = np.zeros((0, 2), np.float32)
RNG = np.random.default_rng(0)
BRIEF = Brief(np.clip(RNG.normal(0, 9, (256, 2, 2)), -24, 24).astype(np.int16))
DESCRIBERS = [UprightOrb(), OrientedOrb(), BRIEF]
IDS = [d.name for d in DESCRIBERS]


def hamming(a, b):
    return distances(packed(a), packed(b))


@pytest.mark.parametrize("describer", DESCRIBERS, ids=IDS)
def test_tracked_points_come_first_in_their_order_wherever_they_are(describer):
    tracked = np.array([[1.2, 0.3], [WIDTH - 1.5, HEIGHT - 1.1], [160.4, 120.6], [0.0, 200.0]], np.float32)
    features = describer(IMAGE, tracked, 100)
    assert np.array_equal(features.uv_px[:4], tracked)
    assert 4 < len(features) <= 104 and features.descriptors.shape == (len(features), 32)
    alone = describer(IMAGE, tracked[::-1], 0)
    assert np.array_equal(alone.descriptors[::-1], features.descriptors[:4])


@pytest.mark.parametrize("describer", DESCRIBERS, ids=IDS)
def test_descriptors_depend_on_comparisons_alone_not_on_brightness(describer):
    dark = (IMAGE // 2).astype(np.uint8)
    tracked = fast_corners(IMAGE, 100, NONE)
    a, b = describer(dark, tracked, 0), describer(dark + np.uint8(60), tracked, 0)
    assert np.array_equal(a.descriptors, b.descriptors)


@pytest.mark.parametrize("describer", DESCRIBERS, ids=IDS)
def test_a_point_looks_more_like_itself_from_nearby_than_like_any_other(describer):
    H = homography((0.05, 0.02, 0.0), (0.01, -0.02, 0.03))
    here = fast_corners(IMAGE, 60, NONE)
    there = move(H, here)
    inside = np.all((there > 20) & (there < [WIDTH - 20, HEIGHT - 20]), axis=1)
    a = describer(IMAGE, here[inside], 0).descriptors
    b = describer(render(H), there[inside].astype(np.float32), 0).descriptors
    apart = distances(packed(a)[:, None], packed(b))
    assert np.mean(apart.argmin(1) == np.arange(len(a))) > 0.9


@pytest.mark.parametrize("describer", DESCRIBERS, ids=IDS)
def test_a_blank_image_has_no_corners_and_its_tracks_are_described_all_the_same(describer):
    blank = np.full((HEIGHT, WIDTH), 90, np.uint8)
    assert len(describer(blank, NONE, 500)) == 0
    assert len(describer(blank, np.array([[50.0, 60.0]]), 500)) == 1


def test_oriented_descriptors_turn_with_the_image_and_upright_ones_do_not():
    square = texture(3, 400)[:240, :240].copy()
    corners = fast_corners(square[40:200, 40:200].copy(), 60, NONE) + 40
    turned = np.stack([corners[:, 1], 239 - corners[:, 0]], 1)  # by a quarter, counter-clockwise
    for describer, same in ((OrientedOrb(), True), (UprightOrb(), False)):
        a = describer(square, corners, 0).descriptors
        b = describer(np.ascontiguousarray(np.rot90(square)), turned, 0).descriptors
        assert (np.median(hamming(a, b)) < 30) == same


def test_the_direction_of_a_patch_points_to_its_bright_side():
    u, v = np.meshgrid(np.arange(100), np.arange(100))
    for angle in (0.0, 30.0, 90.0, 200.0, 310.0):
        ramp = 128 + 2 * ((u - 50) * np.cos(np.radians(angle)) + (v - 50) * np.sin(np.radians(angle)))
        image = np.clip(np.rint(ramp), 0, 255).astype(np.uint8)
        (found,) = patch_angles_deg(image, np.array([[50.0, 50.0]]))
        assert abs((found - angle + 180) % 360 - 180) < 0.5


def test_brief_is_what_its_definition_says():
    points = np.array([[30.7, 40.2], [3.4, 5.9], [WIDTH - 2.0, 100.5]], np.float32)
    smooth = cv2.GaussianBlur(IMAGE, (9, 9), 2.0, sigmaY=2.0)
    expected = np.zeros((3, 256), np.uint8)
    for k, (px, py) in enumerate(points):
        for i, ((ax, ay), (bx, by)) in enumerate(BRIEF.offsets.tolist()):
            x1, y1, x2, y2 = int(px + ax), int(py + ay), int(px + bx), int(py + by)  # towards zero, as in C
            if min(x1, x2, y1, y2) >= 0 and max(x1, x2) < WIDTH and max(y1, y2) < HEIGHT:
                expected[k, i] = smooth[y1, x1] < smooth[y2, x2]
    found = np.unpackbits(BRIEF(IMAGE, points, 0).descriptors, axis=1, bitorder="little")
    assert np.array_equal(found, expected)


def test_corners_are_spread_over_the_image_and_keep_away_from_tracks_and_masked_areas():
    taken = fast_corners(IMAGE, 40, NONE)
    usable = np.full(IMAGE.shape, 255, np.uint8)
    usable[:, : WIDTH // 2] = 0
    corners = fast_corners(IMAGE, 80, taken, usable)
    assert np.all(corners[:, 0] >= WIDTH // 2)
    assert np.linalg.norm(corners[:, None] - taken, axis=2).min() > 3
    cells = {tuple(c) for c in (fast_corners(IMAGE, 60, NONE) // CELL_PX).astype(int).tolist()}
    assert len(cells) > 45
    assert fast_corners(IMAGE, 0, NONE).shape == (0, 2)


def write_pattern(path, columns=("x1", "y1", "x2", "y2"), n=256, value="1"):
    lines = ["%YAML:1.0"]
    for c in columns:
        lines += [f"{c}:", *(f"  - {value}" for _ in range(n))]
    path.write_text("\n".join(lines))
    return path


def test_a_pattern_file_gives_the_comparisons_in_its_order(tmp_path):
    lines = ["%YAML:1.0"]
    for axis, name in enumerate(("x1", "y1", "x2", "y2")):
        lines += [f"{name}:", *(f"  - {(i * 7 + axis) % 49 - 24}" for i in range(256))]
    (tmp_path / "p.yml").write_text("\n".join(lines))
    offsets = read_brief(tmp_path / "p.yml").offsets
    assert offsets[10].tolist() == [[(70 + 0) % 49 - 24, (70 + 1) % 49 - 24], [(70 + 2) % 49 - 24, (70 + 3) % 49 - 24]]


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda p: write_pattern(p, n=255), "x1 is not a list of 256"),
        (lambda p: write_pattern(p, columns=("x1", "y1", "x2")), "y2 is not a list"),
        (lambda p: write_pattern(p, value="1.5"), "whole numbers"),
        (lambda p: write_pattern(p, value="100000"), "within 255 pixels"),
        (lambda p: p.write_text("a: [") and p, "not valid YAML"),
        (lambda p: p, "cannot be read"),
    ],
)
def test_a_wrong_pattern_file_is_told(tmp_path, make, words):
    with pytest.raises(VocabularyError, match=words):
        read_brief(make(tmp_path / "p.yml"))


def test_a_describer_is_known_by_name_or_refused():
    assert describer_named("orb-upright") == UprightOrb() and describer_named("orb") == OrientedOrb()
    with pytest.raises(VocabularyError, match=r"brief_pattern\.yml"):
        describer_named("brief")
    with pytest.raises(VocabularyError, match="unknown descriptor 'sift'"):
        describer_named("sift")
