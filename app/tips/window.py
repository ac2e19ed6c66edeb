"""The sliding window: keyframes, its solve, its states."""

from __future__ import annotations

from collections.abc import Mapping

from .tip import Tip

_PX = "px460"

WINDOW: Mapping[str, Tip] = {
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

SOLVE: Mapping[str, Tip] = {
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

STATE: Mapping[str, Tip] = {
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
