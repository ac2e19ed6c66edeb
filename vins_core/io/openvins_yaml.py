"""OpenVINS' estimator_config.yaml, which names the two Kalibr files beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ..sensors import Calibration
from . import kalibr_yaml
from .yaml_file import Keys, read_yaml

CHAINS = ("relative_config_imucam", "relative_config_imu")
TUNING: dict[str, tuple[str, Callable[[float], Any]]] = {
    "num_pts": ("frontend.max_cnt", int),
    "min_px_dist": ("frontend.min_dist", int),
    "track_frequency": ("frontend.freq", float),
}


def recognizes(keys: Keys) -> bool:
    return all(key in keys for key in CHAINS)


def read(keys: Keys) -> tuple[Calibration, dict[str, Any], tuple[str, ...]]:
    """Sensors from the Kalibr files; gravity, the number of cameras and what to calibrate online from this one."""
    files = [Keys(path, read_yaml(path)) for path in (keys.path.parent / keys.text(key, "a file") for key in CHAINS)]
    count = keys.integer("max_cameras", "the number of cameras") if "max_cameras" in keys else kalibr_yaml.MAX_CAMERAS
    if count < 1:
        raise keys.wrong("max_cameras", count, "1 or more")
    calibration, _, notes = kalibr_yaml.read(files, min(count, kalibr_yaml.MAX_CAMERAS))
    calibration = replace(
        calibration,
        gravity_m_s2=keys.number("gravity_mag", "the norm of gravity in m/s^2", positive=True),
        estimate_td=_is_on(keys, "calib_cam_timeoffset"),
        extrinsics="refine" if _is_on(keys, "calib_cam_extrinsics") else "fixed",
        sources=(str(keys.path), *calibration.sources),
    )
    overrides = {
        parameter: convert(keys.number(key, f"a number for {parameter}"))
        for key, (parameter, convert) in TUNING.items()
        if key in keys
    }
    kept = tuple(note for note in notes if "gives no gravity" not in note)
    if _is_on(keys, "use_mask"):
        keys.used |= {"mask0", "mask1"}
        kept += (
            "use_mask: OpenVINS' masks are white where nothing is used, ours where something is: not used; "
            "invert them and name them in a vinspect calibration",
        )
    rest = [key for key in keys.unused() if key != "verbosity"]
    if rest:
        kept += (f"{len(rest)} keys are not used, they belong to OpenVINS' filter: {', '.join(rest)}",)
    return calibration, overrides, kept


def _is_on(keys: Keys, key: str) -> bool:
    value = keys.content.get(key, False)
    keys.used.add(key)
    if not isinstance(value, bool):
        raise keys.wrong(key, value, "true or false")
    return value
