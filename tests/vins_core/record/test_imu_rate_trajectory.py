"""What a run knew of the body at each IMU sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vins_core.evaluation.align import align
from vins_core.evaluation.associate import associate
from vins_core.evaluation.ate import position_errors
from vins_core.evaluation.evaluate import run_trajectory
from vins_core.geometry import poses
from vins_core.io.write import write_recording
from vins_core.record.imu_rate import imu_rate_trajectory
from vins_core.record.reader import RunReader
from vins_core.runner import run_recording
from vins_core.simulation.simulate import simulate


def between_and_at_frames_m(run: RunReader) -> tuple[float, float]:
    """rms errors after one alignment, of the samples between two frames and of those at a frame."""
    found = imu_rate_trajectory(run)
    i, j = associate(run.truth.t_ns, found.t_ns, 0.001)
    p_true, p, t_ns = run.truth.p_w_b[i], found.p_w_b[j], found.t_ns[j]
    error = position_errors(p, p_true, align(p, p_true))
    at_frame = np.isin(t_ns, [run.packet(k).imu.t_ns[-1] for k in range(len(run))])
    assert at_frame.sum() > 20 and (~at_frame).sum() > 5 * at_frame.sum()
    return tuple(float(np.sqrt(np.mean(error[rows] ** 2))) for rows in (~at_frame, at_frame))


def test_it_is_the_odometry_at_frames_and_has_every_sample_between_them(sample_run: Path) -> None:
    run = RunReader(sample_run)
    found, frames = imu_rate_trajectory(run), run_trajectory(run.summaries)
    t_ns = np.concatenate([run.packet(k).imu.t_ns for k in range(len(run)) if run.summary(k).pose])
    assert np.all(np.diff(found.t_ns) > 0)
    assert set(found.t_ns) == set(t_ns[t_ns >= found.t_ns[0]].tolist())
    at = np.searchsorted(found.t_ns, frames.t_ns + round(1e9 * run.header.calibration.td_s))
    assert np.array_equal(found.p_w_b[at], frames.p_w_b) and np.array_equal(found.v_w_b[at], frames.v_w_b)


def test_it_never_knows_what_came_later(sample_run: Path) -> None:
    run = RunReader(sample_run)
    whole = imu_rate_trajectory(run)
    run.summaries = run.summaries[:20]
    part = imu_rate_trajectory(run)
    assert 0 < len(part) < len(whole) and np.array_equal(part.p_w_b, whole.p_w_b[: len(part)])


def test_between_frames_it_is_hardly_worse_than_at_frames(sample_run: Path) -> None:
    between, at = between_and_at_frames_m(RunReader(sample_run))
    assert between <= 1.2 * at


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_at_200_hz_the_error_between_frames_is_at_most_a_fifth_larger(tmp_path: Path, seed: int) -> None:
    simulation = simulate("room_loop", seed, 15.0)
    write_recording(simulation.messages(), tmp_path / "recording", "asl", settings=simulation.settings)
    settings = ("frontend.min_dist=15", "loop.enabled=false")
    run_recording(tmp_path / "recording", out=tmp_path / "run", settings=settings)
    run = RunReader(tmp_path / "run")
    assert run.header.calibration.noise == simulation.calibration.noise
    between, at = between_and_at_frames_m(run)
    assert between <= 1.2 * at


def test_drift_is_corrected_as_it_was_known_then(looping_run: Path) -> None:
    run = RunReader(looping_run)
    found, frames = imu_rate_trajectory(run), run_trajectory(run.summaries)
    drifts, known = [], poses.IDENTITY
    for summary in run.summaries:
        known = summary.closure.drift if summary.closure else known
        if summary.pose is not None:
            drifts.append(known)
    assert not np.allclose(drifts[-1], poses.IDENTITY, atol=1e-6)  # a loop was closed
    expected = poses.compose(np.array(drifts), np.concatenate([frames.p_w_b, frames.q_w_b], 1))
    ends = [run.packet(k).imu.t_ns[-1] for k in range(len(run)) if run.summary(k).pose is not None]
    at = np.searchsorted(found.t_ns, ends)
    assert np.allclose(found.p_w_b[at], expected[:, :3], atol=1e-12)
    assert np.allclose(found.q_w_b[at], expected[:, 3:], atol=1e-12)
