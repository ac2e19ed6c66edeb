from dataclasses import replace

import dense
import numpy as np
import pytest
import synthetic_window as sw

from vins_core import params as settings
from vins_core.geometry import so3
from vins_core.params import Params
from vins_core.solver.layout import Variable
from vins_core.window.assemble import assemble
from vins_core.window.marginalize import marginalize_oldest, marginalize_second_newest
from vins_core.window.state import OUTLIER, BlockKey, Landmarks, Observations, Prior

FORMS = ("plane", "sphere")


def with_form(form: str) -> Params:
    return settings.replace(Params(), {"projection.residual": form})


def without_oldest(window, prior):
    """What remains of a window whose oldest frame was marginalised, at the same states."""
    first, second, *rest = window.frames
    gone = np.isin(window.landmarks.ids, first.observations.ids)
    status = np.where(gone, OUTLIER, window.landmarks.status).astype(np.uint8)
    return replace(
        window,
        frames=(replace(second, imu=None), *rest),
        landmarks=replace(window.landmarks, status=status),
        prior=prior,
    )


@pytest.mark.parametrize("fresh", [True, False])
@pytest.mark.parametrize("free_extrinsics", [True, False])
@pytest.mark.parametrize("form", FORMS)
def test_marginalising_then_solving_equals_solving_everything(form, free_extrinsics, fresh):
    params = with_form(form)
    flight = sw.make(n_tracks=150, outliers=0.03) if fresh else sw.steady(params, n_tracks=150, outliers=0.03)
    whole = assemble(params, flight.window, sw.GRAVITY).problem
    prior, _ = marginalize_oldest(params, flight.window, sw.GRAVITY)
    rest = assemble(params, without_oldest(flight.window, prior), sw.GRAVITY).problem
    full = dense.step(replace(whole, free_extrinsics=free_extrinsics), held_slot=1)
    reduced = dense.step(replace(rest, free_extrinsics=free_extrinsics), held_slot=0)
    worst = max(np.abs(d).max() for d in full.values())
    for block, d in reduced.items():
        same = block if block.kind == "extrinsic" else Variable(block.kind, block.slot + 1)
        np.testing.assert_allclose(d, full[same], atol=1e-7 * worst)


