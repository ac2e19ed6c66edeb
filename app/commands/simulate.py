from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from .arguments import Format
from .console import progress_bar

if TYPE_CHECKING:
    from vins_core.io.messages import Message

NAMES = (
    "room_loop, standstill, pure_rotation, constant_velocity, image_dropout, imu_gap, low_texture, td_offset, "
    "wrong_extrinsic, rolling_shutter, motion_blur, fisheye, level_camera, twin_rooms, building_first, "
    "building_second, kb190_camera, mei_camera, scaramuzza_camera, rational_camera, stereo, td_20ms, "
    "rolling_shutter_20ms, rough_extrinsics, unknown_extrinsics, depth_camera, street_gps"
)


def simulate(
    scenario: Positional[Annotated[str, arg(metavar="SCENARIO", help=f"one of {NAMES}")]],
    /,
    out: Annotated[Path, arg(metavar="PATH", help="file or folder that does not exist yet")],
    format: Format,
    seed: Annotated[int, arg(metavar="N", help="of noise, biases and pictures")] = 1,
    duration: Annotated[float | None, arg(metavar="S", help="by default the scenario's own")] = None,
) -> None:
    """Render a recording with known truth and its calibration."""
    import cv2

    from vins_core.io.messages import ImageMessage
    from vins_core.io.write import calibration_path, write_recording
    from vins_core.simulation.scenarios import SCENARIOS
    from vins_core.simulation.simulate import simulate

    cv2.setNumThreads(1)
    simulation = simulate(scenario, seed, duration)
    images, done = len(simulation.image_t_ns) * len(simulation.calibration.cameras), 0
    with progress_bar(f"rendering {scenario}") as report:

        def messages() -> Iterator[Message]:
            nonlocal done
            for message in simulation.messages():
                if isinstance(message, ImageMessage):
                    done += 1
                    report(done / images, f"image {done} of {images}")
                yield message

        written = write_recording(messages(), out, format, settings=simulation.settings)
    beside = "" if format == "asl" else f", calibration in {calibration_path(written)}"
    print(f"{written}: {images} images{beside}; {SCENARIOS[scenario].doc}")
