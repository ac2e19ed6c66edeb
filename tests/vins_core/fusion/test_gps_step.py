from dataclasses import replace

import numpy as np
import pytest
from gps_run import Live, final, live, settings, steps

from vins_core import params
from vins_core.fusion.presets import PRESETS
from vins_core.fusion.smooth import smooth
from vins_core.fusion.state import GpsState, OdometryPose, restart
from vins_core.fusion.step import step
from vins_core.geometry import heading, poses, so3
from vins_core.record.codec import Blob, pack
from vins_core.report import FixVerdict, GpsReport, GpsStatus
from vins_core.sensors import GpsFix
from vins_core.simulation.drive import Drive, OdometryError, Receiver, Road, drive

CLEAN = Receiver(outlier_share=0.0)
SHORT = Road(length_m=300.0)


@pytest.fixture(scope="module")
def short() -> Drive:
    """30 s with outliers and 8 s without fixes."""
    return drive(7, SHORT, receiver=Receiver(outage_s=(14.0, 22.0)))


@pytest.fixture(scope="module")
def short_live(short) -> Live:
    return live(settings(), short)


def shifted(fixes: tuple[GpsFix, ...], rows: np.ndarray, d: Drive, way_m: tuple[float, float]) -> tuple[GpsFix, ...]:
    """Some fixes moved by (east, north)."""
    out = list(fixes)
    for k in rows:
        lat, lon, alt = d.start.to_geodetic(d.start.position(fixes[k]) + np.append(way_m, 0.0))
        out[k] = replace(fixes[k], latitude_deg=float(lat), longitude_deg=float(lon), altitude_m=float(alt))
    return tuple(out)


def assert_meets_the_bounds(d: Drive, run: Live, smoothed) -> None:
    """Bounds for a kilometre with 1 m fixes at 5 Hz, 5 % outliers and a 30 s outage."""
    _, track, used = smoothed
    heard = ~d.in_outage
    everything = heard & run.track.known
    assert run.track.horizontal_rmse_m(heard) < 0.7
    assert track.horizontal_rmse_m(heard) < 0.5
    for final_use in (used, run.used(d)):
        assert not (final_use & d.outlier).any()
        assert (~final_use & ~d.outlier).sum() <= 0.03 * (~d.outlier).sum()
    assert abs(run.track.yaw_error_deg[run.first]) < 1.0
    assert np.sqrt(np.mean(run.track.yaw_error_deg[everything] ** 2)) < 1.0
    assert abs(track.yaw_error_deg[run.first]) < 1.0
    assert np.sqrt(np.mean(track.yaw_error_deg**2)) < 0.5


def mean_nees(runs: list[tuple[Drive, Live, tuple]]) -> tuple[float, float]:
    """Live and final, over all frames with fixes around."""
    return (
        float(np.mean([run.track.nees(~d.in_outage) for d, run, _ in runs])),
        float(np.mean([smoothed[1].nees(~d.in_outage) for d, _, smoothed in runs])),
    )


@pytest.mark.slow
def test_twenty_drives_keep_the_bounds():
    runs = [(d, live(settings(), d), final(settings(), d)) for d in map(drive, range(20))]
    for d, run, smoothed in runs:
        assert_meets_the_bounds(d, run, smoothed)
        assert 0.5 < run.track.nees(~d.in_outage) < 2.0
        assert 0.5 < smoothed[1].nees(np.ones(len(d.t_ns), bool)) < 2.0
    assert mean_nees(runs) == pytest.approx((1.0, 1.0), abs=0.2)


def test_a_drive_keeps_the_bounds():
    d = drive(11)
    run, smoothed = live(settings(), d), final(settings(), d)
    assert_meets_the_bounds(d, run, smoothed)
    assert all(0.5 < nees < 2.0 for nees in mean_nees([(d, run, smoothed)]))


def test_live_at_the_end_is_the_final_trajectory_at_its_end():
    """A filter and a smoother of the same past agree; the window's prior has lost nothing."""
    d = drive(5, SHORT, receiver=replace(CLEAN, outage_s=(15.0, 20.0)))
    gps = settings(max_chi2=100.0)  # no verdicts, which may differ
    run, (smoothed, _, used) = live(gps, d), final(gps, d)
    assert used.all()
    last = len(d.t_ns) - 1
    sigma = np.sqrt(np.diagonal(smoothed.covariance[last]))
    moved = run.track.T_e_b[last, :3] - smoothed.T_e_b[last, :3]
    assert np.all(np.abs(moved) < 0.05 * sigma[:3])
    turned = heading.difference(run.track.T_e_b[last, 3:], smoothed.T_e_b[last, 3:])
    assert abs(turned) < 0.05 * sigma[5]
    scale = sigma[:, None] * sigma + 1e-12
    np.testing.assert_allclose(run.track.covariance[last] / scale, smoothed.covariance[last] / scale, atol=0.05)


