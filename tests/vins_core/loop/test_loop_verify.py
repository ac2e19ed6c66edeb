from dataclasses import replace

import numpy as np
import pytest
from loop_world import LOOKING_AHEAD, keyframe, pose

from vins_core.geometry import poses, se3, so3
from vins_core.loop import gates
from vins_core.loop.verify import Pair, verify
from vins_core.params import DECLARATIONS, Loop
from vins_core.report import MATCH_STAGES, LoopOutcome, MatchStage

HERE = pose((0.0, 0.0, 0.0))
NEARBY = pose((0.4, -0.5, 0.1), yaw_deg=12, pitch_deg=-4, roll_deg=3)


def pair(later, earlier):
    return Pair(100, 0, later, earlier, 0.3, ())


def gate(candidate, name):
    return next(g for g in candidate.gates if g.name == name)


def test_the_same_place_is_a_loop_with_the_exact_relative_pose():
    found = verify(Loop(), pair(keyframe(NEARBY), keyframe(HERE)))
    assert found.outcome is LoopOutcome.ACCEPTED
    assert np.allclose(found.T_match_query, poses.between(HERE, NEARBY), atol=1e-5)


def test_the_drift_of_the_odometry_does_not_change_the_relative_pose():
    drift = pose((3.0, -7.0, 1.0), yaw_deg=40)
    found = verify(Loop(), pair(keyframe(NEARBY, drift=drift), keyframe(HERE)))
    assert found.outcome is LoopOutcome.ACCEPTED
    assert np.allclose(found.T_match_query, poses.between(HERE, NEARBY), atol=1e-5)


def test_another_place_is_no_loop():
    found = verify(Loop(), pair(keyframe(NEARBY, place=1), keyframe(HERE)))
    assert found.outcome is LoopOutcome.FEW_MATCHES


def test_another_place_is_no_loop_without_any_check_of_descriptors_either():
    anything = Loop(max_hamming=128, max_ratio=1.0, cross_check=False, epipolar="off")
    found = verify(anything, pair(keyframe(NEARBY, place=1), keyframe(HERE)))
    assert found.outcome is LoopOutcome.PNP


@pytest.mark.parametrize("epipolar", ["essential", "fundamental", "off"])
def test_wrong_matches_are_dropped_and_the_pose_does_not_feel_them(epipolar):
    later, earlier = keyframe(NEARBY, noise_px=0.5), keyframe(HERE, noise_px=0.5)
    clean = verify(Loop(epipolar=epipolar), pair(later, earlier)).matches
    wrong = np.flatnonzero(clean.stage == MATCH_STAGES.index(MatchStage.INLIER))[:16]
    swapped = earlier.descriptors.copy()
    swapped[clean.row[wrong]] = np.roll(earlier.descriptors[clean.row[wrong]], 1, axis=0)
    found = verify(Loop(epipolar=epipolar), pair(later, replace(earlier, descriptors=swapped)))
    assert {MATCH_STAGES[s] for s in found.matches.stage[wrong]} <= {MatchStage.EPIPOLAR, MatchStage.PNP}
    assert found.outcome is LoopOutcome.ACCEPTED
    assert np.linalg.norm(found.T_match_query[:3] - poses.between(HERE, NEARBY)[:3]) < 0.03


def test_inliers_are_those_of_the_final_pose():
    found = verify(Loop(), pair(keyframe(NEARBY, noise_px=2.0), keyframe(HERE, noise_px=2.0)))
    supports = [MATCH_STAGES.index(s) for s in (MatchStage.INLIER, MatchStage.GUIDED)]
    inlier = np.isin(found.matches.stage, supports)
    assert gate(found, "pose inliers").value == inlier.sum()
    assert found.matches.error_px[inlier].max() <= Loop().pnp_px + 1e-3
    rms = np.sqrt(np.mean(np.square(found.matches.error_px[inlier].astype(float))))
    assert gate(found, "reprojection error").value == pytest.approx(rms, rel=1e-3)


def test_a_pose_finds_the_matches_that_ambiguity_had_cost():
    """Half of the landmarks have a double elsewhere in the earlier image: the ratio test drops them, the pose not."""
    later, earlier = keyframe(NEARBY, noise_px=0.5), keyframe(HERE, noise_px=0.5)
    doubled = replace(
        earlier,
        uv_px=np.concatenate([earlier.uv_px, earlier.uv_px + np.float32(90.0)]),
        rays=np.concatenate([earlier.rays, np.roll(earlier.rays, 7, axis=0)]),
        descriptors=np.concatenate([earlier.descriptors, np.where(
            np.arange(len(earlier.descriptors))[:, None] % 2, earlier.descriptors, 255 - earlier.descriptors
        ).astype(np.uint8)]),
    )  # fmt: skip
    plain, guided = (verify(Loop(guided_px=px), pair(later, doubled)) for px in (0.0, 12.0))
    lost = plain.matches.stage == MATCH_STAGES.index(MatchStage.AMBIGUOUS)
    assert lost.sum() > 10
    regained = guided.matches.stage == MATCH_STAGES.index(MatchStage.GUIDED)
    assert (regained & lost).sum() > 0.9 * lost.sum()
    assert np.isnan(guided.matches.ratio[regained]).all() and guided.matches.error_px[regained].max() < 6.0


