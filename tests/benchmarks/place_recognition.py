"""How well places are recognised.

    python tests/benchmarks/place_recognition.py corridor FOLDER          images of rtabmap's samples and samples_GT.bmp
    python tests/benchmarks/place_recognition.py run RUN [--set k=v]      the keyframes of a run with ground truth

`corridor` prints precision and recall of retrieval alone, and of retrieval with an epipolar check; its camera is not
calibrated, so that the check is by a fundamental matrix.  `run` repeats the loop stage over the keyframes of a record
and compares every accepted pair with ground truth.  No figure is asserted.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from vins_core import params as parameters
from vins_core.evaluation.associate import associate
from vins_core.examine import solved_window
from vins_core.frontend.images import usable_area
from vins_core.frontend.reject import epipolar_inliers
from vins_core.geometry import poses, so3
from vins_core.io.recording import open_recording
from vins_core.loop import step
from vins_core.loop.describe import UprightOrb
from vins_core.loop.index import InvertedIndex
from vins_core.loop.keyframe import LoopKeyframe, describe_keyframe
from vins_core.loop.match import match
from vins_core.loop.train import TRAINING_CORNERS, train, train_on_images, training_images
from vins_core.params import Frontend, Loop, Params
from vins_core.process import prepare
from vins_core.record.reader import RunReader
from vins_core.report import LoopReport
from vins_core.sensors import Trajectory
from vins_core.solver.covariance import relative_poses

CORRIDOR_GAP = 37
"""Images between two that may match: revisits come 38 images and more later."""
NEAR_M, NEAR_DEG = 1.0, 30.0
"""A keyframe this near to an earlier one, with 50 between them, revisits its place."""
FAR_M, FAR_DEG = 2.0, 60.0
"""A loop further than this is wrong."""


def corridor(folder: Path) -> None:
    truth = cv2.imread(str(folder / "samples_GT.bmp"), cv2.IMREAD_GRAYSCALE) == 255
    files = sorted((folder / "samples").glob("*.jpg"), key=lambda p: int(p.stem))
    images = [cv2.imread(str(f), cv2.IMREAD_GRAYSCALE) for f in files]
    revisited = truth[:, : -CORRIDOR_GAP - 1].any(1)
    describer, nothing, params = UprightOrb(), np.zeros((0, 2)), Loop()
    vocabulary = train([describer(i, nothing, TRAINING_CORNERS).descriptors for i in images], describer.name)
    features = [describer(i, nothing, params.max_corners) for i in images]
    bags = [vocabulary.bag_of(f.descriptors) for f in features]
    index = InvertedIndex.of(bags)
    rule = Frontend(epipolar_model="fundamental", F_threshold=params.epipolar_px, F_confidence=0.999)
    by_score: list[tuple[float, bool]] = []
    by_geometry: list[list[tuple[int, bool]]] = []  # of each query, its candidates in order: inliers, same place
    for query in range(CORRIDOR_GAP + 1, len(images)):
        scores = index.scores(bags[query])[: query - CORRIDOR_GAP]
        best = np.argsort(-scores, kind="stable")[: params.candidates]
        by_score.append((float(scores[best[0]]), bool(truth[query, best[0]])))
        a, candidates = features[query], []
        for other in best.tolist():
            b = features[other]
            found = match(a.descriptors, a.uv_px, len(a), b.descriptors, b.uv_px)
            inlier = None
            if found is not None:
                good = found.near(params) & found.distinct(params) & found.agreed(params)
                rays = [_guessed_rays(f.uv_px, images[0].shape) for f in (a, b)]
                inlier = epipolar_inliers(rays[0][good], rays[1][found.row[good]], rule)
            candidates.append((0 if inlier is None else int(inlier.sum()), bool(truth[query, other])))
        by_geometry.append(candidates)
    n = int(revisited.sum())
    print(f"{len(images)} images, {n} revisit a place; {vocabulary.n_words} words")
    print("\nretrieval, the best score\n   score  precision  recall")
    for limit in np.quantile([s for s, _ in by_score], np.linspace(0, 0.9, 10)):
        _print_row(f"{limit:8.4f}", [same for score, same in by_score if score >= limit], n)
    _print_full_precision({limit: [s for v, s in by_score if v >= limit] for limit, _ in by_score}, n)
    print(f"\nwith epipolar check, the first of {params.candidates} that passes\n inliers  precision  recall")
    accepted = {limit: list(_first(by_geometry, limit)) for limit in range(8, 200)}
    for limit in (8, 12, 16, 20, 25, 30, 40, 60, 80, 100):
        _print_row(f"{limit:8d}", accepted[limit], n)
    limit = _print_full_precision(accepted, n)
    for query, candidates in enumerate(by_geometry, CORRIDOR_GAP + 1):
        right, wrong = (max((k for k, same in candidates if same is what), default=0) for what in (True, False))
        if revisited[query] and right < limit:
            print(f"  missed {query}: {len(features[query])} corners, {right} inliers with its place")
        if not revisited[query] and wrong:
            print(f"  {query} revisits nothing: at most {wrong} inliers")


def _guessed_rays(uv_px: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Rays of a camera with a focal length of its image width: epipolar geometry does not mind a wrong guess."""
    plane = (uv_px - np.array(shape[::-1]) / 2) / shape[1]
    rays = np.concatenate([plane, np.ones((len(plane), 1))], 1)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _first(queries: list[list[tuple[int, bool]]], limit: int) -> Iterator[bool]:
    for candidates in queries:
        yield from [same for inliers, same in candidates if inliers >= limit][:1]


