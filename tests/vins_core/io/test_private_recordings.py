"""Recordings that cannot be part of the project; their folder is named by VINS_DATA."""

import os
from pathlib import Path

import numpy as np
import pytest

from vins_core.io.calibration import read_calibration
from vins_core.io.recording import Recording, open_recording
from vins_core.io.sync import packets
from vins_core.io.write import convert
from vins_core.params import Params

pytestmark = pytest.mark.skipif("VINS_DATA" not in os.environ, reason="VINS_DATA is not set")


def open_named(name: str) -> tuple[Path, Recording]:
    path = Path(os.environ["VINS_DATA"]) / name
    return path, open_recording(path)


@pytest.mark.parametrize(
    ("name", "frames", "images", "lead_in_s"), [("euroc_mh01_16s", 159, 319, 5.1), ("sim_room_60s", 599, 1199, 0.1)]
)
@pytest.mark.parametrize("given", [True, False], ids=["vins_mono.yaml", "sensor.yaml"])
def test_packets_of_real_recordings(name: str, frames: int, images: int, lead_in_s: float, given: bool) -> None:
    path, recording = open_named(name)
    settings = read_calibration([path / "vins_mono.yaml"] if given else [], recording)
    found = list(packets(recording, settings.calibration, Params()))
    assert len(found) == frames and sum(len(p.pairs) for p in found) == images
    assert (found[0].t_ns - found[0].imu.t_ns[0]) * 1e-9 == pytest.approx(lead_in_s, abs=0.006)
    assert not any(p.anomalies for p in found)
    rows, columns = recording.load(found[5].images[-1]).shape
    assert (rows, columns) == (480, 752)


def test_a_real_recording_survives_a_bag(tmp_path: Path) -> None:
    _, source = open_named("euroc_mh01_16s")
    with open_recording(convert(source, tmp_path / "a.bag", "ros1")) as bag:
        for ours, theirs in ((bag.imu(), source.imu()), (bag.truth(), source.truth())):
            for name, value in vars(theirs).items():
                assert np.array_equal(getattr(ours, name), value)
        bag.use(read_calibration([tmp_path / "a.yaml"], bag).calibration)
        refs = list(bag.images())
        assert [bag.encoded(r) for r in refs[::40]] == [source.encoded(r) for r in list(source.images())[::40]]