def test_no_pose_is_given_before_the_heading_is_known(short, short_live):
    first = short_live.first
    for report in short_live.reports[:first]:
        assert report.status in (GpsStatus.WAITING, GpsStatus.ALIGNING)
        assert report.T_e_b is None and report.T_e_o is None and report.outcome
        assert all(f.verdict is not FixVerdict.USED for f in report.fixes)
    counts = short_live.reports[first]
    assert counts.status is GpsStatus.FUSING and counts.outcome == ""
    assert counts.yaw_sigma_deg <= settings().full_yaw_sigma_deg
    assert {r.verdict for r in counts.revised} == {FixVerdict.USED, FixVerdict.GATED}


def test_verdict_and_gates_of_a_fix_say_the_same(short_live):
    judged = [f for r in short_live.reports for f in r.fixes if f.verdict is not FixVerdict.OPEN]
    assert any(f.verdict is FixVerdict.GATED for f in judged)
    for fix in judged:
        assert all(g.passed for g in fix.gates) == (fix.verdict is FixVerdict.USED)


def test_drift_correction_and_pose_agree(short, short_live):
    for report, T_o_b in zip(short_live.reports[short_live.first :: 20], short.T_o_b[short_live.first :: 20]):
        np.testing.assert_allclose(poses.compose(report.T_e_o, T_o_b), report.T_e_b, atol=1e-9)
        assert report.yaw_deg == pytest.approx(np.rad2deg(heading.turn(report.T_e_o[3:])))


def test_uncertainty_grows_through_an_outage_and_falls_after_it(short, short_live):
    sigma = np.sqrt(np.trace(short_live.track.covariance[:, :2, :2], axis1=1, axis2=2))
    begin, end = (int(np.searchsorted(short.t_ns, t)) for t in short.outage_ns)
    inside = sigma[begin + 3 : end - 1]
    assert np.all(np.diff(inside) > 0) and inside[-1] > 1.3 * sigma[begin]
    assert sigma[end + 10] < inside[-1]
    out = next(g for g in short_live.reports[end - 1].gates if g.name == "outage_s")
    assert not out.passed and not out.decides and out.value == pytest.approx(8.0, abs=0.4)


@pytest.mark.parametrize("way_m", [(14.0, 0.0), (0.0, -14.0)])
def test_outliers_that_come_first_after_an_outage_are_found_out_by_those_that_follow(way_m):
    """At 100 s without a fix, 14 m is within the prediction; the fixes after it tell."""
    d = drive(3, Road(length_m=1200.0, frame_hz=5.0), receiver=replace(CLEAN, outage_s=(12.0, 112.0)))
    stamps = np.array([f.t_ns for f in d.fixes])
    wrong = np.flatnonzero(stamps > d.outage_ns[1])[:2]
    d = replace(d, fixes=shifted(d.fixes, wrong, d, way_m))
    run = live(settings(), d)
    used = run.used(d)
    assert not used[wrong].any()
    assert used[wrong[-1] + 1 :].mean() > 0.97
    assert np.linalg.norm(run.track.error_m[-1, :2]) < 2.0


def test_a_burst_of_fixes_that_agree_only_with_each_other_is_out():
    """Three seconds 15 m beside the road, as by a reflection: the odometry did not go there."""
    d = drive(1, SHORT, receiver=replace(CLEAN, outage_s=(900.0, 901.0)))
    stamps = np.array([f.t_ns for f in d.fixes])
    beside = np.flatnonzero((stamps > 15e9) & (stamps < 18e9))
    d = replace(d, fixes=shifted(d.fixes, beside, d, (15.0, 5.0)))
    run = live(settings(), d)
    used = run.used(d)
    assert not used[beside].any()
    assert (~used).sum() <= len(beside) + 0.03 * len(used)
    assert run.track.horizontal_rmse_m(run.track.known) < 0.8


def test_odometry_that_jumps_is_aligned_anew_instead_of_locking_out_all_fixes():
    d = drive(4, SHORT, receiver=replace(CLEAN, outage_s=(900.0, 901.0)))
    T = d.T_o_b.copy()
    T[150:, :2] += [60.0, -40.0]
    run = live(settings(window=20), replace(d, T_o_b=T))
    assert any("lost" in r.outcome for r in run.reports)
    assert run.reports[-1].status is GpsStatus.FUSING
    assert np.linalg.norm(run.track.error_m[-1, :2]) < 2.0


