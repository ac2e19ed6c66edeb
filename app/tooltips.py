"""What every quantity and gate on the page means: equation, unit, frame, source.

An element with `data-tip="key"` shows `TIPS[key]` under the pointer; page.js gets the whole dictionary once.
Parameters explain themselves through their declaration (`param.section.name`), and so does every gate that has no
entry of its own here (`gate.section.name`, the parameter behind it).
Sources: "seed 004.10" is section 10 of the founding document 004, "W4" a line of the inventory of VINS.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from vins_core.params import DECLARATIONS, Declaration
from vins_core.report import Gate, LossReason

from .loop_tips import LOOPS
from .tip import Tip

_PX = "px460"

_FRONTEND = {
    "tracks": Tip("tracks", "Corners followed from image to image and alive in this one.", source="T4, T9; seed 004.4"),
    "tracks.new": Tip("new tracks", "Corners found in this image to fill up to frontend.max_cnt.", source="T9"),
    "tracks.lost": Tip(
        "lost tracks", "Tracks that ended since the previous frame, each with its reason.", source="T5-T8"
    ),
    "age": Tip("age", "Number of images a track has been seen in; 1 is new.", unit="images", source="T6; seed 004.6"),
    f"loss.{LossReason.FLOW}": Tip(
        "flow failed", "Optical flow did not converge, or its patch changed too much.", source="T5; seed 004.4"
    ),
    f"loss.{LossReason.FLOW_BACK}": Tip(
        "flow-back",
        "Tracked back into the previous image, the point does not return to where it was.",
        equation="|track_back(track(u)) − u| > frontend.flow_back_px",
        unit="px",
        source="TF4; seed 004.28",
    ),
    f"loss.{LossReason.BORDER}": Tip("border", "The point left the image.", source="T5"),
    f"loss.{LossReason.RANSAC}": Tip(
        "F-RANSAC",
        "Too far from the epipolar line of the fundamental matrix that most tracks agree on.",
        equation="dist(u', F u) > frontend.F_threshold",
        unit=_PX,
        source="T7; seed 004.7",
    ),
    f"loss.{LossReason.MASK}": Tip(
        "mask",
        "An older track lies nearer than frontend.min_dist, or the camera's mask is black here.",
        source="T8; seed 004.6",
    ),
    f"loss.{LossReason.OUTLIER}": Tip(
        "estimator outlier",
        "The window found its mean reprojection error above window.max_error_px.",
        source="O12, TF8; seed 004.30",
    ),
    f"loss.{LossReason.DEPTH}": Tip("negative depth", "The solve put the landmark behind its camera.", source="W10"),
    f"loss.{LossReason.RESET}": Tip("tracker reset", "The images have a gap, or time went back.", source="T1"),
}

_WINDOW = {
    "parallax": Tip(
        "parallax",
        "Mean distance between the positions of shared tracks in the second newest frame and the one "
        "before it, after the rotation between them has been taken out.",
        equation="460 · mean |π(R f_i) − π(f_j)|",
        unit=_PX,
        source="W2, W4; seed 004.8",
    ),
    "parallax_raw": Tip(
        "parallax, uncompensated",
        "The same without taking the rotation out: what VINS-Mono compares.",
        equation="460 · mean |π(f_i) − π(f_j)|",
        unit=_PX,
        source="W4",
    ),
    "long_tracks": Tip(
        "long tracks", "Tracks of the newest frame seen in four or more frames of the window.", source="W3"
    ),
    "new_tracks": Tip(
        "new in the window", "Tracks of the newest frame no other frame of the window sees.", source="W3"
    ),
    "keyframe": Tip(
        "keyframe decision",
        "About the second newest frame, taken when the next one arrives. A keyframe stays and the "
        "oldest frame is marginalised; otherwise the second newest is dropped and its IMU joined to the next.",
        source="W2, W5; seeds 000.3.1, 004.8",
    ),
    "margin": Tip(
        "marginalisation",
        "What leaves the window becomes a prior on what stays (Schur complement).",
        equation="H' = H_nn − H_nm H_mm⁻¹ H_mn\nb' = b_n − H_nm H_mm⁻¹ b_m",
        source="G1, G2; seeds 000.3.3.4, 003, 004.21",
    ),
    "margin.m": Tip("m", "Dimension of what was dropped.", source="seed 003.3.1"),
    "margin.n": Tip("n", "Dimension of what was kept: the size of the prior.", source="seed 003.3.1"),
    "margin.rank": Tip(
        "rank",
        "Eigenvalues of the prior's information above marginalization.eigen_threshold. Position and yaw of the "
        "world cannot be observed, so it is at most n − 4 until something leaks in.",
        source="G3; seed 003.3.1",
    ),
    "margin.eigenvalues": Tip(
        "eigenvalues",
        "Spectrum of the prior's information, on a logarithmic scale; those counted as zero are red.",
        equation="H' = V diag(λ) Vᵀ,  J = diag(√λ) Vᵀ",
        source="G3; seed 000.3.3.4",
    ),
    "slot": Tip("slot", "Place in the window, 0 is the oldest frame.", source="W1"),
    "window.kf": Tip("keyframe", "The frame was kept as a keyframe.", source="W5"),
    "window.shared": Tip("shared", "Tracks this frame shares with the newest one.", source="W2"),
    "window.rms": Tip(
        "rms",
        "Root mean square reprojection error of the observations in this frame, after the solve.",
        equation="√(mean |r|²),  r = 460 (π(f̂) − π(f))",
        unit=_PX,
        source="seed 000.3.3.3",
    ),
    "window.imu": Tip(
        "IMU residual",
        "Between this frame and the one before it, whitened: a consistent model gives about √3 in each "
        "of position, rotation, velocity and the biases. The number is the largest of the five.",
        equation="| Σ^(−½) r |,  r = [δp δθ δv δb_a δb_g]",
        unit="sigma",
        source="I4; seeds 000.3.3.2, 004.23",
    ),
    "landmark.state": Tip(
        "state",
        "candidate: no depth yet; triangulated: in the solve; outlier: rejected; marginalized: left with its "
        "anchor frame.",
        source="W6, W10, O12",
    ),
    "landmark.inv_depth": Tip(
        "inverse depth",
        "Along z of the camera that saw the landmark first (its anchor). ± is one standard deviation "
        "from its projections alone, the poses held.",
        equation="λ = 1 / z,  σ = (Σ Jᵀ J)^(−½)",
        unit="1/m",
        frame="anchor camera",
        source="W10; seed 004.19",
    ),
    "landmark.depth": Tip(
        "depth",
        "The inverse of λ; the interval is that of λ ± σ, so it is not symmetric.",
        equation="z = 1 / λ",
        unit="m",
        frame="anchor camera",
        source="W8; seed 004.19",
    ),
    "landmark.xyz": Tip("position", "In the world, after this frame's solve.", unit="m", frame="w"),
    "landmark.obs": Tip("observations", "Frames of the window that see the landmark.", source="W6"),
    "landmark.error": Tip(
        "reprojection error",
        "Distance between where the landmark is seen and where its anchor, depth and the poses "
        "put it, after the solve. The dashed line is window.max_error_px, applied to the mean.",
        equation="460 · |π(T_c_w T_w_a (f_a / λ)) − π(f)|",
        unit=_PX,
        source="O12; seed 000.3.3.3",
    ),
}

_SOLVE = {
    "cost": Tip(
        "cost",
        "What the window solve minimises; about half the number of residuals where the noise model fits.",
        equation="F = ½ Σ ρ(|r_visual|²) + ½ Σ |r_imu|² + ½ |r_prior|²",
        source="seeds 000.3.3, 004.20",
    ),
    "cost.visual": Tip(
        "visual cost",
        "All projections, robust.",
        equation="½ Σ ρ(|r|²),  r = (460 / σ) (π(f̂) − π(f))",
        source="O3, O4; seeds 000.3.3.3, 004.22",
    ),
    "cost.imu": Tip(
        "IMU cost",
        "All pre-integrated intervals against the states at their ends.",
        equation="½ Σ rᵀ Σ⁻¹ r,  r = [δp δθ δv δb_a δb_g]",
        source="I4; seeds 000.3.3.2, 004.23",
    ),
    "cost.prior": Tip(
        "prior cost",
        "What marginalised frames and landmarks still say.",
        equation="½ |r₀ + J (x ⊟ x₀)|²",
        source="G4; seeds 000.3.3.1, 000.3.3.4",
    ),
    "iteration.cost": Tip("cost", "After the step, or at the trial point when the step was rejected."),
    "iteration.step": Tip("step", "Norm of the step in the tangent space.", equation="|d|,  x ← x ⊞ d"),
    "iteration.gain": Tip(
        "gain ratio",
        "How much of the decrease that the quadratic model promised came true; a step is taken when it "
        "exceeds solver.min_gain_ratio.",
        equation="ρ = (F(x) − F(x ⊞ d)) / (m(0) − m(d))",
        source="Madsen, Nielsen, Tingleff 2004",
    ),
    "iteration.radius": Tip(
        "trust-region radius",
        "Large: a Gauss-Newton step; small: a short step down the gradient.",
        equation="(JᵀJ + D / μ) d = −Jᵀ r",
        source="Levenberg-Marquardt",
    ),
    "termination": Tip("termination", "Why the solver stopped.", source="O1"),
    "landmarks": Tip("landmarks", "Landmarks with a depth that took part in the solve.", source="W6"),
}

_STATE = {
    "p": Tip("position", "Of the body, right after this frame's own solve; never revised later.", unit="m", frame="w"),
    "attitude": Tip(
        "attitude",
        "Yaw about gravity, pitch and roll of the body. Yaw is free: only its changes are observed.",
        equation="R_w_b = R_z(yaw) R_y(pitch) R_x(roll)",
        unit="deg",
        frame="w to b",
    ),
    "v": Tip("velocity", "Of the body.", unit="m/s", frame="w"),
    "b_a": Tip(
        "accelerometer bias",
        "Subtracted from the measurement; starts at zero after initialisation.",
        equation="a = a_m − b_a − n_a",
        unit="m/s^2",
        frame="b",
        source="I1, N10; seed 004.10",
    ),
    "b_g": Tip(
        "gyroscope bias",
        "Subtracted from the measurement; first estimated during initialisation.",
        equation="ω = ω_m − b_g − n_g",
        unit="rad/s",
        frame="b",
        source="I1, N7; seeds 000.2.3, 004.15",
    ),
    "speed": Tip("speed", "Norm of the velocity.", equation="|v_w_b|", unit="m/s", frame="w"),
    "ate": Tip(
        "absolute trajectory error",
        "RMSE of the positions up to this frame, after one rigid alignment of the whole run with the truth.",
        equation="√(mean |R p̂ + t − p|²),  (R, t) ∈ SE(3)",
        unit="m",
        frame="w",
        source="Umeyama 1991; Zhang, Scaramuzza 2018",
    ),
    "status": Tip(
        "status",
        "filling: collecting frames until the window is full; initializing: full, without a metric state; "
        "tracking: the window is solved at every frame.",
        source="seed 004.11",
    ),
    "scale": Tip(
        "scale",
        "Metres per unit of the visual structure.",
        equation="p_metric = s · p_structure",
        source="N8; seed 004.16",
    ),
    "gravity": Tip(
        "gravity",
        "In the reference camera's frame, before the world is turned to make it vertical.",
        unit="m/s^2",
        frame="reference camera",
        source="N8, N9; seeds 000.2.4, 000.2.5, 004.17",
    ),
    "reference_slot": Tip(
        "reference frame",
        "The oldest frame of the window with enough matches and parallax to the newest: the "
        "structure is built from this pair.",
        source="N2; seed 004.14",
    ),
    "motion": Tip("motion", "Frames whose window saw no parallax: standing still or pure rotation.", source="SPEC 5.4"),
    "anomaly": Tip(
        "anomalies",
        "What a careful user wants to know about the recording: gaps, duplicates, reversals, images "
        "without IMU, suspicious units.",
        source="S1-S3",
    ),
    "ms": Tip("time", "Measured while the run was made, on that machine; decides nothing.", unit="ms"),
}

_STAGES = {
    "attempts": Tip(
        "initialisation",
        "One mark per attempt: it is tried when the window is full and init.retry_s has passed. "
        "Failed attempts are red, success is green, a restart is white.",
        source="N1-N11; seed 004.11",
    ),
    "stage.excitation": Tip(
        "excitation",
        "Without changes of acceleration, scale and gravity cannot be told apart.",
        equation="std(Δv / Δt) over the frames",
        unit="m/s^2",
        source="N1; seed 004.11",
    ),
    "stage.relative pose": Tip(
        "relative pose",
        "The oldest frame that shares enough tracks, seen from far enough away, with the newest; "
        "their relative pose up to scale.",
        equation="f'ᵀ [t]× R f = 0",
        source="N2, N3; seeds 000.2.2, 004.14",
    ),
    "stage.structure": Tip(
        "structure",
        "Triangulate the pair, place the frames between by PnP, adjust poses and points together.",
        source="N4, N5; seeds 000.2.2, 004.14",
    ),
    "stage.frames between": Tip(
        "frames between", "Frames that the window did not keep are placed in the structure too.", source="N6"
    ),
    "stage.gyroscope bias": Tip(
        "gyroscope bias",
        "The bias that makes the gyroscope turn as the images do.",
        equation="min Σ |2 vec(γ̂⁻¹ ⊗ q_k⁻¹ ⊗ q_k+1) − J_bg δb_g|²",
        source="N7; seeds 000.2.3, 004.15",
    ),
    "stage.alignment": Tip(
        "alignment",
        "Velocities, gravity and scale by linear least squares on the pre-integrated motion.",
        equation="[v_0 … v_n, g, s]",
        source="N8; seeds 000.2.4, 004.16",
    ),
    "stage.refinement": Tip(
        "refinement",
        "Vision and IMU adjust states, points, scale and gravity together; their disagreement, and how well "
        "the scale is known, decide.",
        equation="½ Σ |r_visual|² + ½ Σ |r_imu|² + ½ |b_a|² / σ²",
        source="seeds 000.2.6, 004.20",
    ),
    "stage.gravity": Tip(
        "gravity",
        "Gravity is refined on its tangent plane: its direction moves, its norm is known.",
        equation="g = |g| ĝ + w₁ b₁ + w₂ b₂",
        source="N9; seeds 000.2.5, 004.17",
    ),
}

_GATES = {
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


def _of_parameter(d: Declaration) -> Tip:
    span = f"{d.low:g} to {d.high:g}" if d.low is not None and d.high is not None else ", ".join(d.choices)
    default = {True: "on", False: "off"}.get(d.default, d.default) if d.type is bool else d.default
    return Tip(
        d.key,
        d.doc[:1].upper() + d.doc[1:] + ".",
        f"default {default}" + (f"   range {span}" if span else ""),
        unit=d.unit,
    )


_WHAT_IF = {
    "whatif.gates": Tip(
        "gates judged again",
        "Every recorded value against the new limit, over the whole run, given the recorded trajectory: a verdict that "
        "flips would have changed everything after it, which only a fork shows.",
        source="SPEC 9.3a",
    ),
    "whatif.solve": Tip(
        "this frame again",
        "Repeated from the recorded state before it with the parameters as they stand; with its recorded tracks, or "
        "with its images tracked again.",
        source="SPEC 9.3b",
    ),
}

_PRIOR = {
    "prior.information": Tip(
        "information of the prior",
        "What the frames that left say about those that stay. Rows and columns are the tangents of poses (dp, dθ), "
        "velocities and biases, and the extrinsics; an entry off the diagonal couples two blocks.",
        equation="Λ = JᵀJ = A_kk − A_km A_mm⁻¹ A_mk",
        source="SPEC 6; seeds 003, 000.3.3.4",
    ),
    "prior.null_space": Tip(
        "null-space check",
        "Camera and IMU see neither where the window stands nor its heading: moving all of it along these four must "
        "cost nothing. Where factors were linearised at different estimates, knowledge of them is invented.",
        equation="nᵀ Λ n = 0,   n = x, y, z, yaw of the whole window",
        source="SPEC 6.2",
    ),
    "prior.leak": Tip(
        "leaked information",
        "Information that the prior holds about a direction that nothing measured.",
        equation="nᵀ Λ n",
        unit="1/m² or 1/rad²",
        frame="w",
        source="SPEC 6.2",
    ),
    "prior.sigma": Tip(
        "claimed standard deviation", "How well the prior claims to know the direction.", equation="1 / √(nᵀ Λ n)"
    ),
    **{
        f"prior.{axis}": Tip(
            f"global {axis}", f"All poses moved along {axis}.", equation=f"dp_i = e_{axis}", unit="m", frame="w"
        )
        for axis in "xyz"
    },
    "prior.yaw": Tip(
        "yaw",
        "The window turned about gravity, around the centroid of its poses.",
        equation="dp_i = e_z × (p_i − c),  dθ_i = R_iᵀ e_z,  dv_i = e_z × v_i",
        unit="rad",
        frame="w",
        source="SPEC 6.2",
    ),
}

_PARAMETERS = {f"param.{d.key}": _of_parameter(d) for d in DECLARATIONS.values()}
_GATES_BY_PARAMETER = {
    f"gate.{d.key}": Tip(d.key.split(".")[1].replace("_", " "), tip.text, unit=d.unit)
    for d, tip in zip(DECLARATIONS.values(), _PARAMETERS.values())
}

TIPS: Mapping[str, Tip] = MappingProxyType(
    {
        **_PARAMETERS,
        **_GATES_BY_PARAMETER,
        **_GATES,
        **_FRONTEND,
        **_WINDOW,
        **_SOLVE,
        **_STATE,
        **_STAGES,
        **_WHAT_IF,
        **_PRIOR,
        **LOOPS,
    }
)


def gate_tip(gate: Gate) -> str:
    """Key of the tip that explains a gate: of loop closing by its name, of others by the parameter behind it, or by its
    name; "" when there is none."""
    of_loops = f"gate.loop.{gate.name}" if gate.knob.startswith("loop.") else ""
    return next((key for key in (of_loops, f"gate.{gate.knob or gate.name}") if key in TIPS), "")


def parameter_tip(key: str) -> str:
    """Key of a parameter's tip, "" for a parameter of another version."""
    return f"param.{key}" if key in DECLARATIONS else ""


def page_tips() -> dict[str, str]:
    """Every tip as html, for the page."""
    return {key: tip.html() for key, tip in TIPS.items()}
