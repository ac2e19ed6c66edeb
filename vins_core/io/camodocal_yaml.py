"""Camera blocks of camodocal, as VINS-Mono configs hold them and VINS-Fusion's camera files are (REFERENCE 4)."""

from __future__ import annotations

from collections.abc import Callable

from ..errors import CalibrationError
from ..geometry.camera import CameraModel, camera_from_dict
from .yaml_file import Keys

PINHOLE = ("fx", "fy", "cx", "cy")
RADTAN = ("k1", "k2", "p1", "p2")


def camera_model(keys: Keys) -> CameraModel:
    """The camera of a block; raises CalibrationError that names file and key."""
    keys.used |= {"camera_name"}
    kind = keys.text("model_type", f"one of {', '.join(MODELS)}").upper()
    if kind not in MODELS:
        raise CalibrationError(
            f"{keys.path}: key model_type: unknown camera model {kind!r}; known are {', '.join(MODELS)}"
        )
    name, read = MODELS[kind]
    size = {
        "width": keys.integer("image_width", "the image width in px"),
        "height": keys.integer("image_height", "the image height in px"),
    }
    values = read(keys)
    try:
        return camera_from_dict(name, **size, **values)
    except CalibrationError as error:
        raise CalibrationError(f"{keys.path}: {error}") from error


def _pinhole(keys: Keys) -> dict[str, float]:
    projection = keys.mapping("projection_parameters", "fx, fy, cx and cy")
    distortion = keys.mapping("distortion_parameters", "k1, k2, p1 and p2")
    return _numbers(projection, PINHOLE) | _numbers(distortion, RADTAN)


def _rational(keys: Keys) -> dict[str, float]:
    projection = keys.mapping("projection_parameters", "fx, fy, cx and cy")
    distortion = keys.mapping("distortion_parameters", "k1 to k6, p1 and p2")
    return _numbers(projection, PINHOLE) | _numbers(distortion, (*RADTAN, "k3", "k4", "k5", "k6"))


def _mei(keys: Keys) -> dict[str, float]:
    mirror = keys.mapping("mirror_parameters", "xi")
    distortion = keys.mapping("distortion_parameters", "k1, k2, p1 and p2")
    projection = keys.mapping("projection_parameters", "gamma1, gamma2, u0 and v0")
    gammas = dict(zip(PINHOLE, _numbers(projection, ("gamma1", "gamma2", "u0", "v0")).values()))
    return _numbers(mirror, ("xi",)) | gammas | _numbers(distortion, RADTAN)


def _kannala_brandt(keys: Keys) -> dict[str, float]:
    projection = keys.mapping("projection_parameters", "k2 to k5, mu, mv, u0 and v0")
    values = _numbers(projection, ("mu", "mv", "u0", "v0", "k2", "k3", "k4", "k5")).values()
    return dict(zip((*PINHOLE, "k1", "k2", "k3", "k4"), values))


def _scaramuzza(keys: Keys) -> dict[str, float]:
    """The inverse polynomial is not needed: the camera inverts the polynomial itself."""
    keys.used |= {"inv_poly_parameters"}
    polynomial = keys.mapping("poly_parameters", "p0 to p4")
    affine = keys.mapping("affine_parameters", "ac, ad, ae, cx and cy")
    return _numbers(polynomial, ("p0", "p1", "p2", "p3", "p4")) | _numbers(affine, ("ac", "ad", "ae", "cx", "cy"))


MODELS: dict[str, tuple[str, Callable[[Keys], dict[str, float]]]] = {
    "PINHOLE": ("pinhole-radtan", _pinhole),
    "PINHOLE_FULL": ("pinhole-rational", _rational),
    "KANNALA_BRANDT": ("kannala-brandt", _kannala_brandt),
    "MEI": ("mei", _mei),
    "SCARAMUZZA": ("scaramuzza", _scaramuzza),
}


def _numbers(keys: Keys, names: tuple[str, ...]) -> dict[str, float]:
    return {name: keys.number(name, "a number") for name in names}
