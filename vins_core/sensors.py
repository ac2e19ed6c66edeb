"""What sensors deliver and how they are calibrated: plain values that every other file speaks in.

Frames: `w` world (gravity along -z), `b` body = IMU, `c0`, `c1` cameras.  `T_b_c` maps camera to body coordinates.
Times are integer nanoseconds of the recording's own clock; a camera's `td_s` satisfies t_imu = t_image + td.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from .geometry.camera import CameraModel


@dataclass(frozen=True)
class ImuSamples:
    """Consecutive IMU samples."""

    t_ns: np.ndarray  # (n,) int64
    gyro_rad_s: np.ndarray  # (n, 3)
    accel_m_s2: np.ndarray  # (n, 3) specific force: +g along up at rest

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, rows: slice | np.ndarray) -> ImuSamples:
        return ImuSamples(self.t_ns[rows], self.gyro_rad_s[rows], self.accel_m_s2[rows])

    @staticmethod
    def empty() -> ImuSamples:
        return ImuSamples(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)))

    @staticmethod
    def concatenate(parts: list[ImuSamples]) -> ImuSamples:
        return ImuSamples(
            np.concatenate([p.t_ns for p in parts]),
            np.concatenate([p.gyro_rad_s for p in parts]),
            np.concatenate([p.accel_m_s2 for p in parts]),
        )


@dataclass(frozen=True)
class ImageRef:
    """An image by reference: where to find it in the recording, never its pixels."""

    t_ns: int
    camera: int  # index into Calibration.cameras
    index: int  # running number of this camera's images in the recording
    locator: int = 0  # what its reader needs to find it at once: a bag's record time in ns; folders need none


@dataclass(frozen=True)
class DepthRef:
    """A depth image by reference."""

    t_ns: int
    camera: int  # whose pixels it is registered to
    index: int  # running number in the recording
    locator: int = 0  # as of an ImageRef


@dataclass(frozen=True)
class GpsFix:
    t_ns: int
    latitude_deg: float
    longitude_deg: float
    altitude_m: float  # above the WGS 84 ellipsoid
    covariance_enu_m2: np.ndarray  # (3, 3) east, north, up; zeros where the receiver says nothing
    status: int  # sensor_msgs/NavSatStatus: -1 no fix, 0 fix, 1 with satellite augmentation, 2 with ground stations


@dataclass(frozen=True)
class Trajectory:
    """Stamped body poses, e.g. ground truth or an estimate."""

    t_ns: np.ndarray  # (n,) int64, increasing
    p_w_b: np.ndarray  # (n, 3)
    q_w_b: np.ndarray  # (n, 4) wxyz, NaN where only positions are known
    v_w_b: np.ndarray | None = None  # (n, 3)
    b_g: np.ndarray | None = None
    b_a: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True)
class Anomaly:
    """Something in the recording that a careful user wants to know (SPEC 1.3)."""

    kind: str  # gap, duplicate, reversal, rate_change, no_imu, dropped_image, nan, unit_suspicion, axis_suspicion ...
    t_ns: int
    topic: str
    message: str  # one sentence


@dataclass(frozen=True)
class ImuNoise:
    """IMU noise.  `discrete`: VINS' per-sample sigmas.  `continuous`: Kalibr/EuRoC densities, per sqrt(Hz)."""

    kind: str  # "discrete" | "continuous"
    acc_n: float  # m/s^2   | m/s^2/sqrt(Hz)
    gyr_n: float  # rad/s   | rad/s/sqrt(Hz)
    acc_w: float  # bias random walk; VINS multiplies it by dt per sample | m/s^3/sqrt(Hz)
    gyr_w: float
    # between samples further apart than gap_s the motion is unknown: the mean of either may be off by this much more
    gap_s: float = 1e6
    gap_acc: float = 0.0  # m/s^2
    gap_gyr: float = 0.0  # rad/s


NO_IMU = ImuNoise("discrete", 0.0, 0.0, 0.0, 0.0)
"""The noise of a calibration without IMU: no real one is zero."""


@dataclass(frozen=True)
class DepthCalibration:
    """A depth camera whose images are registered to the pixels of the camera that this belongs to."""

    topic: str = ""  # empty: the recording's only depth topic
    scale_m: float = 1e-3  # metres per unit of an integer image (16UC1); 32FC1 is in metres
    min_m: float = 0.0  # nearer or
    max_m: float = 1e3  # farther depths are not used
    tolerance_s: float = 0.02  # largest difference between the stamps of image and depth