def test_the_covariance_is_the_scatter_of_relative_poses():
    """Only the earlier camera's rays are noisy, as the covariance assumes."""
    true, errors, told = poses.between(HERE, NEARBY), [], []
    for seed in range(60):
        found = verify(Loop(), pair(keyframe(NEARBY), keyframe(HERE, noise_px=1.0, seed=seed)))
        T = found.T_match_query
        errors.append(np.concatenate([T[:3] - true[:3], so3.difference(T[3:], true[3:])]))
        told.append(found.covariance)
    squared = [e @ np.linalg.solve(C, e) for e, C in zip(errors, told)]
    assert 4.5 < np.mean(squared) < 7.5  # 6 degrees of freedom


def test_the_earlier_gates_are_the_same_when_all_are_evaluated():
    strict = Loop(min_matches=200)
    hasty, thorough = (verify(strict, pair(keyframe(NEARBY), keyframe(HERE)), every) for every in (False, True))
    assert hasty.outcome is thorough.outcome is LoopOutcome.FEW_MATCHES
    assert thorough.gates[: len(hasty.gates)] == hasty.gates
    names = list(gates.MEANING)
    assert [g.name for g in thorough.gates] == names[names.index("matches") : names.index("drift")]
    assert all(g.value is not None for g in thorough.gates)


def test_what_cannot_be_computed_has_no_value_and_has_not_passed():
    found = verify(Loop(), pair(keyframe(NEARBY, place=1, n_landmarks=0), keyframe(HERE)), evaluate_all=True)
    assert gate(found, "matches").value == 0
    assert all(g.value is None and not g.passed for g in found.gates if g.name != "matches")


def test_every_gate_names_a_parameter_that_exists():
    found = verify(Loop(), pair(keyframe(NEARBY), keyframe(HERE)), evaluate_all=True)
    assert all(g.knob in DECLARATIONS for g in found.gates)


TURNED = pose((0.2, 0.1, 0.0), yaw_deg=25, pitch_deg=3)


@pytest.mark.parametrize(
    "params, later, outcome",
    [
        (Loop(min_matches=61), NEARBY, LoopOutcome.FEW_MATCHES),
        (Loop(min_epipolar=61), NEARBY, LoopOutcome.EPIPOLAR),
        (Loop(min_inliers=61), NEARBY, LoopOutcome.PNP),
        (Loop(max_rms_px=0.5), NEARBY, LoopOutcome.UNCERTAIN),
        (Loop(max_sigma_m=0.001), NEARBY, LoopOutcome.UNCERTAIN),
        (Loop(max_heading_deg=20), TURNED, LoopOutcome.HEADING),
        (Loop(max_distance_m=0.1), NEARBY, LoopOutcome.DISTANCE),
    ],
)
def test_each_limit_gives_its_own_outcome(params, later, outcome):
    found = verify(params, pair(keyframe(later, noise_px=1.0), keyframe(HERE, noise_px=1.0)))
    assert found.outcome is outcome


def test_a_pose_that_contradicts_gravity_is_refused():
    """The map says that the earlier keyframe stood upright; the pose says that it leaned."""
    leaned = keyframe(pose(roll_deg=9.0))
    told_upright = replace(leaned, T_w_b=HERE)
    found = verify(Loop(), pair(keyframe(NEARBY), told_upright))
    assert found.outcome is LoopOutcome.TILT
    assert gate(found, "tilt").value == pytest.approx(9.0, abs=0.01)


@pytest.mark.parametrize("mounting_deg", [0.0, -70.0, -90.0])
def test_heading_is_the_turn_about_gravity_however_the_imu_is_mounted(mounting_deg):
    """With the body's x axis near the vertical, its Euler yaw says nothing (REFERENCE 23.1)."""
    R = so3.to_matrix(so3.exp(np.radians(mounting_deg) * np.array([0.0, 1.0, 0.0])))
    mounting = np.concatenate([np.zeros(3), so3.from_matrix(R)])
    T_b_c = se3.inverse(se3.from_rotation_translation(R, np.zeros(3))) @ LOOKING_AHEAD
    views = (pose((0.3, 0.2, 0.0), yaw_deg=20, pitch_deg=4, roll_deg=6), pose(pitch_deg=-5, roll_deg=-6))
    later, earlier = (keyframe(poses.compose(T, mounting), T_b_c=T_b_c) for T in views)
    found = verify(Loop(), pair(later, earlier), evaluate_all=True)
    assert gate(found, "heading").value == pytest.approx(20.0, abs=1.5)
    by_euler = verify(Loop(heading="euler"), pair(later, earlier), evaluate_all=True)
    if mounting_deg == -90.0:
        assert gate(by_euler, "heading").value > 45.0


def test_a_pair_is_judged_the_same_twice():
    first, second = (
        verify(Loop(), pair(keyframe(NEARBY, noise_px=1.0), keyframe(HERE, noise_px=1.0)), True) for _ in range(2)
    )
    assert first.gates == second.gates and first.T_match_query.tobytes() == second.T_match_query.tobytes()
