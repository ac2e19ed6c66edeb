"""What readers yield and writers take: stamped sensor messages, independent of the file format."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..sensors import GpsFix


@dataclass(frozen=True)
class ImageMessage:
    """An image, encoded (`format` "jpeg" or "png", `data` its bytes) or raw (`format` "mono8", `data` (rows, cols)).

    A raw one of format "16UC1" or "32FC1" is a depth image.
    """

    t_ns: int
    topic: str
    format: str
    data: bytes | np.ndarray


@dataclass(frozen=True)
class ImuMessage:
    t_ns: int
    topic: str
    gyro_rad_s: np.ndarray  # (3,)
    accel_m_s2: np.ndarray  # (3,)


@dataclass(frozen=True)
class TruthMessage:
    """Ground truth: pose of the body in the world, with velocity and biases where known."""

    t_ns: int
    topic: str
    p_w_b: np.ndarray  # (3,)
    q_w_b: np.ndarray  # (4,) wxyz, NaN where only the position is known
    v_w_b: np.ndarray | None = None
    b_g: np.ndarray | None = None
    b_a: np.ndarray | None = None


@dataclass(frozen=True)
class GpsMessage:
    t_ns: int
    topic: str
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    covariance_enu_m2: np.ndarray  # (3, 3)
    status: int = 0

    @property
    def fix(self) -> GpsFix:
        place = self.latitude_deg, self.longitude_deg, self.altitude_m
        return GpsFix(self.t_ns, *place, self.covariance_enu_m2, self.status)


Message = ImageMessage | ImuMessage | TruthMessage | GpsMessage
