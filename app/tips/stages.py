"""The stages of initialisation."""

from __future__ import annotations

from collections.abc import Mapping

from .tip import Tip

STAGES: Mapping[str, Tip] = {
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
    "stage.time offset": Tip(
        "time offset",
        "Where td is estimated: how much later than believed the images were taken, by the rotations of gyroscope and "
        "images. When it changes by a millisecond or more, the attempt is made again with it.",
        equation="ρ_k = J_bg δb_g + (ω_k+1 − γ̂ᵀ ω_k) δtd",
        unit="s",
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