def _print_row(limit: str, accepted: list[bool], n: int) -> None:
    print(f"{limit}  {np.mean(accepted) if accepted else 1.0:9.3f}  {sum(accepted) / n:6.3f}")


def _print_full_precision(accepted: dict, n: int) -> float:
    """The lowest limit of the highest recall without a wrong one."""
    best = max((sum(a) for a in accepted.values() if all(a)), default=0)
    limits = [limit for limit, a in accepted.items() if all(a) and sum(a) == best]
    print(f"recall at precision 1.0: {best / n:.3f} ({best} of {n}), limit {min(limits):.4g} to {max(limits):.4g}")
    return min(limits)


def keyframes_of(run: RunReader, params: Params) -> tuple[list[LoopKeyframe], Trajectory, step.LoopState, list[float]]:
    """The keyframes that a loop stage would have got from a run, ground truth, its first state, milliseconds each."""
    calibration = run.header.calibration
    camera = calibration.cameras[0]
    usable, describer = usable_area(camera), UprightOrb()
    with open_recording(run.header.recording, calibration) as source:
        refs = [ref for k in range(len(run)) for ref in run.report(k).images]
        t0 = time.perf_counter()
        vocabulary = train_on_images(training_images(refs), source, describer, usable)
        print(
            f"vocabulary of {vocabulary.n_words} words, {vocabulary.levels} levels in {time.perf_counter() - t0:.1f} s"
        )
        found, ms = [], []
        for k in range(len(run)):
            if run.summary(k).marginalized != "MARGIN_OLD":
                continue
            window = run.state(k).window
            image = source.load(run.report(window.frames[-2].frame).image)
            odometry = _odometry(run, k) if found else None
            t0 = time.perf_counter()
            slot, corners = len(window.frames) - 2, params.loop.max_corners
            keyframe = describe_keyframe(window, slot, camera.model, image, describer, vocabulary, corners, usable)
            ms.append(1e3 * (time.perf_counter() - t0))
            found.append(replace(keyframe, odometry=odometry))
        truth = source.truth()
    if truth is None:
        raise SystemExit(f"{run.header.recording} has no ground truth")
    return found, truth, step.begin(vocabulary.limits), ms


def _odometry(run: RunReader, k: int) -> np.ndarray | None:
    """Covariance of the motion from the last keyframe to the one that frame k made."""
    turn = solved_window(run, k)
    assert turn is not None
    solved, newest = turn.solved, len(turn.solved.window.frames) - 1
    return relative_poses(solved.assembly.problem, solved.solution.states, [(newest - 2, newest - 1)])[0]


