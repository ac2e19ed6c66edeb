"""One attempt to initialise: from tracks and pre-integrations to a metric, gravity-aligned window.

Every stage leaves an `InitStage` with its gates; the first stage that fails ends the attempt, and the report says why.
REFERENCE 8 (N1-N10), seeds 000.2 and 004.11-17.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..factors.preintegration import Preintegration, repropagate
from ..geometry import se3, so3
from ..geometry.triangulation import triangulate_tracks
from ..geometry.two_view import RelativePose, estimate_relative_pose
from ..params import Init, Params
from ..report import Gate, InitReport, InitStage, all_pass
from ..sensors import Calibration, ImuNoise
from ..window.keyframe import FOCAL_460, align_rays, parallax_px460
from ..window.slide import restrict
from ..window.state import TRIANGULATED, Landmarks, WindowFrame, WindowState
from . import alignment, gyro_bias
from .bundle import Rays, Structure
from .refinement import Motion, Refinement, refine
from .structure import Reconstruction, Tracks, place_frame, reconstruct


def initialize(
    params: Params, calibration: Calibration, window: WindowState, frames_in_time: tuple[WindowFrame, ...]
) -> tuple[WindowState | None, InitReport]:
    """Tries to initialise a full window; returns the initialised window, or None, and the report of the attempt.

    `window`: its frames with pre-integrations between consecutive frames of the window.
    `frames_in_time`: all frames from the oldest of the window to the newest, kept by the window or not, each with the
    pre-integration from the frame just before it in time (None for the first).

    The world of the result has z up; the oldest body is at its origin with yaw 0.
    """
    attempt = _Attempt(params, calibration, window, frames_in_time)
    state = attempt.run()
    return state, attempt.report(state is not None)


class _Attempt:
    """The stages in order.  Mutable only while one attempt runs."""

    def __init__(
        self, params: Params, calibration: Calibration, window: WindowState, history: tuple[WindowFrame, ...]
    ) -> None:
        self.params, self.calibration, self.window = params.init, calibration, window
        self.all_params = params
        self.history = history
        self.imu = [f.imu for f in history[1:] if f.imu is not None]
        self.stages: list[InitStage] = []
        self.reference_slot = -1
        self.scale: float | None = None
        self.gravity: np.ndarray | None = None
        self.b_g: np.ndarray | None = None

    def report(self, succeeded: bool) -> InitReport:
        return InitReport(tuple(self.stages), succeeded, self.reference_slot, self.scale, self.gravity, self.b_g)

    def record(self, stage: InitStage) -> bool:
        self.stages.append(stage)
        return stage.passed

    def run(self) -> WindowState | None:
        tracks = Tracks.of([f.observations for f in self.window.frames])
        excited = self.record(excitation(self.params, self.imu))
        l, pose, stage = choose_reference(self.params, tracks)
        self.reference_slot = l
        if not (self.record(stage) and excited) or pose is None:
            return None

        sigma_rad = self.all_params.window.pixel_sigma / FOCAL_460
        built = reconstruct(tracks, l, pose.T_a_b, sigma_rad, self.params.min_pnp_points)
        if not self.record(_structure_stage(self.params, built)):
            return None
        Ts_l_c, stage = self._place_all(built, sigma_rad)
        if not self.record(stage):
            return None

        T_b_c = self.window.T_b_c[0]
        R_l_b = Ts_l_c[:, :3, :3] @ T_b_c[:3, :3].T
        self.b_g, imu, stage = calibrate_gyroscope(self.params, self.calibration.noise, R_l_b, self.imu)
        if not self.record(stage):
            return None

        g_norm = self.calibration.gravity_m_s2
        linear = alignment.align(Ts_l_c[:, :3, 3], R_l_b, imu, T_b_c[:3, 3])
        self.scale, self.gravity = linear.scale, linear.gravity
        if not self.record(_alignment_stage(self.params, linear, g_norm)):
            return None
        refined = alignment.refine_gravity(
            Ts_l_c[:, :3, 3], R_l_b, imu, T_b_c[:3, 3], linear.gravity, g_norm, self.params.gravity_iterations
        )
        self.scale, self.gravity = refined.scale, refined.gravity
        if not self.record(_refinement_stage(linear, refined)):
            return None
        motion = self._metric_motion(built, Ts_l_c, R_l_b, refined)
        if self.params.refine:
            motion, stage = self._refine(tracks, built, motion)
            if not self.record(stage):
                return None
        return self._initialized_window(tracks, motion)

    def _place_all(self, built: Reconstruction, sigma_rad: float) -> tuple[np.ndarray, InitStage]:
        """Camera poses of all frames in time: the window's from the structure, the others by PnP."""
        slots = {f.frame: k for k, f in enumerate(self.window.frames)}
        Ts = np.tile(np.eye(4), (len(self.history), 1, 1))
        fewest, lost = None, -1
        for k, frame in enumerate(self.history):
            if frame.frame in slots:
                Ts[k] = built.Ts_l_c[slots[frame.frame]]
                continue
            T, seen = place_frame(frame.observations, built.ids, built.points, Ts[max(k - 1, 0)], sigma_rad)
            fewest = seen if fewest is None else min(fewest, seen)
            if T is None:
                lost = frame.frame
                break
            Ts[k] = T
        gates = (
            (Gate("known_points", fewest, ">=", self.params.min_pnp_points, "init.min_pnp_points", decides=False),)
            if fewest is not None
            else ()
        )
        outcome = "" if lost < 0 else f"frame {lost}, which is not in the window, could not be placed in the structure"
        return Ts, InitStage("frames between", gates, outcome, {"frames": len(self.history) - len(slots)})

    def _metric_motion(
        self, built: Reconstruction, Ts_l_c: np.ndarray, R_l_b: np.ndarray, solved: alignment.Alignment
    ) -> Motion:
        """The window in a world with z up, the oldest body at the origin with yaw 0 (REFERENCE N10)."""
        kept = {f.frame for f in self.window.frames}
        rows = [k for k, f in enumerate(self.history) if f.frame in kept]
        R = R_l_b[rows]
        p = solved.scale * Ts_l_c[rows, :3, 3] - R @ self.window.T_b_c[0, :3, 3]
        structure = Structure(p, R, solved.scale * built.points)
        q_w_l = so3.from_two_vectors(-solved.gravity, np.array([0.0, 0.0, 1.0]))
        assert self.b_g is not None
        return _anchored(_rotated(Motion(structure, solved.v[rows], np.zeros(3), self.b_g), so3.to_matrix(q_w_l)))

    def _refine(self, tracks: Tracks, built: Reconstruction, motion: Motion) -> tuple[Motion, InitStage]:
        known = np.isin(tracks.ids, built.ids)
        point, slot = np.nonzero(tracks.seen[known])
        refined = refine(
            motion,
            self.window.T_b_c[0],
            Rays(slot, point, tracks.rays[known][point, slot]),
            self._window_imu(motion),
            self.calibration.gravity_m_s2,
            self.all_params.window.pixel_sigma / FOCAL_460,
            self.params.acc_bias_sigma,
        )
        before, after = (_extent(m.structure.p) for m in (motion, refined.motion))
        assert self.scale is not None
        self.scale *= after / before
        self.b_g = refined.motion.b_g
        return _anchored(refined.motion), _verdict(self.all_params, refined, after / before)

    def _window_imu(self, motion: Motion) -> list[Preintegration]:
        noise = self.calibration.noise
        return [repropagate(f.imu, motion.b_a, motion.b_g, noise) for f in self.window.frames[1:] if f.imu is not None]

    def _initialized_window(self, tracks: Tracks, motion: Motion) -> WindowState:
        q = so3.from_matrix(motion.structure.R)
        frames = tuple(
            replace(
                frame,
                imu=imu,
                p_w_b=motion.structure.p[k],
                q_w_b=q[k],
                v_w_b=motion.v[k],
                b_a=motion.b_a,
                b_g=motion.b_g,
            )
            for k, (frame, imu) in enumerate(zip(self.window.frames, (None, *self._window_imu(motion))))
        )
        window = replace(self.window, frames=frames, prior=None)
        return replace(window, landmarks=landmarks_of(window, tracks, self.all_params.window.min_depth))


