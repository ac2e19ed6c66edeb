"""A run without an estimator: a camera in a textured box, reports filled from the truth plus drift and noise.

It exercises every part of a `FrameReport`: failed initialisation attempts, the first solve, keyframes, lost tracks
of several reasons, outliers, a cost spike and an anomaly.  Equal seeds give equal runs.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import NoReturn

import cv2
import numpy as np

from vins_core.errors import RunError
from vins_core.geometry import se3, so3
from vins_core.geometry.pinhole_radtan import PinholeRadtan
from vins_core.params import Params
from vins_core.record.header import RunHeader
from vins_core.record.writer import RunWriter
from vins_core.report import (
    LANDMARK_STATUSES,
    LOSS_REASONS,
    BlockReport,
    CostSplit,
    FrameReport,
    FrameSummary,
    Gate,
    HealthReport,
    InitReport,
    InitStage,
    IterationReport,
    KeyframeReport,
    LandmarkReport,
    LandmarkStatus,
    LossReason,
    MarginalizationReport,
    PoseEstimate,
    SolveReport,
    Status,
    Timings,
    TrackReport,
    WindowReport,
    summarize,
)
from vins_core.sensors import Anomaly, Calibration, CameraCalibration, ImageRef, ImuNoise, Trajectory

WIDTH, HEIGHT, FOCAL = 376, 240, 229.0
FRAMES, HZ, FIRST_SOLVE, SPIKE = 60, 10.0, 12, 38
START_NS = 1_403_636_580_000_000_000
LOW, HIGH = np.array([-6.0, -4.5, 0.0]), np.array([6.0, 4.5, 4.0])
T_B_C = se3.from_rotation_translation(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.05, 0.01, 0.0]))
MAX_TRACKS = 110


CAMERA = PinholeRadtan(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, 0.0, 0.0, 0.0, 0.0)


@dataclass
class FakeRun:
    """Stands in for a run record and for its images."""

    header: RunHeader
    truth: Trajectory | None = None
    complete: bool = True
    reports: list[FrameReport] = field(default_factory=list)
    summaries: list[FrameSummary] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.summaries)

    def report(self, k: int) -> FrameReport:
        return self.reports[k]

    def timings(self, k: int) -> Timings:
        return self.summaries[k].ms

    def state(self, k: int) -> NoReturn:
        raise RunError(f"frame {k} was recorded without its state")

    def refresh(self) -> bool:
        return False

    def encoded(self, ref: ImageRef) -> tuple[str, bytes]:
        return "image/jpeg", jpeg(ref.index)

    def load(self, ref: ImageRef) -> np.ndarray:
        return image(ref.index)

    def write(self, folder: Path) -> Path:
        """As a run record with its images inside."""
        with RunWriter(folder, self.header, self.truth, images=self) as record:
            for report, summary in zip(self.reports, self.summaries):
                record.append(report, summary.ms)
        return folder


def body_pose(t_s: float) -> np.ndarray:
    """(4, 4) T_w_b on a figure eight, looking along the path."""
    p = _path(t_s)
    v = _path(t_s + 0.01) - _path(t_s - 0.01)
    yaw, pitch, roll = (
        np.arctan2(v[1], v[0]) + 0.15 * np.sin(0.6 * t_s),
        0.12 * np.sin(1.3 * t_s),
        0.08 * np.sin(2 * t_s),
    )
    q = so3.multiply(so3.exp(np.array([0, 0, yaw])), so3.exp(np.array([0, pitch, 0])))
    return se3.from_quaternion_translation(so3.multiply(q, so3.exp(np.array([roll, 0, 0]))), p)


def _path(t_s: float) -> np.ndarray:
    s = 0.3 * t_s
    return np.array([3.4 * np.sin(s), 2.2 * np.sin(2 * s), 1.6 + 0.4 * np.sin(1.7 * s + 0.4)])


@lru_cache(maxsize=1)
def _textures() -> list[np.ndarray]:
    walls = []
    for seed, base in enumerate((118, 104, 126, 98, 72, 150)):
        rng = np.random.default_rng(seed)
        wall = np.full((320, 800), base, np.float32)
        for _ in range(130):
            x, y, w, h = (int(v) for v in rng.integers([0, 0, 8, 8], [800, 320, 100, 70]))
            cv2.rectangle(wall, (x, y), (x + w, y + h), float(rng.integers(30, 225)), -1 if rng.random() < 0.72 else 2)
        for _ in range(30):
            x, y, r = (int(v) for v in rng.integers([0, 0, 4], [800, 320, 24]))
            cv2.circle(wall, (x, y), r, float(rng.integers(20, 240)), -1 if rng.random() < 0.5 else 2)
        walls.append(cv2.GaussianBlur(wall, (0, 0), 0.9))
    return walls


def image(k: int) -> np.ndarray:
    """(HEIGHT, WIDTH) uint8, the box seen at frame k: each pixel's ray meets the nearest wall."""
    T_w_c = body_pose(k / HZ) @ T_B_C
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL, np.ones_like(u)], -1).reshape(-1, 3)
    d, p = rays @ T_w_c[:3, :3].T, T_w_c[:3, 3]
    with np.errstate(divide="ignore"):
        to_wall = np.where(d > 0, HIGH - p, LOW - p) / d
    axis = to_wall.argmin(1)
    depth = to_wall[np.arange(len(d)), axis]
    hit = p + d * depth[:, None]
    grey = np.zeros(len(d), np.float32)
    for a in range(3):
        across, up = [k for k in range(3) if k != a]
        for side in (0, 1):
            on = (axis == a) & ((d[:, a] > 0) == bool(side))
            wall = _textures()[2 * a + side]
            x, y = ((hit[on][:, c] - LOW[c]) * 66 for c in (across, up))
            grey[on] = wall[-1 - y.astype(int) % wall.shape[0], x.astype(int) % wall.shape[1]] / (1 + 0.05 * depth[on])
    return np.clip(grey.reshape(HEIGHT, WIDTH) * 1.1, 0, 255).astype(np.uint8)