def over_run(folder: Path, settings: list[str]) -> None:
    prepare()
    params = parameters.replace(Params(), dict(s.split("=", 1) for s in settings))
    with RunReader(folder) as run:
        keyframes, truth, state, describe_ms = keyframes_of(run, params)
    T_true = true_poses(keyframes, truth)
    reports, ms = [], []
    for keyframe in keyframes:
        t0 = time.perf_counter()
        reports.append(step.detect(params.loop, state, keyframe))
        state = step.remember(state, keyframe, reports[-1])
        ms.append(1e3 * (time.perf_counter() - t0))
    _print_run(reports, T_true, describe_ms, ms, params.loop)


def true_poses(keyframes: list[LoopKeyframe], truth: Trajectory) -> np.ndarray:
    t_ns = np.array([k.t_ns for k in keyframes])
    i, j = associate(t_ns, truth.t_ns, max_dt_s=0.006)
    T = np.full((len(t_ns), 7), np.nan)
    T[i] = np.concatenate([truth.p_w_b[j], truth.q_w_b[j]], 1)
    return T


def _print_run(
    reports: list[LoopReport], T_true: np.ndarray, describe_ms: list[float], ms: list[float], params: Loop
) -> None:
    n = len(reports)
    apart_m = np.linalg.norm(T_true[:, None, :3] - T_true[None, :, :3], axis=2)
    apart_deg = np.degrees(np.linalg.norm(so3.difference(T_true[:, None, 3:], T_true[None, :, 3:]), axis=2))
    earlier = np.arange(n)[:, None] - np.arange(n) > params.min_gap
    revisit = (earlier & (apart_m < NEAR_M) & (apart_deg < NEAR_DEG)).any(1)
    loops = [c for r in reports if (c := r.accepted)]
    closed = {c.query for c in loops}
    wrong = [c for c in loops if apart_m[c.query, c.match] > FAR_M or apart_deg[c.query, c.match] > FAR_DEG]
    missed = [r for r in reports if revisit[r.keyframe] and r.keyframe not in closed]
    error_m, error_deg = [], []
    for c in loops:
        true = poses.between(T_true[c.match], T_true[c.query])
        error_m.append(np.linalg.norm(c.T_match_query[:3] - true[:3]))
        error_deg.append(np.degrees(np.linalg.norm(so3.difference(c.T_match_query[3:], true[3:]))))
    print(f"{n} keyframes, {revisit.sum()} truly revisit; {len(loops)} loops, {len(wrong)} of them elsewhere")
    print(f"recall {np.mean([q in closed for q in np.flatnonzero(revisit)]) if revisit.any() else np.nan:.4f}")
    for r in missed:
        print(f"  missed {r.keyframe}: {r.outcome}, candidates {[(c.match, str(c.outcome)) for c in r.candidates]}")
    looks_right = [c for r in reports for c in r.candidates if any(g.name == "drift" for g in c.gates)]
    far = [c for c in looks_right if apart_m[c.query, c.match] > FAR_M]
    near = [c for c in looks_right if apart_m[c.query, c.match] <= FAR_M]
    for what, some in (("elsewhere", far), ("the same place", near)):
        sigmas = [g.value for c in some for g in c.gates if g.name == "drift" and g.value is not None]
        ends = Counter(str(c.outcome) for c in some)
        told = f", drift {np.min(sigmas):.2f} to {np.max(sigmas):.2f} sigma" if sigmas else ""
        print(f"{len(some)} candidates pass all but consistency and are {what}{told}: {dict(ends)}")
    print("outcomes:", ", ".join(f"{o} {k}" for o, k in Counter(str(r.outcome) for r in reports).items()))
    if loops:
        at = (50, 95, 100)
        print("relative pose, median / 95 % / worst: "
              f"{' / '.join(f'{e:.3f}' for e in np.percentile(error_m, at))} m, "
              f"{' / '.join(f'{e:.2f}' for e in np.percentile(error_deg, at))} deg")  # fmt: skip
    print(f"median ms a keyframe: describe {np.median(describe_ms):.1f}, retrieve and verify {np.median(ms):.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("corridor", "run"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="section.name=value")
    args = parser.parse_args()
    if args.what == "corridor":
        corridor(args.folder)
    else:
        over_run(args.folder, args.set)


if __name__ == "__main__":
    main()