ExtrinsicKnowledge = Literal["fixed", "refine", "unknown"]
"""How far T_b_c is to be believed: as given, as a start, or not at all (VINS' estimate_extrinsic 0, 1, 2)."""


@dataclass(frozen=True)
class CameraCalibration:
    name: str  # "cam0"
    model: CameraModel
    T_b_c: np.ndarray  # (4, 4); the identity where the extrinsics are unknown
    topic: str = ""
    mask: str = ""  # path of a fisheye mask image, white = usable
    td_s: float | None = None  # of this camera alone; None: that of the calibration
    readout_s: float = 0.0  # rolling shutter: row v is exposed readout_s v / (height - 1) after t_image + td
    depth: DepthCalibration | None = None


@dataclass(frozen=True)
class Calibration:
    """All that must be known about the sensors before a run.  Nothing in here has a silent default."""

    cameras: tuple[CameraCalibration, ...]
    noise: ImuNoise
    gravity_m_s2: float
    td_s: float = 0.0  # t_imu = t_image + td; zero only where the file says so or the format has no such key
    imu_topic: str = ""
    sources: tuple[str, ...] = field(default=())  # the files this was read from
    has_imu: bool = True  # False: cameras alone; then noise is NO_IMU and body coordinates are what T_b_c says
    estimate_td: bool = False  # the file asks for td to be estimated from the given value on
    extrinsics: ExtrinsicKnowledge = "fixed"
    gps_topic: str = ""  # empty: the recording's only one, if any
    p_b_gps: tuple[float, float, float] | None = None  # the antenna in body coordinates in m; None: not known

    def td_of(self, camera: int) -> float:
        """t_imu = t_image + td for images of one camera, s."""
        own = self.cameras[camera].td_s
        return self.td_s if own is None else own

    def exposed_at_once(self) -> Calibration:
        """The same, but all rows are read at the stamp."""
        if not any(camera.readout_s for camera in self.cameras):
            return self
        return replace(self, cameras=tuple(replace(camera, readout_s=0.0) for camera in self.cameras))


@dataclass(frozen=True)
class Packet:
    """All that arrived for one frame: images since the previous frame (the last one is the frame), IMU, GPS, depth.

    `imu` covers [t_previous + td, t_frame + td]: both ends are there, interpolated when no sample falls on them, so
    the last sample of one packet equals the first of the next.  For the first packet it covers what came before.
    Where td is estimated, each end is by the estimate of its time; with a rolling shutter it is the middle row's.
    With two cameras each image of camera 0 is followed by the one that camera 1 took with it, if there is one.
    """

    frame: int
    images: tuple[ImageRef, ...]
    imu: ImuSamples
    anomalies: tuple[Anomaly, ...] = ()
    gps: tuple[GpsFix, ...] = ()  # stamped up to t_frame + td and not in an earlier packet
    depths: tuple[DepthRef | None, ...] = ()  # one for each image of camera 0; empty without a depth camera

    @property
    def late_ns(self) -> int:
        """By how much the end of `imu` is later than the stamp of the frame: t_frame + td, whatever td was then."""
        return int(self.imu.t_ns[-1]) - self.t_ns if len(self.imu) else 0

    @property
    def image(self) -> ImageRef:
        """The frame itself: the newest image of camera 0."""
        return next(ref for ref in reversed(self.images) if ref.camera == 0)

    @property
    def t_ns(self) -> int:
        return self.image.t_ns

    @property
    def pairs(self) -> tuple[tuple[ImageRef, ImageRef | None], ...]:
        """Images of camera 0, oldest first, each with that of camera 1, or None where it is missing."""
        follower = dict(zip(self.images, self.images[1:]))
        partners = ((left, follower.get(left)) for left in self.images if left.camera == 0)
        return tuple((left, right if right is not None and right.camera == 1 else None) for left, right in partners)

    @property
    def depth(self) -> DepthRef | None:
        """The depth image of the frame, None where it is missing."""
        return self.depths[-1] if self.depths else None


class ImageSource(Protocol):
    """Gives pixels for references; recordings implement it."""

    def load(self, ref: ImageRef) -> np.ndarray:
        """Grey image (rows, columns) uint8; raises RecordingError when it cannot be read."""
        ...


@runtime_checkable
class DepthSource(ImageSource, Protocol):
    """An image source with depth images, which mode rgbd_imu needs."""

    def load_depth(self, ref: DepthRef, scale_m: float) -> np.ndarray:
        """Depth image (rows, columns) float32 in metres, NaN where unknown; `scale_m`: of an integer image."""
        ...
