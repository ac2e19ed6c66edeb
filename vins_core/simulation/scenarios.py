"""The named scenarios: what moves where, what is wrong with it, and what should come of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from ..geometry import se3, so3
from ..sensors import ExtrinsicKnowledge
from . import lenses, motions, rooms, street, suite
from .receiver import Receiver
from .sensors import DepthSensor, Exposure, Imu, Rig
from .trajectory import Channels
from .world import World

Interval = tuple[float, float]
"""[start, end) in seconds after the first IMU sample, true time."""


def _looking_forward(
    q_f_b: np.ndarray, p_b_c: list[float], pitch_deg: float, lean_deg: tuple[float, float]
) -> np.ndarray:
    """T_b_c of a camera (z forward, x right) that looks along the vehicle's x axis, pitched down, a little askew."""
    R_f_c = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    lean = so3.exp(np.radians([lean_deg[0], pitch_deg, lean_deg[1]]))
    R_b_c = so3.to_matrix(so3.inverse(q_f_b)) @ so3.to_matrix(lean) @ R_f_c
    return se3.from_rotation_translation(R_b_c, np.array(p_b_c))


def _beside(baseline_m: float, lean_deg: tuple[float, float, float]) -> np.ndarray:
    """T_c0_c1 of a camera to the right of another, a little askew."""
    R = so3.to_matrix(so3.exp(np.radians(lean_deg)))
    return se3.from_rotation_translation(R, np.array([baseline_m, 0.002, -0.003]))


IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
UPRIGHT_IMU = so3.from_matrix(np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]))  # x up, as on EuRoC

PINHOLE = Rig(
    lenses.PINHOLE,
    _looking_forward(IDENTITY, [0.08, 0.02, 0.03], 10.0, (0.8, -0.6)),
    IDENTITY,
)
FISHEYE = Rig(
    lenses.FISHEYE,
    _looking_forward(UPRIGHT_IMU, [0.03, -0.06, 0.01], 10.0, (-0.7, 0.9)),
    UPRIGHT_IMU,
)
LEVEL = Rig(
    PINHOLE.camera,
    _looking_forward(UPRIGHT_IMU, [0.03, -0.06, 0.01], 0.0, (0.0, 0.0)),
    UPRIGHT_IMU,
)
STEREO = replace(PINHOLE, T_c0_c1=_beside(0.12, (0.5, -0.4, 0.3)))
CAR = replace(PINHOLE, T_c0_c1=_beside(0.40, (0.5, -0.4, 0.3)))

WIDE = {"frontend.min_dist": 15, "projection.residual": "sphere"}
"""Parameters for lenses that look far off their axis."""


@dataclass(frozen=True)
class Scenario:
    doc: str  # what happens, and what an estimator should make of it
    motion: Callable[[Rig], Channels] = lambda rig: motions.loop()
    world: Callable[[int], World] = rooms.furnished  # by seed
    rig: Rig = PINHOLE
    imu: Imu = field(default_factory=Imu)
    exposure: Exposure = field(default_factory=Exposure)
    depth: DepthSensor | None = None
    gps: Receiver | None = None  # on the IMU's clock; the world's axes are east, north, up
    duration_s: float = 15.0
    gravity_m_s2: float = 9.81
    td_s: float = 0.0  # true: t_imu = t_image + td
    image_dropouts: tuple[Interval, ...] = ()
    imu_gaps: tuple[Interval, ...] = ()
    believed_td_s: float = 0.0  # what the calibration says
    believed_rotation_error_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of R_b_c, about the camera's axes
    believed_translation_error_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of p_b_c, along the body's axes
    believed_extrinsics: ExtrinsicKnowledge = "fixed"  # "unknown": the calibration has the identity
    estimate_td: bool = False  # what the calibration asks for
    parameters: Mapping[str, Any] = field(default_factory=lambda: {"frontend.min_dist": 15})  # images are small


SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {
        "room_loop": Scenario(
            "One and a third laps around a furnished room, hand-held; from 18 to 21 s the start comes into view again. "
            "Everything is right: it initialises within 3 s and stays within centimetres.",
            duration_s=28.0,
        ),
        "standstill": Scenario(
            "Nothing moves. It must not initialise: no parallax and no excitation.",
            motion=lambda rig: motions.standstill(),
            duration_s=10.0,
        ),
        "pure_rotation": Scenario(
            "The camera turns about its own centre. There is no parallax: no keyframe by parallax, no initialisation.",
            motion=lambda rig: motions.pure_rotation(so3.rotate(rig.q_f_b, rig.T_b_c[:3, 3])),
            duration_s=10.0,
        ),
        "constant_velocity": Scenario(
            "A straight glide without acceleration or rotation for 6 s, then a swaying one. Scale is unobservable "
            "during the glide; it initialises only afterwards.",
            motion=lambda rig: motions.constant_velocity(until_s=6.0),
            duration_s=14.0,
        ),
        "image_dropout": Scenario(
            "The room loop with images missing from 6.0 to 6.3 s, 9.0 to 9.7 s and 13.0 to 14.4 s. The last gap is "
            "longer than the front end bridges: its tracks start anew.",
            image_dropouts=((6.0, 6.3), (9.0, 9.7), (13.0, 14.4)),
            duration_s=18.0,
        ),
        "imu_gap": Scenario(
            "The room loop with the IMU silent from 6.0 to 6.1 s and 10.0 to 10.6 s. Both gaps are reported.",
            imu_gaps=((6.0, 6.1), (10.0, 10.6)),
        ),
        "low_texture": Scenario(
            "The room loop in a bare white room with faint stains and one picture: most corners are noise and nearly "
            "all tracks are lost at once.",
            world=rooms.bare,
        ),
        "td_offset": Scenario(
            "The room loop with images stamped 30 ms early, which the calibration does not know.",
            td_s=0.030,
        ),
        "wrong_extrinsic": Scenario(
            "The room loop with a calibration whose camera is turned by 8 degrees about its x and 5 about its y axis.",
            believed_rotation_error_deg=(8.0, 5.0, 0.0),
        ),
        "rolling_shutter": Scenario(
            "The room loop with rows read one after another within 25 ms, centred on the stamp.",
            exposure=Exposure(readout_s=0.025),
        ),
        "motion_blur": Scenario(
            "The room loop exposed for 30 ms an image.",
            exposure=Exposure(exposure_s=0.030),
        ),
        "fisheye": Scenario(
            "The room loop through a Kannala-Brandt camera of 190 degrees, with an IMU mounted x up.",
            rig=FISHEYE,
        ),
        "level_camera": Scenario(
            "Two laps of the room loop with a camera that looks straight ahead and an IMU mounted x up, so that the "
            "Euler pitch of the body stays near -90 degrees. All of the second lap has been seen before.",
            rig=LEVEL,
            duration_s=41.0,
        ),
        "twin_rooms": Scenario(
            "A round in a room, out to the corridor, a round in the next room, which looks exactly the same, and back "
            "for another round in the first. Loops exist within a room; none exists between the two.",
            motion=lambda rig: motions.rounds((0, 1, 0)),
            world=suite.twins,
            duration_s=55.5,
        ),
        "building_first": Scenario(
            "A round in each of two different rooms on one corridor: a map to come back to.",
            motion=lambda rig: motions.rounds((0, 1)),
            world=suite.different,
            duration_s=34.0,
        ),
        "building_second": Scenario(
            "The building of building_first when the seed is the same, entered in the other room and walked the other "
            "way: a second session for its map.",
            motion=lambda rig: motions.rounds((1, 0), start_deg=70.0, radius_m=1.35),
            world=suite.different,
            duration_s=32.0,
        ),
        "kb190_camera": Scenario(
            "The room loop through a Kannala-Brandt camera of 190 degrees whose corners look behind, on the body of "
            "the pinhole camera.",
            rig=replace(PINHOLE, camera=lenses.KB_190),
            parameters=WIDE,
        ),
        "mei_camera": Scenario(
            "The room loop through a unified (MEI) camera of 140 degrees on the body of the pinhole camera.",
            rig=replace(PINHOLE, camera=lenses.MEI),
            parameters=WIDE,
        ),
        "scaramuzza_camera": Scenario(
            "The room loop through a Scaramuzza camera of 120 degrees on the body of the pinhole camera.",
            rig=replace(PINHOLE, camera=lenses.SCARAMUZZA),
            parameters=WIDE,
        ),
        "rational_camera": Scenario(
            "The room loop through a rational pinhole camera of 130 degrees on the body of the pinhole camera.",
            rig=replace(PINHOLE, camera=lenses.RATIONAL),
            parameters=WIDE,
        ),
        "stereo": Scenario(
            "The room loop with a second camera 12 cm to the right; both take their images at once.",
            rig=STEREO,
        ),
        "td_20ms": Scenario(
            "The room loop with images stamped 20 ms early; the calibration says 0 and asks for td to be estimated.",
            td_s=0.020,
            estimate_td=True,
        ),
        "rolling_shutter_20ms": Scenario(
            "The room loop with rows read one after another within 20 ms from the stamp on, as the calibration says.",
            exposure=Exposure(readout_s=0.020, stamped_row=0.0),
        ),
        "rough_extrinsics": Scenario(
            "The room loop with a calibration whose camera is turned by 1.5 degrees and 2.3 cm off, and that asks for "
            "the extrinsics to be refined.",
            believed_rotation_error_deg=(1.0, -1.0, 0.5),
            believed_translation_error_m=(0.015, -0.01, 0.015),
            believed_extrinsics="refine",
            duration_s=28.0,
        ),
        "unknown_extrinsics": Scenario(
            "The room loop with a calibration that does not know how the camera is mounted.",
            believed_extrinsics="unknown",
        ),
        "depth_camera": Scenario(
            "The room loop with a depth camera registered to the camera: 0.3 to 8 m, 2 % noise.",
            depth=DepthSensor(),
        ),
        "street_gps": Scenario(
            "A car drives once around a block, 68 m in 20 s, with two cameras and GPS: 5 fixes a second of 1 m noise "
            "from an antenna 1 m off, 12 % outliers of 10 m and more, none at all from 12 to 17 s. On the earth it "
            "stays right within a metre, also where there are no fixes.",
            motion=lambda rig: motions.drive(street.LANE_RADII_M, period_s=20.0, height_m=1.4),
            world=street.street,
            rig=CAR,
            gps=Receiver(outlier_share=0.12, outage_s=(12.0, 17.0)),
            duration_s=22.0,
        ),
    }
)
