"""Cameras as Kalibr and EuRoC write them: a word for the projection, one for the distortion, two lists of numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..errors import CalibrationError
from ..geometry.camera import CameraModel, camera_from_dict, camera_to_dict
from .yaml_file import Keys

PINHOLE = ("fx", "fy", "cx", "cy")
RADTAN = ("k1", "k2", "p1", "p2")


class Form(NamedTuple):
    model: str
    intrinsics: tuple[str, ...]
    distortion: tuple[str, ...]


FORMS: dict[tuple[str, str], Form] = {
    ("pinhole", "radtan"): Form("pinhole-radtan", PINHOLE, RADTAN),
    ("pinhole", "radial-tangential"): Form("pinhole-radtan", PINHOLE, RADTAN),
    ("pinhole", "rational"): Form("pinhole-rational", PINHOLE, (*RADTAN, "k3", "k4", "k5", "k6")),
    ("pinhole", "equidistant"): Form("kannala-brandt", PINHOLE, ("k1", "k2", "k3", "k4")),
    ("omni", "radtan"): Form("mei", ("xi", *PINHOLE), RADTAN),
    ("omni", "radial-tangential"): Form("mei", ("xi", *PINHOLE), RADTAN),
    ("scaramuzza", "polynomial"): Form("scaramuzza", ("ac", "ad", "ae", "cx", "cy"), ("p0", "p1", "p2", "p3", "p4")),
}
UNDISTORTED = {"pinhole": "radtan", "omni": "radtan"}
"""What stands for `none`, with zeros."""


def read_camera(keys: Keys, coefficients: str) -> CameraModel:
    """The camera of `camera_model`, `distortion_model`, `resolution`, `intrinsics` and the key named `coefficients`."""
    camera = keys.text("camera_model", "pinhole or omni")
    distortion = keys.text("distortion_model", "radtan or equidistant")
    undistorted = distortion == "none" and camera in UNDISTORTED
    form = FORMS.get((camera, UNDISTORTED[camera] if undistorted else distortion))
    if form is None:
        known = ", ".join(" with ".join(words) for words in FORMS)
        raise CalibrationError(
            f"{keys.path}: key {keys.where}camera_model: {camera} with {distortion} is not supported; known are {known}"
        )
    width, height = keys.numbers("resolution", 2, "width and height in px")
    values = dict(zip(form.intrinsics, keys.numbers("intrinsics", len(form.intrinsics), ", ".join(form.intrinsics))))
    if undistorted:
        keys.used.add(coefficients)
        values |= dict.fromkeys(form.distortion, 0.0)
    else:
        numbers = keys.numbers(coefficients, len(form.distortion), ", ".join(form.distortion))
        values |= dict(zip(form.distortion, numbers))
    try:
        return camera_from_dict(form.model, width=width, height=height, **values)
    except CalibrationError as error:
        raise CalibrationError(f"{keys.path}: {error}") from error


def write_camera(camera: CameraModel, coefficients: str, radtan: str) -> dict[str, Any]:
    """What `read_camera` expects; `radtan` is the word for radial-tangential distortion."""
    values = camera_to_dict(camera)
    words, form = next((w, f) for w, f in FORMS.items() if f.model == values["model"] and w[1] != _other(radtan))
    return {
        "resolution": [values["width"], values["height"]],
        "camera_model": words[0],
        "intrinsics": [values[k] for k in form.intrinsics],
        "distortion_model": words[1],
        coefficients: [values[k] for k in form.distortion],
    }


def _other(radtan: str) -> str:
    return "radtan" if radtan == "radial-tangential" else "radial-tangential"
