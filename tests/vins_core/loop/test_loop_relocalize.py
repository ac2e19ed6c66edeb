"""From an accepted loop to a request, from what the window found to gates and a correction of drift."""

from dataclasses import replace

import numpy as np
import pytest
from loop_world import keyframe, pose

from vins_core import params as settings
from vins_core.geometry import heading, poses, se3, so3
from vins_core.loop.relocalize import drift, recheck, request
from vins_core.loop.verify import Pair, verify
from vins_core.params import DECLARATIONS, Loop, Params, PoseGraph
from vins_core.report import MATCH_STAGES, LoopCandidate, MatchStage, RelocalizationReport

HERE, NEARBY = pose(), pose((0.4, -0.5, 0.1), yaw_deg=12, pitch_deg=-4, roll_deg=3)
DRIFT = pose((3.0, -7.0, 1.0), yaw_deg=40)


def loop(noise_px: float = 0.5) -> tuple:
    later, earlier = keyframe(NEARBY, noise_px=noise_px, drift=DRIFT, number=9), keyframe(HERE, noise_px=noise_px)
    found = verify(Loop(), Pair(100, 0, later, earlier, 0.3, ()))
    assert found.accepted
    return found, later, earlier


def found(**changes) -> RelocalizationReport:
    """A good answer of the window."""
    T_match_query = poses.between(HERE, NEARBY)
    good = RelocalizationReport(
        query=100,
        match=0,
        frame=9,
        ids=np.arange(40),
        error_px=np.full((2, 40), 1.5, np.float32),
        T_w_match=poses.compose(DRIFT, HERE),
        T_match_query=T_match_query,
        covariance=1e-4 * np.eye(6),
    )
    return replace(good, **changes)


def test_a_request_asks_for_the_inliers_and_nothing_else():
    candidate, later, earlier = loop()
    asked = request(candidate, later, earlier)
    supports = [MATCH_STAGES.index(s) for s in (MatchStage.INLIER, MatchStage.GUIDED)]
    inlier = np.flatnonzero(np.isin(candidate.matches.stage, supports))
    assert (asked.query, asked.match, asked.frame) == (100, 0, 9)
    assert (np.diff(asked.track_ids) > 0).all()
    assert set(asked.track_ids) == set(later.track_ids[inlier])
    for track, ray in zip(asked.track_ids, asked.rays):
        k = int(np.flatnonzero(later.track_ids == track)[0])
        np.testing.assert_allclose(ray, earlier.rays[candidate.matches.row[k]], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(asked.rays, axis=1), 1, atol=1e-12)


def test_a_request_starts_where_the_rays_meet_the_landmarks():
    candidate, later, earlier = loop()
    asked = request(candidate, later, earlier)
    np.testing.assert_allclose(poses.between(asked.T_w_match, later.T_w_b), candidate.T_match_query, atol=1e-12)
    T_w_c = se3.from_quaternion_translation(asked.T_w_match[3:], asked.T_w_match[:3]) @ asked.T_b_c
    rows = [int(np.flatnonzero(later.track_ids == t)[0]) for t in asked.track_ids]
    local = se3.transform(se3.inverse(T_w_c), later.points_w[rows])
    cosine = np.sum(local * asked.rays, axis=1) / np.linalg.norm(local, axis=1)
    assert 460 * np.arccos(cosine).max() < Loop().pnp_px


def test_a_candidate_without_pose_cannot_be_refined():
    candidate, later, earlier = loop()
    with pytest.raises(ValueError, match="no pose"):
        request(LoopCandidate(1, 0, 0.1, (), candidate.outcome), later, earlier)


def test_a_good_answer_passes_every_gate():
    gates = recheck(Loop(), found())
    assert gates and all(g.passed for g in gates) and all(g.knob in DECLARATIONS for g in gates)
    assert replace(found(), gates=gates).accepted
    assert not found().accepted  # nobody has judged it yet


@pytest.mark.parametrize(
    ("gate", "changes"),
    [
        ("pose inliers", {"ids": np.arange(8), "error_px": np.full((2, 8), 1.5, np.float32)}),
        ("pose inliers", {"error_px": np.full((2, 40), 7.0, np.float32)}),
        ("reprojection error", {"error_px": np.full((2, 40), 5.0, np.float32)}),
        ("position sigma", {"covariance": np.diag([1e-4, 0.2, 1e-4, 1e-4, 1e-4, 1e-4])}),
        ("position sigma", {"covariance": None}),
        ("heading", {"T_match_query": pose((0.4, -0.5, 0.1), yaw_deg=60)}),
        ("distance", {"T_match_query": pose((25.0, 0.0, 0.0))}),
    ],
)
def test_a_bad_answer_is_refused_by_the_gate_that_sees_it(gate, changes):
    failed = [g.name for g in recheck(Loop(), found(**changes)) if not g.passed]
    assert gate in failed
    assert set(failed) <= {gate, "reprojection error"}  # seven pixels are no inlier, and a high mean
    assert not replace(found(**changes), gates=recheck(Loop(), found(**changes))).accepted


def test_an_answer_without_pose_fails_every_gate():
    nothing = found(ids=np.arange(3), error_px=np.full((2, 3), np.nan, np.float32), covariance=None)
    gates = recheck(Loop(), nothing)
    assert gates[0].value == 0 and not any(g.passed for g in gates)


def test_heading_means_the_turn_about_gravity():
    """A body that pitches on the way turns nowhere."""
    T_w_match, T_w_query = pose(yaw_deg=20), pose((0.2, 0, 0), yaw_deg=45, pitch_deg=40)
    gates = recheck(Loop(), found(T_w_match=T_w_match, T_match_query=poses.between(T_w_match, T_w_query)))
    turned = next(g for g in gates if g.name == "heading").value
    assert turned == pytest.approx(abs(np.degrees(heading.difference(T_w_query[3:], T_w_match[3:]))), abs=1e-9)
    assert turned == pytest.approx(25, abs=0.1)


@pytest.mark.parametrize("dof", ["4", "6"])
def test_the_drift_brings_the_place_to_where_the_graph_has_it(dof):
    graph = settings.replace(Params(), {"pose_graph.dof": dof}).pose_graph
    T_g_match, T_w_match = pose((1, 2, 3), yaw_deg=30, roll_deg=5), pose((-4, 0.5, 1), yaw_deg=-80, roll_deg=6)
    T_g_w = drift(graph, T_g_match, T_w_match)
    moved = poses.compose(T_g_w, T_w_match)
    np.testing.assert_allclose(moved[:3], T_g_match[:3], atol=1e-12)
    assert heading.difference(moved[3:], T_g_match[3:]) == pytest.approx(0, abs=1e-9)
    if dof == "6":
        np.testing.assert_allclose(so3.difference(moved[3:], T_g_match[3:]), 0, atol=1e-9)


def test_four_degrees_of_freedom_never_tilt_the_world():
    up = np.array([0.0, 0.0, 1.0])
    for roll_deg in (-20, 0, 20):
        T_g_w = drift(PoseGraph(), pose((1, 2, 3), yaw_deg=30), pose((-4, 0.5, 1), yaw_deg=-80, roll_deg=roll_deg))
        np.testing.assert_allclose(so3.rotate(T_g_w[3:], up), up, atol=1e-12)


def test_without_drift_nothing_is_corrected():
    T = pose((1, 2, 3), yaw_deg=30, pitch_deg=-60)
    np.testing.assert_allclose(drift(PoseGraph(), T, T), poses.IDENTITY, atol=1e-12)
