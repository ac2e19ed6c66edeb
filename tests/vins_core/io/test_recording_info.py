"""`info`: what is in a recording and what is odd about it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny_recording import FORMATS, T0, gps, images, imus, in_time_order, picture, recorded, truth

from vins_core.io.inspect import inspect
from vins_core.io.messages import ImageMessage


@pytest.mark.parametrize("format", FORMATS)
def test_info_lists_topics_roles_counts_and_rates(tmp_path: Path, format: str) -> None:
    messages = [*imus(), *images(), *(truth(T0 + k * 10_000_000) for k in range(201)), gps(T0), gps(T0 + 10**9)]
    info = inspect(recorded(tmp_path, in_time_order(messages), format))
    found = {s.role: (s.count, round(s.rate_hz or 0, 6)) for s in info.streams if s.role != "other"}
    assert found == {"imu": (401, 200.0), "image": (41, 20.0), "truth": (201, 100.0), "gps": (2, 1.0)}
    assert (info.kind, info.duration_s, info.counts) == (format, 2.0, {})
    assert next(s.image for s in info.streams if s.role == "image") == "64x48 jpeg"


def test_info_is_plain_json(tmp_path: Path) -> None:
    samples = imus()
    samples[7] = replace(samples[7], gyro_rad_s=np.array([np.nan, 0, 0]))
    info = inspect(recorded(tmp_path, [*samples[:300], *samples[340:], *images()], "mcap"))
    found = json.loads(json.dumps(info.to_dict()))
    assert found["counts"] == {"nan": 1, "gap": 1}
    assert found["streams"][1]["longest_gap_s"] == pytest.approx(0.205)
    assert [a["kind"] for a in found["anomalies"]] == ["nan", "gap"]
    assert found["duration_s"] == 2.0


def test_info_reads_recordings_whose_topics_are_ambiguous(tmp_path: Path) -> None:
    messages = in_time_order([*imus(0, 1), *images(0, 1), *images(0, 1, topic="/cam1")])
    info = inspect(recorded(tmp_path, messages, "ros1"))
    assert [s.topic for s in info.streams if s.role == "image"] == ["/cam0/image_raw/compressed", "/cam1/compressed"]


@pytest.mark.parametrize(
    ("span", "said"),
    [
        ((10.0, 11.0), "do not overlap in time"),
        ((0.5, 2.0), "begins 0.500 s before /imu0"),
        ((0.0, 1.5), "ends 0.500 s after /imu0"),
    ],
)
def test_images_without_imu_are_told(tmp_path: Path, span: tuple[float, float], said: str) -> None:
    info = inspect(recorded(tmp_path, [*imus(*span), *images()]))
    assert [said in a.message for a in info.anomalies if a.kind == "no_imu"] == [True]


def test_an_image_that_cannot_be_read_does_not_hide_the_rest(tmp_path: Path) -> None:
    broken = ImageMessage(T0, "/cam0/image_raw", "jpeg", b"nothing")
    info = inspect(recorded(tmp_path, [*imus(), broken]))
    assert any("cannot be read: 7 bytes" in s.image for s in info.streams)
    assert len(info.streams) == 2


def test_depth_images_are_not_taken_for_the_camera(tmp_path: Path) -> None:
    depth = [ImageMessage(T0 + k, "/depth", "16UC1", picture(k, dtype=np.uint16)) for k in range(3)]
    recording = recorded(tmp_path, [*images(0, 0.2), *depth], "ros1")
    assert {s.topic: s.role for s in recording.streams}["/depth"] == "depth"
    assert recording.image_topics == ("/cam0/image_raw/compressed",)


def test_progress_grows_to_the_end(tmp_path: Path) -> None:
    shares: list[float] = []
    inspect(recorded(tmp_path, [*imus(), *images()]), shares.append)
    assert shares == sorted(shares) and 0.95 < shares[-1] <= 1.0 and 50 <= len(shares) <= 101