def test_standing_still_never_aligns_and_says_why():
    d = drive(0, SHORT, receiver=CLEAN)
    still = np.tile(d.T_o_b[0], (len(d.t_ns), 1))
    anywhere = d.fixes[0]
    fixes = tuple(replace(anywhere, t_ns=f.t_ns) for f in d.fixes)
    *_, (state, report) = steps(settings(), replace(d, T_o_b=still, fixes=fixes))
    assert report.status is GpsStatus.ALIGNING and "not moved" in report.outcome
    assert len(state.nodes) < settings().window
    assert "heading" in smooth(settings(), d.p_b_gps, d.t_ns, still, fixes)


def test_a_slow_body_gets_its_heading_from_a_longer_way():
    """0.5 m/s and 1 m noise: the first window covers 4 m; thinned it covers as much as it takes."""
    receiver = replace(CLEAN, rate_hz=1.0, outage_s=(900.0, 901.0))
    d = drive(2, Road(length_m=75.0, speed_m_s=0.5, frame_hz=2.0), receiver=receiver)
    run = live(settings(window=15, max_gap_s=1.0), d)
    assert 20e9 < d.t_ns[run.first] < 149e9
    assert abs(run.track.yaw_error_deg[run.first]) < 6.0
    assert all(r.n_window <= 15 for r in run.reports)


def test_state_does_not_grow_with_the_run():
    d = drive(6, SHORT, receiver=replace(CLEAN, outage_s=(900.0, 901.0)))
    sizes = [(len(s.nodes), len(s.recent), len(s.early), s.x.size) for s, _ in steps(settings(window=20), d)]
    half = len(sizes) // 2
    assert np.max(sizes, 0).tolist() == np.max(sizes[half - 50 : half], 0).tolist()
    assert np.max(sizes, 0)[0] == 20


def test_a_step_leaves_earlier_states_as_they_were(short):
    states = [state for state, _ in steps(settings(), replace(short, t_ns=short.t_ns[:160], T_o_b=short.T_o_b[:160]))]
    before = pack({"state": states[120]})
    state = states[120]
    for k in range(121, 160):
        fixes = [f for f in short.fixes if short.t_ns[k - 1] < f.t_ns <= short.t_ns[k]]
        state, _ = step(settings(), short.p_b_gps, state, OdometryPose(int(short.t_ns[k]), short.T_o_b[k]), fixes)
    assert pack({"state": states[120]}) == before
    assert pack({"state": state}) == pack({"state": states[159]})


def test_fixes_may_come_late_early_or_in_any_order(short, short_live):
    """Two frames late and shuffled, or before their frame: the same fixes count, and the pose is as good."""
    gps, state, reports = settings(), GpsState(), []
    pending = list(short.fixes)
    for t_ns, T_o_b in zip(short.t_ns.tolist(), short.T_o_b):
        ready = [f for f in pending if f.t_ns <= t_ns - 200_000_000 or (t_ns > 10e9 and f.t_ns <= t_ns + 150_000_000)]
        pending = [f for f in pending if f not in ready]
        state, report = step(gps, short.p_b_gps, state, OdometryPose(t_ns, T_o_b), ready[::-1])
        reports.append(report)
    verdicts = {f.t_ns: f.verdict for r in reports for f in (*r.fixes, *r.revised)}
    same = [verdicts.get(t) is v for t, v in short_live.verdicts.items()]
    assert np.mean(same) > 0.99
    assert np.linalg.norm(reports[-1].T_e_b[:3] - short_live.reports[-1].T_e_b[:3]) < 0.3


def test_a_fix_from_another_clock_is_refused_instead_of_waiting_for_ever(short):
    far = replace(short.fixes[0], t_ns=short.t_ns[0] + 10**18)
    state, report = step(settings(), short.p_b_gps, GpsState(), OdometryPose(0, short.T_o_b[0]), [far])
    assert report.fixes[0].verdict is FixVerdict.GATED and report.fixes[0].gates[0].name == "stamp_off_s"
    assert not state.early


def test_a_fix_that_is_sent_twice_counts_once(short, short_live):
    twice = replace(short, fixes=tuple(f for fix in short.fixes for f in (fix, fix)))
    *_, (_, report) = steps(settings(), twice)
    np.testing.assert_array_equal(report.T_e_b, short_live.reports[-1].T_e_b)
    again = final(settings(), twice)[2]
    assert again.sum() == final(settings(), short)[2].sum()


