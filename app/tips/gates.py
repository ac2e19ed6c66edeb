"""Gates that say more than the parameter behind them does."""

from __future__ import annotations

from collections.abc import Mapping

from .tip import Tip

_PX = "px460"

GATES: Mapping[str, Tip] = {
    "gate.window.keyframe_min_tracked": Tip(
        "tracked", "Tracks of the second newest frame that reach the newest. Fewer make a keyframe.", source="W2"
    ),
    "gate.window.keyframe_parallax": Tip(
        "parallax",
        "How far the second newest frame moved from the one before it. More makes a keyframe.",
        equation="460 · mean |π(R f_i) − π(f_j)|",
        unit=_PX,
        source="W2, W4; seed 004.8",
    ),
    "gate.frontend.max_gap_s": Tip(
        "image interval",
        "Longest time between two images of this frame; longer resets the tracker.",
        unit="s",
        source="T1",
    ),
    "gate.frontend.min_flow_share": Tip(
        "flow found",
        "Share of the tracks that optical flow found again. Few: blur, fast motion, a dark image.",
        source="T4; seed 004.4",
    ),
    "gate.frontend.min_flow_back_share": Tip(
        "flow-back agrees",
        "Share of the found tracks that return to where they were when tracked back. Few: repeated "
        "texture, reflections, large steps.",
        source="TF4; seed 004.28",
    ),
    "gate.frontend.min_inlier_share": Tip(
        "F-RANSAC inliers",
        "Share of the tracks that agree with one fundamental matrix between the previous frame and "
        "this one. Few: moving objects, wrong tracks, wrong intrinsics.",
        equation="dist(u', F u) ≤ frontend.F_threshold",
        source="T7; seed 004.7",
    ),
    "gate.frontend.min_tracks": Tip(
        "tracks",
        "Tracks alive after the refill. Few: the image has little texture, or the mask covers it.",
        source="T9",
    ),
    "gate.frontend.F_threshold": Tip(
        "F-RANSAC",
        "Tracks that agree with one fundamental matrix between the previous frame and this one.",
        equation="dist(u', F u) ≤ frontend.F_threshold",
        unit=_PX,
        source="T7; seed 004.7",
    ),
    "gate.frontend.flow_back_px": Tip(
        "flow-back", "Tracks that return to where they were when tracked back.", unit="px", source="TF4; seed 004.28"
    ),
    "gate.init.min_excitation": Tip(
        "excitation",
        "Standard deviation of the mean specific force over the frames. VINS only prints a message.",
        equation="std(Δv / Δt)",
        unit="m/s^2",
        frame="b",
        source="N1; seed 004.11",
    ),
    "gate.init.min_matches": Tip("matches", "Tracks that the reference frame shares with the newest.", source="N2"),
    "gate.init.min_parallax_px": Tip(
        "parallax",
        "Mean parallax between the reference frame and the newest; rotation counts here too.",
        equation="460 · mean |π(f_l) − π(f_n)|",
        unit=_PX,
        source="N2; seed 004.14",
    ),
    "gate.init.min_translation_px": Tip(
        "translation",
        "Parallax that no rotation explains: what is left is the camera's translation.",
        equation="460 · min_R mean |π(R f_l) − π(f_n)|",
        unit=_PX,
        source="N2",
    ),
    "gate.init.min_pose_inliers": Tip(
        "pose inliers", "Points that lie in front of both cameras of the relative pose.", source="N3"
    ),
    "gate.init.min_pnp_points": Tip(
        "known points", "Fewest points of the structure any frame saw when it was placed.", source="N4, N6"
    ),
    "gate.init.max_reprojection_px": Tip(
        "reprojection", "RMS reprojection error of the structure after bundle adjustment.", unit=_PX, source="N5"
    ),
    "gate.init.max_structure_cost": Tip(
        "cost", "Cost of the bundle adjustment; decides only when it did not converge.", source="N5"
    ),
    "gate.init.max_rotation_error_deg": Tip(
        "rotation error",
        "RMS difference between the rotations of vision and gyroscope from frame to frame, after the "
        "bias is estimated. A wrong rotation between camera and IMU, or a time offset, shows here.",
        unit="deg",
        source="N7; seed 004.13",
    ),
    "gate.init.gravity_tolerance": Tip(
        "gravity error",
        "Norm of the estimated gravity against the known one.",
        equation="| |ĝ| − g |",
        unit="m/s^2",
        source="N8; seed 004.16",
    ),
    "gate.init.min_consistent_share": Tip(
        "consistent points",
        "Share of the structure's points whose reprojection error stays below window.max_error_px.",
        source="N5",
    ),
    "gate.init.max_scale_sigma": Tip(
        "scale sigma",
        "Relative standard deviation of the scale after refinement: without changes of acceleration it "
        "cannot be observed.",
        equation="σ_s / s",
        source="seed 004.16",
    ),
    "gate.init.max_imu_error": Tip(
        "IMU error",
        "RMS of the whitened IMU residuals after refinement; 1 where the noise model fits.",
        equation="√(mean |Σ^(−½) r|²)",
        unit="sigma",
        source="seed 004.23",
    ),
    "gate.imu.max_interval_s": Tip(
        "longest interval",
        "Longest time between two frames of the window; the uncertainty of the pre-integration grows with it.",
        unit="s",
        source="I4",
    ),
    "gate.placed": Tip("placed", "Every frame found its place in the structure.", source="N4, N6"),
    "gate.scale": Tip("scale", "A negative scale turns the structure inside out.", source="N8, N9"),
    "gate.health.min_tracked": Tip("tracked", "Tracks shared with the previous frame.", source="F1"),
    "gate.health.max_acc_bias": Tip(
        "accelerometer bias",
        "A real sensor stays far below; more means that something else is being explained by it.",
        equation="|b_a|",
        unit="m/s^2",
        frame="b",
        source="F2",
    ),
    "gate.health.max_gyr_bias": Tip(
        "gyroscope bias", "As for the accelerometer.", equation="|b_g|", unit="rad/s", frame="b", source="F3"
    ),
    "gate.health.max_jump_m": Tip(
        "translation",
        "Distance from the previous frame's estimate.",
        equation="|p_k − p_k−1|",
        unit="m",
        frame="w",
        source="F4",
    ),
    "gate.health.max_z_jump_m": Tip(
        "vertical translation", "Its part along gravity.", equation="|z_k − z_k−1|", unit="m", frame="w", source="F5"
    ),
    "gate.health.max_rotation_deg": Tip(
        "rotation",
        "Angle between the previous frame's attitude and this one.",
        equation="|Log(q_k−1⁻¹ ⊗ q_k)|",
        unit="deg",
        source="F6",
    ),
    "gate.health.min_window_parallax": Tip(
        "window parallax",
        "Mean parallax between the newest frame and the oldest that still shares tracks with it, after the estimated "
        "rotation. Without it new landmarks get no depth: the camera stands still or turns on the spot.",
        unit="px460",
        source="SPEC 5.4",
    ),
}