def seed_example():
    """42 landmarks seen from all 11 frames, beside others that start later."""
    rng = np.random.default_rng(5)
    flight = sw.make(n_tracks=60)
    frames = list(flight.window.frames)
    landmarks = flight.window.landmarks
    extra = 10_000 + np.arange(42)
    directions = rng.normal([0, 0, 4], 1, (42, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for k, f in enumerate(frames):
        o = f.observations
        old = o.ids[~np.isin(o.ids, frames[0].observations.ids)] if k else o.ids[:0]
        rows = np.searchsorted(o.ids, old)
        drift = directions + 0.02 * k * rng.normal(size=3)
        rays = np.concatenate([o.rays[rows], drift / np.linalg.norm(drift, axis=1, keepdims=True)])
        n = len(rays)
        frames[k] = replace(f, observations=Observations(
            np.append(old, extra), rays, np.zeros((n, 2), np.float32), np.zeros((n, 2), np.float32)))  # fmt: skip
    table = replace(
        landmarks,
        ids=np.append(landmarks.ids, extra),
        inv_depth=np.append(landmarks.inv_depth, np.full(42, 0.3)),
        status=np.append(landmarks.status, np.full(42, landmarks.status[0])),
    )
    return replace(flight.window, frames=tuple(frames), landmarks=table)


def test_the_example_of_seed_003_drops_57_and_keeps_75_of_132():
    window = seed_example()
    prior, report = marginalize_oldest(Params(), window, sw.GRAVITY)
    assert (report.kind, report.m, report.n, report.m + report.n) == ("MARGIN_OLD", 57, 75, 132)
    assert prior.J.shape == (75, 75) and prior.r.shape == (75,)
    dropped = [b for b in report.blocks if b.dropped]
    kept = [b for b in report.blocks if not b.dropped]
    assert [b.name for b in dropped[:2]] == ["pose 0 (frame 100)", "speed_bias 0 (frame 100)"]
    assert len(dropped) == 44 and all(b.name.startswith("inv_depth of 1") for b in dropped[2:])
    assert len(kept) == 12 and kept[-1].name == "extrinsic cam0"
    assert sum(b.size for b in kept if b.name.startswith("pose")) == 60
    index = [b.index for b in report.blocks]
    assert index == list(np.cumsum([0] + [b.size for b in report.blocks])[:-1])
    assert kept[0].index == 57


def test_the_first_prior_knows_nothing_of_position_and_yaw():
    prior, report = marginalize_oldest(Params(), seed_example(), sw.GRAVITY)
    poses = [x for key, x in zip(prior.blocks, prior.x0) if key.kind == "pose"]
    up = np.array([0.0, 0.0, 1.0])
    turn = [np.append(np.cross(up, x[:3]), so3.rotate(so3.inverse(x[3:]), up)) for x in poses]
    speeds = [
        np.append(np.cross(up, x[:3]), np.zeros(6)) for k, x in zip(prior.blocks, prior.x0) if k.kind == "speed_bias"
    ]
    yaw = np.concatenate([*turn, *speeds, np.zeros(6)])
    shifts = [np.concatenate([np.tile(np.append(e, np.zeros(3)), 10), np.zeros(15)]) for e in np.eye(3)]
    for direction in (yaw, *shifts):
        assert np.linalg.norm(prior.J @ direction) < 1e-4  # information below 1e-8
    assert report.rank <= 71


def test_prior_reproduces_eigenvalues_and_orders_them():
    prior, report = marginalize_oldest(Params(), seed_example(), sw.GRAVITY)
    assert (np.diff(report.eigenvalues) >= 0).all() and (report.eigenvalues >= 0).all()
    np.testing.assert_allclose(np.linalg.eigvalsh(prior.J.T @ prior.J)[-10:], report.eigenvalues[-10:], rtol=1e-6)
    assert np.linalg.matrix_rank(prior.J, tol=1e-4) == report.rank == (report.eigenvalues > 1e-8).sum()
    assert not prior.r[np.linalg.norm(prior.J, axis=1) == 0].any()


def test_prior_names_frames_and_starts_at_the_current_states():
    window = seed_example()
    prior, _ = marginalize_oldest(Params(), window, sw.GRAVITY)
    expected = [BlockKey("pose", f.frame) for f in window.frames[1:]]
    expected += [BlockKey("speed_bias", window.frames[1].frame), BlockKey("extrinsic", 0)]
    assert list(prior.blocks) == expected
    np.testing.assert_array_equal(prior.x0[0], np.append(window.frames[1].p_w_b, window.frames[1].q_w_b))
    np.testing.assert_array_equal(
        prior.x0[10], np.concatenate([window.frames[1].v_w_b, window.frames[1].b_a, window.frames[1].b_g])
    )


def test_second_newest_without_a_prior_on_it_leaves_the_prior_alone():
    window = sw.make(n_tracks=60).window
    prior, report = marginalize_second_newest(Params(), window, sw.GRAVITY)
    assert prior is None and report.kind == "none" and report.m == 0


def test_second_newest_drops_its_pose_and_nothing_else():
    params = Params()
    window = sw.steady(params, n_tracks=200).window
    second = window.frames[-2]
    key = BlockKey("pose", second.frame)
    assert key in window.prior.blocks
    prior, report = marginalize_second_newest(params, window, sw.GRAVITY)
    assert (report.kind, report.m, report.n) == ("MARGIN_SECOND_NEW", 6, 69)
    assert set(prior.blocks) == set(window.prior.blocks) - {key}

    def minimum(J, r, blocks):
        """Normal equations of a prior without the pose, in the order of the new one."""
        start = dict(zip(blocks, np.cumsum([0] + [b.size for b in blocks])))
        gone = start[key] + np.arange(6) if key in start else np.zeros(0, int)
        kept = np.concatenate([start[b] + np.arange(b.size) for b in prior.blocks])
        A, b = J.T @ J, J.T @ r
        if not len(gone):
            return A[np.ix_(kept, kept)], b[kept]
        gain = A[np.ix_(kept, gone)] @ np.linalg.pinv(A[np.ix_(gone, gone)])
        return A[np.ix_(kept, kept)] - gain @ A[np.ix_(gone, kept)], b[kept] - gain @ b[gone]

    A, b = minimum(window.prior.J, window.prior.r, window.prior.blocks)
    A_new, b_new = minimum(prior.J, prior.r, prior.blocks)
    scale = np.sqrt(np.maximum(A.diagonal(), 1))
    np.testing.assert_allclose(A_new / np.outer(scale, scale), A / np.outer(scale, scale), atol=1e-7)
    np.testing.assert_allclose(b_new / scale, b / scale, atol=1e-5)


def test_eigenvalues_below_the_threshold_count_as_zero():
    window = seed_example()
    prior, report = marginalize_oldest(
        settings.replace(Params(), {"marginalization.eigen_threshold": 1.0}), window, sw.GRAVITY
    )
    assert report.rank == (report.eigenvalues > 1.0).sum() < marginalize_oldest(Params(), window, sw.GRAVITY)[1].rank
    assert (np.linalg.svd(prior.J)[1] ** 2)[report.rank :].max() < 1e-12


def test_a_missing_imu_factor_leaves_the_speed_bias_out():
    window = seed_example()
    frames = list(window.frames)
    frames[1] = replace(frames[1], imu=replace(frames[1].imu, dt_s=99.0))
    prior, report = marginalize_oldest(Params(), replace(window, frames=tuple(frames)), sw.GRAVITY)
    assert not any(b.kind == "speed_bias" for b in prior.blocks)
    assert report.m == 48 and report.n == 66


def test_nothing_known_of_what_stays_gives_no_prior():
    window = seed_example()
    frames = list(window.frames)
    frames[1] = replace(frames[1], imu=replace(frames[1].imu, dt_s=99.0))
    bare = replace(window, frames=tuple(frames), landmarks=Landmarks.empty())
    prior, report = marginalize_oldest(Params(), bare, sw.GRAVITY)
    assert prior is None and (report.m, report.n) == (0, 0)


def test_a_prior_on_one_bias_is_enough_to_start_from():
    window = seed_example()
    key = BlockKey("speed_bias", window.frames[0].frame)
    first = window.frames[0]
    x0 = np.concatenate([first.v_w_b, first.b_a + 0.1, first.b_g])
    J = np.zeros((3, 9))
    J[:, 3:6] = 10 * np.eye(3)
    start = Prior((key,), (x0,), J, np.zeros(3))
    _, without = marginalize_oldest(Params(), window, sw.GRAVITY)
    prior, report = marginalize_oldest(Params(), replace(window, prior=start), sw.GRAVITY)
    assert report.n == without.n and report.rank == without.rank + 3
    step = dense.step(assemble(Params(), replace(window, prior=start), sw.GRAVITY).problem, held_slot=0)
    assert all(np.isfinite(d).all() for d in step.values())
    assert prior.J.shape == (75, 75)


def test_same_window_gives_the_same_bits():
    one, two = (marginalize_oldest(Params(), seed_example(), sw.GRAVITY)[0] for _ in range(2))
    assert one.J.tobytes() == two.J.tobytes() and one.r.tobytes() == two.r.tobytes()