def test_a_recorded_state_goes_on_bit_for_bit(short, short_live):
    gps, k = settings(), 200
    *_, (state, report) = steps(gps, replace(short, t_ns=short.t_ns[:k], T_o_b=short.T_o_b[:k]))
    blob = Blob(pack({"state": state, "report": report}), "a frame")
    state, report = blob.get("state", GpsState), blob.get("report", GpsReport)
    np.testing.assert_array_equal(report.T_e_b, short_live.reports[k - 1].T_e_b)
    rest = tuple(f for f in short.fixes if f.t_ns > short.t_ns[k - 1])
    *_, (_, last) = steps(gps, replace(short, t_ns=short.t_ns[k:], T_o_b=short.T_o_b[k:], fixes=rest), state)
    np.testing.assert_array_equal(last.T_e_b, short_live.reports[-1].T_e_b)
    np.testing.assert_array_equal(last.covariance, short_live.reports[-1].covariance)


@pytest.mark.parametrize("changes", [{"dof": "6"}, {"scale_sigma": 0.0}, {"window": 12}, {"noise": "frame"}])
def test_parameters_may_change_while_it_runs(short, short_live, changes):
    k = 200
    *_, (state, _) = steps(settings(), replace(short, t_ns=short.t_ns[:k], T_o_b=short.T_o_b[:k]))
    rest = tuple(f for f in short.fixes if f.t_ns > short.t_ns[k - 1])
    other = replace(short, t_ns=short.t_ns[k:], T_o_b=short.T_o_b[k:], fixes=rest)
    *_, (state, report) = steps(settings(**changes), other, state)
    assert report.status is GpsStatus.FUSING
    assert np.linalg.norm(report.T_e_b[:3] - short_live.track.truth[-1, :3]) < 3.0


def test_frames_must_come_in_order(short):
    state, _ = step(settings(), short.p_b_gps, GpsState(), OdometryPose(100, short.T_o_b[0]), [])
    with pytest.raises(ValueError, match="comes after"):
        step(settings(), short.p_b_gps, state, OdometryPose(100, short.T_o_b[1]), [])


def test_after_a_restart_of_the_odometry_the_earth_stays_where_it_is(short, short_live):
    fresh = restart(short_live.state)
    assert fresh.origin == short_live.state.origin and not fresh.nodes and not fresh.aligned


def test_the_lever_arm_is_seen():
    """An antenna 3 m ahead of the body: without its calibration the trajectory is 3 m off."""
    d = drive(8, SHORT, receiver=Receiver(outlier_share=0.0, p_b_gps=(3.0, 0.0, 0.0), outage_s=(900.0, 901.0)))
    with_arm, without = (final(settings(lever_arm=on), d)[1] for on in (True, False))
    assert with_arm.horizontal_rmse_m(with_arm.known) < 0.7
    assert without.horizontal_rmse_m(without.known) > 2.5


def test_odometry_without_gravity_needs_six_degrees_of_freedom():
    """Tilted by 3 degrees, as a world of stereo without an IMU is: with 4 DoF height would run away from the fixes."""
    d = drive(4, SHORT, OdometryError(tilt_walk_deg=0.03), replace(CLEAN, outage_s=(900.0, 901.0)))
    tilt = np.append(np.zeros(3), so3.exp(np.array([0.0, np.deg2rad(3.0), 0.0])))
    d = replace(d, T_o_b=poses.compose(np.tile(tilt, (len(d.t_ns), 1)), d.T_o_b))
    run = live(settings(dof="6"), d)
    assert (run.used(d) | (np.arange(len(d.fixes)) < 40)).mean() > 0.97
    assert run.track.horizontal_rmse_m(run.track.known) < 0.8
    _, track, _ = final(settings(dof="6"), d)
    assert np.sqrt(np.mean(track.error_m[:, 2] ** 2)) < 0.6
    assert 0.4 < track.nees(track.known) < 2.0


def test_parity_follows_the_noise_of_the_fixes_and_an_outlier_pulls_it():
    """REFERENCE 23.17: at 0.1 m of odometry error a frame the graph is soft."""
    parity = params.replace(params.Params(), PRESETS["parity"]).gps
    d = drive(10, SHORT, receiver=Receiver(rate_hz=2.0, outage_s=(900.0, 901.0)))
    ours, theirs = final(settings(), d), final(parity, d)
    assert theirs[2].all()
    rows = np.ones(len(d.t_ns), bool)
    assert theirs[1].horizontal_rmse_m(rows) > 1.5 * ours[1].horizontal_rmse_m(rows)
    assert live(parity, d).reports[-1].status is GpsStatus.FUSING