@lru_cache(maxsize=512)
def jpeg(k: int) -> bytes:
    return cv2.imencode(".jpg", image(k), [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()


def fake_run(frames: int = FRAMES, seed: int = 7) -> FakeRun:
    """The whole run at once."""
    world = _World(frames, seed)
    noise = ImuNoise("discrete", 0.08, 0.004, 4e-5, 2e-6)
    camera = CameraCalibration("cam0", CAMERA, T_B_C, "/cam0/image_raw")
    calibration = Calibration((camera,), noise, 9.81, imu_topic="/imu0")
    header = RunHeader(
        Params(),
        calibration,
        recording="/data/fake_room.bag",
        expected_frames=frames,
        duration_s=frames / HZ,
        embedded_images=True,
    )
    run = FakeRun(header, world.truth())
    for k in range(frames):
        report = world.report(k)
        run.reports.append(report)
        run.summaries.append(summarize(report, world.timings(k)))
    return run


class _World:
    def __init__(self, frames: int, seed: int) -> None:
        self.rng = rng = np.random.default_rng(seed)
        self.n = frames
        self.t_ns = START_NS + (np.arange(frames) * 1e9 / HZ).astype(np.int64)
        self.T_w_b = np.stack([body_pose(k / HZ) for k in range(frames)])
        walk = np.cumsum(rng.normal(0, 0.004, (frames, 3)), 0)
        self.drift = walk - walk[min(FIRST_SOLVE, frames - 1)]
        points = rng.uniform(LOW, HIGH, (1500, 3))
        wall, side = rng.integers(0, 3, len(points)), rng.integers(0, 2, len(points))
        points[np.arange(len(points)), wall] = np.where(side, HIGH[wall], LOW[wall])
        self.points = points
        self.outlier = rng.random(len(points)) < 0.04
        self.kept = np.zeros(frames, bool)  # keyframes
        self.kept[0] = True
        last = 0
        for k in range(1, frames):
            if k < FIRST_SOLVE or k - last >= 2 + k % 3:
                self.kept[k], last = True, k
        self.seen: list[dict[int, np.ndarray]] = []  # per frame: track -> pixel
        self.born: dict[int, int] = {}
        self.lost: list[list[tuple[int, np.ndarray, int, LossReason]]] = []
        self._track()

    def truth(self) -> Trajectory:
        """In a world turned and moved against the estimate's, so that alignment matters."""
        turn = so3.exp(np.array([0.0, 0.0, 0.7]))
        at = np.arange(0, self.n / HZ, 0.02)
        T = np.stack([body_pose(t) for t in at])
        p = so3.rotate(turn, T[:, :3, 3]) + np.array([1.0, -2.0, 0.3])
        q = so3.multiply(turn, so3.from_matrix(T[:, :3, :3]))
        return Trajectory(START_NS + (at * 1e9).astype(np.int64), p, q)

    def _pixels(self, k: int) -> np.ndarray:
        T_c_w = se3.inverse(self.T_w_b[k] @ T_B_C)
        return CAMERA.project(se3.transform(T_c_w, self.points))

    def _track(self) -> None:
        alive: set[int] = set()
        for k in range(self.n):
            uv = self._pixels(k)
            with np.errstate(invalid="ignore"):
                inside = ((uv > 6) & (uv < [WIDTH - 6, HEIGHT - 6])).all(1)
            lost = []
            for i in sorted(alive):
                chance = self.rng.random()
                reason = None
                if not inside[i]:
                    reason = LossReason.BORDER
                elif chance < 0.012:
                    reason = LossReason.FLOW
                elif chance < 0.02:
                    reason = LossReason.FLOW_BACK
                elif chance < (0.1 if self.outlier[i] else 0.028):
                    reason = LossReason.RANSAC
                elif chance < 0.032:
                    reason = LossReason.MASK
                if reason is not None:
                    lost.append((i, self.seen[-1][i], k - self.born[i], reason))
                    alive.discard(i)
            cells = {tuple((uv[i] // 20).astype(int)) for i in alive}
            for i in self.rng.permutation(np.flatnonzero(inside)):
                cell = tuple((uv[i] // 20).astype(int))
                if len(alive) >= MAX_TRACKS:
                    break
                if int(i) not in self.born and cell not in cells:
                    cells.add(cell)
                    alive.add(int(i))
                    self.born[int(i)] = k
            self.seen.append({i: uv[i] + self.rng.normal(0, 0.2, 2) for i in sorted(alive)})
            self.lost.append(lost)

    def window_frames(self, k: int) -> list[int]:
        kept = [j for j in range(k) if self.kept[j]]
        return [*kept[-10:], k]

    def status(self, k: int) -> Status:
        return Status.FILLING if k < 10 else Status.INITIALIZING if k < FIRST_SOLVE else Status.TRACKING

    def timings(self, k: int) -> Timings:
        rng = np.random.default_rng(100 + k)
        ms = {"decode": 0.9, "track": 6.0, "preintegrate": 0.4, "record": 0.7}
        if k >= FIRST_SOLVE:
            ms |= {"solve": 13.0, "marginalize": 4.0 if self.kept[k - 1] else 1.0, "slide": 0.3}
        return {name: float(v * rng.uniform(0.8, 1.3)) for name, v in ms.items()}

    def report(self, k: int) -> FrameReport:
        solved = k >= FIRST_SOLVE
        window = self.window(k) if solved else None
        landmarks = self.landmarks(k) if solved else None
        anomaly = Anomaly("gap", int(self.t_ns[k]), "/imu0", "the IMU is silent for 0.031 s where 0.005 s is usual")
        return FrameReport(
            frame=k,
            t_ns=int(self.t_ns[k]),
            images=(ImageRef(int(self.t_ns[k]), 0, k),),
            n_imu=21,
            status=self.status(k),
            anomalies=(anomaly,) if k == 25 else (),
            tracks=self.tracks(k),
            keyframe=self.keyframe(k) if k > 0 else None,
            initialization=self.initialization(k) if 10 <= k <= FIRST_SOLVE else None,
            solve=self.solve(k, landmarks) if landmarks is not None else None,
            window=window,
            landmarks=landmarks,
            marginalization=self.marginalization(k) if solved else None,
            health=self.health(k) if solved else None,
            pose=PoseEstimate(*(a[-1] for a in (window.p_w_b, window.q_w_b, window.v_w_b, window.b_a, window.b_g)))
            if window
            else None,
        )

    def tracks(self, k: int) -> TrackReport:
        ids = np.array(sorted(self.seen[k], key=lambda i: (self.born[i], i)), np.int64)
        lost = self.lost[k]
        return TrackReport(
            ids=ids,
            uv_px=np.array([self.seen[k][int(i)] for i in ids], np.float32).reshape(-1, 2),
            age=np.array([k - self.born[int(i)] + 1 for i in ids], np.int32),
            velocity=np.zeros((len(ids), 2), np.float32),
            lost_ids=np.array([x[0] for x in lost], np.int64),
            lost_uv_px=np.array([x[1] for x in lost], np.float32).reshape(-1, 2),
            lost_age=np.array([x[2] for x in lost], np.int32),
            lost_reason=np.array([LOSS_REASONS.index(x[3]) for x in lost], np.uint8),
            n_new=sum(b == k for b in self.born.values()),
            gates=(
                Gate("flow survivors", 1 - len(lost) / max(len(ids), 1), ">=", 0.3, decides=False),
                Gate("F-RANSAC inliers", 0.97, ">=", 0.5, "frontend.F_threshold", decides=False),
            ),
        )

    def keyframe(self, k: int) -> KeyframeReport:
        is_keyframe = bool(self.kept[k - 1])
        parallax, tracked = (13.4 if is_keyframe else 6.1) + 0.3 * (k % 5), len(self.seen[k]) - 8
        return KeyframeReport(
            is_keyframe,
            f"parallax of {parallax:.1f} px460 is {'above' if is_keyframe else 'below'} 10",
            parallax,
            parallax * 1.6,
            tracked,
            tracked - 20,
            8,
            (
                Gate("tracked", tracked, ">=", 20, "window.keyframe_min_tracked"),
                Gate("parallax", parallax, "<", 10, "window.keyframe_parallax", "px460"),
            ),
        )

    def initialization(self, k: int) -> InitReport:
        done = k == FIRST_SOLVE
        excitation = Gate(
            "excitation", 0.41 if done else 0.1 + 0.02 * k / 10, ">=", 0.25, "init.min_excitation", "m/s^2"
        )
        stages = [InitStage("excitation", (excitation,), "" if done else "the accelerometer is hardly excited")]
        if done:
            stages += [
                InitStage(
                    "relative pose",
                    (
                        Gate("matches", 61, ">=", 20, "init.min_matches"),
                        Gate("parallax", 42.5, ">=", 30, "init.min_parallax_px", "px460"),
                    ),
                    "",
                ),
                InitStage(
                    "structure", (Gate("bundle adjustment cost", 3.1e-4, "<=", 5e-3, "init.max_structure_cost"),), ""
                ),
                InitStage(
                    "alignment", (Gate("gravity error", 0.06, "<=", 1.0, "init.gravity_tolerance", "m/s^2"),), ""
                ),
            ]
        gravity = np.array([0.1, -9.7, 1.2]) if done else None
        return InitReport(tuple(stages), done, 3 if done else -1, 1.27 if done else None, gravity, np.full(3, 0.002))

    def window(self, k: int) -> WindowReport:
        frames = np.array(self.window_frames(k))
        T = self.T_w_b[frames]
        now = set(self.seen[k])
        n = len(frames)
        v = np.stack([(_path(f / HZ + 0.01) - _path(f / HZ - 0.01)) / 0.02 for f in frames])
        return WindowReport(
            frames=frames,
            t_ns=self.t_ns[frames],
            keyframe=np.append(self.kept[frames[:-1]], False),
            p_w_b=T[:, :3, 3] + self.drift[k],
            q_w_b=so3.from_matrix(T[:, :3, :3]),
            v_w_b=v,
            b_a=np.full((n, 3), 0.02),
            b_g=np.full((n, 3), 0.002),
            shared=np.array([len(now & set(self.seen[f])) for f in frames], np.int32),
            error_px=np.random.default_rng(k).uniform(0.3, 0.8, n).astype(np.float32),
        )

    def landmarks(self, k: int) -> LandmarkReport:
        frames = self.window_frames(k)
        sightings: dict[int, list[int]] = {}
        for slot, f in enumerate(frames):
            for i in self.seen[f]:
                sightings.setdefault(i, []).append(slot)
        ids = np.array(sorted(sightings), np.int64)
        n_obs = np.array([len(sightings[int(i)]) for i in ids], np.uint8)
        rng = np.random.default_rng(k)
        status = np.full(len(ids), LANDMARK_STATUSES.index(LandmarkStatus.TRIANGULATED), np.uint8)
        status[n_obs < 2] = LANDMARK_STATUSES.index(LandmarkStatus.CANDIDATE)
        status[self.outlier[ids] & (n_obs >= 4)] = LANDMARK_STATUSES.index(LandmarkStatus.OUTLIER)
        error = rng.uniform(0.2, 1.1, len(ids)) * np.where(self.outlier[ids], 5, 1)
        xyz = self.points[ids] + self.drift[k] + rng.normal(0, 0.01, (len(ids), 3))
        xyz[n_obs < 2] = np.nan
        anchor = np.array([sightings[int(i)][0] for i in ids], np.uint8)
        centre = (self.T_w_b[np.array(frames)] @ T_B_C)[anchor, :3, 3]
        depth = np.linalg.norm(self.points[ids] - centre, axis=1)
        return LandmarkReport(
            ids=ids,
            xyz_w=xyz.astype(np.float32),
            inv_depth=np.where(n_obs < 2, np.nan, 1 / depth),
            sigma_inv_depth=np.where(n_obs < 2, np.nan, 0.02 / n_obs).astype(np.float32),
            anchor_slot=anchor,
            n_obs=n_obs,
            error_px=np.where(n_obs < 2, np.nan, error).astype(np.float32),
            status=status,
        )

    def solve(self, k: int, landmarks: LandmarkReport) -> SolveReport:
        frames, rng = self.window_frames(k), np.random.default_rng(1000 + k)
        used = landmarks.n_obs >= 2
        rows = [
            (int(i), int(anchor), slot)
            for i, anchor in zip(landmarks.ids[used], landmarks.anchor_slot[used])
            for slot, f in enumerate(frames)
            if slot != anchor and int(i) in self.seen[f]
        ]
        spike = 1 + 3.5 * np.exp(-(((k - SPIKE) / 2.0) ** 2))
        after = CostSplit(*(float(c * spike * rng.uniform(0.85, 1.15)) for c in (62.0, 14.0, 5.0)))
        before = CostSplit(after.visual * 2.4, after.imu * 1.9, after.prior * 1.1)
        costs = np.geomspace(before.total, after.total, 6)
        ids = np.array([r[0] for r in rows], np.int64)
        return SolveReport(
            before=before,
            after=after,
            iterations=tuple(IterationReport(float(c), True, 0.3 / (j + 1), 0.9, 1e12) for j, c in enumerate(costs)),
            termination="cost falls by less than 1e-06",
            n_landmarks=int(used.sum()),
            visual_ids=ids,
            visual_slots=np.array([r[1:] for r in rows], np.uint8).reshape(-1, 2),
            visual_error_px=(rng.gamma(2.0, 0.3, len(rows)) * np.where(self.outlier[ids], 5, 1)).astype(np.float32),
            imu_sigma=rng.uniform(0.2, 1.8, (len(frames) - 1, 5)) * spike,
        )

    def marginalization(self, k: int) -> MarginalizationReport:
        old = bool(self.kept[k - 1])
        frames = self.window_frames(k)
        blocks = (
            BlockReport(f"pose 0 (frame {frames[0]})", 6, 0, True),
            BlockReport(f"speed_bias 0 (frame {frames[0]})", 9, 6, True),
            *(BlockReport(f"pose {s} (frame {f})", 6, 9 + 6 * s, False) for s, f in enumerate(frames) if s),
        )
        eigenvalues = np.geomspace(1e-9, 1e5, 75)
        return MarginalizationReport(
            "MARGIN_OLD" if old else "MARGIN_SECOND_NEW", 57 if old else 6, 75, blocks, 71, eigenvalues
        )

    def health(self, k: int) -> HealthReport:
        return HealthReport(
            (
                Gate("tracked", len(self.seen[k]), ">=", 2, "health.min_tracked", decides=False),
                Gate("accelerometer bias", 0.03, "<=", 2.5, "health.max_acc_bias", "m/s^2"),
                Gate("gyroscope bias", 0.003, "<=", 1.0, "health.max_gyr_bias", "rad/s"),
                Gate("jump", 0.11, "<=", 5.0, "health.max_jump_m", "m"),
            ),
            "",
        )