def _rotated(motion: Motion, R: np.ndarray) -> Motion:
    s = motion.structure
    return replace(motion, structure=Structure(s.p @ R.T, R @ s.R, s.points @ R.T), v=motion.v @ R.T)


def _anchored(motion: Motion) -> Motion:
    """The same motion with the oldest body at the origin and its yaw 0."""
    s = motion.structure
    origin = s.p[0]
    motion = replace(motion, structure=Structure(s.p - origin, s.R, s.points - origin))
    yaw = so3.heading(so3.from_matrix(s.R[0]))
    return _rotated(motion, so3.to_matrix(so3.exp(np.array([0.0, 0.0, -yaw]))))


def _extent(p: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum((p - p.mean(0)) ** 2, 1))))


def _verdict(params: Params, refined: Refinement, scale_change: float) -> InitStage:
    """Is the refined window consistent, and was its scale observable?"""
    init, health = params.init, params.health
    b_a, b_g = (float(np.linalg.norm(b)) for b in (refined.motion.b_a, refined.motion.b_g))
    gates = (
        Gate("scale_sigma", refined.scale_sigma, "<=", init.max_scale_sigma, "init.max_scale_sigma"),
        Gate("imu_error", refined.imu_rms, "<=", init.max_imu_error, "init.max_imu_error", "sigma"),
        Gate(
            "reprojection",
            FOCAL_460 * refined.rms_rad,
            "<=",
            init.max_reprojection_px,
            "init.max_reprojection_px",
            "px460",
        ),
        Gate("acc_bias", b_a, "<=", health.max_acc_bias, "health.max_acc_bias", "m/s^2"),
        Gate("gyr_bias", b_g, "<=", health.max_gyr_bias, "health.max_gyr_bias", "rad/s"),
    )
    why = {
        "scale_sigma": f"the scale is only known to {100 * refined.scale_sigma:.0f} %: change speed or direction more",
        "imu_error": "motion seen by camera and IMU differ: check extrinsics, time offset, IMU units and noise",
        "reprojection": "the tracks do not fit any motion the IMU allows: check extrinsics and time offset",
        "acc_bias": f"the accelerometer bias would have to be {b_a:.1f} m/s^2",
        "gyr_bias": f"the gyroscope bias would have to be {b_g:.2f} rad/s",
    }
    outcome = next((why[g.name] for g in gates if not g.passed), "")
    values = {
        "scale_change": scale_change,
        "gravity_sigma_deg": refined.gravity_sigma_deg,
        "iterations": float(refined.iterations),
        **{f"b_a_{axis}": float(x) for axis, x in zip("xyz", refined.motion.b_a)},
        **{f"b_g_{axis}": float(x) for axis, x in zip("xyz", refined.motion.b_g)},
    }
    return InitStage("refinement", gates, outcome, values)


