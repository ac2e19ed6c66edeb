"""What a run needs for GPS fusion beside a pose: fixes in its recording, and where their antenna is on the body.

Neither is ever assumed.  Without them the odometry runs as it is, and a sentence names what is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .. import params
from ..report import PoseEstimate
from ..sensors import Calibration


def antenna(settings: params.Gps, calibration: Calibration) -> np.ndarray | None:
    """Where it is on the body, (3,) m; None where nobody says so.  `gps.lever_arm=off` says: at the origin."""
    if not settings.lever_arm:
        return np.zeros(3)
    return None if calibration.p_b_gps is None else np.array(calibration.p_b_gps, float)


def choose_topic(calibration: Calibration, topics: Sequence[str]) -> Calibration:
    """The calibration with the topic that fixes are taken from: the one it names, or the only one of `topics`, which
    are those with fixes; empty where there is none, or none of several is named.
    """
    named = calibration.gps_topic
    known = named if named in topics else topics[0] if len(topics) == 1 and not named else ""
    return replace(calibration, gps_topic=known)


def missing(settings: params.Gps, calibration: Calibration, topics: Sequence[str]) -> tuple[str, ...]:
    """What keeps fixes of `topics` from being fused, a sentence each; `calibration` comes from `choose_topic`."""
    if not topics or not settings.enabled:
        return ()
    if not calibration.gps_topic:
        return (f"GPS: {' and '.join(topics)} have fixes and none of them is fused: name one as the topic of gps",)
    if antenna(settings, calibration) is not None:
        return ()
    where = ", ".join(calibration.sources) or "the calibration"
    return (
        f"GPS: fixes of {calibration.gps_topic} are not fused, since {where} does not say where the antenna is: give "
        "p_b_gps, in body coordinates in m, or say that it is at the body's origin, with --set gps.lever_arm=off",
    )


def time_of(calibration: Calibration, t_ns: int, pose: PoseEstimate) -> int:
    """When a frame's pose was, on the clock of IMU and fixes: the stamp of its image plus td, estimated or given."""
    return t_ns + round((pose.late_s if calibration.has_imu else calibration.td_of(0)) * 1e9)


def settings_of(settings: params.Gps, calibration: Calibration) -> params.Gps:
    """Those that apply: without an IMU nothing shows where down is, so the inclination is estimated, too."""
    return settings if calibration.has_imu else replace(settings, dof="6")
