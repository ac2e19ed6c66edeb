"""A textured plane seen by a pinhole camera: every image is a homography of one texture, so all motion is known."""

import cv2
import numpy as np

from vins_core.frontend.state import TrackerState
from vins_core.geometry import so3
from vins_core.geometry.pinhole_radtan import PinholeRadtan
from vins_core.params import Frontend
from vins_core.sensors import CameraCalibration, ImageRef, ImuSamples, Packet

WIDTH, HEIGHT, FOCAL = 320, 240, 220.0
CAMERA = CameraCalibration(
    "cam0", PinholeRadtan(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, 0.0, 0.0, 0.0, 0.0), np.eye(4), "/cam0"
)
K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1.0]])
PARAMS = Frontend(max_cnt=60, min_dist=15)
STEP_NS = 50_000_000


def texture(seed=0, size=1200):
    """Smooth random blobs, with corners everywhere."""
    rng = np.random.default_rng(seed)
    image = cv2.resize(rng.uniform(0, 255, (size // 12, size // 12)), (size, size), interpolation=cv2.INTER_CUBIC)
    image += cv2.resize(rng.uniform(-60, 60, (size // 5, size // 5)), (size, size), interpolation=cv2.INTER_CUBIC)
    return np.clip(image, 0, 255).astype(np.uint8)


def homography(p=(0.0, 0.0, 0.0), w=(0.0, 0.0, 0.0), depth=2.0):
    """Pixels of the camera at the origin -> pixels of the camera at p, turned by w; the plane is z = depth."""
    R = so3.to_matrix(so3.exp(np.array(w, float))).T
    return K @ R @ (np.eye(3) - np.outer(p, [0, 0, 1]) / depth) @ np.linalg.inv(K)


def move(H, uv):
    return cv2.perspectiveTransform(np.asarray(uv, float)[:, None], H)[:, 0]


def render(H, canvas=None):
    canvas = texture() if canvas is None else canvas
    centre = np.array([[1, 0, WIDTH / 2 - canvas.shape[1] / 2], [0, 1, HEIGHT / 2 - canvas.shape[0] / 2], [0, 0, 1.0]])
    return cv2.warpPerspective(canvas, H @ centre, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR)


class Film:
    """An image source over arrays that counts how often each image is loaded."""

    def __init__(self, images):
        self.images, self.loads = images, []

    def load(self, ref):
        self.loads.append(ref.index)
        return self.images[ref.index]


def ref(index, t_ns=None):
    return ImageRef(index * STEP_NS if t_ns is None else t_ns, 0, index)


def packet(frame, *refs):
    return Packet(frame, refs, ImuSamples.empty())


def film(n=9, velocity=(0.02, 0.01, 0.0), turn=(0.0, 0.0, 0.002), **kwargs):
    """n images at constant velocity (m and rad per image) and their homographies from the first."""
    Hs = [homography(np.array(velocity) * k, np.array(turn) * k, **kwargs) for k in range(n)]
    return Film([render(H) for H in Hs]), Hs


def packets(n, per_frame=2):
    """The first image alone, then `per_frame` images a frame."""
    yield packet(0, ref(0))
    for frame, first in enumerate(range(1, n - per_frame + 1, per_frame), 1):
        yield packet(frame, *(ref(i) for i in range(first, first + per_frame)))


def start():
    return TrackerState.empty()