def excitation(params: Init, imu: list[Preintegration]) -> InitStage:
    """N1: standard deviation of the mean specific force delta_v / dt, each in the body frame of its interval.

    Zero at rest and at constant velocity without rotation: scale and gravity cannot be told apart then.
    """
    force = np.array([p.delta_v / p.dt_s for p in imu])
    value = float(np.sqrt(np.mean(np.sum((force - force.mean(0)) ** 2, 1))))
    gate = Gate(
        "excitation", value, ">=", params.min_excitation, "init.min_excitation", "m/s^2", params.require_excitation
    )
    outcome = (
        ""
        if all_pass([gate])
        else f"the accelerometer varies by only {value:.2f} m/s^2: move with more changes of speed or direction"
    )
    turned = float(np.rad2deg(sum(np.linalg.norm(so3.log(p.delta_q)) for p in imu)))
    return InitStage("excitation", (gate,), outcome, {"rotation_deg": turned})


def choose_reference(params: Init, tracks: Tracks) -> tuple[int, RelativePose | None, InitStage]:
    """N2, N3: the oldest frame that sees enough of the newest from far enough away, and its relative pose.

    Parallax alone may come from rotation; what the best rotation between the two cannot explain must be there too.
    When no frame qualifies, the stage shows the gates of the frame that came furthest.
    """
    newest = tracks.rays.shape[1] - 1
    best: tuple[int, tuple[Gate, ...]] | None = None
    for l in range(newest):
        rays_l, rays_n = tracks.common(l, newest)
        parallax = translation = pose = None
        if len(rays_l):
            parallax = parallax_px460(rays_l, rays_n)
            translation = parallax_px460(rays_l @ align_rays(rays_l, rays_n).T, rays_n)
        gates: tuple[Gate, ...] = (
            Gate("matches", len(rays_l), ">", params.min_matches, "init.min_matches"),
            Gate("parallax", parallax, ">", params.min_parallax_px, "init.min_parallax_px", "px460"),
            Gate("translation", translation, ">=", params.min_translation_px, "init.min_translation_px", "px460"),
        )
        if all_pass(gates):
            pose = estimate_relative_pose(rays_l, rays_n, params.ransac_px / FOCAL_460)
            inliers = 0 if pose is None else int(np.count_nonzero(pose.in_front))
            gates += (Gate("pose_inliers", inliers, ">=", params.min_pose_inliers, "init.min_pose_inliers"),)
        values = {"slot": float(l), "matches": float(len(rays_l))}
        if pose is not None and all_pass(gates):
            return l, pose, InitStage("relative pose", gates, "", values)
        if best is None or _progress(gates) > _progress(best[1]):
            best = (l, gates)
    assert best is not None
    l, gates = best
    why = {
        "matches": "too few tracks reach from an older frame to the newest: move more slowly or find more texture",
        "parallax": "not enough parallax between any frame of the window and the newest: move the camera sideways",
        "translation": "the camera only turned: move it sideways",
        "pose_inliers": "no relative pose explains the tracks between the reference frame and the newest",
    }[next(g.name for g in gates if not g.passed)]
    return -1, None, InitStage("relative pose", gates, why, {"slot": float(l)})


