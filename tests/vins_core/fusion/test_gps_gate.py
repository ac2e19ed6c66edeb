from dataclasses import replace

import numpy as np
import pytest
from gps_run import settings

from vins_core import params
from vins_core.fusion.gate import admit, weight
from vins_core.fusion.state import Track
from vins_core.geometry import heading, poses
from vins_core.sensors import GpsFix

GOOD = GpsFix(150_000_000, 48.0, 11.0, 500.0, np.diag([1.0, 1.0, 4.0]), 0)
TRACK = Track(
    np.array([0, 100, 200, 300], np.int64) * 1_000_000,
    np.array([[x, 0, 0, *heading.about_gravity(0.1 * x)] for x in range(4)]),
)


def judged(fix: GpsFix, gps: params.Gps | None = None, now_ns: int | None = 300_000_000):
    return admit(gps or settings(), np.array([0.5, 0, 0]), None, TRACK, 3, fix, now_ns=now_ns)[0]


def failed(fix: GpsFix, **changes) -> set[str]:
    return {g.name for g in judged(fix, settings(**changes)).gates if not g.passed}


def test_a_good_fix_passes_every_gate_and_each_gate_has_a_parameter_or_none_to_have():
    admission = judged(GOOD)
    assert admission.anchor is not None
    knobs = {g.name: g.knob for g in admission.gates}
    without = {"position_known", "stamp_is_new"}
    assert all(knob in params.DECLARATIONS for name, knob in knobs.items() if name not in without)


@pytest.mark.parametrize(
    ("changes", "gate"),
    [
        ({"status": -1}, "status"),
        ({"latitude_deg": np.nan}, "position_known"),
        ({"altitude_m": np.inf}, "position_known"),
        ({"latitude_deg": 91.0}, "position_known"),
        ({"covariance_enu_m2": np.diag([400.0, 1, 1])}, "horizontal_sigma_m"),
        ({"covariance_enu_m2": 1e-12 * np.eye(3)}, "smallest_sigma_m"),
        ({"t_ns": 400_000_000}, "frame_gap_s"),
        ({"t_ns": -1}, "frame_gap_s"),
    ],
)
def test_each_defect_fails_its_gate_and_no_other(changes, gate):
    fix = replace(GOOD, **changes)
    assert failed(fix) == {gate}
    assert judged(fix).anchor is None


@pytest.mark.parametrize(
    "covariance", [np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan), np.diag([1.0, 0.0, 1.0])]
)
def test_a_fix_without_a_covariance_counts_only_with_an_assumed_one(covariance):
    fix = replace(GOOD, covariance_enu_m2=covariance)
    assert failed(fix) == {"smallest_sigma_m", "horizontal_sigma_m"}
    assert judged(fix, settings(assumed_sigma_m=2.0)).anchor.covariance == pytest.approx(4.0 * np.eye(3))


def test_a_fix_that_comes_late_is_placed_where_the_body_was():
    """Half way between frames 1 and 2, half a metre ahead of a body that turned by 0.15 rad."""
    assert failed(GOOD, max_age_s=0.1) == {"stamp_off_s"}
    anchor = judged(GOOD).anchor
    expected = np.array([1.5 + 0.5 * np.cos(0.15), 0.5 * np.sin(0.15), 0]) - TRACK.T_o_b[3, :3]
    np.testing.assert_allclose(anchor.lever_o, expected, atol=1e-12)


def test_frames_too_far_apart_say_nothing_of_a_fix_between_them():
    assert failed(GOOD, max_gap_s=0.05) == {"frame_gap_s"}


def test_the_weight_of_a_fix_follows_its_settings():
    C, _ = weight(settings(sigma_scale=3.0), GOOD)
    np.testing.assert_allclose(C, 9 * GOOD.covariance_enu_m2)
    nine = replace(GOOD, covariance_enu_m2=np.diag([9.0, 1.0, 1.0]))
    np.testing.assert_allclose(weight(settings(covariance="sigma"), nine)[0], 81 * np.eye(3))


def test_the_lever_arm_can_be_left_out():
    at_frame = replace(GOOD, t_ns=300_000_000)
    np.testing.assert_allclose(judged(at_frame, settings(lever_arm=False)).anchor.lever_o, 0)


def test_poses_between_frames_lie_on_the_line_and_turn_evenly():
    for share in (0.0, 0.25, 1.0):
        between = TRACK.at(100_000_000 + round(share * 1e8))
        expected = np.array([1 + share, 0, 0, *heading.about_gravity(0.1 * (1 + share))])
        np.testing.assert_allclose(between, expected, atol=1e-12)
    np.testing.assert_allclose(poses.between(TRACK.T_o_b[2], TRACK.at(200_000_000)), poses.IDENTITY, atol=1e-15)
