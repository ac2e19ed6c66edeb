"""Landmarks from a depth camera: the three variants of seed 000.3.2, their gates, and what leaves with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic_window as sw

from vins_core import params as parameters
from vins_core.geometry import inverse_depth, se3
from vins_core.params import Params
from vins_core.report import DepthUse
from vins_core.solver.solve import solve
from vins_core.window import depth
from vins_core.window.assemble import assemble, gather_tracks, solve_report, unpack
from vins_core.window.create import create_landmarks
from vins_core.window.departure import oldest_leaves, second_newest_leaves
from vins_core.window.landmarks import camera_poses
from vins_core.window.marginalize import marginalize_oldest
from vins_core.window.slide import drop_oldest
from vins_core.window.state import CANDIDATE, TRIANGULATED, Landmarks, WindowState

VARIANTS = ("trust", "confirm", "hold")
FRAMES = {"trust": 1, "confirm": 2, "hold": 3}
FACTOR, HELD, WAITING, UNSTEADY, GATED = (depth.USES[use] for use in DepthUse)


def params(variant: str, **changes: float) -> Params:
    return parameters.replace(Params(), {"depth.variant": variant, **{f"depth.{k}": v for k, v in changes.items()}})


def with_depths(flight: WindowState, truth: WindowState, noise: float = 0.0, share: float = 1.0) -> WindowState:
    """`flight` with what a depth camera measures at the true states of `truth`."""
    tracks, table, rng = gather_tracks(truth.frames), truth.landmarks, np.random.default_rng(9)
    T_w_c = camera_poses(truth)
    first = inverse_depth.point(tracks.rays[tracks.start[:-1]], table.inv_depth[np.searchsorted(table.ids, tracks.ids)])
    points_w = se3.transform(T_w_c[tracks.anchor], first)
    frames = []
    for slot, frame in enumerate(flight.frames):
        o = frame.observations
        z = se3.transform(se3.inverse(T_w_c[slot]), points_w[np.searchsorted(tracks.ids, o.ids)])[:, 2]
        z = z * (1 + noise * rng.standard_normal(len(z)))
        z[(rng.random(len(z)) >= share) | (z < 0.1)] = np.nan
        frames.append(replace(frame, observations=replace(o, depth_m=z.astype(np.float32))))
    return replace(flight, frames=tuple(frames))


def made(seed: int = 0, noise: float = 0.0, share: float = 1.0, at_truth: bool = True, **options: float) -> WindowState:
    flight = sw.make(seed, n_tracks=150, **options)
    return with_depths(flight.truth if at_truth else flight.window, flight.truth, noise, share)


def without_landmarks(window: WindowState) -> WindowState:
    n = len(window.landmarks)
    return replace(
        window, landmarks=Landmarks(window.landmarks.ids, np.full(n, np.nan), np.full(n, CANDIDATE, np.uint8))
    )


def changed(window: WindowState, slot: int, rows: np.ndarray, factor: float) -> WindowState:
    """With the depths of some tracks of one frame multiplied."""
    frames = list(window.frames)
    o = frames[slot].observations
    depth_m = o.depth_m.copy()
    depth_m[rows] *= np.float32(factor)
    frames[slot] = replace(frames[slot], observations=replace(o, depth_m=depth_m))
    return replace(window, frames=tuple(frames))


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_landmark_is_where_its_first_frames_have_it(variant: str) -> None:
    window = made(1, pixel_sigma=0.0)
    created = create_landmarks(params(variant), without_landmarks(window))
    tracks = gather_tracks(window.frames)
    soon = tracks.count >= FRAMES[variant]
    rows = np.searchsorted(window.landmarks.ids, tracks.ids)
    assert (created.landmarks.status[rows[soon]] == TRIANGULATED).all()
    np.testing.assert_allclose(
        created.landmarks.inv_depth[rows[soon]], window.landmarks.inv_depth[rows[soon]], rtol=1e-5
    )
    late = tracks.anchor >= len(window.frames) - 3  # too late for triangulation
    assert (late & soon).sum() > 5
    assert (created.landmarks.status[rows[late & ~soon]] == CANDIDATE).all()


def test_without_a_depth_camera_nothing_changes() -> None:
    flight = sw.make(2, n_tracks=100).truth
    assert assemble(params("trust"), flight, sw.GRAVITY).problem.depths is None
    assert create_landmarks(params("trust"), flight) is flight


def test_what_has_no_depth_is_triangulated() -> None:
    window = made(3, share=0.5, pixel_sigma=0.0)
    created = create_landmarks(params("trust"), without_landmarks(window))
    tracks = gather_tracks(window.frames)
    blind = np.isnan(tracks.depth_m[tracks.start[:-1]]) & (tracks.anchor < len(window.frames) - 3)
    rows = np.searchsorted(window.landmarks.ids, tracks.ids[blind])
    assert blind.sum() > 10 and (created.landmarks.status[rows] == TRIANGULATED).all()


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_problem_pulls_or_holds_as_the_variant_says(variant: str) -> None:
    window = made(4, noise=0.01)
    assembly = assemble(params(variant), create_landmarks(params(variant), window), sw.GRAVITY)
    depths = assembly.problem.depths
    tracks = gather_tracks(window.frames)
    enough = tracks.ids[tracks.count >= max(FRAMES[variant], 2)]
    pulled, held = assembly.ids[depths.landmark], assembly.ids[depths.held]
    assert (len(held) == 0) == (variant != "hold") and (len(pulled) == 0) == (variant == "hold")
    found = held if variant == "hold" else pulled
    assert np.isin(found, enough).all() and len(found) > 0.9 * len(enough)


@pytest.mark.parametrize("variant", ["confirm", "hold"])
def test_the_mean_of_frames_is_better_than_one(variant: str) -> None:
    window = made(5, noise=0.02)
    tracks, table = gather_tracks(window.frames), window.landmarks
    true = 1 / table.inv_depth[np.searchsorted(table.ids, tracks.ids)]
    errors = {}
    for v in ("trust", variant):
        points = depth.points(params(v, max_disagreement=50).depth, window, tracks, np.full(len(true), np.nan))
        errors[v] = (points.depth_m / true - 1)[points.counts & (tracks.count >= FRAMES[variant])]
    assert errors[variant].std() < errors["trust"].std() * 1.15 / np.sqrt(FRAMES[variant])


def test_disagreement_is_in_standard_deviations() -> None:
    window = made(6, noise=0.01, pixel_sigma=0.0)
    tracks = gather_tracks(window.frames)
    unknown = np.full(len(tracks.ids), np.nan)
    found = depth.points(params("confirm", sigma=0.01).depth, window, tracks, unknown).disagreement
    assert np.nanmean(found**2) == pytest.approx(1.0, abs=0.35)


def test_confirm_forgets_the_first_frame_of_those_that_disagree_and_tries_the_next_two() -> None:
    window = without_landmarks(made(7, pixel_sigma=0.0))
    first = window.frames[0].observations
    wrong = first.ids[:10]
    window = changed(window, 0, np.arange(10), 1.5)
    once = create_landmarks(params("confirm"), window)
    assert not np.isin(wrong, once.frames[0].observations.ids).any()
    assert len(once.frames[0].observations) == len(first) - 10
    assert len(once.frames[0].observations.depth_m) == len(first) - 10
    twice = create_landmarks(params("confirm"), once)
    tracks = gather_tracks(twice.frames)
    long_enough = np.intersect1d(wrong, tracks.ids[tracks.count >= 2])
    rows = np.searchsorted(twice.landmarks.ids, long_enough)
    points = depth.points(params("trust").depth, twice, tracks, np.full(len(tracks.ids), np.nan))
    np.testing.assert_allclose(
        twice.landmarks.inv_depth[rows], 1 / points.depth_m[np.searchsorted(tracks.ids, long_enough)], rtol=0.01
    )


@pytest.mark.parametrize("variant", ["trust", "hold"])
def test_the_other_variants_forget_no_observation(variant: str) -> None:
    window = changed(without_landmarks(made(7)), 0, np.arange(10), 1.5)
    created = create_landmarks(params(variant), window)
    assert all(a.observations is b.observations for a, b in zip(created.frames, window.frames))


def test_a_depth_that_disagrees_with_the_estimate_counts_no_more() -> None:
    window = changed(made(8), 0, np.arange(5), 1.3)
    assembly = assemble(params("trust"), window, sw.GRAVITY)
    pulled = assembly.ids[assembly.problem.depths.landmark]
    wrong = window.frames[0].observations.ids[:5]
    assert np.isin(np.intersect1d(wrong, assembly.ids), pulled).sum() == 0
    assert len(pulled) > 0.9 * len(assembly.ids) - 5


def test_when_most_disagree_it_is_the_estimate_that_is_wrong() -> None:
    window = made(9)
    shrunk = replace(window, landmarks=replace(window.landmarks, inv_depth=window.landmarks.inv_depth * 1.3))
    tracks = gather_tracks(window.frames)
    inv_depth = shrunk.landmarks.inv_depth[np.searchsorted(shrunk.landmarks.ids, tracks.ids)]
    use = depth.points(params("trust").depth, shrunk, tracks, inv_depth).use
    assert (use == FACTOR).sum() > 100 and (use == GATED).sum() == 0


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_oldest_frame_takes_the_depths_of_its_landmarks_along(variant: str) -> None:
    chosen = params(variant)
    window = create_landmarks(chosen, made(10, noise=0.01))
    whole, part = assemble(chosen, window, sw.GRAVITY), oldest_leaves(chosen, window, sw.GRAVITY)
    leaving = np.flatnonzero(whole.anchor == 0)
    expected, depths = whole.problem.depths, part.problem.depths
    for mine, all_of_them in ((depths.landmark, expected.landmark), (depths.held, expected.held)):
        assert len(mine) == np.isin(all_of_them, leaving).sum()
        np.testing.assert_array_equal(part.landmark_ids[mine], whole.ids[np.intersect1d(all_of_them, leaving)])
    prior, _ = marginalize_oldest(chosen, window, sw.GRAVITY)
    assert second_newest_leaves(chosen, replace(window, prior=prior), sw.GRAVITY).problem.depths is None


@pytest.mark.parametrize("variant", VARIANTS)
def test_first_estimates_at_the_current_states_are_the_current_linearisation(variant: str) -> None:
    chosen = params(variant)
    part = oldest_leaves(chosen, create_landmarks(chosen, made(11, noise=0.01)), sw.GRAVITY)
    one, other = part.projections(), part._projections_at_first_estimates(replace(part.problem, imu=(), prior=None))
    for name in ("H", "g", "W", "h", "g_l"):
        a, b = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(b).max())


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_prior_knows_the_scale_better_with_depth(variant: str) -> None:
    """The information that what leaves has about the distance between two frames that stay."""
    chosen = params(variant)
    window = replace(create_landmarks(chosen, made(12, noise=0.01)), prior=None)
    blind = replace(
        window, frames=tuple(replace(f, observations=replace(f.observations, depth_m=None)) for f in window.frames)
    )
    known = []
    for w in (window, blind):
        prior, _ = marginalize_oldest(chosen, w, sw.GRAVITY)
        columns, start = {}, 0
        for block in prior.blocks:
            columns[block.kind, block.id] = slice(start, start + 3)
            start += block.size
        stretch = np.zeros(start)
        for f in w.frames[1:]:
            if ("pose", f.frame) in columns:
                stretch[columns["pose", f.frame]] = f.p_w_b - w.frames[0].p_w_b
        known.append(np.square(prior.J @ stretch).sum())
    assert known[0] > 1.5 * known[1]


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_report_shows_measured_beside_estimated(variant: str) -> None:
    chosen = params(variant)
    window = create_landmarks(chosen, made(13, noise=0.01, at_truth=False, perturbation=0.2))
    assembly = assemble(chosen, window, sw.GRAVITY)
    solution = solve(chosen, assembly.problem)
    solved = unpack(window, assembly, solution.states)
    found = depth.report(chosen.depth, window, solved, assembly)
    assert solve_report(assembly, solution).after.depth == solution.after.depth
    assert (np.diff(found.ids) > 0).all() and set(found.use) <= {FACTOR, HELD, WAITING, UNSTEADY, GATED}
    rows = np.searchsorted(solved.landmarks.ids, found.ids)
    np.testing.assert_allclose(found.estimated_m, 1 / solved.landmarks.inv_depth[rows], rtol=1e-6)
    newest = window.frames[-1].observations
    np.testing.assert_array_equal(found.seen_ids, newest.ids[~np.isnan(newest.depth_m)])
    assert np.nanmedian(np.abs(found.seen_error_sigma)) < 3
    held = found.use == HELD
    assert held.any() == (variant == "hold")
    np.testing.assert_allclose(found.error_sigma[held], 0, atol=1e-3)


@pytest.mark.parametrize("variant", VARIANTS)
def test_landmarks_keep_their_place_when_the_anchor_moves_on(variant: str) -> None:
    window = made(14, pixel_sigma=0.0)
    slid = drop_oldest(window)
    again = create_landmarks(params(variant), without_landmarks(slid))
    both = np.isfinite(again.landmarks.inv_depth) & np.isfinite(slid.landmarks.inv_depth)
    assert both.sum() > 50
    np.testing.assert_allclose(again.landmarks.inv_depth[both], slid.landmarks.inv_depth[both], rtol=1e-4)