def _progress(gates: tuple[Gate, ...]) -> tuple[int, float]:
    """How many gates passed before the first failure, and how near the failed one came."""
    passed = next(k for k, g in enumerate(gates) if not g.passed)
    value = gates[passed].value
    return passed, 0.0 if value is None else value / max(gates[passed].limit, 1e-9)


def _structure_stage(params: Init, built: Reconstruction) -> InitStage:
    """N4, N5."""
    gates: tuple[Gate, ...] = (
        Gate("known_points", built.min_points, ">=", params.min_pnp_points, "init.min_pnp_points"),
    )
    if built.adjustment is None:
        why = f"the frame in slot {built.lost_slot} could not be placed: it sees {built.min_points} known points"
        return InitStage("structure", gates, why)
    adjusted = built.adjustment
    rms_px = FOCAL_460 * adjusted.rms_rad
    gates += (
        Gate("reprojection", rms_px, "<=", params.max_reprojection_px, "init.max_reprojection_px", "px460"),
        Gate(
            "cost",
            adjusted.cost,
            "<=",
            params.max_structure_cost,
            "init.max_structure_cost",
            decides=not adjusted.converged,
        ),
    )
    values = {"points": float(len(built.ids)), "iterations": float(adjusted.iterations)}
    outcome = ""
    if not all_pass(gates):
        outcome = f"poses and points disagree with the tracks by {rms_px:.1f} px: moving objects, wrong calibration"
    return InitStage("structure", gates, outcome, values)


