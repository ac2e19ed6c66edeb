import numpy as np
import pytest

from vins_core.loop.hamming import distances, packed
from vins_core.loop.match import SAME_PX, match
from vins_core.params import Loop

RNG = np.random.default_rng(0)
POINTS = RNG.integers(0, 256, (50, 32), np.uint8)
UV = np.stack(np.meshgrid(np.arange(10), np.arange(5)), -1).reshape(-1, 2) * 30.0


def flipped(descriptors, n, seed=0):
    """With n bits wrong in each."""
    bits = np.unpackbits(descriptors, axis=1)
    for row, rng in zip(bits, np.random.default_rng(seed).spawn(len(bits))):
        row[rng.permutation(256)[:n]] ^= 1
    return np.packbits(bits, axis=1)


def test_distance_counts_differing_bits():
    a, b = RNG.integers(0, 256, (2, 40, 32), np.uint8)
    expected = (np.unpackbits(a, axis=1) != np.unpackbits(b, axis=1)).sum(1)
    assert np.array_equal(distances(packed(a), packed(b)), expected)


@pytest.mark.parametrize("bits", [0, 20, 45])
def test_every_point_finds_itself_in_any_order(bits):
    order = RNG.permutation(50)
    found = match(flipped(POINTS, bits), UV, 50, POINTS[order], UV[order])
    assert np.array_equal(order[found.row], np.arange(50))
    assert np.all(found.hamming == bits) and found.mutual.all()
    assert np.all(found.near(Loop(max_hamming=max(bits, 10)))) and np.all(found.distinct(Loop()))


def test_only_the_first_points_are_matched_but_all_are_asked_back():
    """Point 0 is not there; what is nearest to it belongs to point 40, which is not matched itself."""
    others = flipped(POINTS[40:41], 3)
    found = match(POINTS, UV, 5, others, UV[:1])
    assert found.row.tolist() == [0] * 5 and not found.mutual.any()
    assert not found.agreed(Loop()).any() and found.agreed(Loop(cross_check=False)).all()


@pytest.mark.parametrize("n", [0, 10])
def test_a_point_seen_twice_is_ambiguous_but_not_when_both_are_one(n):
    twice = np.concatenate([flipped(POINTS[:1], n), flipped(POINTS[:1], n, seed=3), POINTS[30:]])
    for gap_px, distinct in ((3 * SAME_PX, False), (0.5 * SAME_PX, True)):
        uv = np.full((len(twice), 2), 500.0)
        uv[:2] = [[0.0, 0.0], [gap_px, 0.0]]
        found = match(POINTS, UV, 1, twice, uv)
        assert found.row[0] == 0 and found.distinct(Loop())[0] == distinct
        assert found.distinct(Loop(max_ratio=1.0))[0]


def test_equal_rivals_give_the_first():
    found = match(POINTS, UV, 1, np.repeat(POINTS[:1], 3, 0), UV[:3])
    assert found.row[0] == 0


def test_nothing_matches_nothing():
    none = np.zeros((0, 32), np.uint8)
    assert match(POINTS, UV, 0, POINTS, UV) is None
    assert match(POINTS, UV, 5, none, np.zeros((0, 2))) is None


def test_a_single_point_has_no_rival():
    found = match(POINTS, UV, 1, flipped(POINTS[:1], 20), UV[:1])
    assert found.ratio[0] == pytest.approx(20 / 256)
