"""How well tracks follow the world, where the truth is exact: a recording from `vinspect simulate`.

    python tests/benchmarks/track_noise.py RECORDING [--calib FILE] [--set frontend.klt_window=21]

The front end runs alone.  Each track is triangulated from the true camera poses; what its observations are off by is
the error of the front end, in px460:

    sigma       1.48 median |e| per axis
    bad         share of tracks with a mean error above 1.5
    drift k     sigma of e_k - e_0, k frames after the first: tracks do not jitter, they slip away from where they began
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np

from vins_core import params as P
from vins_core.frontend.state import TrackerState
from vins_core.frontend.step import track
from vins_core.geometry import se3, so3
from vins_core.io import modes
from vins_core.io.calibration import read_calibration
from vins_core.io.recording import open_recording
from vins_core.io.sync import packets
from vins_core.process import prepare
from vins_core.sensors import Trajectory

START_S = 2.0  # simulated motions begin at rest
LONGEST, SHORTEST = 30, 5  # frames
MIN_BASELINE_M = 0.15
DRIFT_AFTER = (1, 3, 10, 20)


def pose_at(truth: Trajectory, t_ns: int) -> np.ndarray:
    """T_w_b, interpolated."""
    i = int(np.clip(np.searchsorted(truth.t_ns, t_ns), 1, len(truth.t_ns) - 1))
    w = (t_ns - truth.t_ns[i - 1]) / (truth.t_ns[i] - truth.t_ns[i - 1])
    p = (1 - w) * truth.p_w_b[i - 1] + w * truth.p_w_b[i]
    before, after = truth.q_w_b[i - 1], truth.q_w_b[i]
    return se3.from_quaternion_translation(so3.retract(before, w * so3.difference(after, before)), p)


def errors_px460(T_w_c: np.ndarray, rays: np.ndarray) -> np.ndarray | None:
    """(n, 2) of one track at its best point in the world (Gauss-Newton, Cauchy); None when it lies behind a camera."""
    R, c = T_w_c[:, :3, :3], T_w_c[:, :3, 3]
    d = np.einsum("kij,kj->ki", R, rays)
    off_line = np.eye(3) - d[:, :, None] * d[:, None, :]
    X = np.linalg.solve(off_line.sum(0), np.einsum("kij,kj->i", off_line, c))
    for _ in range(6):
        x, y, z = np.einsum("kji,kj->ik", R, X - c)
        if z.min() < 0.1:
            return None
        e = 460 * (np.stack([x / z, y / z], 1) - rays[:, :2] / rays[:, 2:])
        o = np.zeros_like(z)
        J = 460 * np.stack([np.stack([1 / z, o, -x / z**2], 1), np.stack([o, 1 / z, -y / z**2], 1)], 1)
        J = J @ R.transpose(0, 2, 1)
        w = 1 / (1 + np.square(e).sum(1) / 1.5**2)
        X = X - np.linalg.solve(np.einsum("k,kai,kaj->ij", w, J, J), np.einsum("k,kai,ka->i", w, J, e))
    return e


def sigma(e: np.ndarray) -> float:
    return 1.4826 * float(np.median(np.abs(e)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--calib", type=Path, action="append", default=[])
    parser.add_argument("--set", action="append", default=[], metavar="section.name=value")
    parser.add_argument("--duration", type=float, default=10.0)
    args = parser.parse_args()
    prepare()
    with open_recording(args.recording) as probe:
        settings = read_calibration(args.calib, probe)
    calibration, _ = modes.prepare(settings.calibration)
    source, camera = open_recording(args.recording, calibration), calibration.cameras[0]
    params = P.replace(P.replace(P.Params(), settings.overrides), dict(item.split("=", 1) for item in args.set))
    state, truth, poses, seen = TrackerState.empty(), source.truth(), [], defaultdict(list)
    for packet in packets(source, calibration, params, START_S, args.duration):
        state, found, _ = track(params.frontend, camera, source, state, packet)
        for i, ray in zip(found.ids.tolist(), found.rays):
            seen[i].append((len(poses), ray))
        poses.append(pose_at(truth, packet.t_ns) @ camera.T_b_c)

    tracks = []
    for rows in (rows[:LONGEST] for rows in seen.values() if len(rows) >= SHORTEST):
        T_w_c = np.array([poses[k] for k, _ in rows])
        if np.linalg.norm(T_w_c[:, :3, 3] - T_w_c[0, :3, 3], axis=1).max() < MIN_BASELINE_M:
            continue
        e = errors_px460(T_w_c, np.array([ray for _, ray in rows]))
        if e is not None:
            tracks.append(e)
    mean = np.array([np.linalg.norm(e, axis=1).mean() for e in tracks])
    drift = {k: sigma(np.array([e[k] - e[0] for e in tracks if len(e) > k])) for k in DRIFT_AFTER}
    print(
        f"{len(tracks)} tracks of {np.mean([len(e) for e in tracks]):.1f} frames: "
        f"sigma {sigma(np.concatenate(tracks)):.2f}, bad {100 * np.mean(mean > 1.5):.1f} %, "
        + ", ".join(f"drift {k} {value:.2f}" for k, value in drift.items())
    )


if __name__ == "__main__":
    main()
