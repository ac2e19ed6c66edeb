"""What the words of calibration while running mean."""

from __future__ import annotations

from collections.abc import Mapping

from .tip import Tip

CALIBRATION: Mapping[str, Tip] = {
    "calibration.td": Tip(
        "time offset",
        "By how much images are stamped earlier than the IMU knows the moment. It moves every ray along its velocity; "
        "the IMU samples of the next frame are cut by the newest estimate. The band is three standard deviations.",
        equation="t_imu = t_image + td,   x(td) = x − (td − td_cut) dx/dt",
        unit="ms",
        source="O6, O7, S6, T10",
    ),
    "calibration.turn": Tip(
        "rotation of the camera",
        "How far the camera is found turned from what the calibration gives, as a rotation vector.",
        equation="Log(R_given⁻¹ R_b_c)",
        unit="deg",
        frame="axes of the camera",
        source="O5",
    ),
    "calibration.shift": Tip(
        "position of the camera",
        "How far the camera is found from where the calibration puts it. Position needs rotation of the body to be "
        "seen, so it is known much less well than rotation.",
        equation="p_b_c − p_given",
        unit="cm",
        frame="axes of the body",
        source="O5",
    ),
    "calibration.held": Tip(
        "free or held",
        "Held, it is no variable of the frame's solve, because that could tell nothing about it; what is known of it "
        "stays in the prior. The gates below say why.",
        source="O5, O6",
    ),
    "calibration.readout": Tip(
        "rolling shutter",
        "Rows are read one after another. Every ray is moved along its velocity to the time of the middle row, to "
        "which the pose belongs.",
        equation="x − readout (v / (h − 1) − 1/2) dx/dt",
        source="O7, O8",
    ),
}