def calibrate_gyroscope(
    params: Init, noise: ImuNoise, R_l_b: np.ndarray, imu: list[Preintegration]
) -> tuple[np.ndarray, list[Preintegration], InitStage]:
    """N7: bias, the pre-integrations integrated again with it (accelerometer bias 0), and the stage."""
    before = _rms_deg(gyro_bias.rotation_residuals(R_l_b, imu))
    b_g = imu[0].b_g + gyro_bias.estimate(R_l_b, imu)
    imu = [repropagate(p, np.zeros(3), b_g, noise) for p in imu]
    after = _rms_deg(gyro_bias.rotation_residuals(R_l_b, imu))
    gate = Gate("rotation_error", after, "<=", params.max_rotation_error_deg, "init.max_rotation_error_deg", "deg")
    outcome = ""
    if not gate.passed:
        outcome = (
            f"gyroscope and images turn differently by {after:.2f} deg per frame whatever the bias: "
            "check the rotation between camera and IMU, and their time offset"
        )
    values = {"before_deg": before, "b_g_x": b_g[0], "b_g_y": b_g[1], "b_g_z": b_g[2]}
    return b_g, imu, InitStage("gyroscope bias", (gate,), outcome, {k: float(v) for k, v in values.items()})


def _rms_deg(rotations: np.ndarray) -> float:
    return float(np.rad2deg(np.sqrt(np.mean(np.sum(rotations**2, 1)))))


def _alignment_stage(params: Init, linear: alignment.Alignment, g_norm: float) -> InitStage:
    """N8."""
    norm = float(np.linalg.norm(linear.gravity))
    gates = (
        Gate("gravity_error", abs(norm - g_norm), "<=", params.gravity_tolerance, "init.gravity_tolerance", "m/s^2"),
        Gate("scale", linear.scale, ">", 0.0),
    )
    outcome = ""
    if not gates[0].passed:
        outcome = (
            f"gravity comes out as {norm:.2f} m/s^2 instead of {g_norm:.2f}: structure and IMU do not fit together"
        )
    elif not gates[1].passed:
        outcome = "the scale comes out negative: structure and IMU do not fit together"
    values = {"gravity_norm": norm, "scale_sigma": linear.scale_sigma, "residual_m": linear.residual_m}
    return InitStage("alignment", gates, outcome, values)


def _refinement_stage(linear: alignment.Alignment, refined: alignment.Alignment) -> InitStage:
    """N9."""
    gates = (Gate("scale", refined.scale, ">", 0.0),)
    cosine = linear.gravity @ refined.gravity / np.linalg.norm(linear.gravity) / np.linalg.norm(refined.gravity)
    values = {
        "turned_deg": float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))),
        "scale_sigma": refined.scale_sigma,
        "residual_m": refined.residual_m,
    }
    outcome = "" if all_pass(gates) else "the scale becomes negative once gravity has its known size"
    return InitStage("gravity", gates, outcome, values)


def landmarks_of(window: WindowState, tracks: Tracks, min_depth: float) -> Landmarks:
    """All tracks of the window, those seen twice or more triangulated with its poses."""
    T_w_c = np.array([se3.from_quaternion_translation(f.q_w_b, f.p_w_b) for f in window.frames]) @ window.T_b_c[0]
    track, slot = np.nonzero(tracks.seen)
    anchor = np.argmax(tracks.seen, axis=1)
    depth = triangulate_tracks(T_w_c, track, slot, tracks.rays[track, slot], anchor)
    good = depth > min_depth
    table = restrict(Landmarks.empty(), window.frames)
    inv_depth = np.where(good, 1.0 / np.where(good, depth, 1.0), np.nan)
    return Landmarks(table.ids, inv_depth, np.where(good, TRIANGULATED, table.status).astype(np.uint8))
