from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from vins_core.io.messages import ImuMessage
from vins_core.io.sync import ImuQueue
from vins_core.params import Frontend
from vins_core.record.regroup import regroup
from vins_core.sensors import Anomaly, DepthRef, GpsFix, ImageRef, Packet

MS = 1_000_000
TD_S = 0.0037


def recorded(every: int, images: int = 60, gap_ms: tuple[int, int] | None = None) -> list[Packet]:
    """Packets of a 20 Hz camera of which every n-th image is a frame, and of a 200 Hz IMU that misses its stamps."""
    queue, found, waiting = ImuQueue(), [], []
    for t in range(2 * MS, (images * 50 + 20) * MS, 5 * MS):
        if gap_ms is None or not gap_ms[0] <= t / MS < gap_ms[1]:
            queue.append(ImuMessage(t, "", np.array([t * 1e-9, 0, 0]), np.array([0, 0, 9.8])), False)
    for n in range(1, images):
        waiting.append(ImageRef(n * 50 * MS, 0, n))
        if n % every == 0:
            samples = queue.cut(n * 50 * MS + round(TD_S * 1e9))
            anomaly = Anomaly("gap", n, "", "")
            found.append(Packet(len(found), tuple(waiting), samples, (anomaly,)))
            waiting = []
    return found


@pytest.mark.parametrize("freq", [5.0, 10.0, 20.0])
def test_every_image_and_every_sample_is_kept_at_another_rate(freq: float) -> None:
    packets = recorded(every=2)
    found = list(regroup(packets, replace(Frontend(), freq=freq), 7, None))
    assert [p.frame for p in found] == list(range(7, 7 + len(found)))
    images = [i for p in found for i in p.images]
    assert images == [i for p in packets for i in p.images][: len(images)]
    assert {p.images[-1].t_ns - q.images[-1].t_ns for q, p in pairwise(found[1:])} == {round(1e9 / freq)}
    times = np.unique(np.concatenate([p.imu.t_ns for p in packets]))
    for before, after in pairwise(found):
        assert after.imu.t_ns[0] == before.imu.t_ns[-1] == before.t_ns + round(TD_S * 1e9)
        assert after.imu.t_ns[-1] == after.t_ns + round(TD_S * 1e9) and (np.diff(after.imu.t_ns) > 0).all()
        inside = times[(times > after.imu.t_ns[0]) & (times < after.imu.t_ns[-1])]
        assert np.isin(inside, after.imu.t_ns).all()
        np.testing.assert_allclose(after.imu.gyro_rad_s[:, 0], after.imu.t_ns * 1e-9, rtol=1e-12)
    told = [a for p in found for a in p.anomalies]
    assert told == [a for p in packets for a in p.anomalies][: len(told)]


@pytest.mark.parametrize("freq", [5.0, 20.0])
def test_depth_images_stay_with_their_images(freq: float) -> None:
    """Every third image has none."""

    def depth_of(image: ImageRef) -> DepthRef | None:
        return None if image.index % 3 == 0 else DepthRef(image.t_ns + MS, 0, image.index)

    packets = [replace(p, depths=tuple(depth_of(i) for i in p.images)) for p in recorded(every=2)]
    found = list(regroup(packets, replace(Frontend(), freq=freq), 0, None))
    assert len(found) > 10 and all(p.depths == tuple(depth_of(i) for i in p.images) for p in found)
    assert all(p.depths == () for p in regroup(recorded(every=2), replace(Frontend(), freq=freq), 0, None))


def test_the_clock_goes_on_at_the_frame_before() -> None:
    packets = recorded(every=2)
    found = list(regroup(packets[4:], replace(Frontend(), freq=5.0), 4, packets[3].t_ns))
    assert found[0].t_ns - packets[3].t_ns == 200 * MS
    assert found[0].imu.t_ns[0] == packets[4].imu.t_ns[0]


def test_an_image_in_a_gap_of_the_imu_is_only_tracked() -> None:
    packets = recorded(every=4, gap_ms=(1010, 1090))
    found = list(regroup(packets, replace(Frontend(), freq=20.0), 0, None))
    stamps = [p.t_ns // MS for p in found]
    assert 1050 not in stamps and {950, 1000, 1100, 1150} <= set(stamps)
    assert [i.index for p in found if p.t_ns == 1100 * MS for i in p.images] == [21, 22]


@pytest.mark.parametrize("freq", [5.0, 10.0, 20.0])
def test_fixes_come_with_the_first_frame_that_is_not_before_them(freq: float) -> None:
    stamps = iter(range(120 * MS, 3000 * MS, 130 * MS))
    waiting, packets = [next(stamps)], []
    for packet in recorded(every=2):
        while waiting[-1] <= packet.t_ns + round(TD_S * 1e9):
            waiting.append(next(stamps))
        fixes = tuple(GpsFix(t, 48.0, 11.0, 500.0, np.eye(3), 0) for t in waiting[:-1])
        packets.append(replace(packet, gps=fixes))
        waiting = waiting[-1:]
    found = list(regroup(packets, replace(Frontend(), freq=freq), 0, None))
    for before, after in pairwise(found):
        ends = [p.t_ns + round(TD_S * 1e9) for p in (before, after)]
        assert all(ends[0] < fix.t_ns <= ends[1] for fix in after.gps)
    kept = [fix.t_ns for p in found for fix in p.gps]
    assert kept == [fix.t_ns for p in packets for fix in p.gps][: len(kept)] and len(kept) > 15
