"""The local frame of a GPS track: east, north, up on the WGS84 ellipsoid, by pymap3d."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pymap3d

from ..sensors import GpsFix


@dataclass(frozen=True)
class EnuFrame:
    """Frame `e`: x east, y north, z up along the ellipsoid's normal at the origin.  Heights are above the ellipsoid."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float

    @staticmethod
    def at(fix: GpsFix) -> EnuFrame:
        return EnuFrame(fix.latitude_deg, fix.longitude_deg, fix.altitude_m)

    @property
    def coordinates(self) -> np.ndarray:
        """(3,) latitude, longitude, altitude."""
        return np.array([self.latitude_deg, self.longitude_deg, self.altitude_m])

    def from_geodetic(
        self, latitude_deg: np.ndarray | float, longitude_deg: np.ndarray | float, altitude_m: np.ndarray | float
    ) -> np.ndarray:
        """Geodetic coordinates (...) -> positions in `e`, (..., 3) metres."""
        here = (self.latitude_deg, self.longitude_deg, self.altitude_m)
        return np.stack(pymap3d.geodetic2enu(latitude_deg, longitude_deg, altitude_m, *here), -1)

    def to_geodetic(self, p_e: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions (..., 3) in `e` -> latitude and longitude in degrees, altitude in metres."""
        return pymap3d.enu2geodetic(*np.moveaxis(p_e, -1, 0), self.latitude_deg, self.longitude_deg, self.altitude_m)

    def position(self, fix: GpsFix) -> np.ndarray:
        """Where the antenna was, (3,) in `e`."""
        return self.from_geodetic(fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
