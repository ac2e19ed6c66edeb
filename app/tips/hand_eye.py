"""The rotation between camera and IMU where the calibration does not know it."""

from __future__ import annotations

from collections.abc import Mapping

from .tip import Tip

_SOURCE = "N14; seeds 000.2, 004.13"

HAND_EYE: Mapping[str, Tip] = {
    "stage.extrinsic rotation": Tip(
        "extrinsic rotation",
        "Unknown extrinsics: how the camera is turned against the IMU, from how both turn between frames, together "
        "with gyroscope bias and time offset. Nothing else is tried before every gate of it has passed.",
        equation="γ(b_g, td) = R_bc R_c R_bcᵀ",
        source=_SOURCE,
    ),
    "hand_eye.rotation": Tip(
        "camera in the body",
        "Rotation vector from camera to IMU coordinates. Sigma is about each axis of the camera: it comes from the "
        "covariance of every pair of frames, enlarged where the pairs disagree by more than that.",
        equation="R_bc = Exp(r)",
        unit="deg",
        frame="camera to body",
        source=_SOURCE,
    ),
    "hand_eye.bias": Tip(
        "gyroscope bias",
        "Found with the rotation: left out, 0.08 rad/s pass for ten degrees of rotation.",
        equation="γ(b_g) = γ₀ Exp(J b_g)",
        unit="rad/s",
        frame="body",
    ),
    "hand_eye.td": Tip(
        "time offset",
        "How much later than the calibration says the images were taken, found with the rotation: of a device that "
        "turns about changing axes, left out, it looks like a rotation.",
        equation="γ(td) = Exp(−ω_a td) γ Exp(ω_b td)",
        unit="ms",
    ),
    "hand_eye.given": Tip("from given", "Angle to the rotation in the calibration, which is not used.", unit="deg"),
    "hand_eye.attempts": Tip(
        "attempts",
        "One column an attempt: how far the rotation found then is from the one found last (or from what the "
        "calibration says), with one sigma to either side. A click goes to the frame.",
        unit="deg",
        frame="camera",
    ),
    "hand_eye.sigma": Tip(
        "worst sigma",
        "Standard deviation about the axis that is known least of the three. The dashed line is the limit.",
        unit="deg",
    ),
    "hand_eye.singular": Tip(
        "second smallest singular value",
        "Of the stacked system that VINS solves: zero while all turning is about one axis. VINS waits for 0.25 and "
        "looks at nothing else.",
        equation="(L(q_γ) − R(q_c)) q_bc = 0",
        source="N14",
    ),
    "hand_eye.gates": Tip(
        "gates", "All must pass before the rotation is used; each names its parameter.", source="N14"
    ),
    "gate.init.hand_eye_min_pairs": Tip(
        "pairs", "Pairs of consecutive frames in which enough tracks are shared; the newest 200.", source="N14"
    ),
    "gate.init.hand_eye_min_turn_deg_s": Tip(
        "second axis",
        "rms rate of turning about the second strongest axis, beside its mean, which might be bias. One axis leaves "
        "the rotation about it open.",
        unit="deg/s",
    ),
    "gate.init.hand_eye_min_singular": Tip(
        "singular value", "Second smallest of the stacked quaternions, without the bias.", source="N14"
    ),
    "gate.init.hand_eye_max_sigma_deg": Tip(
        "rotation sigma", "Standard deviation of the rotation about its worst axis.", unit="deg"
    ),
    "gate.init.hand_eye_max_misfit": Tip(
        "rotation misfit",
        "By how much camera and gyroscope still turn apart, in standard deviations. Large: mirrored or swapped axes of "
        "the IMU, wrong stamps.",
        unit="sigma",
    ),
    "gate.init.hand_eye_min_agreement": Tip(
        "rotation agreement", "Share of the pairs within three standard deviations. Few: things that move in the image."
    ),
    "gate.init.hand_eye_max_halves_deg": Tip(
        "rotation halves", "Angle between what the earlier and the later half of the pairs say alone.", unit="deg"
    ),
    "gate.init.hand_eye_max_td_ms": Tip(
        "time offset",
        "Found with the rotation. Large: the stamps of images and IMU do not fit, and estimating td helps.",
        unit="ms",
    ),
}
