"""Cameras of every model at about the resolution of the pinhole one, so that only the lens makes a difference."""

from ..geometry.kannala_brandt import KannalaBrandt
from ..geometry.mei import Mei
from ..geometry.pinhole_radtan import PinholeRadtan
from ..geometry.pinhole_rational import PinholeRational
from ..geometry.scaramuzza import Scaramuzza

PINHOLE = PinholeRadtan(376, 240, 229.0, 228.6, 185.2, 121.5, -0.283, 0.0740, 1.9e-4, 1.8e-5)
FISHEYE = KannalaBrandt(360, 360, 110.0, 110.0, 179.2, 180.6, -0.012, 0.004, -0.003, 0.0006)
KB_190 = KannalaBrandt(600, 600, 184.0, 184.0, 299.2, 300.6, -0.012, 0.004, -0.003, 0.0006)  # 193 degrees across
MEI = Mei(480, 360, 1.35, 420.0, 419.0, 238.6, 181.2, -0.06, 0.02, 3e-4, -2e-4)  # 146
SCARAMUZZA = Scaramuzza(480, 360, -175.0, 0.0, 9.0e-4, -6.0e-7, 3.0e-9, 1.0008, 3e-4, -2e-4, 239.4, 181.3)  # 126
RATIONAL = PinholeRational(480, 320, 200.0, 200.4, 241.0, 158.5, 0.31, 0.02, 4e-4, -3e-4, 1e-3, 0.65, 0.06, 3e-3)  # 135
